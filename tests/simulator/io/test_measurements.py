"""Files as people have them, written by packages that are not ours: the numbers that went in, and what is said of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from simulator.errors import InputError
from simulator.io.measurements import (
    MeasuredImage,
    full_pixels,
    full_scale,
    looks_like_a_mosaic,
    read_measured_image,
    read_measurement,
    superpixels,
)

ROWS, COLUMNS = 32, 48
RNG = np.random.default_rng(3)
GREY_16 = RNG.integers(0, 65536, (ROWS, COLUMNS), np.uint16)
RGB_16 = RNG.integers(0, 65536, (ROWS, COLUMNS, 3), np.uint16)
RGB_8 = RNG.integers(0, 256, (ROWS, COLUMNS, 3), np.uint8)
ALPHA_16 = RNG.integers(0, 65536, (ROWS, COLUMNS, 1), np.uint16)


def first(image: NDArray[Any]) -> NDArray[Any]:
    """Return ``(H, W)`` or ``(H, W, C)`` with channels first."""
    return image[None] if image.ndim == 2 else np.moveaxis(image, -1, 0)


@pytest.mark.parametrize("image", [GREY_16, RGB_16, RGB_16.astype(np.float32)])
@pytest.mark.parametrize("shape", ["channels first", "channels last", "a stack of one"])
def test_npy_in_the_shapes_that_people_save(tmp_path: Path, image: NDArray[Any], shape: str) -> None:
    saved = {
        "channels first": first(image),
        "channels last": image.reshape(ROWS, COLUMNS, -1),
        "a stack of one": image.reshape(1, ROWS, COLUMNS, -1),
    }[shape]
    np.save(tmp_path / "m.npy", saved)
    found = read_measured_image(tmp_path / "m.npy")
    assert np.array_equal(found.values, first(image))
    axis, names = "first" if shape == "channels first" else "last", "grey" if image.ndim == 2 else "R, G, B"
    said = [] if (axis, names) == ("first", "grey") else [f"its {axis} axis is taken as {names}"]
    assert [note.split(": ")[1] for note in found.notes] == said


@pytest.mark.parametrize("extra", [{}, {"A": ALPHA_16}])
@pytest.mark.parametrize("names", ["RGB", "Y", ("depth",)])
def test_exr_of_one_channel_or_of_colours_with_alpha(tmp_path: Path, names: Any, extra: dict[str, Any]) -> None:
    values = RNG.random((len(names), ROWS, COLUMNS)).astype(np.float32)
    channels = dict(zip(names, values, strict=True)) | {k: v[..., 0].astype(np.float32) for k, v in extra.items()}
    OpenEXR.File({}, channels).write(str(tmp_path / "m.exr"))
    for wanted in (("R", "G", "B"), ("grey",)):
        assert np.array_equal(read_measured_image(tmp_path / "m.exr", wanted[: len(values)]).values, values)


@pytest.mark.parametrize("image", [GREY_16, RGB_8, GREY_16.astype(np.float32)])
def test_tiff_compressed_by_lzw(tmp_path: Path, image: NDArray[Any]) -> None:
    Image.fromarray(image).save(tmp_path / "m.tif", compression="tiff_lzw")
    assert np.array_equal(read_measured_image(tmp_path / "m.tif").values, first(image))


def test_lzw_without_its_codec_is_read_where_pillow_loses_nothing_and_else_names_the_extra(tmp_path: Path) -> None:
    Image.fromarray(GREY_16).save(tmp_path / "grey.tif", compression="tiff_lzw")
    cv2.imwrite(str(tmp_path / "deep.tif"), RGB_16)  # LZW is OpenCV's default
    code = """
import sys
sys.modules["imagecodecs"] = None
import numpy as np
from pathlib import Path
from simulator.errors import InputError
from simulator.io.measurements import read_measured_image
print(int(read_measured_image(Path("grey.tif")).values.sum(dtype=np.int64)))
try:
    read_measured_image(Path("deep.tif"))
except InputError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    total, refusal = done.stdout.splitlines()
    assert int(total) == int(GREY_16.sum(dtype=np.int64))
    assert refusal.startswith("deep.tif: ")
    assert "captures" in refusal
    found = read_measured_image(tmp_path / "deep.tif").values  # with imagecodecs, which the tests have
    assert np.array_equal(found, first(RGB_16[..., ::-1]))  # OpenCV writes blue first


