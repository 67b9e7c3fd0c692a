"""Constrained least squares against the normal equations written out as matrices."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel, plain_capture
from learning.classical.method import ConstrainedLeastSquares
from simulator.optics.stack import PsfStack

SENSOR, SCENE = (12, 10), (6, 4)


def circulant(kernel: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the matrix of the circular convolution with a kernel whose origin is its sample (n // 2, m // 2)."""
    rows, columns = shape
    matrix = np.zeros((rows, columns, rows, columns))
    for (a, b), value in np.ndenumerate(kernel):
        for i in range(rows):
            for j in range(columns):
                down, right = a - kernel.shape[0] // 2, b - kernel.shape[1] // 2
                matrix[(i + down) % rows, (j + right) % columns, i, j] += value
    return matrix.reshape(rows * columns, rows * columns)


def camera() -> CaptureModel:
    values = np.random.default_rng(0).random((2, 1, 7, 7)) ** 4
    stack = PsfStack(values.astype(np.float32), np.linspace(0.1, 0.2, 2), 1e-5, ("Y",), "random")
    return plain_capture(stack, SENSOR, SCENE, background=0.25, white=1.7)


@pytest.mark.parametrize("tikhonov", [0.0, 0.5])
def test_equals_its_closed_form(tikhonov: float) -> None:
    """Any Y, on the circle that the sensor makes where it holds all of the light: argmin |Y - H S|^2 + lambda |L S|^2."""
    capture, regularisation_lambda = camera(), 0.03
    measurement = np.random.default_rng(1).random(SENSOR)
    laplacian = circulant(np.array([[0, -1, 0], [-1, 4 + tikhonov, -1], [0, -1, 0.0]]), SENSOR)
    method = ConstrainedLeastSquares(capture, regularisation_lambda=regularisation_lambda, tikhonov=tikhonov)
    volume = method(torch.from_numpy(measurement)[None, None].float())
    top, left = (SENSOR[0] - SCENE[0]) // 2, (SENSOR[1] - SCENE[1]) // 2
    for plane in range(2):
        kernel = np.asarray(capture.stack.values[plane, 0], np.float64)
        matrix = circulant(kernel, SENSOR)
        penalty = regularisation_lambda * np.sum(kernel**2)
        normal = matrix.T @ matrix + penalty * laplacian.T @ laplacian
        exact = np.linalg.solve(normal, matrix.T @ (measurement - 0.25).ravel()).reshape(SENSOR)
        expected = exact[top : top + SCENE[0], left : left + SCENE[1]] / 1.7
        # Single precision; and 1e-8 of the power that keeps the division finite is no part of the closed form.
        np.testing.assert_allclose(volume[0, plane, 0].numpy(), expected, atol=2e-5 * np.abs(expected).max())


def test_has_nothing_to_learn_and_keeps_no_gradient() -> None:
    method = ConstrainedLeastSquares(camera(), regularisation_lambda=0.1, tikhonov=0.0)
    assert not any(parameter.requires_grad for parameter in method.parameters())
    assert not method(torch.ones(1, 1, *SENSOR, requires_grad=True)).requires_grad


def test_another_precision_and_memory_format_keep_the_imaginary_part(tiny_capture: CaptureModel) -> None:
    """A complex buffer would lose it on the way to float64, and channels_last would tear pairs apart."""
    measurement = torch.rand(2, 3, 48, 48)
    wanted = ConstrainedLeastSquares(tiny_capture, regularisation_lambda=0.1, tikhonov=0.0)(measurement)
    moved = ConstrainedLeastSquares(tiny_capture, regularisation_lambda=0.1, tikhonov=0.0)
    moved = moved.to(torch.float64).to(memory_format=torch.channels_last)
    got = moved(measurement.double())
    assert got.dtype == torch.float64
    torch.testing.assert_close(got.float(), wanted, rtol=1e-4, atol=1e-4 * float(wanted.abs().max()))
