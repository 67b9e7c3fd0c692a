"""Height maps and amplitudes from files, and solid bodies, judged by trimesh, that are or are not height maps."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
import trimesh
from PIL import Image

from simulator.design.height_maps import read_height_map, read_stl_height, read_unit_map
from simulator.design.solid import stl_bytes
from simulator.errors import InputError
from simulator.io.exr import write_exr
from simulator.optics.mask import Mask

# ---- images and arrays


CODES = np.array([[0, 10, 255], [128, 3, 77]], np.uint8)
METRES = np.array([[0.0, 1e-7, 2e-6], [5e-7, 3e-7, 9e-7]], np.float32)


def _write(path: Path, image: np.ndarray) -> None:
    if path.suffix == ".exr":
        write_exr(path, {"Y": image}, {})
    else:
        {".png": lambda p, i: Image.fromarray(i).save(p), ".tif": tifffile.imwrite, ".npy": np.save}[path.suffix](
            path, image
        )


@pytest.mark.parametrize(("dtype", "largest"), [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("kind", ["png", "tif", "npy"])
def test_integers_are_shares_of_the_largest_code(tmp_path, kind, dtype, largest):
    codes = CODES.astype(dtype) * (largest // 255)
    path = tmp_path / f"map.{kind}"
    _write(path, codes)
    np.testing.assert_allclose(read_height_map(path, None, 1.5e-6), CODES / 255 * 1.5e-6, rtol=1e-6)
    np.testing.assert_allclose(read_unit_map(path), CODES / 255, rtol=1e-6)


@pytest.mark.parametrize("kind", ["exr", "tif", "npy"])
def test_floats_are_metres_or_of_the_unit_that_is_given(tmp_path, kind):
    path = tmp_path / f"map.{kind}"
    _write(path, METRES)
    np.testing.assert_array_equal(read_height_map(path, None, None), METRES)
    np.testing.assert_allclose(read_height_map(path, 1e-3, None), METRES * 1e-3, rtol=1e-6)


def test_the_scale_must_be_given_and_of_the_right_kind(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "map.png")
    np.save(tmp_path / "map.npy", METRES)
    for name, unit_m, highest_m in (("map.png", None, None), ("map.png", 1e-6, 1e-6), ("map.npy", None, 2e-6)):
        with pytest.raises(InputError, match=r"^max_height_um: "):
            read_height_map(tmp_path / name, unit_m, highest_m)


def test_a_relief_in_the_wrong_unit_is_refused(tmp_path):
    """Micrometres taken for metres make a mask as high as a person; without a word its PSF would be noise."""
    path = tmp_path / "map.npy"
    np.save(path, METRES * 1e6)
    with pytest.raises(InputError, match=r"map\.npy: "):
        read_height_map(path, None, None)
    np.testing.assert_allclose(read_height_map(path, 1e-6, None), METRES, rtol=1e-6)
    np.save(path, CODES)
    with pytest.raises(InputError, match=r"20 mm.*max_height_um"):
        read_height_map(path, None, 2e-2)
    assert read_height_map(path, None, 1e-2).max() == pytest.approx(1e-2)  # the highest that may be asked for


def test_a_grey_image_saved_in_colour_is_grey_and_a_colour_image_is_refused(tmp_path):
    path = tmp_path / "map.png"
    Image.fromarray(np.stack([CODES] * 3, -1)).save(path)
    np.testing.assert_allclose(read_unit_map(path), CODES / 255, rtol=1e-6)
    Image.fromarray(np.stack([CODES, CODES, CODES[::-1]], -1)).save(path)
    with pytest.raises(InputError, match=r"map\.png: "):
        read_unit_map(path)


def test_numbers_that_are_no_map_are_refused(tmp_path):
    path = tmp_path / "map.npy"
    for numbers in (
        CODES.astype(np.int32),
        np.array([[0.5, 1.5]]),
        np.array([[-0.5, 0.5]]),
        np.array([[np.nan, 0.5]]),
        np.zeros((2, 5, 5)),
    ):
        np.save(path, numbers)
        with pytest.raises(InputError, match=r"map\.npy: "):
            read_unit_map(path)
    with pytest.raises(InputError, match=r"map\.jpg"):
        read_unit_map(tmp_path / "map.jpg")


# ---- bodies


def _mask(height_m, pitch_m=2e-6, profile="staircase") -> Mask:
    height_m = np.asarray(height_m, np.float32)
    return Mask(height_m, np.ones_like(height_m), pitch_m, profile=profile, name="relief")


def _steps(shape=(23, 17), seed=0):
    """Random heights of five steps: checkerboard corners, equal neighbours and walls of every height are all there."""
    return np.random.default_rng(seed).integers(0, 6, shape) * np.float32(0.2e-6)


def _stl(path: Path, mesh: trimesh.Trimesh) -> Path:
    path.write_bytes(mesh.export(file_type="stl"))
    return path


def _blocks(heights_mm) -> trimesh.Trimesh:
    """Boxes of 1 mm x 1 mm side by side on z = 0, with upright walls, row 0 at the top."""
    boxes = []
    for (row, column), height in np.ndenumerate(np.asarray(heights_mm, float)):
        at = [column + 0.5, -row - 0.5, height / 2]
        boxes.append(trimesh.creation.box((1, 1, height), trimesh.transformations.translation_matrix(at)))
    return trimesh.util.concatenate(boxes)


@pytest.mark.parametrize(("profile", "tolerance_m"), [("staircase", 2e-13), ("smooth", 2e-12)])
def test_a_body_reads_back_as_its_heights(profile, tolerance_m, tmp_path):
    """Single precision in the file: 1e-7 of a height of 1 um; and of a place 40 um away, met on a slope of 1/2."""
    height = _steps((31, 40), 4)
    path = tmp_path / "mask.stl"
    path.write_bytes(stl_bytes(_mask(height, profile=profile), 0.5e-3))
    found = read_stl_height(path, 2e-6, 1e-3)
    assert (found.shape, found.dtype) == (height.shape, np.float32)
    np.testing.assert_allclose(found, height, rtol=0, atol=tolerance_m)


def test_a_finer_grid_sees_the_same_blocks(tmp_path):
    height = _steps((6, 5), 1)
    path = tmp_path / "mask.stl"
    path.write_bytes(stl_bytes(_mask(height), 1e-5))
    np.testing.assert_allclose(read_stl_height(path, 0.5e-6, 1e-3), np.kron(height, np.ones((4, 4))), atol=1e-12)


def test_upright_walls_of_other_programs_are_read(tmp_path):
    heights = np.array([[1.0, 2.0, 5.0], [4.0, 1.5, 3.0]])
    found = read_stl_height(_stl(tmp_path / "blocks.stl", _blocks(heights)), 1e-4, 1e-3)
    np.testing.assert_allclose(found, np.kron(heights - 1, np.ones((10, 10))) * 1e-3, atol=1e-9)


def test_a_slope_is_sampled_where_the_pixels_are(tmp_path):
    """An open surface z = 0.3 x + 0.1 y over 4 x 2 units: the plane at pixel centres, y up; text STL is read too."""
    corners = np.array([[x, y, 0.3 * x + 0.1 * y] for y in (0, 2) for x in (0, 4)])
    mesh = trimesh.Trimesh(corners, [[0, 1, 3], [0, 3, 2]], process=False)
    path = tmp_path / "slope.stl"
    path.write_text(mesh.export(file_type="stl_ascii"))
    found = read_stl_height(path, 0.25e-6, 1e-6)
    x, y = (np.arange(16) + 0.5) / 4, 2 - (np.arange(8) + 0.5) / 4
    expected = 0.3 * x[None, :] + 0.1 * y[:, None]
    np.testing.assert_allclose(found, (expected - expected.min()) * 1e-6, atol=1e-12)


def test_a_text_file_of_several_bodies_is_one_surface(tmp_path):
    left, right = (_blocks([[height]]) for height in (1.0, 3.0))
    right.apply_translation([1, 0, 0])
    texts = [body.export(file_type="stl_ascii") for body in (left, right)]
    path = tmp_path / "two.stl"
    path.write_text("\n".join(texts))
    np.testing.assert_allclose(read_stl_height(path, 0.5, 1.0), [[0, 0, 2, 2]] * 2)


def test_an_upright_lens_has_its_sag(tmp_path):
    """A paraboloid meshed on an irregular (Delaunay) net of other points than ours: sag within the net's own error."""
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(0)
    edge = np.linspace(-1, 1, 41)
    rim = [(x, y) for s in (-1, 1) for x, y in [*((t, s) for t in edge), *((s, t) for t in edge[1:-1])]]
    points = np.concatenate([rng.uniform(-0.99, 0.99, (4000, 2)), rim])
    mesh = trimesh.Trimesh(np.c_[points, 2 - (points**2).sum(1)], Delaunay(points).simplices, process=False)
    mesh.faces[mesh.face_normals[:, 2] < 0] = mesh.faces[mesh.face_normals[:, 2] < 0][:, ::-1]
    found = read_stl_height(_stl(tmp_path / "lens.stl", mesh), 2e-5, 1e-3)
    x = (np.arange(100) - 49.5) * 0.02
    sag = 2 - x[None, :] ** 2 - x[:, None] ** 2
    assert np.abs(found / 1e-3 - (sag - sag.min())).max() < 0.1**2  # edge^2 / 4 per axis; edges reach 0.14


