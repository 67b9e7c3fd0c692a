"""FISTA-TV: its proximal steps and its minimum against other algorithms; points that flash in turn come out in turn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from torch import Tensor

from learning.camera import CaptureModel
from learning.classical.fista import FistaTv, prox_haar, prox_tv
from learning.layers.space_time import JOINT, ClipProblem, JointLeastSquares
from simulator.errors import InputError

pytestmark = pytest.mark.usefixtures("double")

SETTINGS: dict[str, Any] = {"tv": 0.02, "tv_over_time": 0.5, "iterations": 40, "prox": "exact", "inner": 8}


Dense = Callable[[ClipProblem], np.ndarray]


@pytest.fixture(scope="module")
def small(dotted_camera: Callable[..., CaptureModel]) -> CaptureModel:
    """12 x 11 pixels for three frames of 4 x 3 in a field of 6 x 5."""
    return dotted_camera((12, 11), (4, 3), 9, 3, dots=20)


@pytest.fixture
def given(small: CaptureModel, measured: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """Return a function that gives the measurement ``(1, C, H, W)`` of what moves, at a PSNR."""

    def given(noise_db: float, gain: float = 1.0) -> Tensor:
        light = torch.from_numpy(gain * moving(small))[:, None, None]
        return measured(ClipProblem(small), light, 10 ** (-noise_db / 20))

    return given


def moving(capture: CaptureModel) -> np.ndarray:
    """Return light ``(N, C, rows, columns)``: a bright corner before a grey wall, that moves and changes its colour."""
    light = np.full((capture.frames, len(capture.offset), *capture.field_shape), 0.2)
    for frame in range(capture.frames):
        light[frame, :, frame : frame + 3, 1:4] = np.array([0.9, 0.4, 0.6])[: light.shape[1], None, None]
    return light


def variation(light: np.ndarray, weights: tuple[float, float, float]) -> float:
    """Return the weighted total variation over the first and the last two axes."""
    axes = zip(weights, (0, -2, -1), strict=True)
    return float(sum(weight * np.abs(np.diff(light, axis=axis)).sum() for weight, axis in axes))


def differences(shape: tuple[int, int, int]) -> list[np.ndarray]:
    """Return the matrices of the differences along each axis."""
    unit = np.eye(int(np.prod(shape))).reshape(-1, *shape)
    return [np.diff(unit, axis=axis).reshape(len(unit), -1).T for axis in (1, 2, 3)]


LIMITS = [[0.05, 0.2, 0.1], [0.3, 0.0, 0.02], [2.0, 3.0, 4.0]]


@pytest.mark.parametrize("limits", LIMITS)
def test_the_exact_prox_is_the_minimum_that_another_algorithm_finds(limits: list[float]) -> None:
    """The dual's box by L-BFGS-B; what both give lies within the gap of primal and dual."""
    shape = (4, 3, 5)
    given = np.random.default_rng(0).normal(0.3, 0.6, shape)
    parts = differences(shape)
    matrix = np.concatenate(parts)
    box = np.concatenate([np.full(len(part), limit) for part, limit in zip(parts, limits, strict=True)])

    def dual(multipliers: np.ndarray) -> tuple[float, np.ndarray]:
        left = np.maximum(given.ravel() - matrix.T @ multipliers, 0)
        return float(left @ left) / 2, -matrix @ left

    options = {"maxiter": 20000, "maxfun": 40000, "ftol": 1e-16, "gtol": 1e-12}
    bounds = list(zip(-box, box, strict=True))
    solved = minimize(dual, np.zeros(len(box)), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    wanted = np.maximum(given.ravel() - matrix.T @ solved.x, 0)
    light = torch.from_numpy(given)
    zeros = tuple(torch.zeros_like(torch.diff(light, dim=axis)) for axis in (0, -2, -1))
    found, multipliers = prox_tv(light, limits, zeros, 3000)
    np.testing.assert_allclose(found.numpy().ravel(), wanted, rtol=0, atol=1e-6)
    assert float(found.min()) >= 0
    for part, limit in zip(multipliers, limits, strict=True):
        assert float(part.abs().max()) <= limit

    def primal(x: np.ndarray) -> float:
        return float(np.sum((x - given) ** 2)) / 2 + variation(x, (limits[0], limits[1], limits[2]))

    # Of any multipliers within the box, the dual is a bound from below that only the minimum reaches.
    bound = float(given.ravel() @ given.ravel()) / 2 - dual(np.concatenate([p.numpy().ravel() for p in multipliers]))[0]
    assert bound <= primal(found.numpy()) + 1e-12
    assert primal(found.numpy()) - bound < 1e-9 * bound
    if limits == LIMITS[2]:  # all differences are too dear: what is left is the mean
        np.testing.assert_allclose(found.numpy(), given.mean(), rtol=0, atol=1e-6)


def test_the_exact_prox_goes_on_from_its_multipliers() -> None:
    """A hundred times three steps, each begun where the last ended: not a hundred times the same three."""
    light = torch.from_numpy(np.random.default_rng(0).random((3, 6, 6)))
    zeros = tuple(torch.zeros_like(torch.diff(light, dim=axis)) for axis in (0, -2, -1))
    best, _ = prox_tv(light, LIMITS[0], zeros, 5000)
    multipliers, errors = zeros, []
    for _ in range(100):
        found, multipliers = prox_tv(light, LIMITS[0], multipliers, 3)
        errors.append(float((found - best).abs().max()))
    assert errors[0] > 0.05
    assert errors[-1] < 0.003


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("limit", [0.02, 0.05])
def test_the_haar_prox_of_one_pair(axis: int, limit: float) -> None:
    """0.5 apart, both move towards each other, by six limits at most, until they meet; as one of six parts of a mean."""
    shape = [1, 1, 1]
    shape[axis] = 2
    light = torch.tensor([0.9, 0.4]).reshape(shape)
    limits = [9.0, 9.0, 9.0]  # nothing else has a pair
    limits[axis] = limit
    found = prox_haar(light, limits).flatten().tolist()
    move = min(0.25, 6 * limit) / 6
    assert found == pytest.approx([0.9 - move, 0.4 + move], abs=1e-15)


def test_the_haar_prox_is_a_mean_over_axes_and_shifts() -> None:
    """Pair by pair in loops: odd and even lengths, and a leading pair of axes between time and rows."""
    light = np.random.default_rng(1).normal(size=(5, 2, 4, 3))
    limits = [0.03, 0.08, 0.2]
    total = np.zeros_like(light)
    for axis, limit in zip((0, 2, 3), limits, strict=True):
        for shift in (0, 1):
            part = np.moveaxis(light.copy(), axis, 0)
            for first in range(shift, len(part) - 1, 2):
                one, other = part[first].copy(), part[first + 1].copy()
                move = np.sign(one - other) * np.minimum(np.abs(one - other) / 2, 6 * limit)
                part[first], part[first + 1] = one - move, other + move
            total += np.moveaxis(part, 0, axis)
    found = prox_haar(torch.from_numpy(light), limits)
    np.testing.assert_allclose(found.numpy(), total / 6, rtol=0, atol=1e-15)


def test_the_step_is_safe_and_hardly_too_short(small: CaptureModel, dense: Dense) -> None:
    """Below the reciprocal of the greatest eigenvalue of A^T A of all channels, which a longer step would diverge beyond."""
    method = FistaTv(small, **SETTINGS)
    greatest = max(np.linalg.norm(matrix, 2) ** 2 for matrix in dense(method.problem))
    assert greatest <= method._eigenvalue(method.problem.dark(1)) <= 1.03 * greatest


def test_reaches_the_least_objective(small: CaptureModel, given: Callable[..., Tensor], dense: Dense) -> None:
    """The minimum of each channel by the method of Chambolle and Pock, 2011, with dense matrices."""
    measurement = given(40)
    method = FistaTv(small, **SETTINGS | {"iterations": 600})
    light = method._solve(measurement)
    target = method.problem.target(measurement)
    shape = (small.frames, *small.field_shape)
    weights = (0.02 * 0.5, 0.02, 0.02)
    limits = np.concatenate([np.full(len(m), w) for m, w in zip(differences(shape), weights, strict=True)])
    gradient, least, own = np.concatenate(differences(shape)), 0.0, 0.0
    for channel, matrix in enumerate(dense(method.problem)):
        y = target[0, channel].numpy().ravel()
        step = 0.99 / np.linalg.norm(np.concatenate([matrix, gradient]), 2)
        x = ahead = np.zeros(matrix.shape[1])
        p, t = np.zeros(len(y)), np.zeros(len(gradient))
        for _ in range(6000):
            p = (p + step * (matrix @ ahead - y)) / (1 + step)
            t = np.clip(t + step * (gradient @ ahead), -limits, limits)
            new = np.maximum(x - step * (matrix.T @ p + gradient.T @ t), 0)
            ahead, x = 2 * new - x, new
        found = light[:, 0, 0, channel].numpy()
        for name, each in (("least", x.reshape(shape)), ("own", found)):
            value = np.sum((matrix @ each.ravel() - y) ** 2) / 2 + variation(each, weights)
            least, own = (least + value, own) if name == "least" else (least, own + value)
        np.testing.assert_allclose(found, x.reshape(shape), rtol=0, atol=1e-3)  # of white
    assert method.objective(light, target) == pytest.approx(own, rel=1e-12)
    # Both are above the minimum, and both approach it.
    assert own == pytest.approx(least, rel=1e-5)


def test_its_steps_are_those_of_restarted_fista(
    small: CaptureModel, given: Callable[..., Tensor], dense: Dense
) -> None:
    """Beck and Teboulle's momentum, dropped as O'Donoghue and Candes do by the gradient, with dense matrices and tv 0."""
    measurement = given(40)
    method = FistaTv(small, **SETTINGS | {"tv": 0.0, "iterations": 300})
    method(measurement)
    matrices = dense(method.problem)
    target = method.problem.target(measurement)[0].numpy().reshape(len(matrices), -1)
    step = 1 / method._eigenvalue(method.problem.dark(1))
    x = ahead = np.zeros((len(matrices), matrices.shape[2]))
    t, curve, restarts = 1.0, [], 0
    for _ in range(300):
        misfit = np.einsum("cij,cj->ci", matrices, ahead) - target
        new = np.maximum(ahead - step * np.einsum("cij,ci->cj", matrices, misfit), 0)
        if np.sum((ahead - new) * (new - x)) > 0:
            t, ahead, restarts = 1.0, new, restarts + 1
        else:
            after = (1 + np.sqrt(1 + 4 * t**2)) / 2
            ahead, t = new + (t - 1) / after * (new - x), after
        x = new
        curve.append(np.sum((np.einsum("cij,cj->ci", matrices, x) - target) ** 2) / 2)
    assert restarts > 0
    # Rounding of A by FFTs and by matrices, some 1e-15 in each step
    np.testing.assert_allclose(method.curve, curve, rtol=1e-8)


@pytest.mark.parametrize("prox", ["exact", "haar"])
def test_longer_is_never_worse_and_what_is_returned_is_the_best(
    small: CaptureModel, given: Callable[..., Tensor], prox: str
) -> None:
    measurement = given(40)
    objectives = []
    for iterations in (1, 3, 10, 30, 100):
        method = FistaTv(small, **SETTINGS | {"iterations": iterations, "prox": prox})
        light, target = method._solve(measurement), method.problem.target(measurement)
        assert float(light.min()) >= 0
        assert len(method.curve) == iterations
        objectives.append(method.objective(light, target))
        assert objectives[-1] == pytest.approx(min(method.curve), rel=1e-12)
        film = method.problem.film(light)[:, :, 0]
        torch.testing.assert_close(method(measurement), film, rtol=1e-12, atol=0)
    # The same steps each time, within the rounding of the same sums
    assert all(after <= before * (1 + 1e-12) for before, after in pairwise(objectives))
    dark = method.objective(method.problem.dark(1), target)
    assert objectives[-1] < 0.05 * dark
    assert objectives[-1] < 0.7 * objectives[0]


def test_a_start_is_where_it_begins(small: CaptureModel, given: Callable[..., Tensor]) -> None:
    """One step from the joint least squares explains more than one step from the dark; at the end both are the same."""
    measurement = given(60)
    start = JointLeastSquares(small, **dict(JOINT) | {"static": 0.5, "moving": 0.3})
    ends = {}
    for name, first in (("dark", None), ("joint", start)):
        for iterations in (1, 400):
            method = FistaTv(small, **SETTINGS | {"iterations": iterations, "tv": 0.05}, start=first)
            film = method(measurement)
            ends[name, iterations] = method.curve[-1], film
    assert ends["joint", 1][0] < 0.7 * ends["dark", 1][0]
    assert ends["joint", 400][0] == pytest.approx(ends["dark", 400][0], rel=1e-4)
    torch.testing.assert_close(ends["joint", 400][1], ends["dark", 400][1], rtol=0, atol=0.01)  # of white


def test_captures_of_a_batch_do_not_know_of_each_other(small: CaptureModel, given: Callable[..., Tensor]) -> None:
    """One after the other: the multipliers of one are none of the next one's."""
    batch = torch.cat([given(40, gain) for gain in (1.0, 0.1)])
    method = FistaTv(small, **SETTINGS)
    together = method(batch)
    assert together.shape == (2, 3, 2, 4, 3)
    for each, alone in zip(together.flip(0), batch.flip(0).split(1), strict=True):
        torch.testing.assert_close(each, method(alone)[0], rtol=0, atol=1e-12)


FLASHES = {1: (2, 9), 2: (7, 3), 3: (10, 8)}  # in each frame, where


@pytest.mark.parametrize(("prox", "noise_db"), [("exact", np.inf), ("exact", 60.0), ("haar", 60.0)])
def test_points_that_flash_in_turn_come_out_in_turn_and_place(
    dotted_camera: Callable[..., CaptureModel], measured: Callable[..., Tensor], prox: str, noise_db: float
) -> None:
    capture = dotted_camera((48, 44), (12, 12), 61, 5, dots=60, channels=1, margin=0)
    light = np.full((5, 1, 12, 12), 0.02)
    for frame, (row, column) in FLASHES.items():
        light[frame, :, row, column] = 1.0
    settings = SETTINGS | {"tv": 1e-3, "tv_over_time": 1.0, "iterations": 150, "prox": prox, "inner": 4}
    seen = measured(ClipProblem(capture), torch.from_numpy(light)[:, None, None], 10 ** (-noise_db / 20))
    film = FistaTv(capture, **settings)(seen)[0, :, 0].numpy()
    assert film.shape == (5, 12, 12)
    assert film.min() >= 0
    for frame, place in FLASHES.items():
        assert np.unravel_index(film[frame].argmax(), (12, 12)) == place
        assert film[:, *place].argmax() == frame
        assert film[frame, *place] > 0.5
        others = np.delete(film[:, *place], frame)
        assert others.max() < 0.5 * film[frame, *place]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tv": -0.1}, "^tv: "),
        ({"tv": float("nan")}, "^tv: "),
        ({"tv_over_time": float("inf")}, "^tv_over_time: "),
        ({"iterations": 0}, "^iterations: "),
        ({"inner": 0}, "^inner: "),
        ({"prox": "soft"}, "^prox: "),
    ],
)
def test_bad_settings_are_refused(small: CaptureModel, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        FistaTv(small, **SETTINGS | settings)


def test_stills_and_other_shapes_are_refused(small: CaptureModel) -> None:
    with pytest.raises(InputError, match=r"^capture: "):
        FistaTv(replace(small, timing=None), **SETTINGS)
    with pytest.raises(InputError, match=r"^measurement: "):
        FistaTv(small, **SETTINGS)(torch.zeros(1, 2, 12, 12))
