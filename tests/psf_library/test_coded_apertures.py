"""FlatCam and MURA: the correlations and separability that they are published for, and features that a grid can hold."""

import numpy as np
import pytest

from psf_library.designs.flatcam import flatcam, sequence
from psf_library.designs.mura import coded_array, decoding_array, mura
from simulator.design.patterns import amplitude_mask
from simulator.errors import InputError
from simulator.optics.error_budget.sampling import sampling_error
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld
from simulator.types import CameraGeometry, SpectralResponse

BLUE = SpectralResponse(np.array([449e-9, 450e-9, 451e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")


def _features(mask, feature_samples):
    """One value per feature; every feature is uniform."""
    rows, columns = (n // feature_samples for n in mask.shape)
    blocks = np.asarray(mask.amplitude).reshape(rows, feature_samples, columns, feature_samples)
    values = blocks[:, 0, :, 0]
    assert np.all(blocks == values[:, None, :, None])
    return values.astype(int)


def _periodic_correlation(a, b):
    """Sums over all shifts, one by one: integers, exact."""
    return np.array([[np.sum(a * np.roll(b, (-i, -j), (0, 1))) for j in range(a.shape[1])] for i in range(a.shape[0])])


@pytest.mark.parametrize("order", [2, 5, 8])
def test_a_maximum_length_sequence_has_a_two_valued_autocorrelation(order):
    """N at no shift and -1 at every other (Golomb, Shift Register Sequences)."""
    signs = sequence(order)
    assert set(signs) == {-1, 1}
    length = 2**order - 1
    shifts = [int(signs @ np.roll(signs, shift)) for shift in range(length)]
    assert shifts == [length] + [-1] * (length - 1)


def test_flatcam_is_separable_and_half_open():
    pattern = _features(flatcam(order=6, feature_um=30, pixel_um=10), 3)
    assert pattern.shape == (63, 63)
    assert set(pattern.ravel()) == {0, 1}
    assert np.linalg.matrix_rank(2 * pattern - 1) == 1
    # 32 of 63 entries are +1: (32^2 + 31^2) / 63^2 of the squares are open.
    assert pattern.sum() == 32**2 + 31**2


def test_flatcams_mask_has_a_flat_autocorrelation():
    """(a a^T) * (a a^T) factors: N^2 at no shift, -N along the axes, +1 elsewhere."""
    signs = 2 * _features(flatcam(order=4, feature_um=4), 2) - 1
    expected = np.ones((15, 15), int)
    expected[0, :] = expected[:, 0] = -15
    expected[0, 0] = 225
    np.testing.assert_array_equal(_periodic_correlation(signs, signs), expected)


@pytest.mark.parametrize("rank", [3, 5, 13, 19])
def test_mura_decodes_to_a_delta_exactly(rank):
    """Primes of both kinds, 4 m + 1 and 4 m + 3; the peak is the number of open features."""
    expected = np.zeros((rank, rank), int)
    expected[0, 0] = (rank**2 - 1) // 2
    np.testing.assert_array_equal(_periodic_correlation(coded_array(rank), decoding_array(rank)), expected)


def test_a_cyclic_mura_decodes_to_a_delta_where_the_scene_moves_its_shadow():
    """Linear correlation of the mosaic, with the decoding array inside it, is periodic for every shift that fits."""
    from scipy.signal import correlate2d

    mask = mura(rank=11, feature_um=6, cyclic=True)
    mosaic = _features(mask, 3)
    assert mosaic.shape == (21, 21)
    decoded = correlate2d(mosaic, decoding_array(11), "valid")
    expected = np.zeros((11, 11), int)
    expected[0, 0] = 60
    np.testing.assert_array_equal(decoded, expected)


def test_the_cyclic_flatcam_holds_a_whole_period_in_every_window():
    once, mosaic = (_features(flatcam(order=3, feature_um=2, cyclic=cyclic), 1) for cyclic in (False, True))
    assert mosaic.shape == (13, 13)
    for shift in range(7):
        np.testing.assert_array_equal(mosaic[shift : shift + 7, :7], np.roll(once, -shift, 0))


@pytest.mark.parametrize("rank", [4, 9, 15, 49])
def test_a_rank_that_is_no_prime_is_refused(rank):
    with pytest.raises(InputError, match=r"^rank: "):
        mura(rank=rank)


def test_features_are_whole_samples():
    mask = amplitude_mask([[1, 0], [0, 0.5]], 30e-6, 5e-6, "corner")
    assert (mask.shape, mask.pitch_m, mask.name) == ((12, 12), 5e-6, "corner")
    assert mask.transmitted_area_m2 == pytest.approx(1.25 * 900e-12)
    with pytest.raises(InputError, match=r"^pixel_um: "):
        amplitude_mask([[1]], 30e-6, 7e-6, "corner")
    with pytest.raises(InputError, match=r"^pixel_um: "):
        amplitude_mask([[1]], 2e-6, 7e-6, "corner")


@pytest.mark.filterwarnings("ignore:the PSF's sampling error")
@pytest.mark.parametrize("distance_m", [0.5e-3, 1.9e-3])
def test_hard_edges_cast_the_shadow_of_the_direct_sum(distance_m):
    """Six sensor pixels, 8 x 8 Gauss points each, against |Rayleigh-Sommerfeld|^2 summed over 1 um squares.

    What is left is the 2 um grid of the mask (measured 0.6 and 0.5 %) and the truth's own midpoint rule (0.4 %).
    """
    pitch_m, pattern = 9.6e-6, np.array([[1, 0, 1], [1, 1, 0], [0, 1, 0], [0, 0, 1]], float)
    mask = amplitude_mask(pattern, 30e-6, 2e-6, "pattern")
    config = PsfConfig((np.inf,), wavelengths_per_channel=1)
    (stored,) = compute_psf_stack(mask, CameraGeometry(distance_m, pitch_m, BLUE), config).values[0]
    pixels = np.random.default_rng(2).integers(-5, 6, (6, 2))
    nodes, weights = np.polynomial.legendre.leggauss(8)
    truth = []
    for row, column in pixels:
        x, y = np.meshgrid((column + nodes / 2) * pitch_m, (row + nodes / 2) * pitch_m)
        points_m = np.stack([x.ravel(), y.ravel()], 1)
        field = rayleigh_sommerfeld(np.kron(pattern, np.ones((30, 30))) + 0j, 1e-6, 450e-9, distance_m, points_m)
        truth.append(np.sum(np.outer(weights, weights).ravel() / 4 * np.abs(field) ** 2))
    middle = len(stored) // 2
    found = stored[middle - pixels[:, 0], middle - pixels[:, 1]]
    assert np.linalg.norm(found - truth) < 0.015 * np.linalg.norm(truth)


@pytest.mark.parametrize(("distance_m", "pitch_m"), [(1.9e-3, 19.2e-6), (0.5e-3, 9.6e-6)])
@pytest.mark.parametrize("design", [flatcam, mura])
def test_the_default_grid_is_fine_enough(design, distance_m, pitch_m):
    """Well below the 5 % that the library refuses, at the default camera and at the published distance of FlatCam."""
    config = PsfConfig((0.036, np.inf), wavelengths_per_channel=1)
    assert sampling_error(design(), CameraGeometry(distance_m, pitch_m, BLUE), config)["error"] < 0.03
