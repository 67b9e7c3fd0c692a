"""Stacks from folders, and measured stacks at other planes, as a configuration asks for them."""

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.errors import InputError
from simulator.optics.interpolation import interpolate_stack
from simulator.optics.stack_files import write_psf_stack

pytestmark = pytest.mark.filterwarnings("ignore::simulator.optics.error_budget.sampling.SamplingWarning")
NO_MASK = {"mask": None}


@pytest.fixture
def stored(trial):
    """The trial's own stack, written beside its YAML file as ``psf --output`` does."""
    stack = Assembly(load_config(trial.write())).psf_stack
    write_psf_stack(trial.folder / "stack", stack)
    return stack


def build(trial, **psf):
    return Assembly(load_config(trial.write(camera=NO_MASK, psf=psf))).psf_stack


def test_a_written_stack_comes_back_as_it_was(trial, stored) -> None:
    back = build(trial, measured="stack")
    np.testing.assert_array_equal(back.values, stored.values)
    assert (back.fingerprint, back.provenance["kind"]) == (stored.fingerprint, "computed")
    view = Assembly(load_config(trial.path)).view
    assert (view.near_m, view.far_m) == pytest.approx((0.036, 0.2))


def test_its_files_decide_a_data_set(trial, stored) -> None:
    config = load_config(trial.write(camera=NO_MASK, psf={"measured": "stack"}))
    names = [path.name for path in Assembly(config, "none").input_files]
    assert {"psf.json", "depth_0000.exr", "depth_0001.exr", "depth_0002.exr"} <= set(names)


def test_a_data_sets_folder_serves_too(trial) -> None:
    root = trial.generate()
    stack = build(trial, measured=str(root))
    assert len(stack.depths_m) == 3


def test_planes_are_interpolated_and_the_scene_follows_them(trial, stored) -> None:
    planes = {"near_cm": 4, "far_cm": 10, "depths": 4}
    found = build(trial, measured="stack", planes=planes)
    expected = interpolate_stack(stored, found.depths_m.tolist(), 1.9e-3)
    np.testing.assert_array_equal(found.values, expected.values)
    assert found.depths_m[[0, -1]] == pytest.approx([0.04, 0.1])
    view = Assembly(load_config(trial.path)).view
    assert (view.near_m, view.far_m) == pytest.approx((0.04, 0.1))


def test_images_at_other_planes(trial) -> None:
    light = np.zeros((2, 41, 41))
    light[:, 15:26, 12:20] = 1
    np.save(trial.folder / "psf.npy", light)
    images = {
        "measured": ["psf.npy"],
        "depths_cm": [5, 20],
        "frame": "stored",
        "background": "none",
        "throughput_mm2": 1,
    }
    found = build(trial, **images, planes={"depths_cm": [5, 10, 30], "extrapolate": True})
    assert found.provenance["interpolation"]["planes"][2]["extrapolated"]
    assert found.provenance["kind"] == "measured"
    with pytest.raises(InputError, match=r"^depths_m: "):
        build(trial, **images, planes={"depths_cm": [30]})


def test_mistakes_are_named(trial, stored) -> None:
    with pytest.raises(InputError, match="nowhere: "):
        build(trial, measured="nowhere")
    images = {"measured": ["no.tif"], "depths_cm": [5], "frame": "stored", "throughput_mm2": 1}
    with pytest.raises(InputError, match=r"^psf\.measured\[0\]: "):
        build(trial, **images)
    (trial.folder / "psf.tif").write_bytes(b"")
    with pytest.raises(InputError, match=r"^psf\.measured: "):
        build(trial, measured="psf.tif")
    camera = NO_MASK | {"sensor": {"binning": 4, "shape": [48, 60]}}
    with pytest.raises(InputError, match=r"^psf\.measured: "):
        _ = Assembly(load_config(trial.write(camera=camera, psf={"measured": "stack"}))).psf_stack


@pytest.mark.parametrize(
    ("made", "now", "words"),
    [
        (
            {"mask_to_sensor_mm": 1.9},
            {"mask_to_sensor_mm": 2.1},
            r"with 1\.9 mm of air.*the camera has 2\.1 mm; set camera",
        ),
        (
            {"mask_to_sensor_mm": None, "gap": [{"mm": 3, "n": 1.5}]},
            {"mask_to_sensor_mm": 1.9},
            r"with 2 mm of air.*the camera has 1\.9 mm",
        ),
        (
            {"mask_to_sensor_mm": None, "gap": [{"mm": 3, "n": 1.5}]},
            {"mask_to_sensor_mm": None, "gap": [{"mm": 1, "n": "air"}, {"mm": 1.5, "n": 1.5}]},
            r"behind a gap of 3 mm n = 1\.5, the camera's is 1 mm air \+ 1\.5 mm n = 1\.5; set camera\.gap",
        ),
        ({"mask_to_sensor_mm": 1.9}, {"mask_to_sensor_mm": None, "gap": [{"mm": 1.9, "n": "air"}]}, None),
        ({"mask_to_sensor_mm": None, "gap": [{"mm": 3, "n": 1.5}]}, {"mask_to_sensor_mm": 2}, None),
    ],
)
def test_a_stack_of_another_gap_is_refused(trial, made, now, words) -> None:
    write_psf_stack(trial.folder / "stack", Assembly(load_config(trial.write(camera=made))).psf_stack)
    config = load_config(trial.write(camera=NO_MASK | now, psf={"measured": "stack"}))
    if words is None:
        assert Assembly(config).psf_stack.provenance["kind"] == "computed"
    else:
        with pytest.raises(InputError, match=words):
            _ = Assembly(config).psf_stack
