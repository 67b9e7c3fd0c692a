"""Picture and depth of labels, pixel by pixel."""

import numpy as np
import pytest
import torch

from learning.baselines.all_in_focus import assemble
from learning.display import decode
from simulator.errors import InputError


@pytest.fixture
def scene():
    """Linear radiance of three planes, in sRGB primaries, each pixel and plane another."""
    return np.random.default_rng(0).uniform(0.05, 0.3, (2, 3, 3, 16, 16))


def volume_of(scene, capture):
    return torch.from_numpy(np.einsum("ca,bkahw->bkchw", capture.scene_to_camera, scene))


@pytest.fixture
def labels():
    return torch.from_numpy(np.random.default_rng(1).integers(0, 3, (2, 16, 16)))


def test_each_pixel_comes_from_its_plane(tiny_capture, scene, labels):
    """One by one, and back through the camera's colours."""
    estimate = assemble(volume_of(scene, tiny_capture), labels, tiny_capture, "label")
    radiance = decode(estimate.picture, 1.0).numpy()
    depths_cm = estimate.depth_m(tiny_capture).numpy() * 100
    for b, y, x in ((0, 0, 0), (1, 3, 15), (0, 15, 2), (1, 8, 8)):
        label = int(labels[b, y, x])
        np.testing.assert_allclose(radiance[b, :, y, x], scene[b, label, :, y, x], rtol=1e-6)
        np.testing.assert_allclose(depths_cm[b, 0, y, x], tiny_capture.stack.depths_m[label] * 100, rtol=1e-6)


def test_between_planes_light_and_disparity_go_linearly_from_one_to_the_next(tiny_capture, scene):
    """Pixel by pixel; disparity by depth, whose inverse goes evenly."""
    places = torch.from_numpy(np.random.default_rng(2).uniform(0, 2, (2, 16, 16)))
    estimate = assemble(volume_of(scene, tiny_capture), places, tiny_capture, "label")
    radiance = decode(estimate.picture, 1.0).numpy()
    depths_m = estimate.depth_m(tiny_capture).numpy()
    inverse = 1 / np.asarray(tiny_capture.stack.depths_m)
    for b, y, x in ((0, 0, 0), (1, 3, 15), (0, 15, 2), (1, 8, 8)):
        place = float(places[b, y, x])
        k, share = int(place), place % 1
        expected = (1 - share) * scene[b, k, :, y, x] + share * scene[b, k + 1, :, y, x]
        np.testing.assert_allclose(radiance[b, :, y, x], expected, rtol=1e-6)
        np.testing.assert_allclose(1 / depths_m[b, 0, y, x], np.interp(place, range(3), inverse), rtol=1e-6)


def test_sum_adds_up_the_planes(tiny_capture, scene, labels):
    estimate = assemble(volume_of(scene, tiny_capture), labels, tiny_capture, "sum")
    np.testing.assert_allclose(decode(estimate.picture, 1.0).numpy(), scene.sum(axis=1), rtol=1e-6)


def test_refuses_what_does_not_fit(tiny_capture, scene, labels):
    volume = volume_of(scene, tiny_capture)
    with pytest.raises(InputError, match=r"volume, places: got shapes .* with K = 3"):
        assemble(volume[:, :2], labels, tiny_capture, "label")
    with pytest.raises(InputError, match="volume, places: got shapes"):
        assemble(volume, labels[:1], tiny_capture, "label")
    for wrong in (2.25, -0.5, float("nan")):
        outside = torch.zeros(labels.shape).index_fill_(1, torch.tensor([0]), wrong)
        with pytest.raises(InputError, match=r"places: got .*, expected 0 to 2, from the first plane to the last"):
            assemble(volume, outside, tiny_capture, "label")
    with pytest.raises(InputError, match="light: got 'all', expected one of label, sum"):
        assemble(volume, labels, tiny_capture, "all")
