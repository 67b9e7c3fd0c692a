"""Pictures come back bit by bit; whatever would lose bits is refused by name."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image, ImageOps

from simulator.errors import InputError
from simulator.io.exr import write_exr
from simulator.io.images import MAX_PIXELS, image_shape, read_image, read_light, read_shown_image


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_16_bit_grey_keeps_all_bits(tmp_path, rng):
    grey = rng.integers(0, 65535, (6, 4), dtype=np.uint16, endpoint=True)
    cv2.imwrite(str(tmp_path / "a.png"), grey)  # an independent writer
    found = read_image(tmp_path / "a.png")
    assert found.dtype == np.uint16
    assert np.array_equal(found, grey)


@pytest.mark.parametrize("suffix", [".png", ".webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_shown_picture_is_upright_as_pillow_turns_it_and_a_read_one_as_it_is_stored(
    tmp_path, rng, suffix, orientation
):
    rgba = rng.integers(0, 255, (5, 7, 4), dtype=np.uint8, endpoint=True)
    rgba[..., 3] |= 1  # WebP may drop the colour of what cannot be seen
    exif = Image.Exif()
    exif[274] = orientation
    path = tmp_path / f"a{suffix}"
    Image.fromarray(rgba).save(path, exif=exif, lossless=True)
    with Image.open(path) as image:
        expected = np.asarray(ImageOps.exif_transpose(image))
    codes, alpha = read_shown_image(path)
    assert alpha is not None
    assert np.array_equal(codes, expected[..., :3])
    assert np.array_equal(alpha, expected[..., 3])
    assert np.array_equal(read_image(path), rgba[..., :3])
    assert image_shape(path) == (5, 7)


def test_a_colour_of_a_palette_or_of_8_bits_may_be_transparent_and_16_bits_are_upright(tmp_path, rng):
    image = Image.fromarray(np.array([[0, 1], [1, 0]], np.uint8), "L").convert("P")
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.save(tmp_path / "a.png", transparency=1)
    codes, alpha = read_shown_image(tmp_path / "a.png")
    assert alpha is not None
    assert alpha.tolist() == [[255, 0], [0, 255]]
    assert codes[0].tolist() == [[10, 20, 30], [200, 100, 50]]
    Image.fromarray(np.array([[[9, 9, 9], [1, 2, 3]]], np.uint8)).save(tmp_path / "b.png", transparency=(1, 2, 3))
    assert np.array_equal(np.asarray(read_shown_image(tmp_path / "b.png")[1]), [[255, 0]])
    grey = rng.integers(0, 65535, (6, 4), dtype=np.uint16, endpoint=True)
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(grey).save(tmp_path / "c.png", exif=exif)
    codes, alpha = read_shown_image(tmp_path / "c.png")
    assert alpha is None
    assert np.array_equal(codes, np.rot90(grey, -1))
    Image.fromarray(grey).save(tmp_path / "d.png", transparency=5)
    with pytest.raises(InputError, match=r"d\.png: "):
        read_shown_image(tmp_path / "d.png")


@pytest.mark.parametrize("filters", [cv2.IMWRITE_PNG_ALL_FILTERS, *(8 << kind for kind in range(5))])
@pytest.mark.parametrize("channels", [3, 4])
def test_16_bit_colour_keeps_all_bits(tmp_path, rng, filters, channels):
    """Smooth colours, for which OpenCV's writer takes all of PNG's filters; and each of them alone."""
    codes = cv2.GaussianBlur(rng.integers(0, 65535, (23, 31, channels), dtype=np.uint16), (0, 0), 2)
    codes[9:14, 4:20] = rng.integers(0, 65535, (5, 16, channels))
    cv2.imwrite(str(tmp_path / "a.png"), codes, [cv2.IMWRITE_PNG_FILTER, filters])
    expected = codes[..., [2, 1, 0]]  # OpenCV's order is blue, green, red
    found = read_image(tmp_path / "a.png")
    assert found.dtype == np.uint16
    assert np.array_equal(found, expected)
    shown, alpha = read_shown_image(tmp_path / "a.png")
    assert np.array_equal(shown, expected)
    assert alpha is None if channels == 3 else np.array_equal(alpha, codes[..., 3])
    assert image_shape(tmp_path / "a.png") == (23, 31)


def deep_png(values: np.ndarray, colour: int, interlaced: int = 0) -> bytes:
    """Return a PNG of ``(H, W, C)`` 16 bit codes, unfiltered."""
    rows, columns = values.shape[:2]
    lines = b"".join(b"\0" + line.astype(">u2").tobytes() for line in values)
    header = struct.pack(">IIBBBBB", columns, rows, 16, colour, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")


def test_16_bit_grey_with_alpha(tmp_path, rng):
    codes = rng.integers(0, 65535, (5, 7, 2), dtype=np.uint16)
    (tmp_path / "a.png").write_bytes(deep_png(codes, 4))
    assert np.array_equal(read_image(tmp_path / "a.png"), codes[..., 0])
    light = read_light(tmp_path / "a.png")[..., 0]
    np.testing.assert_allclose(light, linear(codes[..., 0], 65535) * codes[..., 1] / 65535, rtol=1e-5)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[:-12],
        lambda data: data[:80],
        lambda data: data[:60] + bytes([data[60] ^ 1]) + data[61:],
        lambda data: data.replace(b"\0\0\0\0IEND", chunk(b"tRNS", bytes(6)) + b"\0\0\0\0IEND"),
        lambda data: deep_png(np.ones((6, 4, 3)), 2, interlaced=1),
        lambda data: data[:8] + chunk(b"IHDR", struct.pack(">IIBBBBB", 5, 6, 16, 2, 0, 0, 0)) + data[33:],
    ],
)
def test_16_bit_colour_that_is_damaged_is_refused(tmp_path, rng, spoil):
    path = tmp_path / "deep.png"
    path.write_bytes(spoil(deep_png(rng.integers(0, 65535, (6, 4, 3)), 2)))
    with pytest.raises(InputError, match=r"deep\.png: "):
        read_image(path)


def test_files_that_are_broken_or_would_lose_bits_are_named(tmp_path, rng):
    Image.new("CMYK", (3, 3)).save(tmp_path / "print.jpg")
    with pytest.raises(InputError, match=r"print\.jpg: "):
        read_image(tmp_path / "print.jpg")
    path = tmp_path / "a.png"
    with pytest.raises(InputError, match=r"a\.png: "):
        read_image(path)
    path.write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"a\.png: "):
        read_image(path)
    Image.fromarray(rng.integers(0, 255, (50, 70, 3), dtype=np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"a\.png: "):
        read_image(path)


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def claim(path, rows: int, columns: int, bits: int = 8) -> None:
    """Write a PNG whose header claims a size that its content does not hold."""
    header = struct.pack(">IIBBBBB", columns, rows, bits, 2, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    path.write_bytes(content)


@pytest.mark.parametrize(("rows", "columns"), [(60_000,) * 2, (2_000_000_000,) * 2, (13_500,) * 2, (1, MAX_PIXELS + 1)])
def test_a_tiny_file_that_claims_a_huge_picture_is_refused(tmp_path, rows, columns):
    for bits in (8, 16):
        claim(tmp_path / "bomb.png", rows, columns, bits)
        with pytest.raises(InputError, match=r"bomb\.png: "):
            read_image(tmp_path / "bomb.png")


@pytest.mark.filterwarnings("error")
def test_the_limit_is_what_the_refusal_says_and_below_it_nothing_is_warned_of(tmp_path):
    claim(tmp_path / "large.png", 1, MAX_PIXELS)
    assert image_shape(tmp_path / "large.png") == (1, MAX_PIXELS)


# Pictures as linear light: codes, alpha and orientation, each by a picture whose light is known by hand.


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
    ("values", "options"),
    [
        (np.array([[[0.5, -1, 0]]], np.float32), {}),
        (np.array([[[0.5, np.nan, 0]]], np.float32), {}),
        (np.zeros((1, 1, 3), np.int32), {}),
        (np.array([[[9, 9, 9, 1], [9, 9, 9, 2]]], np.uint8), {"extrasamples": ["assocalpha"]}),
    ],
)
def test_what_is_not_light_is_refused(tmp_path: Path, values: np.ndarray, options: dict) -> None:
    tifffile.imwrite(tmp_path / "bad.tif", values, photometric="rgb", **options)
    with pytest.raises(InputError, match=r"bad\.tif: "):
        read_light(tmp_path / "bad.tif")
    write_exr(tmp_path / "depth.exr", {"Z": np.ones((2, 2), np.float32)}, {})
    with pytest.raises(InputError, match=r"depth\.exr: "):
        read_light(tmp_path / "depth.exr")
