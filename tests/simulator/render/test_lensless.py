"""The ray-traced lensless camera against integrals, and the forward model against it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from simulator.errors import InputError
from simulator.render import Environment, Scene, activate
from simulator.render.lensless import lensless_render, shadow_psfs
from simulator.types import View

Arrays = Mapping[str, NDArray[Any]]
VIEW = View((8, 8), 19.2e-6, 1.9e-3, 0.036, 0.2)
RNG = np.random.default_rng(5)
AMPLITUDE = np.where(RNG.random((5, 8)) < 0.5, 0.7, 0.0) + 0.3 * (RNG.random((5, 8)) < 0.5)


@pytest.fixture(scope="module")
def quick(needs_llvm: None, rendered: Callable[..., Arrays]) -> Arrays:
    return rendered("simulator/render/worker.py", "lensless", "quick")


@pytest.fixture(scope="module")
def slow(needs_llvm: None, rendered: Callable[..., Arrays]) -> Arrays:
    return rendered("simulator/render/worker.py", "lensless", "slow")


class Agreement(NamedTuple):
    """How two sets of runs compare."""

    ratio: float  # of the sums, second over first
    p_value: float  # smallest of all pixels and channels, Welch's t-test
    sidak: float  # all p-values stay above it with probability 0.99 if both sets have the same means
    spread: float  # mean square of the scores over what it should be
    noise: float  # median standard error of the difference, relative
    error: float  # relative L2 of the difference with the noise taken out


def agreement(measured: NDArray[Any], modelled: NDArray[Any]) -> Agreement:
    runs = [np.asarray(part, np.float64) for part in (measured, modelled)]
    first, second = (part.mean(axis=0) for part in runs)
    squared = [part.var(axis=0, ddof=1) / len(part) for part in runs]
    variance = squared[0] + squared[1]
    difference = second - first
    # A t-test wants a mean of many hits: pixels that few openings light are left to the ratio and the L2 error.
    lit = second > 0.05 * second.max()
    score = difference[lit] / np.sqrt(variance[lit])
    each = sum(part[lit] ** 2 / (len(all_runs) - 1) for part, all_runs in zip(squared, runs, strict=True))
    freedom = variance[lit] ** 2 / each
    excess = np.sum(difference**2) - np.sum(variance)
    return Agreement(
        ratio=second.sum() / first.sum(),
        p_value=float(np.min(2 * stats.t.sf(np.abs(score), freedom))),
        sidak=1 - 0.99 ** (1 / score.size),
        spread=float(np.mean(score**2) / np.mean(freedom / (freedom - 2))),
        noise=float(np.median(np.sqrt(variance[lit]) / second[lit])),
        error=float(np.sign(excess) * np.sqrt(np.abs(excess) / np.sum(first**2))),
    )


def case(arrays: Arrays, name: str) -> Agreement:
    return agreement(arrays[f"{name}.measured"], arrays[f"{name}.modelled"])


@pytest.mark.slow
def test_an_even_sky_lights_the_sensor_as_the_integral_over_the_openings_says(quick: Arrays, geometry: Any) -> None:
    # Two Gauss points per axis in each cell and in each pixel.
    amplitude = geometry.random_mask(9)[:, 1:]
    node = 0.5 / np.sqrt(3)
    expected = np.zeros((40, 64))
    for pixel_y, pixel_x, cell_y, cell_x in np.ndindex(2, 2, 2, 2):
        # Stored pixel i lies at -(i - 19.5) p on the physical sensor: s - a becomes their sum.
        y = (np.arange(40) - 19.5 + (2 * pixel_y - 1) * node) * 19.2e-6
        x = (np.arange(64) - 31.5 + (2 * pixel_x - 1) * node) * 19.2e-6
        for i, j in np.argwhere(amplitude):
            down = y + (i - 4 + (2 * cell_y - 1) * node) * 60e-6
            right = x + (j - 3.5 + (2 * cell_x - 1) * node) * 60e-6
            squared = 1.9e-3**2 + down[:, np.newaxis] ** 2 + right**2
            expected += amplitude[i, j] ** 2 * 1.9e-3**2 / squared**2 * 60e-6**2 / 16
    runs = np.asarray(quick["sky.first"], np.float64)[..., 0]
    assert np.median(runs.std(axis=0) / 4 / expected) < 1e-3  # so sharp is this test
    p_values = np.asarray(stats.ttest_1samp(runs, expected, axis=0)[1])
    assert p_values.min() > 1 - 0.99 ** (1 / p_values.size)
    assert runs.mean() == pytest.approx(expected.mean(), rel=1e-5)
    np.testing.assert_allclose(quick["sky.first"], runs[..., np.newaxis] * (1.0, 2.0, 0.5), rtol=1e-5)


def test_a_seed_gives_the_same_picture_again(quick: Arrays) -> None:
    assert quick["sky.first"][3].tobytes() == quick["sky.again"][0].tobytes()
    assert not np.array_equal(quick["sky.first"][3], quick["sky.first"][4])


@pytest.mark.parametrize("name", ["0.036 m", "0.2 m", "slanted"])
def test_the_model_agrees_within_the_noise(quick: Arrays, name: str) -> None:
    # The model's own bias here, from cos^4 of the chief ray, is 0.15 % at 3.6 cm; the noise is 2.6 %.
    found = case(quick, name)
    assert found.noise < 0.03
    assert found.p_value > found.sidak
    assert found.spread == pytest.approx(1, abs=0.1)  # 2500 pixels of three correlated colours scatter by 0.03
    assert found.ratio == pytest.approx(1, abs=0.003)
    assert found.error < 0.006


@pytest.mark.slow
@pytest.mark.parametrize("name", ["0.07 m", "0.2 m", "2 m"])
def test_the_model_agrees_within_a_small_noise(slow: Arrays, name: str) -> None:
    # Bias by cos^4 of the chief ray: 0.09 % at 7 cm, less beyond.
    found = case(slow, name)
    assert found.noise < 0.007
    assert found.p_value > found.sidak
    assert found.spread == pytest.approx(1, abs=0.1)
    assert found.ratio == pytest.approx(1, abs=0.0005)
    assert found.error < 0.0015


@pytest.mark.slow
def test_near_the_mask_cos4_of_each_ray_is_all_that_the_model_lacks(slow: Arrays) -> None:
    by_cells = agreement(slow["0.036 m.measured"], slow["0.036 m.by_cells"])
    assert by_cells.p_value > by_cells.sidak
    assert by_cells.spread == pytest.approx(1, abs=0.1)
    # cos^4 of each cell's middle: its rays scatter about that by (60 um)^2 / 12 on each axis, which takes 4 / d^2 times that.
    assert by_cells.ratio == pytest.approx(1 - 4 * 60e-6**2 / 12 / 1.9e-3**2, abs=0.0005)
    assert by_cells.error < 0.001  # the noise leaves 0.0008 open
    assert 0.001 < case(slow, "0.036 m").error < 0.002


@pytest.mark.slow
def test_a_slanted_plane_differs_by_its_foreshortening_alone(slow: Arrays, geometry: Any) -> None:
    # Seen from a point a of the mask, the plane 1/z = 16 + 20 x/z - 15 y/z sends 1 - 20 a_x + 15 a_y times the light that
    # the centre sees; the model knows the centre only, so that it misses 20 a_x - 15 a_y at the openings' centroid.
    found = case(slow, "slanted")
    amplitude = geometry.random_mask(9)
    openings = amplitude**2 / np.sum(amplitude**2)
    position = (np.arange(9) - 4) * 60e-6
    centroid_x, centroid_y = np.sum(openings @ position), np.sum(openings.T @ position)
    assert found.ratio == pytest.approx(1 + 20 * centroid_x - 15 * centroid_y, abs=0.0004)
    assert found.error < 0.006


def test_occlusion_is_the_layered_models_error_and_hidden_layers_make_it_worse(quick: Arrays) -> None:
    found = case(quick, "occlusion")
    assert 0.01 < found.error < 0.04
    assert found.ratio == pytest.approx(1, abs=0.01)
    with_hidden = agreement(quick["occlusion.measured"], quick["occlusion.modelled"] + quick["occlusion.hidden"])
    assert with_hidden.ratio > 1.1
    assert with_hidden.error > 5 * found.error


def test_with_its_margin_the_model_measures_what_the_whole_sensor_sees(quick: Arrays) -> None:
    """Lights in view, to 40 degrees beside the image; what is left is cos^4 of the chief ray and the wall's edge."""
    found = case(quick, "whole sensor")
    assert found.ratio == pytest.approx(1, abs=0.005)
    assert found.error < 0.01
    alone = agreement(quick["whole sensor.measured"], quick["whole sensor.alone"])
    assert alone.error > 0.5  # which is what a data set without margin measures