@pytest.mark.parametrize("image", [GREY_16, RGB_16])
def test_tiff_in_tiles(tmp_path: Path, image: NDArray[Any]) -> None:
    tifffile.imwrite(tmp_path / "m.tif", image, tile=(16, 16), photometric="rgb" if image.ndim == 3 else "minisblack")
    assert np.array_equal(read_measured_image(tmp_path / "m.tif").values, first(image))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_sixteen_bit_colour_with_and_without_alpha(tmp_path: Path, suffix: str) -> None:
    for image in (RGB_16, np.concatenate([RGB_16, ALPHA_16], axis=2)):
        bgr = np.concatenate([image[..., 2::-1], image[..., 3:]], axis=2)
        cv2.imwrite(str(tmp_path / f"m{suffix}"), bgr)
        found = read_measured_image(tmp_path / f"m{suffix}")
        assert np.array_equal(found.values, first(RGB_16))
        assert any("alpha" in note for note in found.notes) == (image.shape[2] == 4)


def test_a_grey_capture_saved_as_colours_is_grey(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "m.png"), np.repeat(GREY_16[..., None], 3, axis=2))
    found = read_measured_image(tmp_path / "m.png")
    assert np.array_equal(found.values, GREY_16[None])
    assert found.notes


@pytest.mark.parametrize("kind", ["white is 0", "palette", "palette.png", "inks", "JPEG"])
def test_numbers_that_are_not_light_are_refused(tmp_path: Path, kind: str) -> None:
    path, colours = tmp_path / f"m{'.png' if kind.endswith('.png') else '.tif'}", Image.fromarray(RGB_8)
    if kind == "white is 0":
        tifffile.imwrite(path, GREY_16, photometric="miniswhite")
    elif kind == "JPEG":
        colours.save(path, compression="jpeg")
    else:
        (colours.convert("CMYK") if kind == "inks" else colours.quantize(64)).save(path)
    with pytest.raises(InputError, match=rf"{path.name}: .*save it as"):
        read_measured_image(path)


def write_dng(path: Path, mosaic: NDArray[np.uint16], cfa: str, black: int, white: int) -> None:
    """Write a mosaic as the DNG specification 1.4 has it, which LibRaw reads."""
    colours = bytes("RGB".index(colour) for colour in cfa)
    identity = (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1)
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, colours, True),  # CFAPattern
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),  # DNGVersion
        (50708, "s", 0, "a camera", True),  # UniqueCameraModel
        (50714, "H", 1, black, True),  # BlackLevel
        (50717, "H", 1, white, True),  # WhiteLevel
        (50721, "2i", 9, identity, True),  # ColorMatrix1
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
    ]
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags, metadata=None)


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_a_dng_is_the_mosaic_over_the_range_that_it_states(tmp_path: Path, cfa: str) -> None:
    mosaic = RNG.integers(0, 1024, (ROWS, COLUMNS), np.uint16)
    write_dng(tmp_path / "m.dng", mosaic, cfa, 64, 1023)
    found = read_measured_image(tmp_path / "m.dng")
    assert found.cfa == cfa
    assert np.allclose(found.values[0], (mosaic - 64.0) / (1023 - 64), rtol=1e-6, atol=0)  # float32
    assert found.values.min() < 0  # noise below black is not cut off
    (tmp_path / "m.dng").write_bytes((tmp_path / "m.dng").read_bytes()[:60])
    with pytest.raises(InputError, match=r"m\.dng: "):
        read_measured_image(tmp_path / "m.dng")


