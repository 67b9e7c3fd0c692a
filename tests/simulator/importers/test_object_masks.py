"""Masks are read as numbers, never as colours: palettes, binary pictures, void, and what cannot be told."""

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.importers.object_masks import fit_mask, object_pixels, read_object_numbers

NUMBERS = np.array([[0, 1, 2], [3, 255, 0]], np.uint8)


def save(path, values, mode=None, palette=None, **options):
    image = Image.fromarray(values) if mode is None else Image.fromarray(values, mode)
    if palette is not None:
        image.putpalette(palette)
    image.save(path, **options)
    return path


@pytest.mark.parametrize("seed", [1, 2])
def test_palette_indices_are_read_whatever_their_colours(tmp_path, seed) -> None:
    colours = np.random.default_rng(seed).integers(0, 256, 768, dtype=np.uint8).tolist()
    path = save(tmp_path / "m.png", NUMBERS, "P", colours)
    np.testing.assert_array_equal(read_object_numbers(path), NUMBERS)
    np.testing.assert_array_equal(object_pixels(NUMBERS), [[False, True, True], [True, False, False]])


def test_palettes_of_few_bits_and_with_a_transparent_colour(tmp_path) -> None:
    few = np.array([[0, 1, 2], [3, 1, 0]], np.uint8)
    path = save(tmp_path / "m.png", few, "P", [9, 9, 9, 8, 8, 8, 7, 7, 7, 6, 6, 6], bits=2, transparency=0)
    assert path.read_bytes()[24] == 2  # the bit depth in the header
    np.testing.assert_array_equal(read_object_numbers(path), few)


@pytest.mark.parametrize("kind", ["grey 255", "grey 1", "bit", "RGB", "RGBA"])
def test_binary_masks(tmp_path, kind) -> None:
    lit = np.array([[0, 1, 1], [0, 0, 1]], np.uint8)
    values = {
        "grey 255": lit * 255,
        "grey 1": lit,
        "bit": lit.astype(bool),
        "RGB": np.repeat(lit[..., None] * 255, 3, axis=-1),
        "RGBA": np.concatenate([np.repeat(lit[..., None] * 255, 3, axis=-1), np.full((2, 3, 1), 255, np.uint8)], -1),
    }[kind]
    np.testing.assert_array_equal(read_object_numbers(save(tmp_path / "m.png", values)), lit)


def test_what_cannot_be_told_is_refused_by_name(tmp_path) -> None:
    colours = np.zeros((2, 3, 3), np.uint8)
    colours[0, 1] = 128, 0, 0
    greys = [np.array(rows, np.uint8) for rows in ([[0, 3], [7, 0]], [[0, 1, 2], [3, 4, 5]], [[0, 1], [255, 0]])]
    for values in (colours, *greys, np.array([[0, 256]], np.uint16)):
        with pytest.raises(InputError, match=r"m\.png: "):
            read_object_numbers(save(tmp_path / "m.png", values))
    draw = np.random.default_rng(3).integers(0, 2, (40, 40), dtype=np.uint8)
    path = save(tmp_path / "m.png", draw, "P", [0, 0, 0, 9, 9, 9])
    path.write_bytes(path.read_bytes()[:-60])
    for file in (path, tmp_path / "no.png"):
        with pytest.raises(InputError, match=f"{file.name}: "):
            read_object_numbers(file)


@pytest.mark.parametrize("shape", [(8, 11), (8, 13), (7, 12), (9, 13)])
def test_resizing_by_a_pixel_is_nearest_neighbour(tmp_path, shape) -> None:
    numbers = np.random.default_rng(4).integers(0, 5, shape, dtype=np.uint8)
    fitted = fit_mask(numbers, (8, 12), tmp_path / "m.png", tmp_path / "p.jpg")
    np.testing.assert_array_equal(
        fitted, np.asarray(Image.fromarray(numbers).resize((12, 8), Image.Resampling.NEAREST))
    )
    with pytest.raises(InputError, match=r"m\.png: "):
        fit_mask(np.zeros((8, 10), np.uint8), (8, 12), tmp_path / "m.png", tmp_path / "p.jpg")
