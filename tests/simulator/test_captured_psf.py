"""The stack as captured from a configuration: nothing wrong gives the nominal one, all is recorded, the seed decides."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.captured_psf import captured_stack, check_calibration
from simulator.config import load_config
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

NO_ERROR = {
    "source_um": 0,
    "illuminant": "camera",
    "depth_offset_mm": 0,
    "depth_std_mm": 0,
    "shift_std_um": 0,
    "tilt_deg": [0, 0],
    "pedestal_percent": 0,
    "glow_percent": 0,
    "noise": "none",
}
pytestmark = pytest.mark.filterwarnings("ignore::simulator.optics.error_budget.sampling.SamplingWarning")
PSF = {"depths_cm": [3.6, 20, "inf"], "wavelengths_per_channel": 2, "accept_error": 1}


@pytest.fixture
def capture(trial) -> Callable[..., tuple[PsfStack, PsfStack]]:
    def both(*overrides: str, **settings: Any) -> tuple[PsfStack, PsfStack]:
        path = trial.write(psf=PSF | {"as_captured": settings})
        config = load_config(path, overrides)
        nominal = Assembly(config).psf_stack
        return nominal, captured_stack(Assembly(config).having(psf_stack=nominal))

    return both


def distance(nominal: PsfStack, captured: PsfStack) -> float:
    return float(np.linalg.norm(captured.values - nominal.values) / np.linalg.norm(nominal.values))


@pytest.mark.slow
def test_a_perfect_laboratory_measures_the_nominal_stack(capture) -> None:
    nominal, captured = capture(**NO_ERROR)
    assert distance(nominal, captured) < 1e-6  # float32
    assert captured.values.dtype == np.float32
    assert captured.fingerprint != nominal.fingerprint


@pytest.mark.parametrize(
    "one",
    [
        {"source_um": 400},
        {"illuminant": {"led_nm": 640, "fwhm_nm": 20}},
        {"depth_offset_mm": 2},
        {"depth_std_mm": 2},
        {"shift_std_um": 300},
        {"tilt_deg": [0.5, 0]},
        {"pedestal_percent": 1, "background": "none"},
        {"glow_percent": 2, "background": "border"},
        {"noise": "physical", "frames": 1},
    ],
)
@pytest.mark.slow
def test_every_key_reaches_the_stack(capture, one) -> None:
    """How much each error does is tested where it is made; a key without effect would leave rounding, 1e-7."""
    nominal, captured = capture(**(NO_ERROR | one))
    assert distance(nominal, captured) > 1e-3


@pytest.mark.slow
def test_an_led_is_seen_by_every_channel(capture) -> None:
    _, captured = capture(**(NO_ERROR | {"illuminant": {"led_nm": 530, "fwhm_nm": 10}}))
    # Deep blue light spreads less than daylight's red: the grid must stay the nominal one all the same.
    nominal, blue = capture(**(NO_ERROR | {"illuminant": {"led_nm": 440, "fwhm_nm": 10}}))
    assert blue.values.shape == nominal.values.shape
    for channel in "RGB":
        centroid = sum(w * weight for c, w, weight in captured.provenance["lines"] if c == channel)
        # Within a tenth of its width: the channel's slope and the photons' factor pull a little.
        assert centroid == pytest.approx(530e-9, abs=1e-9)
    assert "530 nm" in captured.provenance["response"]


def test_everything_is_recorded(capture) -> None:
    nominal, captured = capture(depth_offset_mm=0.5, depth_std_mm=0, shift_std_um=0, tilt_deg=[0.3, 0.0])
    record = captured.provenance
    assert (record["kind"], record["nominal_fingerprint"]) == ("captured", nominal.fingerprint)
    assert record["true_depths_m"] == [pytest.approx(0.0365), pytest.approx(0.2005), "inf"]
    assert record["shifts_m"][0] == [0, 0]
    assert record["shifts_m"][2] == [pytest.approx(1.9e-3 * np.tan(np.radians(0.3))), 0]
    assert record["settings"]["diameter_m"] == pytest.approx(25e-6)
    assert len(record["recordings"]) == 3
    assert all(30 < entry["snr_db"] < 90 for entry in record["recordings"])
    assert record["sampling"] == nominal.provenance["sampling"]  # the model's own error stays
    np.testing.assert_array_equal(captured.depths_m, nominal.depths_m)  # what the laboratory assumes


@pytest.mark.slow
def test_the_seed_decides(capture, monkeypatch, tmp_path) -> None:
    _, first = capture()
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "another"))
    _, again = capture()
    np.testing.assert_array_equal(first.values, again.values)
    assert first.provenance == again.provenance
    _, other = capture("seed=12")
    assert not np.array_equal(other.values, first.values)
    assert other.fingerprint != first.fingerprint


def test_a_measured_psf_is_refused(trial, capture) -> None:
    from simulator.optics.stack_files import write_psf_stack

    nominal, _ = capture(**NO_ERROR)
    write_psf_stack(trial.folder / "stack", nominal)
    config = load_config(trial.write(camera={"mask": None}, psf={"measured": "stack"}))
    with pytest.raises(InputError, match=r"^psf\.as_captured: "):
        captured_stack(Assembly(config).having(psf_stack=nominal))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"illuminant": "Bengal"}, r"^psf\.as_captured\.illuminant: "),
        ({"illuminant": {"led_nm": 1500, "fwhm_nm": 20}}, r"^psf\.as_captured\.illuminant: "),
        ({"depth_offset_mm": -50}, r"^psf\.as_captured\.depth_offset_mm, depth_std_mm: "),
        (
            {"peak_percent": 100, "pedestal_percent": 30, "glow_percent": 0},
            r"^psf\.as_captured\.peak_percent \+ pedestal_percent \+ glow_percent: ",
        ),
    ],
)
def test_a_calibration_that_cannot_be_is_told_beforehand(trial, settings, words) -> None:
    config = load_config(trial.write(psf=PSF | {"as_captured": settings}))
    with pytest.raises(InputError, match=words):
        check_calibration(Assembly(config))


def test_only_a_file_of_the_calibrations_light_is_an_input(trial) -> None:
    (trial.folder / "lamp.csv").write_text("400,1\n700,2\n")
    (trial.folder / "camera").write_text("400,1\n700,2\n")
    for light, found in (("lamp.csv", 1), ("camera", 0)):
        config = load_config(trial.write(psf=PSF | {"as_captured": {"illuminant": light}}))
        names = [path.name for path in Assembly(config, "none").input_files]
        assert names.count(light) == found
