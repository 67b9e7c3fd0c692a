"""The comparison of PSF stacks on differences that are known, and what it refuses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from psf_library.reference import CASES, compare_stacks, compute, draw_difference, load, load_pinned_mask
from simulator.errors import InputError
from simulator.optics.stack import PsfStack


@pytest.fixture
def stack() -> PsfStack:
    values = np.random.default_rng(0).random((2, 3, 8, 9))
    return PsfStack(values, np.array([0.04, np.inf]), 1e-5, ("R", "G", "B"), "test")


def _changed(stack: PsfStack, place: tuple[int, int, int, int], by: float) -> PsfStack:
    values = np.array(stack.values)
    values[place] += by
    return replace(stack, values=values)


def test_one_pixel_is_found_with_its_size(stack: PsfStack) -> None:
    """One pixel changed by e makes ||difference|| = e, in that plane alone."""
    place = (1, 0, 6, 2)
    difference = compare_stacks(_changed(stack, place, 0.25), stack)
    expected = np.zeros((2, 3))
    expected[1, 0] = 0.25 / np.linalg.norm(stack.values[1, 0])
    np.testing.assert_allclose(difference.relative_l2, expected, rtol=1e-12)
    assert difference.worst_pixel == place
    assert difference.expected == stack.values[place]
    assert difference.found == stack.values[place] + 0.25
    words = str(difference)
    assert "depth ∞, channel R" in words
    assert "row 6, column 2" in words


def test_the_worst_plane_is_the_worst_relative_to_its_light(stack: PsfStack) -> None:
    """The same error weighs more where the plane is dim."""
    values = np.array(stack.values)
    values[0, 1] *= 1e-3
    dim = replace(stack, values=values)
    difference = compare_stacks(_changed(_changed(dim, (0, 1, 3, 3), 0.1), (1, 2, 4, 4), 0.1), dim)
    assert difference.worst_pixel == (0, 1, 3, 3)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"values": np.ones((2, 3, 8, 8))}, "size (K, C, H, W)"),
        ({"channels": ("R", "G", "X")}, "channels"),
        ({"pixel_pitch_m": 2e-5}, "pixel pitch"),
        ({"depths_m": np.array([0.04, 3.0])}, "depths (m)"),
    ],
)
def test_stacks_without_common_pixels_are_refused(stack: PsfStack, change: dict, named: str) -> None:
    with pytest.raises(InputError, match=f"^{re.escape(named)}"):
        compare_stacks(replace(stack, **change), stack)


def test_the_picture_shows_expected_found_and_difference(stack: PsfStack, tmp_path) -> None:
    path = draw_difference(_changed(stack, (1, 0, 6, 2), 0.5), stack, tmp_path / "difference.png")
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"), np.int16)
    panels = np.array_split(pixels, 3, axis=1)
    coloured = [np.mean(np.ptp(panel, axis=-1) > 40) for panel in panels]
    assert coloured[2] > 5 * max(coloured[:2])  # grey PSFs, and a difference in red and blue


def test_what_a_reference_was_made_from() -> None:
    stack, mask = load("pinhole"), load_pinned_mask("pinhole")
    made_from = stack.provenance["reference"]
    assert made_from["design"] == "pinhole"
    assert made_from["parameters"] == dict(CASES["pinhole"].parameters)
    assert stack.provenance["mask"]["sha256"] == mask.digest()


@pytest.mark.parametrize("ask", [load, load_pinned_mask, compute])
def test_unknown_names(ask) -> None:
    with pytest.raises(InputError, match=r"^name: .*'phlatcam'\?"):
        ask("phlatcm")
