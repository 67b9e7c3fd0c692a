"""An absolute scale: electrons counted by hand from lux, and what a fast shutter costs."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.errors import InputError
from simulator.optics.spectra import camera_curves
from simulator.types import Clip

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")
H, C = 6.62607015e-34, 299792458.0


def _config(trial, *, ms=5.0, camera=None, **changes):
    lit = {"exposure": {"illuminance_lux": 800}, "shutter": {"exposure_ms": ms}, "noise": {"type": "physical"}}
    return load_config(trial.write(camera=lit | (camera or {}), **changes))


def _white(level=1.0):
    rgb = np.full((1, 16, 20, 3), level, np.float32)
    return Clip(rgb, np.full((1, 16, 20), 0.1, np.float32), np.ones((1, 16, 20), bool), np.array([0.0, 1.0]))


def test_electrons_of_a_white_pixel_are_those_counted_by_hand(trial):
    """Lux to watts to photons through the mask's openings, for a light of one colour: nothing is taken from our own code."""
    light = {"illuminant": {"led_nm": 540, "fwhm_nm": 1}}
    config = _config(trial, camera=light)
    record = Assembly(config).fixed_exposure
    assert record is not None
    sensor = replace(Assembly(config).sensor, full_scale=record["full_scale"])
    model = Assembly(config).forward_model
    clip = _white(0.0)
    clip.rgb[0, 8, 10] = 1
    signal = model.forward_clip(clip) / sensor.full_scale
    collected = signal.sum((1, 2)) * sensor.full_well_e * np.array(sensor.responsivity) * sensor.binning**2

    radiance = 800 / 683 / 0.954 / np.pi  # W / (m2 sr); V(540 nm) = 0.954 (CIE 018:2019)
    mask = Assembly(config).mask
    assert mask is not None
    opening_m2 = mask.amplitude.sum() * 4e-6**2
    tan2 = 2 * (0.5 * 19.2e-6 / 1.9e-3) ** 2  # the pixel beside the middle
    steradian = (19.2e-6 / 1.9e-3) ** 2 / (1 + tan2) ** 2
    photons = radiance * opening_m2 * steradian * 5e-3 * 540e-9 / (H * C)
    curves = camera_curves("Nikon 5100 (NPL)")
    at_540 = curves.values[:, np.argmin(np.abs(curves.wavelengths_m - 540e-9))]
    # The edges of the openings scatter 2 % of the light off the sensor.
    ratio = collected / (photons * 0.6 * at_540 / curves.values.max())
    assert ratio == pytest.approx(np.full(3, 0.98), abs=0.01)
    # The channels see one wavelength, so their PSFs are one and their ratio is that of their efficiencies.
    assert ratio == pytest.approx(np.full(3, ratio[1]), rel=2e-3)
    assert record["electrons_per_exposure"] == pytest.approx(sensor.full_well_e / record["full_scale"])
    assert max(record["responsivity"].values()) == 1
    assert "quantum efficiency and spectral response nominal" in record["peak_quantum_efficiency_from"]


def test_the_scale_does_not_depend_on_the_time_and_follows_what_it_should(trial):
    def scale(**numbers):
        sensor = {"shape": [48, 60], "binning": 8} | numbers.pop("sensor", {})
        record = Assembly(
            _config(trial, camera={"sensor": sensor} | numbers.pop("camera", {}), **numbers)
        ).fixed_exposure
        assert record is not None
        return record["full_scale"]

    reference = scale()
    assert scale(ms=0.1) == reference
    assert scale(camera={"exposure": {"illuminance_lux": 80}}) == pytest.approx(10 * reference)
    assert scale(sensor={"peak_quantum_efficiency": 0.3}) == pytest.approx(2 * reference)
    assert scale(sensor={"pixel_pitch_um": 4.8, "binning": 4}) == pytest.approx(reference / 4)
    assert scale(sensor={"full_well_e": 30000}) == pytest.approx(2 * reference)


def test_without_lux_the_channels_are_alike(trial):
    config = load_config(trial.write())
    assert Assembly(config).fixed_exposure == {"full_scale": 3e-6, "from": "configuration"}
    assert Assembly(config).sensor.responsivity is None
    assert Assembly(load_config(trial.write(camera={"exposure": {"full_scale": "auto"}}))).fixed_exposure is None


def test_a_response_of_other_channels_is_refused(trial):
    (trial.folder / "grey.csv").write_text("400,1\n700,1\n")
    sensor = {"shape": [48, 60], "binning": 8, "spectral_response": "grey.csv"}
    mono = Assembly(_config(trial, camera={"sensor": sensor})).sensor
    assert mono.channels(("Y",)) == ("Y",)
    with pytest.raises(InputError, match=r"^camera\.exposure\.illuminance_lux: "):
        mono.channels(("R", "G", "B"))
