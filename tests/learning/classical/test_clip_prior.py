"""Plug-and-play over frames: without a prior it is non-negative least squares; with one it finds what a prior must."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.checkpoint import find_denoiser, load_denoiser
from learning.classical import clip_prior
from learning.classical.clip_prior import ClipPlugAndPlay, MeanInverse
from learning.layers.space_time import JOINT, ClipProblem, JointLeastSquares
from learning.timing import Timing
from simulator.camera.shutter import DualRollingShutter
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

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


class Nothing(nn.Module):
    """What does not precondition."""

    def forward(self, light: Tensor, weight: Tensor) -> Tensor:
        return light


def camera(sensor: tuple[int, int], scene: tuple[int, int], psf: int, frames: int, dots: int = 25) -> CaptureModel:
    """Return a camera of two colours: dots as wide apart as its sensor, light from one pixel around, two rolling shutters."""
    rng = np.random.default_rng(3)
    values = np.zeros((1, 2, psf, psf))
    for row, column in rng.integers(0, psf, (dots, 2)):
        values[0, :, row, column] = rng.uniform(0.5, 1.0, 2)
    shutter = DualRollingShutter(10e-3 / frames, 10e-3 * (1 - 1 / frames) / ((sensor[0] - 1) // 2))
    return CaptureModel(
        stack=PsfStack(values, np.array([0.1]), 1e-5, ("R", "G"), "dots"),
        sensor_shape=sensor,
        scene_shape=scene,
        gain=3.0,
        offset=np.full(2, 0.02),
        irradiance=rng.uniform(0.6, 0.9, (scene[0] + 2, scene[1] + 2)).astype(np.float32),
        scene_to_camera=np.eye(2, 3),
        white=0.7,
        timing=Timing(shutter, np.linspace(0, 10e-3, frames + 1)),
    )


@pytest.fixture(scope="module")
def small() -> CaptureModel:
    """16 x 14 pixels for three frames of 6 x 4 in a field of 8 x 6."""
    return camera((16, 14), (6, 4), 11, 3)


def method(capture: CaptureModel, denoiser: Any, **settings: Any) -> ClipPlugAndPlay:
    start = JointLeastSquares(capture, **dict(JOINT))
    return ClipPlugAndPlay(capture, denoiser=denoiser, start=start, **SETTINGS | settings)


def measure(problem: ClipProblem, light: Tensor, noise: float) -> Tensor:
    """Return the measurement ``(1, C, H, W)`` of light, with noise over the greatest value."""
    clean = problem(light) / problem.scale
    drawn = torch.from_numpy(np.random.default_rng(4).standard_normal(clean.shape))
    return clean + problem.offset + noise * clean.max() * drawn


def squares(problem: ClipProblem) -> Tensor:
    """Return light with a bright square that moves in the dark: where there is none, noise pulls below zero."""
    light = problem.dark(1)
    for frame in range(len(light)):
        light[frame, ..., 1:4, frame : frame + 2] = 0.8
    return light


def dense(problem: ClipProblem) -> np.ndarray:
    """Return A for each channel, column by column, ``(C, H W, N rows columns)``; that these are right is tested elsewhere."""
    frames, _, channels, *field = problem.shape
    count = frames * field[0] * field[1]
    units = torch.eye(count).reshape(count, frames, 1, 1, *field).movedim(0, 2).expand(-1, -1, -1, channels, -1, -1)
    return problem(units).permute(1, 2, 3, 0).flatten(1, 2).numpy()


@pytest.mark.parametrize("level_last", [0.2, 0.1])
def test_without_a_prior_it_is_non_negative_least_squares(small: CaptureModel, level_last: float) -> None:
    """Against an active-set solver on the matrix of each channel, with a weight that stays or rises fourfold."""
    prior, problem = Plain(), ClipProblem(small)
    given = measure(problem, squares(problem), 0.05)
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


def test_the_data_step_solves_the_normal_equations(small: CaptureModel) -> None:
    """Of each capture and channel with its own weight; from where it is begun, and nearer with each step."""
    solver = method(small, Plain(), inner=80)
    rng = np.random.default_rng(0)
    wanted, begun = (torch.from_numpy(rng.normal(size=(3, 1, 2, 2, 8, 6))) for _ in range(2))
    weight = torch.tensor([[0.1, 0.3], [1.0, 2.0]])[..., None, None]
    found = solver._explained(begun, wanted, weight)
    matrices = dense(solver.problem)
    for capture, channel in np.ndindex(2, 2):
        matrix, own = matrices[channel], float(weight[capture, channel])
        right = wanted[:, 0, capture, channel].numpy().ravel()
        exact = np.linalg.solve(matrix.T @ matrix + own * np.eye(len(right)), right)
        np.testing.assert_allclose(found[:, 0, capture, channel].numpy().ravel(), exact, atol=1e-8)
    exact, errors = found, []
    for inner in (1, 3, 9, 27):
        solver._inner = inner
        errors.append(float((solver._explained(begun, wanted, weight) - exact).square().sum()))
    assert errors[0] > errors[1] > errors[2] > errors[3]
    torch.testing.assert_close(solver._explained(exact, wanted, weight), exact, rtol=0, atol=1e-8)


def test_the_mean_inverse_is_symmetric_positive_and_exact_where_rows_see_alike(small: CaptureModel) -> None:
    problem = ClipProblem(small)
    inverse, weight = MeanInverse(small, problem), torch.full((1, 2, 1, 1), 0.1)
    one, other = (torch.from_numpy(np.random.default_rng(n).normal(size=(3, 1, 1, 2, 8, 6))) for n in range(2))
    there, back = ((a * inverse(b, weight)).sum() for a, b in ((one, other), (other, one)))
    torch.testing.assert_close(there, back, rtol=1e-12, atol=0)
    assert float((one * inverse(one, weight)).sum()) > 0
    # A pinhole and one frame: all light is on the sensor, and A^T A is 1.
    values = np.zeros((1, 2, 3, 3))
    values[..., 1, 1] = 0.7
    assert small.timing is not None
    timing = replace(small.timing, frame_edges_s=small.timing.frame_edges_s[[0, -1]])
    pinhole = replace(small, stack=replace(small.stack, values=values), timing=timing)
    found = MeanInverse(pinhole, ClipProblem(pinhole))(one[:1], weight)
    torch.testing.assert_close(found, one[:1] / 1.1, rtol=1e-12, atol=1e-14)


def test_the_mean_inverse_saves_steps() -> None:
    """Points over the whole sensor, four steps: less is left to minimise than without it."""
    capture = camera((48, 44), (12, 12), 61, 4, dots=60)
    problem = ClipProblem(capture)
    begun = torch.zeros_like(problem.dark(1))
    wanted, weight = problem.adjoint(problem(squares(problem))), torch.full((1, 2, 1, 1), 0.01)
    exact = method(capture, Plain(), inner=200)._explained(begun, wanted, weight)
    left: list[float] = []
    for inverse in (MeanInverse(capture, problem), Nothing()):
        solver = method(capture, Plain())
        solver._inverse = inverse  # pyright: ignore[reportAttributeAccessIssue]
        error = solver._explained(begun, wanted, weight) - exact
        left.append(float(problem(error).square().sum() + (weight * error.square()).sum()))
    assert left[0] < 0.6 * left[1]


def test_frames_are_drawn_to_the_static_picture_where_nothing_moves() -> None:
    """Five frames of a wall with noise of 0.1, which a bright square crosses on the left."""
    capture = camera((32, 32), (20, 20), 11, 5)
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
    small: CaptureModel, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clip_prior, "samples_at_once", lambda *_: at_once)
    problem = ClipProblem(small)
    both = torch.cat([measure(problem, gain * squares(problem), 0.03) for gain in (1.0, 0.3)])
    solver = method(small, Plain(), over_time=0.5)
    together = solver(both)
    assert together.shape == (2, 3, 2, 6, 4)
    for film, alone in zip(together, both.split(1), strict=True):
        torch.testing.assert_close(film, solver(alone)[0], rtol=1e-9, atol=1e-12)


def test_the_shipped_denoiser_improves_on_the_start() -> None:
    """A disc that moves before a wall with a brighter half, in two per cent of noise."""
    capture = camera((64, 60), (24, 24), 81, 4, dots=60)
    problem = ClipProblem(capture)
    rows, columns = np.mgrid[:26, :26]
    film = np.stack([np.where((rows - 12) ** 2 + (columns - 6 - 4 * n) ** 2 < 16, 0.9, 0.1) for n in range(4)])
    light = torch.from_numpy(film + 0.2 * (rows > 18))[:, None, None, None].repeat(1, 1, 1, 2, 1, 1)
    given, wanted = measure(problem, light, 0.02), problem.film(light)[:, :, 0]
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
