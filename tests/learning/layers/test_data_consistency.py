"""The data step: against dense solutions, and what its preconditioner must be and saves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.signal import correlate2d
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.data_consistency import DataConsistency, MeanInverse
from learning.layers.space_time import ClipProblem

pytestmark = pytest.mark.usefixtures("double")


class Nothing(nn.Module):
    """What does not precondition."""

    def forward(self, light: Tensor, weight: Tensor) -> Tensor:
        return light


@pytest.fixture(scope="module")
def small(dotted_camera: Callable[..., CaptureModel]) -> CaptureModel:
    """16 x 14 pixels for three frames of 6 x 4 in a field of 8 x 6."""
    return dotted_camera((16, 14), (6, 4), 11, 3)


def test_the_data_step_solves_the_normal_equations(small: CaptureModel) -> None:
    """Of each capture and channel with its own weight; from where it is begun, and nearer with each step."""
    solver = DataConsistency(small)
    rng = np.random.default_rng(0)
    wanted, begun = (torch.from_numpy(rng.normal(size=(3, 1, 2, 2, 8, 6))) for _ in range(2))
    weight = torch.tensor([[0.1, 0.3], [1.0, 2.0]])[..., None, None]
    found = solver(begun, wanted, weight, 80)
    frames, _, channels, *field = solver.problem.shape
    count = frames * field[0] * field[1]
    units = torch.eye(count).reshape(count, frames, 1, 1, *field).movedim(0, 2).expand(-1, -1, -1, channels, -1, -1)
    matrices = solver.problem(units).permute(1, 2, 3, 0).flatten(1, 2).numpy()
    for capture, channel in np.ndindex(2, 2):
        matrix, own = matrices[channel], float(weight[capture, channel])
        right = wanted[:, 0, capture, channel].numpy().ravel()
        exact = np.linalg.solve(matrix.T @ matrix + own * np.eye(len(right)), right)
        np.testing.assert_allclose(found[:, 0, capture, channel].numpy().ravel(), exact, atol=1e-8)
    exact, errors = found, []
    for steps in (1, 3, 9, 27):
        errors.append(float((solver(begun, wanted, weight, steps) - exact).square().sum()))
    assert errors[0] > errors[1] > errors[2] > errors[3]
    torch.testing.assert_close(solver(exact, wanted, weight, 1), exact, rtol=0, atol=1e-8)


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


@pytest.mark.parametrize(("image", "period"), [((6, 4), (8, 6)), ((12, 4), (15, 6))])
def test_it_is_the_frames_overlap_times_the_nearest_circulant_matrix(
    dotted_camera: Callable[..., CaptureModel], image: tuple[int, int], period: tuple[int, int]
) -> None:
    """Its entries over places are the means of the Toeplitz matrix's along wrapped diagonals; 14 rows are taken as 15."""
    capture, weight = dotted_camera((24, 14), image, 11, 3), 0.03
    rows, columns = capture.field_shape
    light = torch.from_numpy(np.random.default_rng(3).normal(size=(3, 1, 1, 2, rows, columns)))
    found = MeanInverse(capture, ClipProblem(capture))(light, torch.full((1, 2, 1, 1), weight))
    shares = capture.row_weights
    overlap = sum(np.outer(row, row) for row in shares.T) / shares.shape[1]
    places = np.array(list(np.ndindex(*period)))
    apart = places[:, None] - places
    wrapped = np.ravel_multi_index(tuple(np.moveaxis(apart % period, -1, 0)), period)
    for channel, psf in enumerate(np.asarray(capture.stack.values, np.float64)[0]):
        alike = np.zeros(tuple(2 * side - 1 for side in period))  # of all lags between places
        whole = correlate2d(psf, psf) / np.sum(psf**2)
        middles = [(np.array(shape) - 1) // 2 for shape in (alike.shape, whole.shape)]
        reach = np.minimum(*middles)
        here, there = (tuple(slice(m - r, m + r + 1) for m, r in zip(middle, reach, strict=True)) for middle in middles)
        alike[here] = whole[there]
        toeplitz = alike[tuple(np.moveaxis(apart + middles[0], -1, 0))]
        circulant = (np.bincount(wrapped.ravel(), toeplitz.ravel()) / len(places))[wrapped]
        given = np.zeros((3, *period))
        given[:, :rows, :columns] = light[:, 0, 0, channel].numpy()
        matrix = np.kron(overlap, circulant) + weight * np.eye(given.size)
        wanted = np.linalg.solve(matrix, given.ravel()).reshape(given.shape)[:, :rows, :columns]
        np.testing.assert_allclose(found[:, 0, 0, channel].numpy(), wanted, rtol=0, atol=1e-10)


def test_the_mean_inverse_saves_steps(dotted_camera: Callable[..., CaptureModel]) -> None:
    """Points over the whole sensor, four steps: less is left to minimise than without it."""
    capture = dotted_camera((48, 44), (12, 12), 61, 4, dots=60)
    solver = DataConsistency(capture)
    problem = solver.problem
    begun, light = torch.zeros_like(problem.dark(1)), problem.dark(1)
    for frame in range(len(light)):
        light[frame, ..., 1:4, frame : frame + 2] = 0.8
    wanted, weight = problem.adjoint(problem(light)), torch.full((1, 2, 1, 1), 0.01)
    exact = solver(begun, wanted, weight, 200)
    left: list[float] = []
    for inverse in (solver.inverse, Nothing()):
        solver.inverse = inverse
        error = solver(begun, wanted, weight, 4) - exact
        left.append(float(problem(error).square().sum() + (weight * error.square()).sum()))
    assert left[0] < 0.6 * left[1]
