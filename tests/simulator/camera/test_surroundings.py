"""Images amid their surroundings: where each pixel goes, by explicit indices; what continues an image; what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.camera.surroundings import surrounded, whole_frames
from simulator.errors import InputError
from simulator.types import Clip, Surroundings, View

VIEW = View((8, 6), 1e-3, 2e-3, 0.05, 0.2, margin=(2, 3))


def clip(shape=(8, 6), frames=1, surroundings=None):
    rng = np.random.default_rng(0)
    rgb = rng.random((frames, *shape, 3)).astype(np.float32)
    depth = rng.uniform(0.05, 0.2, (frames, *shape)).astype(np.float32)
    return Clip(rgb, depth, np.ones(depth.shape, bool), np.arange(frames + 1.0), surroundings=surroundings)


@pytest.mark.parametrize(
    ("shape", "margin", "coarse", "coarseness"),
    [
        ((8, 6), (2, 3), (3, 3), 4),
        ((8, 8), (2, 1), (3, 3), 4),
        ((7, 6), (2, 3), (5, 4), 3),
        ((5, 5), (1, 0), (3, 3), 3),
    ],
)
def test_coarse_pixels_cover_the_field_about_the_same_middle(shape, margin, coarse, coarseness):
    view, found = replace(VIEW, shape=shape, margin=margin).coarse_field
    assert (view.shape, found) == (coarse, coarseness)
    assert view.pixel_pitch_m == coarseness * VIEW.pixel_pitch_m
    for fine, margin_, rows in zip(shape, margin, coarse, strict=True):
        assert rows * coarseness >= fine + 2 * margin_
        assert (rows * coarseness - fine) % 2 == 0


@pytest.mark.parametrize("still", [True, False])
def test_every_pixel_of_the_field_is_the_images_or_the_coarse_one_over_it(still):
    rng = np.random.default_rng(1)
    count = 1 if still else 2
    light = rng.random((count, 3, 3, 3)).astype(np.float32)
    depth = rng.uniform(0.05, 0.2, (count, 3, 3)).astype(np.float32)
    seen = clip(frames=2, surroundings=Surroundings(light, depth, 4))
    for t, (rgb, depth_m) in enumerate(whole_frames(seen, (12, 10))):
        around = 0 if still else t
        assert rgb.shape == (12, 10, 3)
        for i, j in np.ndindex(12, 10):
            inside = 2 <= i < 10 and 2 <= j < 8
            if inside:
                expected = seen.rgb[t, i - 2, j - 2], seen.depth_m[t, i - 2, j - 2]
            else:  # 12 x 12 fine pixels lie under the coarse ones, one column more on each side
                expected = light[around, i // 4, (j + 1) // 4], depth[around, i // 4, (j + 1) // 4]
            np.testing.assert_array_equal(rgb[i, j], expected[0])
            assert depth_m[i, j] == expected[1]


def test_an_image_goes_on_as_in_mirrors_again_and_again():
    view = replace(VIEW, shape=(4, 4), margin=(12, 4))
    seen = clip((4, 4), frames=2)
    around = surrounded(seen, view, "continue").surroundings
    assert around is not None
    assert (around.rgb.shape, around.coarseness) == ((2, 7, 3, 3), 4)
    # Whole coarse pixels lie over whole mirror images here, all with the image's mean.
    np.testing.assert_allclose(
        around.rgb, np.broadcast_to(seen.rgb.mean(axis=(1, 2))[:, None, None], (2, 7, 3, 3)), rtol=1e-6
    )
    half = replace(VIEW, shape=(8, 8), margin=(4, 4))
    seen = clip((8, 8))
    around = surrounded(seen, half, "continue").surroundings
    assert around is not None
    np.testing.assert_allclose(around.rgb[0, 0, 1], seen.rgb[0, :4, :4].mean(axis=(0, 1)), rtol=1e-6)
    np.testing.assert_allclose(around.rgb[0, 3, 3], seen.rgb[0, 4:, 4:].mean(axis=(0, 1)), rtol=1e-6)
    assert around.depth_m[0, 0, 1] == seen.depth_m[0, 1, 2]  # the middle of a coarse pixel, mirrored up and down


def test_black_and_images_lie_at_the_far_depth():
    dark = surrounded(clip(), VIEW, "black").surroundings
    assert dark is not None
    assert not dark.rgb.any()
    assert np.all(dark.depth_m == np.float32(0.2))
    image = np.random.default_rng(2).random((3, 3, 3)).astype(np.float32)
    around = surrounded(clip(), replace(VIEW, far_m=np.inf), image).surroundings
    assert around is not None
    np.testing.assert_array_equal(around.rgb[0], image)
    assert np.all(around.depth_m == 1e6)


def test_scenes_that_bring_their_own_or_need_none_stay_as_they_are():
    own = clip(surroundings=Surroundings(np.ones((1, 3, 3, 3), np.float32), np.ones((1, 3, 3), np.float32), 4))
    assert surrounded(own, VIEW, None) is own
    with pytest.raises(InputError, match=r"^scene\.surroundings: "):
        surrounded(own, VIEW, "black")
    bare = clip()
    assert surrounded(bare, replace(VIEW, margin=(0, 0)), None) is bare
    with pytest.raises(InputError, match=r"^scene\.surroundings: "):
        surrounded(bare, VIEW, None)


@pytest.mark.parametrize(
    ("seen", "field"),
    [
        (clip(), (12, 10)),
        (
            clip(surroundings=Surroundings(np.ones((1, 3, 3, 3), np.float32), np.ones((1, 3, 3), np.float32), 4)),
            (16, 10),
        ),
        (
            clip(surroundings=Surroundings(np.ones((1, 3, 3, 3), np.float32), np.ones((1, 3, 3), np.float32), 4)),
            (11, 10),
        ),
    ],
    ids=["no surroundings", "too small", "another middle"],
)
def test_what_does_not_make_the_field_is_refused(seen, field):
    with pytest.raises(InputError, match=r"^clip: "):
        list(whole_frames(seen, field))
