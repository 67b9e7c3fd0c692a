"""What ``psf_library`` promises: designs by name, stacks from a data set, a folder or a configuration."""

import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from psf_library import load_mask, load_psf_stack
from simulator import arrays as memory
from simulator.errors import InputError
from simulator.plugins import available, resolve

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

# Relative files are taken from a folder that holds map.npy.
SMALL = {
    "amplitude_image": {"file": "map.npy", "feature_um": 4.0},
    "diffusercam": {"width_mm": 0.6},
    "flatcam": {"order": 4},
    "fresnel_zone": {"width_mm": 0.6},
    "height_map": {"file": "map.npy", "pixel_um": 2.0, "unit_um": 1.0},
    "lens": {"width_mm": 0.2},
    "mura": {"rank": 11},
    "phlatcam": {"width_mm": 0.6, "iterations": 2},
    "pinhole": {},
    "random_lenslets": {"width_mm": 0.6},
    "spiral": {"width_mm": 0.6},
    "vortex": {"width_mm": 0.2},
}


def test_every_design_has_a_small_example_here() -> None:
    assert set(available("mask")) == set(SMALL)


@pytest.mark.parametrize(("design", "params"), SMALL.items())
def test_designs_by_name(design: str, params: dict[str, Any], tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.eye(30))
    mask, again = load_mask(design, tmp_path, **params), load_mask(design, tmp_path, **params)
    assert mask.name == design
    assert mask.digest() == again.digest()
    assert mask.height_m.dtype == mask.amplitude.dtype == np.float32
    assert mask.transmitted_area_m2 > 0
    if "seed" in inspect.signature(resolve("mask", design).function).parameters:
        assert {load_mask(design, tmp_path, **params, seed=seed).digest() for seed in (0, 2)}.isdisjoint(
            {mask.digest()}
        )
    if "width_mm" in params:
        assert mask.shape[0] * mask.pitch_m == pytest.approx(params["width_mm"] * 1e-3, rel=0.01)


@pytest.mark.parametrize("design", sorted(set(SMALL) - {"height_map"}))  # whose grid is its file's
def test_a_grid_that_exceeds_the_memory_is_refused_before_it_is_allocated(
    design: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "map.npy", np.eye(30))
    plugin = resolve("mask", design, tmp_path)
    arguments = plugin.bind(SMALL[design])
    monkeypatch.setattr(memory, "machine_bytes", lambda: 10_000)
    with pytest.raises(InputError, match=r"^pixel_um: "):
        plugin.function(**arguments)


def test_memory_that_runs_out_within_a_design_is_told_with_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("psf_library.designs.flatcam.sequence", exhausted)
    with pytest.raises(InputError, match=r"^mask design 'flatcam': "):
        load_mask("flatcam", order=3, feature_um=77, pixel_um=7)


@pytest.mark.parametrize("design", ["diffusercam", "lens", "phlatcam", "random_lenslets", "spiral", "vortex"])
def test_a_material_that_delays_no_light_is_refused(design: str) -> None:
    with pytest.raises(InputError, match=r"^material: "):
        load_mask(design, **SMALL[design], material="air")


def test_a_stack_from_each_of_its_places(trial, flatlight) -> None:
    path = trial.write()
    described = load_psf_stack(path)
    assert flatlight("psf", path, "--output", trial.folder / "stack")[0] == 0
    root = trial.generate()
    for place in (root, root / "psf", str(root), trial.folder / "stack"):
        stack = load_psf_stack(place)
        assert np.array_equal(stack.values, described.values)
        assert (stack.fingerprint, stack.channels) == (described.fingerprint, described.channels)


def test_no_stack(tmp_path: Path) -> None:
    for place in (tmp_path, tmp_path / "nowhere", tmp_path / "none.yaml"):
        with pytest.raises(InputError, match=re.escape(str(place))):
            load_psf_stack(place)