def test_bodies_that_are_no_height_maps_are_refused(tmp_path):
    overhang = trimesh.util.concatenate(
        [_blocks([[1.0, 1.0]]), trimesh.creation.box(bounds=[[0.2, -0.8, 2], [0.6, -0.4, 3]])]
    )
    hole = _blocks([[1, 1, 1], [1, 1, 1], [1, 1, 1]])
    hole.update_faces(
        ~((hole.face_normals[:, 2] > 0.5) & (np.abs(hole.triangles_center - [1.5, -1.5, 1]).max(1) < 0.5))
    )
    upside_down = _blocks([[1.0, 2.0]])
    upside_down.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0]))
    twice = trimesh.util.concatenate([_blocks([[1.0, 1.0]]), _blocks([[2.0, 2.0]])])
    for body, words in (
        (trimesh.creation.icosphere(radius=1.0), "overhang"),
        (overhang, "0.16 mm2"),
        (upside_down, "upside down"),
        (hole, "1 of 9 mm2"),
        (trimesh.creation.cylinder(radius=1.0, height=1.0, sections=64), "0.863 of 4 mm2"),
        (twice, "4 mm2 .* 2 mm2"),
    ):
        path = _stl(tmp_path / "body.stl", body)
        with pytest.raises(InputError, match=rf"body\.stl: .*{words}"):
            read_stl_height(path, 1e-4, 1e-3)


