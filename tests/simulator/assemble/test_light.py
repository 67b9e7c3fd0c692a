"""Light of a configuration: LEDs, files beside the YAML file and in the fingerprint."""

import pytest

from simulator import assemble
from simulator.config import load_config
from simulator.errors import InputError


def _config(trial, **camera):
    return load_config(trial.write(camera=camera))


def test_leds_become_the_response(trial):
    one = assemble.build_geometry(_config(trial, illuminant={"led_nm": 532, "fwhm_nm": 20})).response
    assert one.label == "Nikon 5100 (NPL) under LED 532 nm (20 nm wide), nominal"
    assert one.wavelengths_m[0] == pytest.approx(482e-9)
    assert one.wavelengths_m[-1] == pytest.approx(582e-9)
    leds = [{"led_nm": 455, "fwhm_nm": 20}, {"led_nm": 620, "fwhm_nm": 20, "power": 2}]
    two = assemble.build_geometry(_config(trial, illuminant=leds)).response
    peaks = two.wavelengths_m[two.weights.argmax(1)]
    assert peaks[[0, 2]] == pytest.approx([620e-9, 455e-9], abs=3e-9)


def test_curves_lie_beside_the_yaml_file_and_are_inputs(trial):
    (trial.folder / "sensor.csv").write_text("400,1,2,3\n700,3,2,1\n")
    (trial.folder / "lamp.csv").write_text("wavelength_um,power\n0.35,1\n0.65,2\n")
    sensor = {"shape": [48, 60], "binning": 8, "spectral_response": "sensor.csv"}
    config = _config(trial, sensor=sensor, illuminant="lamp.csv")
    response = assemble.build_geometry(config).response
    assert response.label == "sensor.csv under lamp.csv"
    assert (response.wavelengths_m[0], response.wavelengths_m[-1]) == (pytest.approx(400e-9), pytest.approx(650e-9))
    source = assemble.build_source(config, "none")
    names = [path.name for path in assemble.input_files(config, source)]
    assert names.count("sensor.csv") == names.count("lamp.csv") == 1
    (trial.folder / "lamp.csv").unlink()
    with pytest.raises(InputError, match=r"cannot read .*lamp\.csv: No such file"):
        assemble.build_geometry(config)
