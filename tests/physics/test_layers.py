"""Light through cover glasses and substrates: against Fermat's principle, plane waves, and air cut into slices."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import minimize

from simulator.errors import InputError
from simulator.optics.exact import exact_images
from simulator.optics.kernel import PixelKernel
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.propagation import TiltedTransfer, Transfer, air_equivalent_m, fan, gap_strata, reduced_m
from simulator.optics.psf import PsfConfig, compute_psf_stack, depth_images, psf_fingerprint
from simulator.optics.sources import Source
from simulator.types import CameraGeometry, Layer, SpectralResponse

WAVELENGTH_M = 532e-9
GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")
GLASS = FUSED_SILICA.index(WAVELENGTH_M)
STRATA = ((0.3e-3, 1.0), (0.7e-3, GLASS), (0.1e-3, 1.33))


class Air:
    name = "air"

    def index(self, wavelength_m: float) -> float:
        return 1.0


def shortest_path_m(strata, rho_m: float) -> float:
    """Fermat: the least optical path over where the ray crosses each interface."""

    def path(crossings):
        places = [0.0, *crossings, rho_m]
        return 1e6 * sum(n * np.hypot(d, b - a) for (d, n), (a, b) in zip(strata, pairwise(places), strict=True))

    start = np.cumsum([d for d, _ in strata])[:-1] / sum(d for d, _ in strata) * rho_m
    best = minimize(path, start, method="BFGS", options={"gtol": 1e-9})
    return best.fun * 1e-6 - sum(d * n for d, n in strata)


def test_rays_take_the_shortest_path():
    """To what the minimiser finds, 5e-6 of a wavelength over paths of a millimetre; the sine is the path's slope."""
    for rho in (0.0, 0.05e-3, 0.4e-3, 1.1e-3):
        rays = fan(STRATA, np.array([rho**2]))
        assert float(rays.path_m[0]) == pytest.approx(shortest_path_m(STRATA, rho), abs=5e-6 * WAVELENGTH_M)
        step = 1e-7
        before, after = (float(fan(STRATA, np.array([(rho + s) ** 2])).path_m[0]) for s in (-step, step))
        if rho:
            assert float(rays.inverse_m[0]) * rho == pytest.approx((after - before) / (2 * step), rel=1e-5)
    assert float(fan(STRATA, np.array([0.0])).inverse_m[0]) == pytest.approx(1 / reduced_m(STRATA), rel=1e-12)


def test_the_table_of_rays_equals_the_closed_form_in_air():
    """Air cut into three slices of index 1 goes through the table, whole air through the formula."""
    rho = np.linspace(0, 2e-3, 50) ** 2
    whole, cut = fan(((1e-3, 1.0),), rho), fan(((0.2e-3, 1.0), (0.5e-3, 1.0), (0.3e-3, 1.0)), rho)
    np.testing.assert_allclose(cut.path_m, whole.path_m, atol=1e-15)
    np.testing.assert_allclose(cut.inverse_m, whole.inverse_m, rtol=1e-9)
    np.testing.assert_allclose(cut.spreading, whole.spreading, rtol=1e-9)