def test_a_hole_hidden_by_an_overlap_is_found(tmp_path):
    """The areas sum to the rectangle's, but the surface does not cover it."""
    sheet = [[x, y, 0.1 * x] for y in (0, 1) for x in range(4)]
    quads = [[0, 1, 5], [0, 5, 4], [2, 3, 7], [2, 7, 6], [0, 1, 5], [0, 5, 4]]
    path = _stl(tmp_path / "body.stl", trimesh.Trimesh(sheet, quads, process=False))
    with pytest.raises(InputError, match=r"body\.stl: "):
        read_stl_height(path, 1e-4, 1e-3)


def test_files_that_are_no_stl_are_refused(tmp_path):
    path = tmp_path / "body.stl"
    with pytest.raises(InputError, match=r"body\.stl: "):
        read_stl_height(path, 1e-6, 1e-3)
    for content in (
        b"",
        b"solid nothing\nendsolid nothing\n",
        b"\x89PNG and so on",
        stl_bytes(_mask(_steps()), 1e-6)[:-70],
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"body\.stl: "):
            read_stl_height(path, 1e-6, 1e-3)
    path.write_text("the quick brown fox\n" * 9)
    with pytest.raises(InputError, match=r"body\.stl: ") as caught:
        read_stl_height(path, 1e-6, 1e-3)
    assert "concatenate" not in str(caught.value)


def test_files_too_large_are_refused_unread(tmp_path, monkeypatch):
    path = _stl(tmp_path / "blocks.stl", _blocks([[1.0, 2.0]]))
    monkeypatch.setattr("simulator.design.height_maps.MAX_TRIANGLES", 3)
    with pytest.raises(InputError, match=r"blocks\.stl: "):
        read_stl_height(path, 1e-4, 1e-3)


def test_units_that_make_no_sensible_grid_are_refused(tmp_path):
    path = _stl(tmp_path / "blocks.stl", _blocks([[1.0, 2.0]]))
    with pytest.raises(InputError, match=r"^pixel_um: "):
        read_stl_height(path, 2e-6, 1.0)
    with pytest.raises(InputError, match=r"^pixel_um: "):
        read_stl_height(path, 3e-6, 1e-6)
