"""Pictures come back bit by bit; whatever would lose bits is refused by name."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps

from simulator.errors import InputError
from simulator.io.images import MAX_PIXELS, picture_shape, read_picture, read_shown_picture


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_8_bit_colour_is_exact_and_alpha_is_ignored(tmp_path, rng):
    rgba = rng.integers(0, 255, (5, 7, 4), dtype=np.uint8, endpoint=True)
    Image.fromarray(rgba).save(tmp_path / "a.png")
    assert np.array_equal(read_picture(tmp_path / "a.png"), rgba[..., :3])
    assert picture_shape(tmp_path / "a.png") == (5, 7)


def test_lossless_webp_is_exact(tmp_path, rng):
    rgb = rng.integers(0, 255, (5, 7, 3), dtype=np.uint8, endpoint=True)
    Image.fromarray(rgb).save(tmp_path / "a.webp", lossless=True)
    assert np.array_equal(read_picture(tmp_path / "a.webp"), rgb)


def test_palette_becomes_its_colours(tmp_path):
    image = Image.fromarray(np.array([[0, 1], [1, 0]], np.uint8), "L").convert("P")
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.save(tmp_path / "a.png")
    assert read_picture(tmp_path / "a.png").tolist() == [[[10, 20, 30], [200, 100, 50]], [[200, 100, 50], [10, 20, 30]]]


def test_16_bit_grey_keeps_all_bits(tmp_path, rng):
    grey = rng.integers(0, 65535, (6, 4), dtype=np.uint16, endpoint=True)
    cv2.imwrite(str(tmp_path / "a.png"), grey)  # an independent writer
    found = read_picture(tmp_path / "a.png")
    assert found.dtype == np.uint16
    assert np.array_equal(found, grey)


def test_16_bit_colour_is_refused_rather_than_halved(tmp_path, rng):
    cv2.imwrite(str(tmp_path / "deep.png"), rng.integers(0, 65535, (6, 4, 3), dtype=np.uint16))
    with pytest.raises(InputError, match=r"deep\.png .*16 bit.*TIFF"):
        read_picture(tmp_path / "deep.png")


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
    codes, alpha = read_shown_picture(path)
    assert alpha is not None
    assert np.array_equal(codes, expected[..., :3])
    assert np.array_equal(alpha, expected[..., 3])
    assert np.array_equal(read_picture(path), rgba[..., :3])


def test_a_colour_of_a_palette_or_of_8_bits_may_be_transparent_and_16_bits_are_upright(tmp_path, rng):
    image = Image.fromarray(np.array([[0, 1], [1, 0]], np.uint8), "L").convert("P")
    image.putpalette([10, 20, 30, 200, 100, 50])
    image.save(tmp_path / "a.png", transparency=1)
    codes, alpha = read_shown_picture(tmp_path / "a.png")
    assert alpha is not None
    assert alpha.tolist() == [[255, 0], [0, 255]]
    assert codes[0, 0].tolist() == [10, 20, 30]
    Image.fromarray(np.array([[[9, 9, 9], [1, 2, 3]]], np.uint8)).save(tmp_path / "b.png", transparency=(1, 2, 3))
    assert np.array_equal(np.asarray(read_shown_picture(tmp_path / "b.png")[1]), [[255, 0]])
    grey = rng.integers(0, 65535, (6, 4), dtype=np.uint16, endpoint=True)
    exif = Image.Exif()
    exif[274] = 6
    Image.fromarray(grey).save(tmp_path / "c.png", exif=exif)
    codes, alpha = read_shown_picture(tmp_path / "c.png")
    assert alpha is None
    assert np.array_equal(codes, np.rot90(grey, -1))
    Image.fromarray(grey).save(tmp_path / "d.png", transparency=5)
    with pytest.raises(InputError, match=r"d\.png .*16 bit"):
        read_shown_picture(tmp_path / "d.png")


def test_unknown_pixel_kinds_are_refused(tmp_path):
    Image.new("CMYK", (3, 3)).save(tmp_path / "print.jpg")
    with pytest.raises(InputError, match=r"print\.jpg .*'CMYK'"):
        read_picture(tmp_path / "print.jpg")


def test_broken_files_are_named(tmp_path, rng):
    path = tmp_path / "a.png"
    with pytest.raises(InputError, match=r"a\.png"):
        read_picture(path)
    path.write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"a\.png"):
        read_picture(path)
    Image.fromarray(rng.integers(0, 255, (50, 70, 3), dtype=np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match=r"a\.png"):
        read_picture(path)


def claim(path, rows: int, columns: int) -> None:
    """Write a PNG whose header claims a size that its content does not hold."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    path.write_bytes(content)


@pytest.mark.parametrize(("rows", "columns"), [(60_000,) * 2, (2_000_000_000,) * 2, (13_500,) * 2, (1, MAX_PIXELS + 1)])
def test_a_tiny_file_that_claims_a_huge_picture_is_refused(tmp_path, rows, columns):
    claim(tmp_path / "bomb.png", rows, columns)
    with pytest.raises(InputError, match=rf"bomb\.png .*{MAX_PIXELS}"):
        read_picture(tmp_path / "bomb.png")


@pytest.mark.filterwarnings("error")
def test_the_limit_is_what_the_refusal_says_and_below_it_nothing_is_warned_of(tmp_path):
    claim(tmp_path / "large.png", 1, MAX_PIXELS)
    assert picture_shape(tmp_path / "large.png") == (1, MAX_PIXELS)
