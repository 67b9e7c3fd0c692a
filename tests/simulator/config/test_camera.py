"""Keys of the camera that contradict each other, and those that may be left out."""

import re

import pytest

from simulator.config import load_config
from simulator.errors import InputError

SENSOR = "sensor: {shape: [64, 96], binning: 4}"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (SENSOR, "sensor: {shape: [64, 96], binning: 4, cfa: RGGB}", "got RGGB with readout binned_rgb"),
        (SENSOR, "sensor: {shape: [64, 96], binning: 4, readout: bayer, cfa: RGBW}", "camera.sensor.cfa:"),
        (SENSOR, "sensor: {shape: [64, 96], binning: 4, readout: raw}", "camera.sensor.readout:"),
        (SENSOR, "sensor: {shape: [64, 96], peak_quantum_efficiency: 60}", "got 60; expected 0.001 to 1"),
        (SENSOR, "sensor: {shape: [64, 96], pattern_seed: -1}", "a seed is not negative"),
        ("full_scale: auto", "full_scale: 2.0, illuminance_lux: 100", "beside full_scale, which it decides"),
        ("full_scale: auto", "illuminance_lux: 0", "camera.exposure.illuminance_lux:"),
    ],
)
def test_senseless_cameras_are_refused(write, old, new, words):
    with pytest.raises(InputError, match=re.escape(words)):
        load_config(write(old, new))


@pytest.mark.parametrize(
    ("old", "new", "needs"),
    [
        ("full_scale: auto", "illuminance_lux: 800", "camera.exposure.illuminance_lux"),
        ("noise: {type: gaussian, psnr_db: 40}", "noise: {type: physical}", "camera.noise: physical"),
    ],
)
def test_photons_are_counted_of_exposures_only(write, old, new, needs):
    """A mean over time is the same for a row that is open for 1 ms and for 16 ms; their photon noise is not."""
    path = write(old, new)
    assert load_config(path).forward.time == "integral"
    path.write_text(path.read_text() + "forward: {time: mean}\n")
    with pytest.raises(InputError) as caught:
        load_config(path)
    line = len(path.read_text().splitlines())
    assert str(caught.value) == (
        f"{path}:{line}:17: forward.time: got mean, which takes the exposure time out of the measurement, but {needs} needs "
        "it to count each row's photons; use time: integral"
    )


@pytest.mark.parametrize(
    ("sensor", "key"),
    [
        ({"shape": [48, 60], "model": "imx999"}, "camera.sensor.model"),
        ({"shape": [480, 600], "binning": 10}, "camera.sensor.shape"),
        ({"shape": [48, 60], "bit_depth": 4, "black_level_dn": 15}, "camera.sensor.black_level_dn"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused_in_the_file(trial, sensor: dict, key: str) -> None:
    with pytest.raises(InputError, match=rf"trial\.yaml:\d+:\d+: {key}: "):
        load_config(trial.write(camera={"sensor": sensor}))
