"""Quantile lines against closed forms, polychromatic convergence, and responses against colour-science's own numbers."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.spectra import NOMINAL_CAMERA, quantile_lines, spectral_response
from simulator.types import SpectralResponse

NM = 1e-9


def _response(wavelengths_nm, *weights):
    return SpectralResponse(
        np.asarray(wavelengths_nm) * NM, np.array(weights, float), tuple("RGB"[: len(weights)]), "test"
    )


def _lines_nm(response, count, channel=0):
    return [line.wavelength_m / NM for line in quantile_lines(response, count) if line.channel == channel]


# --- quantile lines


def test_lines_of_a_box_are_evenly_spaced():
    """A flat response from 500 to 600 nm: n equal shares of width 100 / n, each with its centre."""
    response = _response(np.arange(500, 601), np.ones(101))
    for count in (1, 2, 5):
        np.testing.assert_allclose(_lines_nm(response, count), 500 + (np.arange(count) + 0.5) * 100 / count, atol=1e-3)


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


def test_lines_of_a_box_are_the_midpoint_rule():
    """Its error falls by 4 when the lines double; the integral of cos(k l) over the box is known."""
    response = _response(np.arange(500, 601), np.ones(101))
    k = 0.04  # per nm: two thirds of a fringe over the box
    truth = (np.sin(k * 600) - np.sin(k * 500)) / (k * 100)
    errors = np.array([abs(np.mean(np.cos(k * np.array(_lines_nm(response, n)))) - truth) for n in (4, 8, 16, 32)])
    np.testing.assert_allclose(errors[:-1] / errors[1:], 4, rtol=0.05)


def test_the_lines_of_a_camera_integrate_ever_better():
    """What a PSF needs: the response's mean of cos(2 pi h / l), the fringes of mask steps to 2 um, RMS over h and channel.

    Measured 0.29, 0.078, 0.030, 0.005: the long faint tails of the dyes make it slower than on a box.
    """
    response = spectral_response()
    heights = np.linspace(0.1e-6, 2e-6, 60)[:, None]
    shares = response.weights / response.weights.sum(1, keepdims=True)
    truth = np.cos(2 * np.pi * heights / response.wavelengths_m) @ shares.T
    errors = []
    for count in (1, 3, 9, 27):
        got = np.zeros_like(truth)
        for line in quantile_lines(response, count):
            got[:, line.channel] += line.weight * np.cos(2 * np.pi * heights[:, 0] / line.wavelength_m)
        errors.append(np.sqrt(np.mean((got - truth) ** 2)))
    assert np.all(np.array(errors[:-1]) / errors[1:] > 2)
    assert errors[-1] < 0.02


@pytest.mark.parametrize("count", [0, -1])
def test_no_lines_are_refused(count):
    with pytest.raises(InputError, match="wavelengths_per_channel"):
        quantile_lines(spectral_response(), count)


def test_a_dark_channel_is_refused():
    with pytest.raises(InputError, match=r"'G' .*'test'"):
        quantile_lines(_response([500, 510, 520], [1, 2, 1], [0, 0, 0]), 3)


# --- responses


def test_the_default_response_is_d65_times_camera_times_wavelength():
    """Centroids by colour-science's own tables and rectangle sums on their common 5 nm samples."""
    import colour

    response = spectral_response()
    camera = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    d65 = colour.SDS_ILLUMINANTS["D65"]
    for channel in range(3):
        photons = np.array([camera[w][channel] * d65[w] * w for w in camera.wavelengths])
        expected = np.sum(photons * camera.wavelengths) / photons.sum()
        weights = response.weights[channel]
        got = np.sum(weights * response.wavelengths_m) / weights.sum() / NM
        assert got == pytest.approx(expected, abs=0.2)  # 5 nm against 1 nm sums
        # On the table's own wavelengths the product is exact up to one common factor.
        index = np.rint(camera.wavelengths - response.wavelengths_m[0] / NM).astype(int)
        seen = photons > 1e-6 * photons.max()
        ratio = weights[index][seen] / photons[seen]
        np.testing.assert_allclose(ratio / ratio[0], 1, rtol=1e-9)


def test_the_stand_in_is_labelled_nominal():
    response = spectral_response()
    assert response.channels == ("R", "G", "B")
    assert response.label == f"{NOMINAL_CAMERA} under D65, nominal"
    assert np.all(response.weights >= 0)
    np.testing.assert_allclose(np.diff(response.wavelengths_m), NM, rtol=1e-6)
    peaks = response.wavelengths_m[np.argmax(response.weights, axis=1)] / NM
    assert peaks[0] > 570 > peaks[1] > 500 > peaks[2]


def test_another_light_shifts_the_response():
    """Incandescent light (A) is redder than daylight in every channel."""
    incandescent, daylight = (
        (response.weights @ response.wavelengths_m) / response.weights.sum(1)
        for response in (spectral_response(illuminant=light) for light in ("A", "D65"))
    )
    assert np.all(incandescent - daylight > 2 * NM)


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
    [
        ({"camera": "Nikon 5100"}, "spectral_response:"),
        ({"illuminant": "D66"}, "illuminant:"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(arguments, words):
    with pytest.raises(InputError, match=words):
        spectral_response(**arguments)
