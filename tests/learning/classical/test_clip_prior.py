"""Plug-and-play over frames: without a prior it is non-negative least squares; with one it finds what a prior must."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor

from learning.camera import CaptureModel
from learning.checkpoint import find_denoiser, load_denoiser
from learning.classical import clip_prior
from learning.classical.clip_prior import ClipPlugAndPlay
from learning.layers.noise import noise_level
from learning.layers.space_time import JOINT, ClipProblem, JointLeastSquares
from simulator.errors import InputError

pytestmark = pytest.mark.usefixtures("double")

SETTINGS: dict[str, Any] = {"prior": 1.0, "level_first": 0.2, "level_last": 0.05, "over_time": 0.0}
SETTINGS |= {"iterations": 12, "inner": 4}


class Plain:
    """A prior that finds nothing wrong, and remembers what it was told."""

    def __init__(self) -> None:
        self.told: list[Tensor] = []

    def planes(self, volume: Tensor, noise: Tensor) -> Tensor:
        self.told.append(noise)
        return volume.clone()


@pytest.fixture(scope="module")
def small(dotted_camera: Callable[..., CaptureModel]) -> CaptureModel:
    """16 x 14 pixels for three frames of 6 x 4 in a field of 8 x 6."""
    return dotted_camera((16, 14), (6, 4), 11, 3)


def method(capture: CaptureModel, denoiser: Any, **settings: Any) -> ClipPlugAndPlay:
    start = JointLeastSquares(capture, **dict(JOINT))
    return ClipPlugAndPlay(capture, denoiser=denoiser, start=start, **SETTINGS | settings)


def squares(problem: ClipProblem) -> Tensor:
    """Return light with a bright square that moves in the dark: where there is none, noise pulls below zero."""
    light = problem.dark(1)
    for frame in range(len(light)):
        light[frame, ..., 1:4, frame : frame + 2] = 0.8
    return light


@pytest.mark.parametrize("level_last", [0.2, 0.1])
def test_without_a_prior_it_is_non_negative_least_squares(
    small: CaptureModel, level_last: float, measured: Callable[..., Tensor], dense: Callable[[ClipProblem], np.ndarray]
) -> None:
    """Against an active-set solver on the matrix of each channel, with a weight that stays or rises fourfold."""
    prior, problem = Plain(), ClipProblem(small)
    given = measured(problem, squares(problem), 0.05)
    solver = method(small, prior, prior=0.3, level_last=level_last, iterations=250)
    found = solver(given)[0]
    assert float(found.min()) >= 0
    target = problem.target(given)[0]
    light = [nnls(matrix, y.numpy().ravel())[0] for matrix, y in zip(dense(problem), target, strict=True)]
    wanted = torch.from_numpy(np.stack(light, axis=1)).reshape(3, *small.field_shape, 2)
    wanted = problem.film(wanted.movedim(-1, 1)[:, None, None])[0, :, 0]
    assert float((wanted == 0).double().mean()) > 0.2  # the constraint decides
    np.testing.assert_allclose(found.numpy(), wanted.numpy(), atol=3e-5)
    np.testing.assert_allclose(torch.cat(prior.told), 0.2 * (level_last / 0.2) ** (np.arange(250) / 249))


@pytest.mark.parametrize("weight", [0.1, 10.0])
def test_the_prior_weighs_against_the_misfit_over_the_noise(
    small: CaptureModel, weight: float, measured: Callable[..., Tensor], dense: Callable[[ClipProblem], np.ndarray]
) -> None:
    """One step that denoises nothing: argmin |(A x - y) / s|^2 + prior |(x - x0) / d|^2, dense, then cut off at zero."""
    problem = ClipProblem(small)
    given = measured(problem, squares(problem), 0.05)
    solver = method(small, Plain(), prior=weight, iterations=1, inner=400)
    found = solver(given)[0]
    noise = (noise_level(given) * problem.scale).flatten()  # of each channel
    start = solver._start.light(given).clamp_min(0)
    wanted = torch.empty_like(start)
    for channel, (matrix, target) in enumerate(zip(dense(problem), problem.target(given)[0], strict=True)):
        own = weight * (float(noise[channel]) / SETTINGS["level_first"]) ** 2
        first = start[:, 0, 0, channel].numpy().ravel()
        right = matrix.T @ target.numpy().ravel() + own * first
        light = np.linalg.solve(matrix.T @ matrix + own * np.eye(len(right)), right)
        wanted[:, 0, 0, channel] = torch.from_numpy(light).reshape(3, *small.field_shape)
    film = problem.film(wanted.clamp_min(0))[0, :, 0]
    assert float((film - problem.film(start)[0, :, 0]).abs().max()) > 0.02  # it moves
    np.testing.assert_allclose(found.numpy(), film.numpy(), atol=1e-6)


def test_frames_are_drawn_to_the_static_picture_where_nothing_moves(dotted_camera: Callable[..., CaptureModel]) -> None:
    """Five frames of a wall with noise of 0.1, which a bright square crosses on the left."""
    capture = dotted_camera((32, 32), (20, 20), 11, 5)
    wall = torch.full((5, 1, 1, 2, 22, 22), 0.4)
    for frame in range(5):
        wall[frame, ..., 4 * frame : 4 * frame + 4, 2:6] = 1.6
    noisy = wall + 0.1 * torch.from_numpy(np.random.default_rng(0).normal(size=wall.shape))
    errors = {}
    for over_time in (0.0, 1.0, 2.0):
        found = method(capture, Plain(), over_time=over_time).denoised(noisy, 0.1) - wall
        errors[over_time] = [float(part.square().mean().sqrt()) for part in (found[..., 10:], found[..., :8])]
        if over_time == 0:
            torch.testing.assert_close(found, noisy - wall, rtol=0, atol=0)
    assert errors[2.0][0] == pytest.approx(0.1 / 5**0.5, rel=0.1)  # the error of a mean of five
    assert errors[1.0][0] < 0.75 * errors[0.0][0]
    assert errors[1.0][1] < 1.05 * errors[0.0][1]
    # The square is passed by, and counts as if it were no more than noise: a fifth of 0.1, not of 1.2.
    static = method(capture, Plain(), over_time=1e9).denoised(wall, 0.1)
    torch.testing.assert_close(static, static[:1].expand_as(static), rtol=0, atol=0)
    assert float(static.max()) == pytest.approx(0.4 + 0.1 / 5)


def test_the_static_picture_is_denoised_with_less_noise(small: CaptureModel) -> None:
    prior = Plain()
    method(small, prior, over_time=1.0).denoised(torch.rand(3, 1, 2, 2, 8, 6), 0.3)
    assert [each.tolist() for each in prior.told] == [[0.3] * 2, [pytest.approx(0.3 / 3**0.5)] * 2]


@pytest.mark.parametrize("at_once", [1, 2])  # as on a CPU, and as on a GPU
def test_each_capture_is_a_problem_of_its_own(
    small: CaptureModel, at_once: int, monkeypatch: pytest.MonkeyPatch, measured: Callable[..., Tensor]
) -> None:
    monkeypatch.setattr(clip_prior, "samples_at_once", lambda *_: at_once)
    problem = ClipProblem(small)
    both = torch.cat([measured(problem, gain * squares(problem), 0.03) for gain in (1.0, 0.3)])
    solver = method(small, Plain(), over_time=0.5)
    together = solver(both)
    assert together.shape == (2, 3, 2, 6, 4)
    for film, alone in zip(together, both.split(1), strict=True):
        torch.testing.assert_close(film, solver(alone)[0], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_the_shipped_denoiser_improves_on_the_start(
    dotted_camera: Callable[..., CaptureModel], measured: Callable[..., Tensor]
) -> None:
    """A disc that moves before a wall with a brighter half, in two per cent of noise."""
    capture = dotted_camera((64, 60), (24, 24), 81, 4, dots=60)
    problem = ClipProblem(capture)
    rows, columns = np.mgrid[:26, :26]
    film = np.stack([np.where((rows - 12) ** 2 + (columns - 6 - 4 * n) ** 2 < 16, 0.9, 0.1) for n in range(4)])
    light = torch.from_numpy(film + 0.2 * (rows > 18))[:, None, None, None].repeat(1, 1, 1, 2, 1, 1)
    given, wanted = measured(problem, light, 0.02), problem.film(light)[:, :, 0]
    denoiser, _ = load_denoiser(find_denoiser("denoiser"))
    settings: dict[str, Any] = {"prior": 2.0, "level_last": 0.02, "over_time": 1.0}
    solver = method(capture, denoiser.double(), **settings)
    errors = [float((each - wanted).square().mean().sqrt()) for each in (solver(given), solver._start(given))]
    assert errors[0] < 0.7 * errors[1]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("prior", 0.0),
        ("level_first", float("nan")),
        ("level_last", -0.1),
        ("level_last", 0.3),  # above the first
        ("over_time", -1.0),
        ("over_time", float("inf")),
        ("iterations", 0),
        ("inner", 0),
    ],
)
def test_bad_settings_are_refused(small: CaptureModel, name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"^{name}: "):
        method(small, Plain(), **{name: value})


def test_stills_and_other_shapes_are_refused(small: CaptureModel) -> None:
    with pytest.raises(InputError, match=r"^capture: "):
        method(replace(small, timing=None), Plain())
    with pytest.raises(InputError, match=r"^measurement: "):
        method(small, Plain())(torch.zeros(1, 2, 12, 12))
