"""Solid bodies of masks, judged by trimesh and by matplotlib's interpolation on their triangles."""

import numpy as np
import pytest
import trimesh

from psf_library import load_mask
from simulator.design.solid import relief_solid, stl_bytes
from simulator.design.staircase import LEAN
from simulator.errors import InputError
from simulator.optics.mask import Mask


def _mask(height_m, pitch_m=2e-6, profile="staircase") -> Mask:
    height_m = np.asarray(height_m, np.float32)
    return Mask(height_m, np.ones_like(height_m), pitch_m, profile=profile, name="relief")


def _steps(shape=(23, 17), seed=0, levels=6):
    """Random heights of a few steps: checkerboard corners, equal neighbours and walls of every height are all there."""
    return np.random.default_rng(seed).integers(0, levels, shape) * np.float32(0.2e-6)


def _body(mask, base_m) -> trimesh.Trimesh:
    """The body in millimetres, as a mesh program merges it."""
    vertices, faces = relief_solid(mask, base_m)
    return trimesh.Trimesh(vertices * 1e3, faces, process=True)


def _upper(vertices, faces):
    """The triangles that are seen from above."""
    return faces[np.cross(*(np.diff(vertices[faces], axis=1)[:, k] for k in (0, 1)))[:, 2] > 0]


def _heights(vertices, faces, mask) -> np.ndarray:
    """The upper surface over the middles of the mask's pixels; matplotlib finds the triangle of each."""
    from matplotlib.tri import LinearTriInterpolator, Triangulation

    rows, columns = mask.shape
    y, x = np.mgrid[:rows, :columns]
    surface = LinearTriInterpolator(
        Triangulation(vertices[:, 0], vertices[:, 1], _upper(vertices, faces)), vertices[:, 2]
    )
    found = surface((x - (columns - 1) / 2) * mask.pitch_m, ((rows - 1) / 2 - y) * mask.pitch_m)
    assert not np.ma.is_masked(found)
    return np.asarray(found)


@pytest.mark.parametrize("profile", ["staircase", "smooth"])
def test_bodies_are_closed_and_of_the_right_size(profile):
    mask = _mask(_steps(), profile=profile)
    body = _body(mask, 3e-6)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.volume > 0  # faces look outside
    np.testing.assert_allclose(body.bounds * 1e-3, [[-17e-6, -23e-6, -3e-6], [17e-6, 23e-6, 1e-6]], rtol=1e-6)


def test_the_volume_of_a_staircase_is_that_of_its_blocks():
    """Leaning walls take from one block what they give to the other; corners keep (1/256)^2 of a pixel: 1e-5."""
    height = _steps()
    expected_mm3 = (np.sum(height, dtype=np.float64) + height.size * 3e-6) * 4e-12 * 1e9
    assert _body(_mask(height), 3e-6).volume == pytest.approx(expected_mm3, rel=1e-5)


def test_the_volume_of_a_smooth_slope_is_that_of_its_wedge():
    """A slope of 1 in 10, level over the outer half sample on each side: the mean height is half of the rise, exactly."""
    height = np.tile(np.arange(20) * 0.2e-6, (5, 1))
    body = _body(_mask(height, profile="smooth"), 1e-6)
    assert body.volume == pytest.approx((1e-6 + 1.9e-6) * 40e-6 * 10e-6 * 1e9, rel=1e-6)


def test_an_stl_file_of_other_programs_readers_is_a_solid():
    body = trimesh.load(trimesh.util.wrap_as_stream(stl_bytes(_mask(_steps()), 0.5e-3)), file_type="stl")
    assert body.is_volume


def test_what_has_no_body_is_refused():
    with pytest.raises(InputError, match=r"^height_m: "):
        relief_solid(_mask(np.full((3, 3), 1e-6)), 1e-6)
    for base_m in (0, np.inf):
        with pytest.raises(InputError, match=r"^base_m: "):
            relief_solid(_mask(_steps()), base_m)
    with pytest.raises(InputError, match=r"1200 x 1200 .*11520000 .*2\.2 mm"):  # eight for each pixel, all different
        relief_solid(_mask(np.arange(1200 * 1200).reshape(1200, 1200) * 1e-12), 1e-6)