@pytest.mark.parametrize("depth_m", [0.01, 0.05, np.inf])
def test_shadows_are_those_of_many_rays(depth_m: float) -> None:
    # 200 x 200 rays per cell to where they land: each cell's edges are known to 1/200 of it.
    magnification = 1 + 1.9e-3 / depth_m
    fine = np.kron(AMPLITUDE**2, np.ones((200, 200)))
    y, x = ((np.arange(n) - (n - 1) / 2) * 50e-6 / 200 * magnification for n in fine.shape)
    found = shadow_psfs(AMPLITUDE, 50e-6, 1.9e-3, [depth_m], 19.2e-6)[0]
    size = len(found)
    rows, columns = (np.floor(-part / 19.2e-6 + 0.5).astype(int) + size // 2 for part in (y, x))
    rays = np.zeros((size, size))
    np.add.at(rays, (rows[:, np.newaxis], columns), fine)
    rays *= (50e-6 / 200 / 19.2e-6) ** 2
    np.testing.assert_allclose(found, rays, atol=0.03)  # 1/200 x 50 um in 19.2 um, on each axis
    assert found.sum() * 19.2e-6**2 == pytest.approx(np.sum(AMPLITUDE**2) * 50e-6**2, rel=1e-12)


def test_the_shadow_of_a_pixel_is_the_mean_of_its_points_shadows() -> None:
    # A point of the patch at u pixels moves the shadow by u: so does moving the mask, in steps of 1/20 pixel.
    pitch = 19.2e-6 / 20
    amplitude = np.kron(AMPLITUDE, np.ones((10, 10)))
    patch = shadow_psfs(amplitude, pitch, 1.9e-3, [np.inf], 19.2e-6, source="pixel")[0]
    total = np.zeros_like(patch)
    for down, right in np.ndindex(20, 20):
        moved = np.pad(amplitude, ((down, 19 - down), (right, 19 - right)))
        point = shadow_psfs(moved, pitch, 1.9e-3, [np.inf], 19.2e-6)[0]
        margin = (len(point) - len(patch)) // 2
        total += point[margin : margin + len(patch), margin : margin + len(patch)]
    np.testing.assert_allclose(patch, total / 400, atol=2e-3)  # 20 points along each axis stand for an integral


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"mask_amplitude": np.full((3, 3), 1.5)}, "mask_amplitude"),
        ({"mask_amplitude": np.zeros((3, 3))}, "mask_amplitude"),
        ({"mask_amplitude": np.ones(3)}, "mask_amplitude"),
        ({"mask_amplitude": np.full((3, 3), np.nan)}, "mask_amplitude"),
        ({"mask_pitch_m": 30.0}, "mask_pitch_m"),
        ({"sensor_shape": (0, 8)}, "sensor_shape"),
        ({"samples_per_pixel": 0}, "samples_per_pixel"),
        ({"seeds": []}, "seeds"),
        ({"seeds": [2**32]}, "seeds"),
        ({}, "variant"),  # in this process, which renders with the scalar variant
    ],
)
def test_what_cannot_be_traced_is_refused(changes: dict[str, Any], named: str) -> None:
    activate("scalar_rgb")
    arguments = {"mask_amplitude": np.ones((3, 3)), "mask_pitch_m": 50e-6, "sensor_shape": (8, 8)}
    options = {"samples_per_pixel": 4, "seeds": [1]}
    with pytest.raises(InputError, match=f"^{named}: "):
        lensless_render(Scene((), (Environment(np.ones(3)),)), VIEW, **(arguments | options | changes))


def test_a_shadow_of_something_else_is_refused() -> None:
    with pytest.raises(InputError, match=r"^source: "):
        shadow_psfs(AMPLITUDE, 50e-6, 1.9e-3, [0.1], 19.2e-6, source="line")
