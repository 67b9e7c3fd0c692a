"""Unary costs against SciPy and by hand."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, laplace

from learning.baselines.focus import COSTS, MEASURES, sharpness, unary_cost
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
    average = lambda values: gaussian_filter(values, 1.3, mode="constant", truncate=20, axes=(2, 3))  # noqa: E731
    np.testing.assert_allclose(cost, average(raw) / average(np.ones_like(raw)), rtol=1e-10)


def test_spread_is_the_mean_squared_distance_to_the_light():
    light = torch.zeros(1, 5, 1, 1, 2, dtype=torch.float64)
    light[0, 0, 0, 0], light[0, 4, 0, 0] = torch.tensor([1.0, 0.0]), torch.tensor([1.0, 3.0])
    cost = cost_of(light, cost="spread", measure="light", contrast=0.5, window_px=0)
    x = np.arange(5) / 4
    np.testing.assert_allclose(cost[0, :, 0, 0], 0.5 * x**2 + 0.5 * (1 - x) ** 2, atol=1e-12)
    np.testing.assert_allclose(cost[0, :, 0, 1], (1 - x) ** 2, atol=1e-12)


@pytest.mark.parametrize("steps", [2, 3, 4])
def test_spread_between_planes_is_the_mean_squared_distance_too(volume, steps):
    """By its definition, label by label; at planes the same as without labels between."""
    settings = {"cost": "spread", "measure": "light", "contrast": 0.5, "window_px": 0}
    cost = cost_of(volume, **settings, steps_between_planes=steps)
    assert cost.shape == (2, 3 * steps + 1, 9, 11)
    torch.testing.assert_close(cost[:, ::steps], cost_of(volume, **settings))
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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contrast": 0}, "contrast: got 0, expected a positive number"),
        ({"window_px": -1}, "window_px: got -1"),
        ({"steps_between_planes": 0}, "steps_between_planes: got 0, expected 1"),
        ({"measure": "edges"}, "measure: got 'edges', expected one of gradient, laplacian, light"),
        ({"cost": "best"}, "cost: got 'best', expected one of defocus, spread"),
    ],
)
def test_refuses_what_makes_no_sense(volume, changes, message):
    with pytest.raises(InputError, match=message):
        cost_of(volume, **changes)


def test_refuses_another_shape():
    with pytest.raises(InputError, match=r"volume: got shape \(3, 4, 4\), expected \(B, K, C, h, w\)"):
        sharpness(torch.zeros(3, 4, 4))