@pytest.mark.parametrize("levels", [2, 3, 6, 10**6])
@pytest.mark.parametrize("shape", [(1, 2), (1, 9), (7, 1), (2, 2), (3, 5), (20, 31)])
def test_a_staircase_is_exact_whatever_meets_whatever(shape, levels):
    """Closed, of one piece without tunnels (Euler number 2), one sheet over the whole rectangle, every pixel at its height.

    No wall leans by more than LEAN to a side, and level tops are level: so much the volume may be off.
    """
    for seed in range(5):
        height = _steps(shape, seed, levels) if levels < 10 else np.random.default_rng(seed).random(shape) * 1e-6
        if not np.ptp(height):
            continue
        mask = _mask(height)
        vertices, faces = relief_solid(mask, 3e-6)
        body = trimesh.Trimesh(vertices * 1e6, faces, process=True)
        assert body.is_watertight
        assert body.is_winding_consistent
        assert body.euler_number == 2
        relief = np.asarray(mask.height_m, np.float64) - mask.height_m.min()
        corners = vertices[_upper(vertices, faces)]
        seen = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2].sum() / 2
        assert seen == pytest.approx(height.size * 4e-12, rel=1e-12)
        np.testing.assert_allclose(_heights(vertices, faces, mask), relief, rtol=0, atol=1e-18)
        walls_um = sum(np.abs(np.diff(relief, axis=axis)).sum() for axis in (0, 1)) * 1e6
        expected_um3 = (relief.sum() * 1e6 + height.size * 3) * 4
        assert abs(body.volume - expected_um3) <= LEAN * walls_um * 4 + 1e-9


def test_a_level_region_takes_triangles_for_its_corners_and_not_for_its_pixels():
    sizes = []
    for pixels in (20, 200):
        height = np.zeros((pixels, pixels))
        height[pixels // 4 : pixels // 2, pixels // 4 : pixels // 2] = 1e-6
        sizes.append(len(relief_solid(_mask(height), 1e-6)[1]))
    assert sizes[0] == sizes[1] < 60


def test_a_phlatcam_is_little_larger_than_any_exact_mesh_of_it():
    """A level region has a vertex at each of its corners, and a closed mesh of genus g has 2 V - 4 + 4 g triangles.

    Cuts into rectangles, sides and bottom may take a fifth more, where the plain mesh takes three times as many. Corners
    are counted here pixel by pixel: of the four round a grid point, one that differs from both of its neighbours
    has a corner, and so have three equal ones round a different one.
    """
    mask = load_mask(design="phlatcam", width_mm=0.3)
    level = np.pad(np.rint(np.asarray(mask.height_m) / 0.2e-6).astype(int), 1, constant_values=-1)
    corners = 0
    for i, j in np.ndindex(level.shape[0] - 1, level.shape[1] - 1):
        ring = [level[i, j], level[i, j + 1], level[i + 1, j + 1], level[i + 1, j]]
        corners += sum(ring[k] not in (-1, ring[k - 1], ring[k - 3]) for k in range(4))
        corners += any(ring[k] == ring[k - 1] == ring[k - 3] != ring[k - 2] and ring[k] != -1 for k in range(4))
    faces = relief_solid(mask, 5e-4)[1]
    assert 2 * corners - 4 < len(faces) < 2.4 * corners
    assert len(faces) < 0.4 * 8 * mask.shape[0] * mask.shape[1]  # two for the top of a pixel, and walls for each


@pytest.mark.parametrize("tolerance_nm", [0, 20, 200])
def test_a_smooth_body_is_as_small_as_its_tolerance_allows(tolerance_nm):
    """Heights at all samples by matplotlib's interpolation on the body's own upper triangles; trimesh says it is closed."""
    y, x = np.mgrid[:41, :54]
    mask = _mask(2e-6 * np.exp(-((x - 20) ** 2 + (y - 25) ** 2) / 300), profile="smooth")
    vertices, faces = relief_solid(mask, 1e-5, tolerance_nm * 1e-9)
    body = trimesh.Trimesh(vertices * 1e3, faces, process=False)
    assert body.is_watertight
    assert body.is_winding_consistent
    found = _heights(vertices, faces, mask)
    relief = np.asarray(mask.height_m, np.float64) - mask.height_m.min()
    off_m = np.abs(found - relief).max()
    assert off_m <= tolerance_nm * 1e-9 + 1e-15  # rounding of 1e-6 m in double precision is 1e-22
    if tolerance_nm:  # what it allows for is this very error
        assert len(relief_solid(mask, 1e-5, off_m * (1 + 1e-9))[1]) == len(faces)
    every = 2 * (42 * 55) + 6 * (42 + 55)  # upper triangles, sides and bottom with all samples
    assert len(faces) == every if tolerance_nm == 0 else len(faces) < every / (2 if tolerance_nm == 20 else 10)