def test_colours_are_those_of_opencv_for_every_mosaic() -> None:
    """OpenCV's bilinear demosaicing keeps a mosaic of even colour; superpixels do, too, without its margins."""
    colour = np.array([50, 120, 200])
    for cfa, name in (
        ("RGGB", "BG"),
        ("BGGR", "RG"),
        ("GRBG", "GB"),
        ("GBRG", "GR"),
    ):  # OpenCV counts from pixel (1, 1)
        mosaic = np.zeros((1, 8, 11), np.uint8)
        for k, letter in enumerate(cfa):
            mosaic[0, k // 2 :: 2, k % 2 :: 2] = colour["RGB".index(letter)]
        theirs = cv2.cvtColor(mosaic[0], getattr(cv2, f"COLOR_Bayer{name}2RGB"))
        ours = superpixels(mosaic, cfa)
        assert ours.shape == (3, 4, 5)
        assert np.array_equal(ours[:, 1:3, 1:4], first(theirs[2:6:2, 2:8:2]))


def test_a_red_image_is_the_scene_through_the_red_psf() -> None:
    """Sampling every other pixel commutes with convolution by a scene that has light on the same pixels only."""
    from scipy.signal import convolve2d

    scene, psf = np.zeros((20, 20)), RNG.random((24, 24))
    scene[::2, ::2] = RNG.random((10, 10))
    measured = superpixels(convolve2d(scene, psf)[None, :42, :42], "RGGB")
    for channel, kernel in zip(measured, superpixels(psf[None], "RGGB"), strict=True):
        assert np.allclose(channel, convolve2d(scene[::2, ::2], kernel)[:21, :21], rtol=1e-12)


def through(psf: NDArray[Any], colours: NDArray[Any]) -> NDArray[Any]:
    """Return three boxes of these colours ``(3, 3)`` as a sensor sees them through a PSF, ``(3, 128, 192)``, at most 1."""
    scene = np.zeros((3, 128, 192))
    for colour, (top, left) in zip(colours, ((20, 40), (60, 100), (45, 20)), strict=True):
        scene[:, top : top + 40, left : left + 40] += colour[:, None, None]
    seen = np.stack([fftconvolve(channel, psf, "same") for channel in scene])
    return seen / seen.max()


def exposed(light: NDArray[Any], electrons: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Return what a sensor of 2.5 electrons read noise and a black level of 100 stores, ``(1, H, W)``."""
    return np.round(100 + rng.poisson(light.clip(0) * electrons) + rng.normal(0, 2.5, light.shape)).astype(np.uint16)[
        None
    ]


DIFFUSER = gaussian_filter(np.random.default_rng(4).random((128, 192)) ** 6, 1.2)
FLATCAM = np.pad(  # features of 2 pixels, that no 2 x 2 of the sensor holds
    np.kron(
        np.outer(*(np.random.default_rng(seed).random(n) > 0.5 for seed, n in ((0, 32), (1, 48)))), np.ones((2, 2))
    ),
    ((33, 31), (49, 47)),
)


@pytest.mark.parametrize("electrons", [20_000, 100])
@pytest.mark.parametrize("psf", [DIFFUSER, FLATCAM])
@pytest.mark.parametrize(
    "colours", [np.eye(3), np.full((3, 3), 1.0), [[1, 0.4, 0.1], [0.1, 0.6, 0.2], [0.3, 0.3, 0.9]]]
)
def test_mosaics_are_recognised_and_grey_captures_are_not(psf: NDArray[Any], colours: Any, electrons: int) -> None:
    """Whatever the scene's colours, at low light too; white light is seen by the sensor's response to it."""
    rng = np.random.default_rng(1)
    seen = through(psf, np.asarray(colours))
    for response in ((0.7, 1, 0.6), (0.9, 1, 0.8)):
        for cfa in ("RGGB", "GBRG"):
            mosaic = np.zeros(seen.shape[1:])
            for k, colour in enumerate(cfa):
                place = np.s_[k // 2 :: 2, k % 2 :: 2]
                mosaic[place] = seen["RGB".index(colour)][place] * response["RGB".index(colour)]
            assert looks_like_a_mosaic(exposed(mosaic, electrons, rng))
    grey = seen.mean(axis=0)
    assert not looks_like_a_mosaic(exposed(grey, electrons, rng))
    grey[:, ::2] *= 0.98  # read by two converters
    assert not looks_like_a_mosaic(exposed(grey, electrons, rng))
    assert not looks_like_a_mosaic(psf[None])


def test_an_image_that_says_little_is_taken_as_grey() -> None:
    spots = np.zeros((256, 256))
    spots[100:103, 40:42] = 1  # a pinhole's PSF, on few pixels
    for image in (spots, np.ones((256, 256)), np.ones((8, 8))):
        assert not looks_like_a_mosaic(image[None])


@pytest.mark.parametrize("shape", [(2, 3, 4, 5), (5, ROWS, COLUMNS), (ROWS, COLUMNS, 7), (0, 3), (4,)])
def test_other_shapes_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    np.save(tmp_path / "m.npy", np.ones(shape))
    with pytest.raises(InputError, match=r"m\.npy: "):
        read_measured_image(tmp_path / "m.npy")


def test_colours_are_refused_where_one_channel_is_wanted(tmp_path: Path) -> None:
    OpenEXR.File({}, {n: RNG.random((4, 4)).astype(np.float32) for n in "RGB"}).write(str(tmp_path / "m.exr"))
    with pytest.raises(InputError, match=r"m\.exr: "):
        read_measurement(tmp_path / "m.exr", ("Y",))


def test_a_smooth_capture_of_few_codes_is_not_full() -> None:
    """In 8 bits a bright spot's top is one code wide; clipped at three quarters of its height, it is full."""
    y, x = np.mgrid[-100:100, -100:100]
    spot = 200 * np.exp(-(x**2 + y**2) / (2 * 60.0**2))
    as_it_is, clipped = (np.round(light).astype(np.uint8)[None] for light in (spot, np.minimum(spot, 150)))
    assert np.count_nonzero(as_it_is == 200) > 20
    assert not full_pixels(as_it_is, 255.0)[0].any()
    filled, level = full_pixels(clipped, 255.0)
    assert level == 150
    assert np.array_equal(filled, np.round(spot) >= 150)


def test_a_raw_file_states_its_range_itself(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^--bits: "):
        full_scale(MeasuredImage(np.full((1, 4, 4), 0.5), cfa="RGGB"), 12, tmp_path)
