"""The fitted 3x3 against spectra: surfaces that it was not fitted to, white, and cameras whose matrix is known."""

import numpy as np
import pytest

from simulator.camera.colour import fit_camera_colour, linear_srgb
from simulator.optics.spectra import Led, spectral_response
from simulator.types import SpectralResponse

NM = 1e-9


def _srgb_curves():
    """Photon weights of a camera whose channels are sRGB's own, under D65; they have negative parts, which is the point."""
    import colour

    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    shape = colour.SpectralShape(380, 780, 1)
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(shape).values
    to_srgb = np.linalg.inv(colour.RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ)
    weights = to_srgb @ (observer.copy().align(shape).values.T * light)
    return SpectralResponse(np.asarray(shape.wavelengths) * NM, weights, ("R", "G", "B"), "sRGB")


def test_a_camera_with_srgbs_curves_needs_no_matrix():
    fit = fit_camera_colour(_srgb_curves())
    np.testing.assert_allclose(fit.matrix, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(fit.origin["relative_rms_error"], 0, atol=1e-6)


def test_a_camera_with_mixed_srgb_curves_needs_the_mixture():
    """Any white-keeping mixture of sRGB's curves is found exactly: the fit has no other optimum."""
    mixture = np.array([[0.6, 0.3, 0.1], [0.2, 0.9, -0.1], [0.05, 0.15, 0.8]])
    srgb = _srgb_curves()
    shares = srgb.weights / srgb.weights.sum(1, keepdims=True)
    camera = SpectralResponse(srgb.wavelengths_m, mixture @ shares, srgb.channels, "mixed")
    np.testing.assert_allclose(fit_camera_colour(camera).matrix, mixture, atol=1e-9)


@pytest.mark.parametrize(
    "light", ["D65", "A", [Led(455 * NM, 20 * NM), Led(530 * NM, 30 * NM), Led(620 * NM, 20 * NM)]]
)
@pytest.mark.parametrize("camera", ["Nikon 5100 (NPL)", "Sigma SDMerill (NPL)"])
def test_white_stays_white(camera, light):
    fit = fit_camera_colour(spectral_response(camera, light))
    np.testing.assert_allclose(fit.matrix.sum(1), 1, atol=1e-12)
    assert np.all(np.array(fit.origin["relative_rms_error"]) < 0.15)  # three LEDs see least of a spectrum


def test_a_monochrome_sensor_gets_one_row(tmp_path):
    """A sensor with the eye's own luminosity curve sees sRGB's Y under D65: 0.2126 R + 0.7152 G + 0.0722 B."""
    import colour

    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(colour.SpectralShape(380, 780, 1))
    # Divided by the wavelength, because a response counts photons: the weights are then those of luminance.
    rows = "\n".join(f"{w},{y / w}" for w, y in zip(eye.wavelengths, eye.values[:, 1], strict=True))
    (tmp_path / "eye.csv").write_text(rows)
    fit = fit_camera_colour(spectral_response("eye.csv", "D65", tmp_path))
    assert fit.matrix.shape == (1, 3)
    np.testing.assert_allclose(fit.matrix, [[0.2126, 0.7152, 0.0722]], atol=1e-4)  # the rounding of sRGB's matrix


@pytest.mark.filterwarnings("ignore:Aligning")  # its own tables have other wavelengths
def test_linear_srgb_is_colour_sciences():
    """Against its own integration and its own matrix for the patches of the ColorChecker."""
    import colour

    patches = list(colour.SDS_COLOURCHECKERS["ISO 17321-1"].values())
    light = colour.SDS_ILLUMINANTS["D65"]
    expected = [
        colour.XYZ_to_RGB(colour.sd_to_XYZ(patch, illuminant=light) / 100, "sRGB", apply_cctf_encoding=False)
        for patch in patches
    ]
    got = linear_srgb(np.array([p.values for p in patches]), np.asarray(patches[0].wavelengths) * NM)
    # 5 nm reflectances, linear here and by Sprague there; and white, which is 1 exactly here.
    np.testing.assert_allclose(got, expected, atol=1.5e-3)
    flat = linear_srgb(np.array([[1.0, 1.0], [0.18, 0.18]]), np.array([400e-9, 700e-9]))
    np.testing.assert_allclose(flat, [[1, 1, 1], [0.18, 0.18, 0.18]], rtol=1e-12)


@pytest.mark.parametrize(
    ("camera", "light", "bound"), [("Nikon 5100 (NPL)", "D65", 0.04), ("Nikon 5100 (NPL)", "A", 0.06)]
)
def test_surfaces_that_were_not_fitted(camera, light, bound):
    """The 14 test colours of CIE 13.3, by sums over the tables' own 5 nm samples.

    Measured relative RMS error: 3.0, 1.4, 3.3 % (D65) and 4.8, 0.1, 4.8 % (A) in R, G and B; RGB taken as it is errs by 26,
    16, 21 % and 19, 12, 30 %.
    """
    import colour
    from colour.quality.datasets import SDS_TCS

    shape = colour.SpectralShape(380, 780, 5)
    surfaces = np.array([s.copy().align(shape).values for s in SDS_TCS["CIE 1995"].values()])
    curves = colour.MSDS_CAMERA_SENSITIVITIES[camera].copy().align(shape).values
    power = colour.SDS_ILLUMINANTS[light].copy().align(shape).values * np.asarray(shape.wavelengths)
    seen = (surfaces * power) @ curves / (power @ curves)
    scene = linear_srgb(surfaces, np.asarray(shape.wavelengths) * NM)
    fit = fit_camera_colour(spectral_response(camera, light))

    def error(values):
        return np.sqrt(np.mean((values - seen) ** 2, axis=0) / np.mean(seen**2, axis=0))

    assert np.all(error(scene @ fit.matrix.T) < bound)
    assert np.all(error(scene) > 2 * bound)
    # The error that is recorded, on the patches that were fitted, tells the size of the one on others.
    np.testing.assert_allclose(error(scene @ fit.matrix.T), fit.origin["relative_rms_error"], atol=0.015)
