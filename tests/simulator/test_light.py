"""Pictures as linear light: codes, alpha and orientation, each by a picture whose light is known by hand."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from simulator.errors import InputError
from simulator.io.exr import write_exr
from simulator.io.images import read_light

CODES = np.random.default_rng(1).integers(0, 256, (3, 5, 3), dtype=np.uint8)
# What EXIF and TIFF number an orientation by: how the upright picture is stored (TIFF 6.0, page 36).
STORED = {
    1: CODES,
    2: CODES[:, ::-1],
    3: CODES[::-1, ::-1],
    4: CODES[::-1],
    5: CODES.transpose(1, 0, 2),
    6: np.rot90(CODES),  # row 0 of what is stored is the right side of what is seen
    7: CODES[::-1, ::-1].transpose(1, 0, 2),
    8: np.rot90(CODES, -1),
}


def linear(codes: np.ndarray, full: int = 255) -> np.ndarray:
    """IEC 61966-2-1."""
    encoded = codes / full
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


@pytest.mark.parametrize("orientation", STORED)
def test_pictures_are_upright(tmp_path: Path, orientation: int) -> None:
    stored = np.ascontiguousarray(STORED[orientation])
    exif = Image.Exif()
    exif[274] = orientation
    Image.fromarray(stored).save(tmp_path / "a.png", exif=exif)
    tags = [(274, "H", 1, orientation, True)]
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", extratags=tags)
    for name in ("a.png", "a.tif"):
        np.testing.assert_allclose(read_light(tmp_path / name), linear(CODES), rtol=1e-5)


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_what_is_transparent_shines_the_less(tmp_path: Path, name: str) -> None:
    alpha = np.array([[0, 51, 102, 153, 255]] * 3, np.uint8)
    both = np.dstack((CODES, alpha))
    if name == "a.png":
        Image.fromarray(both).save(tmp_path / name)
    else:
        tifffile.imwrite(tmp_path / name, both, photometric="rgb", extrasamples=["unassalpha"])
    expected = linear(CODES) * np.array([0, 0.2, 0.4, 0.6, 1])[:, None]  # in linear light, after the codes are decoded
    np.testing.assert_allclose(read_light(tmp_path / name), expected, rtol=1e-5, atol=1e-9)


def test_alpha_turns_with_its_picture_and_has_the_full_scale_of_its_type(tmp_path: Path) -> None:
    codes = np.full((2, 3, 4), 65535, np.uint16)
    codes[..., 3] = [[0, 13107, 65535], [65535, 65535, 65535]]
    tags = [(274, "H", 1, 3, True)]
    options = {"photometric": "rgb", "extrasamples": ["unassalpha"], "extratags": tags}
    tifffile.imwrite(tmp_path / "a.tif", codes, **options)
    np.testing.assert_allclose(read_light(tmp_path / "a.tif")[..., 1], [[1, 1, 1], [1, 0.2, 0]], rtol=1e-6)
    values = np.full((1, 2, 4), 2, np.float32)
    values[..., 3] = [[0.25, 1]]
    tifffile.imwrite(tmp_path / "b.tif", values, photometric="rgb", extrasamples=["unassalpha"])
    np.testing.assert_allclose(read_light(tmp_path / "b.tif")[..., 0], [[0.5, 2]])


def test_integers_are_codes_and_floating_point_is_light(tmp_path: Path) -> None:
    deep = np.array([[[100, 30000, 65535]]], np.uint16)
    tifffile.imwrite(tmp_path / "deep.tif", deep, photometric="rgb")
    np.testing.assert_allclose(read_light(tmp_path / "deep.tif"), linear(deep, 65535), rtol=1e-5)
    light = np.array([[[0.25, 1.5, 7]]], np.float32)
    tifffile.imwrite(tmp_path / "light.tif", light, photometric="rgb")
    assert np.array_equal(read_light(tmp_path / "light.tif"), light)
    write_exr(tmp_path / "light.exr", {name: light[..., i] for i, name in enumerate("RGB")}, {})
    assert np.array_equal(read_light(tmp_path / "light.exr"), light)
    write_exr(tmp_path / "grey.exr", {"Y": light[..., 1]}, {})
    assert read_light(tmp_path / "grey.exr").tolist() == [[[1.5, 1.5, 1.5]]]
    Image.fromarray(CODES[..., 0]).save(tmp_path / "grey.png")
    np.testing.assert_allclose(read_light(tmp_path / "grey.png"), linear(CODES[..., [0, 0, 0]]), rtol=1e-5)


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        (np.array([[[0.5, -1, 0]]], np.float32), {}, "1 of its values are negative or NaN"),
        (np.array([[[0.5, np.nan, 0]]], np.float32), {}, "holds NaN or inf"),
        (np.zeros((1, 1, 3), np.int32), {}, "holds int32; expected 8 or 16 bit sRGB"),
        (np.array([[[9, 9, 9, 1], [9, 9, 9, 2]]], np.uint8), {"extrasamples": ["assocalpha"]}, "no straight alpha"),
    ],
)
def test_what_is_no_light_is_refused(tmp_path: Path, values: np.ndarray, options: dict, message: str) -> None:
    tifffile.imwrite(tmp_path / "bad.tif", values, photometric="rgb", **options)
    with pytest.raises(InputError, match=rf"bad\.tif.*{message}"):
        read_light(tmp_path / "bad.tif")


def test_an_exr_without_colours_is_refused(tmp_path: Path) -> None:
    write_exr(tmp_path / "depth.exr", {"Z": np.ones((2, 2), np.float32)}, {})
    with pytest.raises(InputError, match=r"depth\.exr: .*Z; "):
        read_light(tmp_path / "depth.exr")
