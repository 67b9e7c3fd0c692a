"""Curves and lights from files and LEDs, responses, the quantile lines that stand for them, and electrons per lux."""

import json
import re

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.materials import load_material
from simulator.optics.spectra import (
    NOMINAL_CAMERA,
    Led,
    camera_curves,
    check_materials,
    electron_rates,
    illuminant_curve,
    quantile_lines,
    shared_lines,
    spectral_response,
)
from simulator.types import SpectralResponse

# ---- curves and lights


NM = 1e-9


def _csv(folder, text, name="sensor.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return camera_curves(name, folder)


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
        ("400,1,2\n500,1,2\n", "expected one (monochrome, a light), or red, green and blue"),
        ("nm,x,y,z\n400,1,2,3\n500,1,2,3\n", "columns x, y, z; expected one"),
        ("400,-1\n500,2\n", "values"),
        ("400,0\n500,0\n", "values"),
        ("400,x\n500,2\n", "sensor.csv:1:"),
    ],
)
def test_bad_curves_are_refused(tmp_path, text, words):
    with pytest.raises(InputError, match=re.escape(words)):
        _csv(tmp_path, text)


@pytest.mark.parametrize(
    "content", [{}, [], {"spectral_data": {"index": {"main": ["R"]}, "data": {"main": {"x": [1]}}}}]
)
def test_other_json_is_refused(tmp_path, content):
    (tmp_path / "sensor.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"sensor\.json: "):
        camera_curves("sensor.json", tmp_path)


def test_a_light_of_three_columns_is_refused(tmp_path):
    (tmp_path / "light.csv").write_text("400,1,2,3\n500,1,2,3\n")
    with pytest.raises(InputError, match=r"light\.csv: "):
        illuminant_curve("light.csv", tmp_path)


def test_curves_without_a_common_wavelength_are_refused(tmp_path):
    (tmp_path / "infrared.csv").write_text("1000,1\n1700,1\n")
    (tmp_path / "light.csv").write_text("400,1\n700,1\n")
    with pytest.raises(InputError, match=r"^infrared\.csv under light\.csv: "):
        spectral_response("infrared.csv", "light.csv", tmp_path)


def test_materials_unknown_at_a_channels_wavelength_are_refused():
    response = spectral_response()
    lines = quantile_lines(response, 3)
    check_materials(response, lines, [load_material("fused-silica"), load_material("n-bk7")])
    with pytest.raises(InputError, match=r"'B' of Nikon 5100 \(NPL\) under D65.* 44.* nm .*'noa61'"):
        check_materials(response, lines, [load_material("fused-silica"), load_material("noa61")])


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


# ---- responses and their lines


def _response(wavelengths_nm, *weights):
    return SpectralResponse(
        np.asarray(wavelengths_nm) * NM, np.array(weights, float), tuple("RGB"[: len(weights)]), "test"
    )


def _lines_nm(response, count, channel=0):
    return [line.wavelength_m / NM for line in quantile_lines(response, count) if line.channel == channel]


def test_lines_of_a_triangle():
    """Weights x on 0..1 have their quantile edges at sqrt(i / n) and centroids 2/3 (e1^3 - e0^3) / (e1^2 - e0^2)."""
    response = _response(np.linspace(400, 500, 201), np.linspace(0, 1, 201))
    for count in (1, 3, 8):
        edge = np.sqrt(np.arange(count + 1) / count)
        expected = 400 + 100 * 2 / 3 * np.diff(edge**3) / np.diff(edge**2)
        np.testing.assert_allclose(_lines_nm(response, count), expected, atol=2e-3)


def test_one_narrow_line_stays_where_it_is():
    response = _response([531, 532, 533], [0, 1, 0])
    assert _lines_nm(response, 1)[0] == pytest.approx(532, abs=1e-6)
    spread = np.array(_lines_nm(response, 4))
    assert np.all(np.abs(spread - 532) < 1)
    np.testing.assert_allclose(spread - 532, 532 - spread[::-1], atol=1e-6)


def test_a_response_with_a_gap_puts_lines_on_both_sides():
    """Equal boxes 420-440 and 620-640 nm: two lines, one in the middle of each, none in the dark between."""
    wavelengths = np.arange(400, 661)
    weights = ((wavelengths >= 420) & (wavelengths <= 440)) | ((wavelengths >= 620) & (wavelengths <= 640))
    np.testing.assert_allclose(_lines_nm(_response(wavelengths, weights), 2), [430, 630], atol=0.05)


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_every_channel_has_unit_weight_and_its_own_mean_wavelength(count):
    """The lines' mean is the response's centroid, whatever their number: the sum of the parts' first moments."""
    response = spectral_response()
    lines = quantile_lines(response, count)
    assert [line.channel for line in lines] == [c for c in range(3) for _ in range(count)]
    for channel, weights in enumerate(response.weights):
        mine = [line for line in lines if line.channel == channel]
        assert sum(line.weight for line in mine) == pytest.approx(1, abs=1e-12)
        mean = sum(line.weight * line.wavelength_m for line in mine)
        centroid = np.trapezoid(weights * response.wavelengths_m, response.wavelengths_m) / np.trapezoid(
            weights, response.wavelengths_m
        )
        assert mean == pytest.approx(centroid, abs=0.01 * NM)  # linear between samples of 1 nm
        assert np.all(np.diff([line.wavelength_m for line in mine]) > 0)


def test_the_lines_of_a_camera_integrate_ever_better():
    """What a PSF needs: the response's mean of cos(2 pi h / l), the fringes of mask steps to 2 um, RMS over h and channel.

    Measured 0.29, 0.078, 0.030, 0.005: the long faint tails of the dyes make it slower than on a box.
    """
    response = spectral_response()
    heights = np.linspace(0.1e-6, 2e-6, 60)[:, None]
    shares = response.weights / response.weights.sum(1, keepdims=True)
    reference = np.cos(2 * np.pi * heights / response.wavelengths_m) @ shares.T
    errors = []
    for count in (1, 3, 9, 27):
        got = np.zeros_like(reference)
        for line in quantile_lines(response, count):
            got[:, line.channel] += line.weight * np.cos(2 * np.pi * heights[:, 0] / line.wavelength_m)
        errors.append(np.sqrt(np.mean((got - reference) ** 2)))
    assert np.all(np.array(errors[:-1]) / errors[1:] > 2)
    assert errors[-1] < 0.02


@pytest.mark.parametrize("count", [1, 4, 7])
def test_shared_wavelengths_hold_every_channels_photons(count):
    """Each takes an equal share of the channels' mean, whose centroid the wavelengths keep."""
    response = spectral_response()
    lines = shared_lines(response, count)
    wavelengths_m = sorted({line.wavelength_m for line in lines})
    assert len(wavelengths_m) == count
    totals = [sum(line.weight for line in lines if line.channel == channel) for channel in range(3)]
    np.testing.assert_allclose(totals, 1, rtol=1e-9)
    shares = [sum(line.weight for line in lines if line.wavelength_m == at) / 3 for at in wavelengths_m]
    np.testing.assert_allclose(shares, 1 / count, rtol=1e-2)
    mean = np.mean(response.weights / response.weights.sum(1, keepdims=True), axis=0)
    assert np.dot(shares, wavelengths_m) == pytest.approx(mean @ response.wavelengths_m, abs=0.1 * NM)


def test_five_shared_wavelengths_integrate_better_than_nine_of_the_channels_own():
    """RMS over heights and channels, as above."""
    response = spectral_response()
    heights = np.linspace(0.1e-6, 2e-6, 60)
    shares = response.weights / response.weights.sum(1, keepdims=True)
    reference = np.cos(2 * np.pi * heights[:, None] / response.wavelengths_m) @ shares.T

    def error(lines):
        got = np.zeros_like(reference)
        for line in lines:
            got[:, line.channel] += line.weight * np.cos(2 * np.pi * heights / line.wavelength_m)
        return np.sqrt(np.mean((got - reference) ** 2))

    assert error(shared_lines(response, 5)) < error(quantile_lines(response, 3))
    assert error(shared_lines(response, 40)) < 5e-3


@pytest.mark.parametrize("count", [0, -1])
def test_no_lines_are_refused(count):
    with pytest.raises(InputError, match=r"^wavelengths_per_channel: "):
        quantile_lines(spectral_response(), count)
    with pytest.raises(InputError, match=r"^shared_wavelengths: "):
        shared_lines(spectral_response(), count)


def test_a_dark_channel_is_refused():
    with pytest.raises(InputError, match=r"^test, channel 'G': "):
        quantile_lines(_response([500, 510, 520], [1, 2, 1], [0, 0, 0]), 3)


def test_the_default_response_is_d65_times_camera_times_wavelength():
    """By colour-science's own tables, on their common 5 nm samples."""
    import colour

    response = spectral_response()
    camera = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    d65 = colour.SDS_ILLUMINANTS["D65"]
    for channel in range(3):
        photons = np.array([camera[w][channel] * d65[w] * w for w in camera.wavelengths])
        weights = response.weights[channel]
        # On the table's own wavelengths the product is exact up to one common factor.
        index = np.rint(camera.wavelengths - response.wavelengths_m[0] / NM).astype(int)
        seen = photons > 1e-6 * photons.max()
        ratio = weights[index][seen] / photons[seen]
        np.testing.assert_allclose(ratio / ratio[0], 1, rtol=1e-9)


def test_equal_energy_leaves_sensitivity_times_wavelength():
    import colour

    response = spectral_response(illuminant="E")
    camera = colour.MSDS_CAMERA_SENSITIVITIES[NOMINAL_CAMERA]
    at = np.rint(camera.wavelengths - response.wavelengths_m[0] / NM).astype(int)
    expected = np.clip(camera.values.T, 0, None) * camera.wavelengths
    got = response.weights[:, at]
    np.testing.assert_allclose(got / got.max(), expected / expected.max(), atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"camera": "Nikon 5100"}, "^spectral_response: "), ({"illuminant": "D66"}, "^illuminant: ")],
)
def test_unknown_names_are_refused_with_the_known_ones(arguments, words):
    with pytest.raises(InputError, match=words):
        spectral_response(**arguments)


