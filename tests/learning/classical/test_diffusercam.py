"""A real capture, a hand before DiffuserCam, through our methods and through the algorithm as it was published."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import tifffile
import torch

from learning.camera import CaptureModel, plain_capture, typical_white
from learning.classical.admm import Admm
from learning.classical.method import ConstrainedLeastSquares
from simulator.optics.stack import PsfStack

pytestmark = pytest.mark.shared


class Hand(NamedTuple):
    psf: np.ndarray
    measurement: np.ndarray


@pytest.fixture(scope="module")
def hand(shared_data: Path) -> Hand:
    """PSF and measurement, an eighth of their size, without the background that the PSF's dark corner shows."""
    folder = shared_data / "diffusercam" / "tutorial"
    names = ("psf_sample.tif", "rawdata_hand_sample.tif")
    psf, raw = (tifffile.imread(folder / name).astype(np.float64) for name in names)
    background = psf[5:15, 5:15].mean()
    psf, raw = ((image - background).reshape(150, 8, 200, 8).mean(axis=(1, 3)) for image in (psf, raw))
    return Hand(psf.clip(0) / np.linalg.norm(psf), raw / np.linalg.norm(raw))


def published_admm(hand: Hand, iterations: int, mu: tuple[float, float, float], tau: float) -> np.ndarray:
    """Return the image of ADMM as published, written here in its own variables, on a period of twice the sensor.

    Antipa et al., Optica 5 (2018), equations of the supplement in the order of the authors' tutorial: u, x, v, w, multipliers
    xi, eta, rho; first differences around the period.
    """
    mu1, mu2, mu3 = mu
    rows, columns = hand.measurement.shape
    shape = (2 * rows, 2 * columns)
    top, left = rows // 2, columns // 2
    inside = np.s_[top : top + rows, left : left + columns]

    def padded(image: np.ndarray) -> np.ndarray:
        whole = np.zeros(shape)
        whole[inside] = image
        return whole

    transfer = np.fft.fft2(np.fft.ifftshift(padded(hand.psf)))
    x_division = 1 / (padded(np.ones((rows, columns))) + mu1)
    impulse = np.zeros(shape)
    impulse[0, 0], impulse[0, 1], impulse[1, 0], impulse[0, -1], impulse[-1, 0] = 4, -1, -1, -1, -1
    v_division = 1 / (mu1 * np.abs(transfer) ** 2 + mu2 * np.abs(np.fft.fft2(impulse)) + mu3)
    v, w, rho, x, xi = (np.zeros(shape) for _ in range(5))
    u, eta = np.zeros((2, *shape)), np.zeros((2, *shape))

    def seen(v: np.ndarray) -> np.ndarray:
        return np.fft.ifft2(transfer * np.fft.fft2(v)).real

    def gradient(v: np.ndarray) -> np.ndarray:
        return np.stack([np.roll(v, 1, axis) - v for axis in (0, 1)])

    def gradient_adjoint(u: np.ndarray) -> np.ndarray:
        return np.roll(u[0], -1, 0) - u[0] + np.roll(u[1], -1, 1) - u[1]

    for _ in range(iterations):
        sloped = gradient(v) + eta / mu2
        u = np.sign(sloped) * np.maximum(np.abs(sloped) - tau / mu2, 0)
        x = x_division * (xi + mu1 * seen(v) + padded(hand.measurement))
        w = np.maximum(rho / mu3 + v, 0)
        right = mu3 * w - rho + gradient_adjoint(mu2 * u - eta)
        right = right + np.fft.ifft2(np.fft.fft2(mu1 * x - xi) * transfer.conj()).real
        v = np.fft.ifft2(v_division * np.fft.fft2(right)).real
        xi = xi + mu1 * (seen(v) - x)
        eta = eta + mu2 * (gradient(v) - u)
        rho = rho + mu3 * (v - w)
    return v[inside].clip(0)


def camera(hand: Hand, white: float = 1.0) -> CaptureModel:
    stack = PsfStack(hand.psf[None, None], np.array([np.inf]), 48e-6, ("Y",), "measured")
    return plain_capture(stack, (150, 200), white=white)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


@pytest.mark.slow
def test_admm_equals_the_published_algorithm(hand: Hand) -> None:
    mu, tau, iterations = (1e-6, 1e-5, 4e-5), 1e-4, 40  # the tutorial's
    options = {"weights": mu, "light": "anywhere", "dtype": torch.float64}
    method = Admm(camera(hand), tv=tau, sparsity=0, iterations=iterations, **options)
    ours = method(torch.from_numpy(hand.measurement)[None, None])[0, 0, 0].numpy()
    published = published_admm(hand, iterations, mu, tau)
    # Differences: the publication's gradient runs round the period, and its multipliers follow one step later.
    assert correlation(ours, published) > 0.9999


def test_the_hand_is_there_with_our_own_settings(hand: Hand) -> None:
    """The thumb is up: bright where the published image is bright, in the unit that `typical_white` sets."""
    measurement = torch.from_numpy(hand.measurement)[None, None]
    capture = camera(hand, typical_white(camera(hand), hand.measurement[None]))
    published = published_admm(hand, 20, (1e-6, 1e-5, 4e-5), 1e-4)
    least_squares = ConstrainedLeastSquares(capture, regularisation_lambda=10.0, tikhonov=0.0)
    squares = least_squares(measurement.float())[0, 0, 0].numpy()
    sparse = Admm(capture, tv=0.1, sparsity=0.01, iterations=60, light="anywhere")(measurement)[0, 0, 0].numpy()
    assert correlation(squares, published) > 0.9
    assert correlation(sparse, published) > 0.95
    assert 0.3 < sparse.mean() < 3  # of white