def test_transfer_through_layers_is_the_product_of_plane_waves():
    """exp(i sum d_j sqrt(k^2 n_j^2 - k_perp^2)) without its value straight ahead (PHYSICS 3), in extended precision."""
    shape, pitch = (40, 60), 1e-6
    like = np.zeros(1, complex)
    found = Transfer(shape, pitch, WAVELENGTH_M, like=like).quadrant(STRATA)
    tilted = TiltedTransfer(shape, pitch, WAVELENGTH_M, (0.31, -0.12), like=like).block(STRATA)
    k = 2 * np.longdouble(np.pi) / np.longdouble(WAVELENGTH_M)
    fy, fx = (np.fft.fftfreq(n, pitch).astype(np.longdouble) * WAVELENGTH_M for n in shape)

    def phase(sy, sx):
        return k * sum(d * (np.sqrt(n**2 - sy**2 - sx**2) - n) for d, n in STRATA)

    expected = np.exp(1j * (phase(fy[:, None], fx[None, :])).astype(float))
    np.testing.assert_allclose(found, expected[: 40 // 2 + 1, : 60 // 2 + 1], atol=1e-9)
    cosines = [np.sqrt(n**2 - 0.31**2 - 0.12**2) for _, n in STRATA]
    travel = sum(d / c for (d, _), c in zip(STRATA, cosines, strict=True))
    oblique = phase(fy[:, None] - 0.12, fx[None, :] + 0.31) - phase(np.longdouble(-0.12), np.longdouble(0.31))
    oblique = oblique + k * travel * (fy[:, None] * -0.12 + fx[None, :] * 0.31)
    np.testing.assert_allclose(tilted, np.exp(1j * oblique.astype(float)), atol=1e-9)


def test_the_kernel_through_slices_of_air_is_that_of_air():
    """The rays' kernel of a homogeneous medium is Rayleigh and Sommerfeld's."""
    like = np.zeros(1, complex)
    kernel = PixelKernel((400, 400), 2e-6, WAVELENGTH_M, 0.35e-3, like=like)
    whole, cut = (kernel.quadrant(s)(slice(None)) for s in (1e-3, ((0.4e-3, 1.0), (0.6e-3, 1.0))))
    np.testing.assert_allclose(cut, whole, atol=1e-9)


def _camera(gap: tuple[Layer, ...], pitch_m: float = 4e-6, window: tuple[Layer, ...] = ()) -> CameraGeometry:
    return CameraGeometry(air_equivalent_m(gap, WAVELENGTH_M), pitch_m, GREEN, gap, window)


def _staircase() -> Mask:
    height = np.random.default_rng(0).integers(0, 6, (60, 60)) * 0.2e-6
    return Mask(height, np.ones_like(height), 2e-6, FUSED_SILICA, "staircase")


def _lens(focal_m: float, samples: int = 300, pitch_m: float = 1e-6) -> Mask:
    x = (np.arange(samples) - (samples - 1) / 2) * pitch_m
    rho_squared = x[:, None] ** 2 + x[None, :] ** 2
    aperture = np.exp(-((np.sqrt(rho_squared) / (0.4 * samples * pitch_m)) ** 8))
    height = -(np.sqrt(rho_squared + focal_m**2) - focal_m) / (GLASS - 1)
    return Mask(height - height.min(), aperture, pitch_m, FUSED_SILICA, "smooth")


GAP = (Layer(0.3e-3, Air()), Layer(0.4e-3, FUSED_SILICA))


def test_a_cover_glass_moves_the_focus_by_its_reduced_thickness():
    """A plate of thickness t moves a focus back by t (1 - 1/n) (Born and Wolf 4.2): in air the same sensor is out of focus.

    At f/4 the plate's spherical aberration is under a tenth of a wave.
    """
    focal = air_equivalent_m(GAP, WAVELENGTH_M)
    through = next(exact_images(_lens(focal), _camera(GAP), [Source(WAVELENGTH_M, np.inf)], 61))
    air = next(exact_images(_lens(focal), CameraGeometry(focal, 4e-6, GREEN), [Source(WAVELENGTH_M, np.inf)], 61))
    wrong = next(exact_images(_lens(focal), CameraGeometry(0.7e-3, 4e-6, GREEN), [Source(WAVELENGTH_M, np.inf)], 61))
    assert through.max() == pytest.approx(air.max(), rel=0.05)
    assert through.max() > 5 * wrong.max()
    assert through.sum() == pytest.approx(air.sum(), rel=1e-6)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(_staircase, marks=pytest.mark.slow, id="staircase"),
        pytest.param(lambda: _lens(2e-3, 150), id="smooth"),
    ],
)
def test_scaled_and_exact_psfs_agree_through_glass(make):
    """From infinity they differ in the grid's rule alone (0.5 %, and a staircase's fading orders); both see the glass."""
    mask, camera = make(), _camera(GAP, 8e-6)
    config = PsfConfig((np.inf,), "exact", oversampling=3)
    (exact,) = depth_images(mask, camera, config, WAVELENGTH_M, 61)
    (scaled,) = depth_images(mask, camera, replace(config, model="scaled_distance"), WAVELENGTH_M, 61)
    (air,) = depth_images(mask, replace(camera, gap=()), config, WAVELENGTH_M, 61)
    assert np.linalg.norm(scaled - exact) / np.linalg.norm(exact) < 0.01
    if mask.profile == "staircase":  # whose light is steep enough to tell glass from its air equivalent
        assert np.linalg.norm(air - exact) / np.linalg.norm(exact) > 0.02


