"""What is compared, through which camera, and whether the figures are those of the PSFs."""

import re
from pathlib import Path

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.plots.comparison import COLUMNS, NOTES, cameras_in_words, load_configs, measure


def test_the_figures_of_a_gaussian(gaussian_candidate) -> None:
    candidate = gaussian_candidate(sigmas=(3.0, 4.0))
    assert candidate.width_m[1] / candidate.width_m[0] == pytest.approx(4 / 3, rel=0.01)
    # Two Gaussians: C = 2 s t / (s^2 + t^2) in two dimensions, and N = 1 / mean C^2, C^2 linear in between.
    assert candidate.distinct_depths == pytest.approx(3 / (2 + (2 * 3 * 4 / (3**2 + 4**2)) ** 2))
    assert candidate.transmitted_m2 == 2e-6
    np.testing.assert_allclose(candidate.received_m2, [1.5e-6, 1e-6])  # a quarter and a half miss the sensor
    assert [view.name for view in candidate.views] == ["4 cm", "20 cm"]


def test_the_cells_of_the_table(gaussian_candidate) -> None:
    cells = {column.title: column.cell(gaussian_candidate()) for column in COLUMNS}
    assert re.fullmatch(r"99\.\d µm / 133 µm|100 µm / 133 µm", cells["Autocorrelation width"])
    assert cells["Distinct depths"] == "1.03"
    assert cells["Transmitted area"] == "2 mm²"
    assert cells["Light on sensor"] == "1.5 mm² / 1 mm²"
    assert cells["Light off sensor"] == "25 % / 50 %"
    assert cells["Errors"] == "1.2 % / ? / 34 %"  # the worst channel's; no model error was recorded
    assert "nearest / at the farthest" in NOTES


def test_one_depth_has_one_figure(gaussian_candidate) -> None:
    candidate = gaussian_candidate(sigmas=(3.0,))
    assert len(candidate.views) == len(candidate.width_m) == 1
    assert candidate.distinct_depths == pytest.approx(1)
    assert "/" not in "".join(column.cell(candidate) for column in COLUMNS if column.title != "Errors")


def test_depths_too_far_apart_are_told(gaussian_candidate) -> None:
    """Gaussians of 3 and 24 pixels have a correlation of a quarter: what lies between them was not looked at."""
    cell = next(column.cell for column in COLUMNS if column.title == "Distinct depths")
    assert cell(gaussian_candidate(sigmas=(3.0, 24.0))).startswith("about 1.")


def test_different_cameras_are_told(gaussian_candidate) -> None:
    same = [gaussian_candidate("a"), gaussian_candidate("b")]
    assert cameras_in_words(same) == "One camera for all: a camera."
    assert cameras_in_words([*same, gaussian_candidate("c", camera="another")]).startswith("These cameras differ.")


class TestConfigs:
    def test_designs_share_the_base_configuration(self, trial) -> None:
        words = ["pinhole", "{design: pinhole, diameter_um: 80}", "pinhole"]
        configs = load_configs(words, trial.write(), ["psf.depths=2"])
        assert list(configs) == ["pinhole", "pinhole, diameter_um 80", "pinhole (2)"]
        assert {config.camera.mask_to_sensor_mm for config in configs.values()} == {1.9}
        assert [config.camera.mask.params["diameter_um"] for config in configs.values() if config.camera.mask] == [
            40,
            80,
            40,
        ]
        assert all(config.psf.depths == 2 for config in configs.values())

    def test_an_override_of_the_mask_reaches_every_design(self, trial) -> None:
        configs = load_configs(["phlatcam", "diffusercam"], trial.write(), ["camera.mask.width_mm=0.5"])
        assert [config.camera.mask.params["width_mm"] for config in configs.values() if config.camera.mask] == [
            0.5,
            0.5,
        ]

    def test_a_configuration_keeps_its_own_camera(self, trial, tmp_path: Path) -> None:
        own = tmp_path / "far.yaml"
        own.write_text(trial.write(camera={"mask_to_sensor_mm": 5}).read_text())
        configs = load_configs(["pinhole", str(own)], trial.write())
        assert {name: config.camera.mask_to_sensor_mm for name, config in configs.items()} == {"pinhole": 1.9, "far": 5}

    def test_no_base_is_needed_for_configurations(self, trial, tmp_path: Path) -> None:
        assert list(load_configs([str(trial.write())], tmp_path / "absent.yaml")) == ["trial"]

    def test_a_file_is_named_from_the_current_folder(self, trial, tmp_path: Path, monkeypatch) -> None:
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        (elsewhere / "mine.py").write_text(trial.plugins.read_text())
        monkeypatch.chdir(elsewhere)
        (config,) = load_configs(["./mine.py:corners"], trial.write()).values()
        assert config.camera.mask is not None
        assert config.camera.mask.design == f"{elsewhere / 'mine.py'}:corners"

    @pytest.mark.parametrize(
        ("word", "message"),
        [
            ("phlatcm", "did you mean 'phlatcam'"),
            ("{design: pinhole, diametr_um: 8}", "did you mean 'diameter_um'"),
            ("absent.yaml", "absent.yaml"),
        ],
    )
    def test_mistakes_are_named(self, trial, word: str, message: str) -> None:
        with pytest.raises(InputError, match=re.escape(message)):
            load_configs([word], trial.write())


@pytest.mark.filterwarnings("ignore:the PSF's sampling error")
def test_a_configuration_is_measured(trial) -> None:
    from simulator.assembly import Assembly
    from simulator.optics.metrics import light_off_sensor

    steps = []
    (config,) = load_configs(["{design: pinhole, diameter_um: 200, pixel_um: 4}"], trial.write()).values()
    candidate = measure("hole", config, progress=lambda *step: steps.append(step))
    stack, mask = Assembly(config).psf_stack, Assembly(config).mask
    assert mask is not None
    assert steps[-1] == ("PSFs of hole", 9, 9)
    assert "3 of 3 compared" in candidate.camera
    ends = measure("hole", config, depths=2)
    assert "2 of 3 compared" in ends.camera
    assert ends.correlations.shape == (2, 2)
    assert ends.width_m == candidate.width_m
    assert candidate.camera.startswith(
        "48 x 60 pixels of 19.2 µm, 1.9 mm from the mask; scene of 16 x 20; depths of 3.6 cm"
    )
    assert candidate.transmitted_m2 == pytest.approx(mask.transmitted_area_m2)
    off = light_off_sensor(stack, (48, 60), (16, 20))
    assert candidate.received_m2[0] == pytest.approx(np.mean(stack.energy_m2()[0] * (1 - off[0])))
    assert candidate.received_m2[0] < candidate.transmitted_m2
    assert candidate.errors[0] == stack.provenance["sampling"]["error"]
    assert None not in candidate.errors
    assert dict(candidate.facts)["mask"].startswith("pinhole")
