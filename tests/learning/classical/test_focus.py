"""Unary costs against SciPy and by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, laplace

from learning.classical.focus import COSTS, MEASURES, assemble, sharpness, unary_cost
from learning.method import srgb_to_linear
from simulator.errors import InputError

THESIS = {"cost": "defocus", "measure": "gradient", "contrast": 0.5, "window_px": 2.0, "steps_between_planes": 1}


def cost_of(volume, **changes):
    return unary_cost(volume, **THESIS | changes)


@pytest.fixture
def volume():
    return torch.from_numpy(np.random.default_rng(0).uniform(size=(2, 4, 3, 9, 11)))


def test_gradient_of_a_ramp_is_its_slope_squared_at_the_edges_too():
    rows, columns = torch.meshgrid(torch.arange(5.0), torch.arange(6.0), indexing="ij")
    ramps = torch.stack([3 * rows - 2 * columns, 0.5 * columns, torch.ones_like(rows)])[None, None]
    torch.testing.assert_close(sharpness(ramps), torch.full((1, 1, 5, 6), 9 + 4 + 0.25))


def test_laplacian_equals_scipys(volume):
    """``nearest`` repeats the last pixel: a difference of 0 to a neighbour that is not there."""
    expected = (laplace(volume.numpy(), mode="nearest", axes=(3, 4)) ** 2).sum(axis=2)
    np.testing.assert_allclose(sharpness(volume, "laplacian").numpy(), expected, rtol=1e-12)


def test_light_is_the_square(volume):
    np.testing.assert_allclose(sharpness(volume, "light").numpy(), (volume.numpy() ** 2).sum(axis=2), rtol=1e-12)


def test_defocus_is_the_thesis_formula_averaged_by_a_gaussian(volume):
    """Against SciPy's filter, whose weights at the edges are divided by what lies inside."""
    cost = cost_of(volume, contrast=0.7, window_px=1.3).numpy()
    slopes = sharpness(volume).numpy()
    raw = np.exp(-0.7 * slopes / slopes.mean(axis=(1, 2, 3), keepdims=True))

    def average(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, 1.3, mode="constant", truncate=20, axes=(2, 3))

    np.testing.assert_allclose(cost, average(raw) / average(np.ones_like(raw)), rtol=1e-10)


@pytest.mark.parametrize("steps", [1, 2, 3, 4])
def test_spread_is_the_mean_squared_distance_to_the_light(volume, steps):
    """By its definition, label by label, those between planes too."""
    settings = {"cost": "spread", "measure": "light", "contrast": 0.5, "window_px": 0}
    cost = cost_of(volume, **settings, steps_between_planes=steps)
    assert cost.shape == (2, 3 * steps + 1, 9, 11)
    light = sharpness(volume, "light").numpy() ** 0.5
    for label in range(3 * steps + 1):
        squares = (label / steps - np.arange(4)[:, None, None]) ** 2 / 9
        np.testing.assert_allclose(cost[:, label], (squares * light).sum(axis=1) / light.sum(axis=1), rtol=1e-10)


def test_defocus_has_the_planes_alone(volume):
    torch.testing.assert_close(cost_of(volume, steps_between_planes=4), cost_of(volume), rtol=0, atol=0)


def test_high_powers_of_the_spread_choose_the_sharpest(volume):
    cost = cost_of(volume.float(), cost="spread", measure="light", contrast=2000.0, window_px=0)
    torch.testing.assert_close(cost.argmin(dim=1), sharpness(volume, "light").argmax(dim=1))


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("cost", COSTS)
def test_costs_have_no_unit_and_scenes_do_not_touch(volume, cost, measure):
    alone = cost_of(volume[:1], cost=cost, measure=measure)
    assert alone.std(dim=1).mean() > 1e-4
    brighter = volume * torch.tensor([1e-3, 1e4], dtype=volume.dtype)[:, None, None, None, None]
    torch.testing.assert_close(cost_of(brighter, cost=cost, measure=measure)[:1], alone, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("cost", COSTS)
def test_black_costs_the_same_everywhere_and_nan_stays_nan(cost):
    black = torch.zeros(1, 3, 1, 4, 4)
    alike = cost_of(black, cost=cost)
    torch.testing.assert_close(alike, alike.flip(1))
    black[0, 1, 0, 2, 2] = torch.nan
    assert cost_of(black, cost=cost).isnan().any()


def test_refuses_another_shape():
    with pytest.raises(InputError, match=r"^volume: "):
        sharpness(torch.zeros(3, 4, 4))


@pytest.fixture
def scene():
    """Linear radiance of three planes, in sRGB primaries, each pixel and plane another."""
    return np.random.default_rng(0).uniform(0.05, 0.3, (2, 3, 3, 16, 16))


def volume_of(scene, capture):
    return torch.from_numpy(np.einsum("ca,bkahw->bkchw", capture.scene_to_camera, scene))


@pytest.fixture
def labels():
    return torch.from_numpy(np.random.default_rng(1).integers(0, 3, (2, 16, 16)))


def test_between_planes_light_and_disparity_go_linearly_from_one_to_the_next(tiny_capture, scene):
    """Pixel by pixel; disparity by depth, whose inverse goes evenly."""
    places = torch.from_numpy(np.random.default_rng(2).uniform(0, 2, (2, 16, 16)))
    places[1] = places[1].round()  # planes themselves
    estimate = assemble(volume_of(scene, tiny_capture), places, tiny_capture, "label")
    radiance = srgb_to_linear(estimate.image, 1.0).numpy()
    depths_m = estimate.depth_m(tiny_capture).numpy()
    inverse = 1 / np.asarray(tiny_capture.stack.depths_m)
    for b, y, x in ((0, 0, 0), (1, 3, 15), (0, 15, 2), (1, 8, 8)):
        place = float(places[b, y, x])
        k, share = int(place), place % 1
        expected = (1 - share) * scene[b, k, :, y, x] + share * scene[b, min(k + 1, 2), :, y, x]
        np.testing.assert_allclose(radiance[b, :, y, x], expected, rtol=1e-6)
        np.testing.assert_allclose(1 / depths_m[b, 0, y, x], np.interp(place, range(3), inverse), rtol=1e-6)


def test_sum_adds_up_the_planes(tiny_capture, scene, labels):
    estimate = assemble(volume_of(scene, tiny_capture), labels, tiny_capture, "sum")
    np.testing.assert_allclose(srgb_to_linear(estimate.image, 1.0).numpy(), scene.sum(axis=1), rtol=1e-6)


def test_refuses_what_does_not_fit(tiny_capture, scene, labels):
    volume = volume_of(scene, tiny_capture)
    with pytest.raises(InputError, match=r"^volume, places: "):
        assemble(volume[:, :2], labels, tiny_capture, "label")
    with pytest.raises(InputError, match=r"^volume, places: "):
        assemble(volume, labels[:1], tiny_capture, "label")
    for wrong in (2.25, -0.5, float("nan")):
        outside = torch.zeros(labels.shape).index_fill_(1, torch.tensor([0]), wrong)
        with pytest.raises(InputError, match=r"^places: "):
            assemble(volume, outside, tiny_capture, "label")
    with pytest.raises(InputError, match=r"^light: "):
        assemble(volume, labels, tiny_capture, "all")