def test_oblique_light_lands_where_snell_says():
    """The grid's middle is where a convolution puts a PSF, the tangent times the distance in air; glass bends light away."""
    hole = np.exp(-(((np.arange(61) - 30) / 9.0) ** 2))
    mask = Mask(np.zeros((61, 61)), np.outer(hole, hole), 1e-6, FUSED_SILICA, "smooth")
    camera, tangent = _camera(GAP), 0.4
    (image,) = exact_images(mask, camera, [Source(WAVELENGTH_M, np.inf, (tangent, 0.0))], 121)
    inside = np.tan(np.arcsin(np.sin(np.arctan(tangent)) / GLASS))
    beyond_m = 0.3e-3 * tangent + 0.4e-3 * inside - tangent * camera.mask_to_sensor_m  # stored pictures are turned
    columns = np.arange(121) - 60
    # The lobe of 10 um waist spreads by 1 degree; its skew to second order stays below a twentieth of a pixel.
    assert np.sum(image.sum(0) * columns) / image.sum() == pytest.approx(beyond_m / camera.pixel_pitch_m, abs=0.05)
    assert abs(beyond_m) > camera.pixel_pitch_m


def test_oblique_sources_behind_a_window_each_have_their_own_carrier():
    """Behind glass the chief ray's angle depends on the depth, so such sources share no grid."""
    mask, camera, window = _lens(0.5e-3, 150), CameraGeometry(0.5e-3, 8e-6, GREEN), ((3e-3, GLASS),)
    sources = [Source(WAVELENGTH_M, depth, (0.5, 0.0), window) for depth in (0.01, 0.0101)]
    for source, image in zip(sources, exact_images(mask, camera, sources, 101), strict=True):
        (alone,) = exact_images(mask, camera, [source], 101)
        np.testing.assert_array_equal(image, alone)


def test_a_window_of_air_changes_nothing_and_one_of_glass_moves_the_source():
    """Behind a plate a source seems nearer by t (1 - 1/n); the rest is aberration, under 1e-3 of a wave here."""
    mask, camera = _lens(0.5e-3, 150), CameraGeometry(0.5e-3, 4e-6, GREEN)
    window = ((0.3e-3, GLASS),)
    for direction in ((0.0, 0.0), (0.15, 0.05)):
        plain, aired = (
            next(exact_images(mask, camera, [Source(WAVELENGTH_M, 5e-3, direction, w)], 101))
            for w in ((), ((0.3e-3, 1.0 + 1e-12),))
        )
        np.testing.assert_allclose(aired, plain, atol=1e-6 * plain.max())
    through = next(exact_images(mask, camera, [Source(WAVELENGTH_M, 5e-3, window=window)], 101))
    nearer = next(exact_images(mask, camera, [Source(WAVELENGTH_M, 5e-3 - 0.3e-3 * (1 - 1 / GLASS))], 101))
    plain = next(exact_images(mask, camera, [Source(WAVELENGTH_M, 5e-3)], 101))

    def distance(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.linalg.norm(a - b) / np.linalg.norm(b))

    assert distance(through, nearer) < 1e-3
    assert distance(plain, nearer) > 20 * distance(through, nearer)


def test_layers_are_part_of_a_stacks_identity_and_record():
    mask, config = _lens(1e-3, 60), PsfConfig((0.1,), wavelengths_per_channel=1)
    camera = _camera(GAP, 8e-6, (Layer(0.5e-3, FUSED_SILICA),))
    prints = {psf_fingerprint(mask, c, config) for c in (camera, replace(camera, gap=()), replace(camera, window=()))}
    assert len(prints) == 3
    provenance = compute_psf_stack(mask, camera, config).provenance
    assert [layer["material"] for layer in provenance["gap"]] == ["air", "fused-silica"]
    assert provenance["window"] == [{"thickness_m": 0.5e-3, "material": "fused-silica"}]
    assert gap_strata(camera, WAVELENGTH_M)[1] == (0.4e-3, GLASS)


def test_a_source_inside_its_window_is_refused():
    with pytest.raises(InputError, match=r"^depth_m: "):
        Source(WAVELENGTH_M, 0.004, window=((0.005, GLASS),))