# ---- electrons per lux


H, C = 6.62607015e-34, 299792458.0


@pytest.fixture
def flat(tmp_path):
    """Name of a sensor that counts a share of all photons from 360 to 830 nm, and its folder."""
    (tmp_path / "flat.csv").write_text("360,0.25\n830,0.25\n")
    return "flat.csv", tmp_path


@pytest.mark.parametrize(("led_nm", "efficiency"), [(480, 0.13902), (510, 0.503), (620, 0.381)])
def test_a_line_counts_by_the_eyes_efficiency_and_the_sensors(led_nm, efficiency):
    """V as CIE 018:2019 tables it; the response of a named camera at that wavelength."""
    rates = electron_rates("Nikon 5100 (NPL)", (Led(led_nm * 1e-9, 1e-9),))
    curves = camera_curves("Nikon 5100 (NPL)")
    at = int(np.argmin(np.abs(curves.wavelengths_m - led_nm * 1e-9)))
    expected = 1 / (683 * efficiency) / np.pi * led_nm * 1e-9 / (H * C) * curves.values[:, at] / curves.values.max()
    # Curves bend within the 1 nm of the line.
    assert list(rates.values()) == pytest.approx(expected.tolist(), rel=2e-3)


def test_equal_energy_has_the_eyes_known_integral(flat):
    """The integral of V is 106.857 nm (CIE); that of l / hc from 360 to 830 nm is a parabola."""
    photons_nm = 1e-9 * (830**2 - 360**2) / 2 / (H * C)
    rates = electron_rates(flat[0], "E", flat[1])
    # Sums of 1 nm against integrals.
    assert rates["Y"] == pytest.approx(photons_nm / (683 * 106.857) / np.pi, rel=1e-5)


def test_invisible_light_has_no_lux(flat):
    (flat[1] / "uv.csv").write_text("250,1\n830,1\n")
    with pytest.raises(InputError, match=r"^camera\.exposure\.illuminance_lux: "):
        electron_rates("uv.csv", (Led(300e-9, 5e-9),), flat[1])
