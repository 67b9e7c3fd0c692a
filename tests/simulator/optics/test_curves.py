"""Curves from files against their own rows, LEDs against the Gaussian's closed forms, and bad files."""

import json

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.materials import load_material
from simulator.optics.spectra import (
    Led,
    camera_curves,
    check_materials,
    illuminant_curve,
    quantile_lines,
    spectral_response,
)

NM = 1e-9


def _csv(folder, text, name="sensor.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return camera_curves(name, folder)


# --- LEDs


@pytest.mark.parametrize(("centre_nm", "fwhm_nm"), [(532, 20), (850, 40), (632.8, 1), (455.3, 17.5)])
def test_an_led_has_its_centre_width_and_power(centre_nm, fwhm_nm):
    """Area 1.0645 fwhm x peak; mean = centre; standard deviation fwhm / 2.3548: a Gaussian's, tails cut at 3e-8."""
    led = illuminant_curve([Led(centre_nm * NM, fwhm_nm * NM, 2.0)])
    wavelengths, power = led.wavelengths_m / NM, led.values[0]
    area = np.trapezoid(power, wavelengths)
    mean = np.trapezoid(power * wavelengths, wavelengths) / area
    deviation = np.sqrt(np.trapezoid(power * (wavelengths - mean) ** 2, wavelengths) / area)
    assert area == pytest.approx(2.0 * np.sqrt(np.pi / np.log(2)) / 2, rel=1e-7)
    assert mean == pytest.approx(centre_nm, abs=1e-6)
    assert deviation == pytest.approx(fwhm_nm / np.sqrt(8 * np.log(2)), rel=1e-5)
    half = np.interp(centre_nm + fwhm_nm / 2, wavelengths, power) / power.max()
    assert half == pytest.approx(0.5, abs=0.005)


def test_several_leds_add_by_power():
    light = illuminant_curve([Led(455 * NM, 20 * NM, 1.0), Led(620 * NM, 10 * NM, 3.0)])
    wavelengths, power = light.wavelengths_m, light.values[0]
    blue = wavelengths < 540 * NM
    share = np.trapezoid(power[blue], wavelengths[blue]) / np.trapezoid(power, wavelengths)
    assert share == pytest.approx(0.25, abs=1e-6)
    assert light.label == "LED 455 nm (20 nm wide) + LED 620 nm (10 nm wide)"


def test_a_narrow_led_gives_lines_at_its_centre():
    """Over 2 nm the camera's curves hardly change: the channels' lines lie within a tenth of a nanometre of each other."""
    response = spectral_response(illuminant=[Led(532 * NM, 2 * NM)])
    lines = quantile_lines(response, 1)
    assert [line.wavelength_m / NM for line in lines] == [pytest.approx(532, abs=0.1)] * 3
    spread = np.std([line.wavelength_m / NM for line in quantile_lines(response, 50) if line.channel == 1])
    assert spread == pytest.approx(2 / np.sqrt(8 * np.log(2)), rel=0.02)  # 50 shares lose 1 % of a Gaussian's variance


# --- files


def test_columns_are_found_by_name_and_unit(tmp_path):
    blue_first = "wavelength_um, blue_qe, Red, g\n0.5, 30, 10, 20\n0.4, 31, 11, 21\n"
    curves = _csv(tmp_path, blue_first)
    assert curves.channels == ("R", "G", "B")
    np.testing.assert_allclose(curves.wavelengths_m, [400e-9, 500e-9])
    np.testing.assert_array_equal(curves.values, [[11, 10], [21, 20], [31, 30]])
    assert curves.label == "sensor.csv"


def test_a_table_without_header_is_in_nanometres(tmp_path):
    curves = _csv(tmp_path, "400 0.1 0.2 0.3\n410 0.1 0.2 0.3\n")
    np.testing.assert_allclose(curves.wavelengths_m, [400e-9, 410e-9])
    assert curves.channels == ("R", "G", "B")
    grey = _csv(tmp_path, "320,0.2\n700,0.8\n1100,0.1\n")
    assert grey.channels == ("Y",)
    np.testing.assert_allclose(grey.at(np.array([700e-9])), [[0.8]])


def test_percent_and_angstrom_are_read_where_they_are_said(tmp_path):
    curves = _csv(tmp_path, "wavelength [Angstrom],QE (%)\n4000,50\n7000,80\n")
    np.testing.assert_allclose(curves.wavelengths_m, [400e-9, 700e-9])
    np.testing.assert_allclose(curves.values, [[0.5, 0.8]])


def test_only_ratios_count(tmp_path):
    """A curve in percent and the same as a fraction give the same lines."""
    _csv(tmp_path, "# in percent\n400,20\n500,80\n600,40\n", "percent.csv")
    _csv(tmp_path, "400,0.2\n500,0.8\n600,0.4\n", "share.csv")
    lines = [quantile_lines(spectral_response(f, "E", tmp_path), 4) for f in ("percent.csv", "share.csv")]
    assert [a.wavelength_m for a in lines[0]] == pytest.approx([b.wavelength_m for b in lines[1]], rel=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("400,1,2\n500,1,2\n", "expected one (a monochrome sensor, a light), or red, green and blue"),
        ("nm,x,y,z\n400,1,2,3\n500,1,2,3\n", "columns x, y, z; expected one"),
        ("400,-1\n500,2\n", "values"),
        ("400,0\n500,0\n", "values"),
        ("400,x\n500,2\n", "sensor.csv:1:"),
    ],
)
def test_bad_curves_are_refused(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        _csv(tmp_path, text)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "content", [{}, [], {"spectral_data": {"index": {"main": ["R"]}, "data": {"main": {"x": [1]}}}}]
)
def test_other_json_is_refused(tmp_path, content):
    (tmp_path / "sensor.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"sensor\.json: .*spectral_data .*index\.main"):
        camera_curves("sensor.json", tmp_path)


def test_a_light_of_three_columns_is_refused(tmp_path):
    (tmp_path / "light.csv").write_text("400,1,2,3\n500,1,2,3\n")
    with pytest.raises(InputError, match=r"light\.csv: 3 columns"):
        illuminant_curve("light.csv", tmp_path)


def test_curves_without_a_common_wavelength_are_refused(tmp_path):
    (tmp_path / "infrared.csv").write_text("1000,1\n1700,1\n")
    (tmp_path / "light.csv").write_text("400,1\n700,1\n")
    with pytest.raises(InputError, match=r"1000 to 1700 nm.* 400 to 700 nm"):
        spectral_response("infrared.csv", "light.csv", tmp_path)


def test_materials_unknown_at_a_channels_wavelength_are_refused():
    response = spectral_response()
    lines = quantile_lines(response, 3)
    check_materials(response, lines, [load_material("fused-silica"), load_material("n-bk7")])
    with pytest.raises(InputError, match=r"'B' of Nikon 5100 \(NPL\) under D65.* 44.* nm .*'noa61'"):
        check_materials(response, lines, [load_material("fused-silica"), load_material("noa61")])


# --- real files


@pytest.mark.shared
def test_the_imx219_peaks_where_its_table_does(shared_data):
    """Percent, columns red, green, blue by name; its blue at 400 nm is 48.8 percent in the file."""
    path = shared_data / "sensor_spectral/raspicam/archive/IMX219.csv"
    curves = camera_curves(str(path))
    table = np.loadtxt(path, delimiter=",", skiprows=2)
    np.testing.assert_allclose(curves.values, table[:, 1:].T / 100, rtol=1e-12)
    np.testing.assert_allclose(curves.wavelengths_m, table[:, 0] * 1e-9, rtol=1e-12)
    assert curves.values[2, 0] == pytest.approx(0.488481749)
    response = spectral_response(str(path), "E")
    assert response.label == "IMX219.csv under E"
    expected = table[:, 1:].T * table[:, 0]
    got = response.weights
    np.testing.assert_allclose(got / got.max(), expected / expected.max(), atol=1e-12)


@pytest.mark.shared
def test_rawtoaces_files(shared_data):
    folder = shared_data / "sensor_spectral/rawtoaces/data"
    cameras = sorted((folder / "camera").glob("*.json"))
    assert len(cameras) == 6
    for path in cameras:
        curves = camera_curves(str(path))
        rows = json.loads(path.read_text())["spectral_data"]["data"]["main"]
        np.testing.assert_allclose(curves.values.T, [rows[str(w)] for w in range(380, 781, 5)], atol=1e-12)
        peaks = curves.wavelengths_m[curves.values.argmax(1)]
        assert peaks[0] > 570e-9 > peaks[1] > 500e-9 > peaks[2]
    tungsten = illuminant_curve(str(folder / "illuminant/iso7589_stutung_380_780_5.json"))
    assert tungsten.values[0, [0, 1, -1]] == pytest.approx([0.04, 0.05, 1.0])


@pytest.mark.shared
def test_two_measurements_of_one_camera_agree(shared_data):
    """NPL's and rawtoaces' Nikon D5100 (two laboratories, two bodies): the channels' centroids lie within 5 nm."""
    path = shared_data / "sensor_spectral/rawtoaces/data/camera/Nikon_D5100_380_780_5.json"
    responses = [spectral_response(name) for name in (str(path), "Nikon 5100 (NPL)")]
    ours, theirs = ((r.weights @ r.wavelengths_m) / r.weights.sum(1) / NM for r in responses)
    np.testing.assert_allclose(ours, theirs, atol=5)
