"""Height maps and amplitudes from files, written by Pillow, tifffile, NumPy and our EXR writer: the numbers that went in."""

import numpy as np
import pytest
import tifffile
from PIL import Image

from simulator.design.height_maps import read_height_map, read_unit_map
from simulator.errors import InputError
from simulator.io.exr import write_exr

CODES = np.array([[0, 10, 255], [128, 3, 77]], np.uint8)
METRES = np.array([[0.0, 1e-7, 2e-6], [5e-7, 3e-7, 9e-7]], np.float32)


@pytest.mark.parametrize(("dtype", "largest"), [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("kind", ["png", "tif", "npy"])
def test_integers_are_shares_of_the_largest_code(tmp_path, kind, dtype, largest):
    codes = CODES.astype(dtype) * (largest // 255)
    path = tmp_path / f"map.{kind}"
    {"png": lambda: Image.fromarray(codes).save(path), "tif": lambda: tifffile.imwrite(path, codes)}.get(
        kind, lambda: np.save(path, codes)
    )()
    np.testing.assert_allclose(read_height_map(path, None, 1.5e-6), CODES / 255 * 1.5e-6, rtol=1e-6)
    np.testing.assert_allclose(read_unit_map(path), CODES / 255, rtol=1e-6)


@pytest.mark.parametrize("kind", ["exr", "tif", "npy"])
def test_floats_are_metres_or_of_the_unit_that_is_given(tmp_path, kind):
    path = tmp_path / f"map.{kind}"
    {"exr": lambda: write_exr(path, {"Y": METRES}, {}), "tif": lambda: tifffile.imwrite(path, METRES)}.get(
        kind, lambda: np.save(path, METRES)
    )()
    np.testing.assert_array_equal(read_height_map(path, None, None), METRES)
    np.testing.assert_allclose(read_height_map(path, 1e-3, None), METRES * 1e-3, rtol=1e-6)


def test_the_scale_must_be_given_and_of_the_right_kind(tmp_path):
    Image.fromarray(CODES).save(tmp_path / "map.png")
    np.save(tmp_path / "map.npy", METRES)
    with pytest.raises(InputError, match=r"max_height_um: .*map\.png.* 8 bits.* 255"):
        read_height_map(tmp_path / "map.png", None, None)
    with pytest.raises(InputError, match=r"max_height_um: .*unit_um"):
        read_height_map(tmp_path / "map.png", 1e-6, 1e-6)
    with pytest.raises(InputError, match=r"max_height_um: .*map\.npy .*unit_um"):
        read_height_map(tmp_path / "map.npy", None, 2e-6)


def test_a_relief_in_the_wrong_unit_is_refused(tmp_path):
    """Micrometres taken for metres make a mask as high as a person; without a word its PSF would be noise."""
    path = tmp_path / "map.npy"
    np.save(path, METRES * 1e6)
    with pytest.raises(InputError, match=r"map\.npy .*2e\+03 mm.*10 mm.*unit_um"):
        read_height_map(path, None, None)
    np.testing.assert_allclose(read_height_map(path, 1e-6, None), METRES, rtol=1e-6)
    np.save(path, CODES)
    with pytest.raises(InputError, match=r"20 mm.*max_height_um"):
        read_height_map(path, None, 2e-2)
    assert read_height_map(path, None, 1e-2).max() == pytest.approx(1e-2)  # the highest that may be asked for


def test_a_grey_picture_saved_in_colour_is_grey_and_a_colour_picture_is_refused(tmp_path):
    path = tmp_path / "map.png"
    Image.fromarray(np.stack([CODES] * 3, -1)).save(path)
    np.testing.assert_allclose(read_unit_map(path), CODES / 255, rtol=1e-6)
    Image.fromarray(np.stack([CODES, CODES, CODES[::-1]], -1)).save(path)
    with pytest.raises(InputError, match=r"map\.png"):
        read_unit_map(path)


def test_numbers_that_are_no_map_are_refused(tmp_path):
    path = tmp_path / "map.npy"
    for numbers, words in (
        (CODES.astype(np.int32), "holds int32; expected 8 or 16 bit"),
        (np.array([[0.5, 1.5]]), "numbers from 0.5 to 1.5; expected 0 .opaque. to 1 .open."),
        (np.array([[-0.5, 0.5]]), "numbers from -0.5 to 0.5"),
        (np.array([[np.nan, 0.5]]), "1 values that are NaN or infinite; expected finite numbers"),
        (np.zeros((2, 5, 5)), "shape"),
    ):
        np.save(path, numbers)
        with pytest.raises(InputError, match=rf"map\.npy .*{words}"):
            read_unit_map(path)
    with pytest.raises(InputError, match=r"map\.jpg"):
        read_unit_map(tmp_path / "map.jpg")


@pytest.mark.parametrize("kind", ["tif", "npy"])
def test_a_missing_file_is_called_missing(tmp_path, kind):
    with pytest.raises(InputError, match=rf"map\.{kind}"):
        read_height_map(tmp_path / f"map.{kind}", None, None)
