"""Light of a configuration: LEDs, files beside the YAML file and in the fingerprint."""

import json

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.colour import fit_camera_colour
from simulator.config import load_config
from simulator.dataset import open_dataset, verify
from simulator.errors import InputError
from simulator.optics.spectra import spectral_response


def _config(trial, **camera):
    return load_config(trial.write(camera=camera))


def test_leds_become_the_response(trial):
    one = Assembly(_config(trial, illuminant={"led_nm": 532, "fwhm_nm": 20})).geometry.response
    assert one.label == "Nikon 5100 (NPL) under LED 532 nm (20 nm wide), nominal"
    assert one.wavelengths_m[0] == pytest.approx(482e-9)
    assert one.wavelengths_m[-1] == pytest.approx(582e-9)
    leds = [{"led_nm": 455, "fwhm_nm": 20}, {"led_nm": 620, "fwhm_nm": 20, "power": 2}]
    two = Assembly(_config(trial, illuminant=leds)).geometry.response
    peaks = two.wavelengths_m[two.weights.argmax(1)]
    assert peaks[[0, 2]] == pytest.approx([620e-9, 455e-9], abs=3e-9)


def test_curves_lie_beside_the_yaml_file_and_are_inputs(trial):
    (trial.folder / "sensor.csv").write_text("400,1,2,3\n700,3,2,1\n")
    (trial.folder / "lamp.csv").write_text("wavelength_um,power\n0.35,1\n0.65,2\n")
    sensor = {"shape": [48, 60], "binning": 8, "spectral_response": "sensor.csv"}
    config = _config(trial, sensor=sensor, illuminant="lamp.csv")
    response = Assembly(config).geometry.response
    assert response.label == "sensor.csv under lamp.csv"
    assert (response.wavelengths_m[0], response.wavelengths_m[-1]) == (pytest.approx(400e-9), pytest.approx(650e-9))
    source = Assembly(config, "none").source
    names = [path.name for path in Assembly(config).having(source=source).input_files]
    assert names.count("sensor.csv") == names.count("lamp.csv") == 1
    (trial.folder / "lamp.csv").unlink()
    with pytest.raises(InputError, match=r"lamp\.csv: "):
        _ = Assembly(config).geometry


def test_a_response_comes_from_the_cache_as_it_was(trial, monkeypatch):
    config = _config(trial, illuminant="A")
    assert Assembly(config).response.label == "Nikon 5100 (NPL) under A, nominal"
    monkeypatch.setattr("simulator.assembly.spectral_response", None)
    again, expected = Assembly(config).response, spectral_response(illuminant="A")
    np.testing.assert_array_equal(again.weights, expected.weights)
    np.testing.assert_array_equal(again.wavelengths_m, expected.wavelengths_m)
    assert (again.channels, again.label) == (expected.channels, expected.label)


class TestSceneColours:
    def test_auto_fits_the_sensor_and_its_light_once(self, trial, monkeypatch):
        config = _config(trial, illuminant="A")
        first = Assembly(config).camera_colour(("R", "G", "B"))
        expected = fit_camera_colour(spectral_response(illuminant="A"))
        np.testing.assert_array_equal(first.matrix, expected.matrix)
        assert first.origin["response"] == "Nikon 5100 (NPL) under A, nominal"
        monkeypatch.setattr("simulator.assembly.fit_camera_colour", None)  # the second comes from the cache
        assert Assembly(config).camera_colour(("R", "G", "B")).origin == first.origin

    def test_another_content_of_a_curve_file_is_another_matrix(self, trial):
        matrices = []
        for green in (1, 3):
            (trial.folder / "lamp.csv").write_text(f"400,1\n550,{green}\n700,2\n")
            config = _config(trial, illuminant="lamp.csv")
            matrices.append(Assembly(config).camera_colour(("R", "G", "B")).matrix)
        assert np.abs(matrices[0] - matrices[1]).max() > 1e-3

    def test_given_and_identity(self, trial):
        rows = [[0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.25, 0.75]]
        for chosen, expected in (("identity", np.eye(3)), (rows, rows)):
            config = _config(trial, scene_to_camera=chosen)
            model = Assembly(config).forward_model
            np.testing.assert_array_equal(model.scene_to_camera, expected)

    def test_a_row_for_each_channel(self, trial):
        config = _config(trial, scene_to_camera=[[0.2, 0.7, 0.1]])
        with pytest.raises(InputError, match=r"^camera\.scene_to_camera: "):
            Assembly(config).camera_colour(("R", "G", "B"))
        config = _config(trial, scene_to_camera="identity")
        with pytest.raises(InputError, match=r"^camera\.scene_to_camera: "):
            Assembly(config).camera_colour(("Y",))

    def test_a_data_set_records_the_matrix(self, trial):
        rows = [[0.5, 0.5, 0.0], [0.0, 1.0, 0.0], [-2.0, 0.0, 3.0]]
        root = trial.generate(camera={"scene_to_camera": rows})
        described = json.loads((root / "dataset.json").read_text())
        assert described["scene_to_camera"] == {"from": "configuration", "matrix": rows}
        sample = open_dataset(root, "train")[0]
        clipped = np.mean(sample.rgb[..., 2] * 3 < sample.rgb[..., 0] * 2) / 3
        assert sample.metadata["clipped_colour_share"] == pytest.approx(clipped, abs=1e-9)
        assert clipped > 0


@pytest.mark.slow
def test_a_monochrome_sensor_all_the_way(trial):
    """One channel Y from the curve to the file: its image is the grey one of a camera with that row."""
    (trial.folder / "mono.csv").write_text("400,0.5\n550,0.9\n700,0.6\n")
    sensor = {"shape": [48, 60], "binning": 8, "spectral_response": "mono.csv"}
    root = trial.generate(camera={"sensor": sensor, "noise": {"type": "physical"}})
    described = json.loads((root / "dataset.json").read_text())
    assert described["channels"] == ["Y"]
    assert sum(described["scene_to_camera"]["matrix"][0]) == pytest.approx(1)
    sample = open_dataset(root, "train")[0]
    assert sample.measurement.shape == (1, 48, 60)
    assert sample.noiseless.max() > 0
    assert verify(root).ok
