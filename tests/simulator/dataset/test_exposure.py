"""Exposures that make useless data are refused or told, with the number that would do."""

import json
import re
from typing import Any

import numpy as np
import pytest

from simulator.camera.exposure import ExposureShares
from simulator.dataset import generate, open_dataset, verify
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

SENSOR = {"binning": 8, "shape": [48, 60]}
PHYSICAL = {"noise": {"type": "physical"}}
USELESS: dict[str, tuple[str, dict[str, Any]]] = {
    "far too bright": ("camera.exposure.full_scale", {"exposure": {"full_scale": 1e-12}}),
    "far too dark": ("camera.exposure.full_scale", {"exposure": {"full_scale": 1e15}}),
    "without noise": ("camera.exposure.full_scale", {"exposure": {"full_scale": 1e15}, "noise": {"type": "none"}}),
    "a nearby star": (
        "camera.exposure.illuminance_lux",
        PHYSICAL
        | {
            "sensor": SENSOR | {"full_well_e": 50},
            "exposure": {"illuminance_lux": 1e9},
            "shutter": {"exposure_ms": 900},
        },
    ),
    "deep space": ("camera.exposure.illuminance_lux", PHYSICAL | {"exposure": {"illuminance_lux": 1e-6}}),
    "a hot sensor": (
        "camera.sensor.dark_current_e_per_s",
        PHYSICAL
        | {"sensor": SENSOR | {"dark_current_e_per_s": 1e6, "full_well_e": 3000}, "exposure": {"full_scale": "auto"}},
    ),
}


@pytest.mark.parametrize("case", USELESS)
def test_data_without_signal_are_refused_before_the_first_sample(trial, case: str) -> None:
    key, camera = USELESS[case]
    with pytest.raises(InputError, match=f"^{key}: ".replace(".", r"\.")) as caught:
        generate(trial.write(camera=camera))
    assert "--accept-exposure" in str(caught.value)
    assert not (trial.folder / "out").exists()


@pytest.mark.parametrize("case", ["far too bright", "far too dark", "a nearby star"])
def test_the_number_that_the_refusal_names_would_do(trial, case: str) -> None:
    key, camera = USELESS[case]
    with pytest.raises(InputError) as caught:
        generate(trial.write(camera=camera))
    found = re.search(r"chooses (\S+)$|; (\S+) lux", str(caught.value).partition(". Such data")[0])
    assert found is not None
    said: list[str] = []
    generate(trial.path, [f"{key}={found[1] or found[2]}"], say=said.append)
    assert [line for line in said if line.startswith("exposure, ")]
    assert not [line for line in said if line.startswith("note: camera.exposure")]


def test_useless_data_on_purpose(trial) -> None:
    said: list[str] = []
    path = trial.write(camera={"exposure": {"full_scale": 1e-12}})
    root = generate(path, accept_exposure=True, say=said.append).path
    assert any(line.startswith("note: camera.exposure.full_scale: ") for line in said)
    assert json.loads((root / "dataset.json").read_text())["exposure"]["pilot_shares"]["signal"] == 0
    assert verify(root).ok


def test_shares_are_said_of_a_few_pilots_and_of_all_samples(trial) -> None:
    """Of a given exposure too; the last line is over all samples, those of an earlier run included."""
    camera = {"exposure": {"full_scale": 1.2e-6}}
    root = generate(trial.write(camera=camera)).path
    exposure = json.loads((root / "dataset.json").read_text())["exposure"]
    assert exposure["pilots"] == 4
    assert exposure["auto_full_scale"] > 1.5e-6
    assert 0.01 < exposure["pilot_shares"]["saturated"] < 0.5
    said: list[str] = []
    generate(trial.write(camera=camera, dataset={"train": 5}), say=said.append)
    samples = [sample for split in ("train", "validation", "test") for sample in open_dataset(root, split)]
    saturated = np.mean([sample.metadata["saturated_share"] for sample in samples])
    assert np.mean([np.mean(sample.noiseless >= 1) for sample in samples]) == pytest.approx(saturated, abs=1e-3)
    lines = [line for line in said if line.startswith("exposure, ")]
    assert len(lines) == 1
    assert lines[0].startswith(f"exposure, 7 samples: {saturated:.2%} of the values saturated")
    assert [line for line in said if line.startswith("note: camera.exposure.full_scale: ")]


def test_an_exposure_that_suits_is_not_complained_of(trial) -> None:
    said: list[str] = []
    generate(trial.write(camera={"exposure": {"full_scale": "auto"}}), say=said.append)
    assert [line.partition(":")[0] for line in said if line.startswith("exposure")] == [
        "exposure, 16 pilot samples",
        "exposure, 5 samples",
    ]
    assert not [line for line in said if line.startswith("note: camera")]


def test_pilots_that_cannot_be_made_hinder_no_given_exposure(trial) -> None:
    for scene in ({"fail_at": 1}, {"depth_m": 0.5}):
        said: list[str] = []
        scene |= {"family": "./plugins.py:boxes", "size": [16, 20]}
        result = generate(
            trial.write(scene=scene, dataset={"output": f"out{len(scene)}{'fail_at' in scene}"}), say=said.append
        )
        assert len(result.failed) == (1 if "fail_at" in scene else 5)
        assert any("1 of 4 exposure pilots" in line for line in said) == ("fail_at" in scene)


def test_shares_are_read_from_metadata_that_hold_all_of_them() -> None:
    assert ExposureShares.from_record({"saturated_share": 0.5}) is None
    shares = ExposureShares(0.25, 0.5, 0.5, 0.125)
    assert ExposureShares.from_record({"clamped": 1, **shares.record}) == shares
    assert ExposureShares.mean([shares, ExposureShares(0.75, 0, 0, 0.25)]) == ExposureShares(0.5, 0.25, 0.25, 0.1875)
