"""Differences: adjoint, spectrum, and the sum written out."""

import numpy as np
import torch

from learning.baselines.total_variation import add_adjoint, difference_power, differences, total_variation


def test_adjoint_is_the_transpose() -> None:
    generator = torch.Generator().manual_seed(0)
    picture = torch.randn(2, 5, 7, dtype=torch.float64, generator=generator)
    rows, columns = (torch.randn(part.shape, dtype=torch.float64, generator=generator) for part in differences(picture))
    back = torch.zeros_like(picture)
    add_adjoint(back, rows, columns)
    there = sum((a * b).sum() for a, b in zip(differences(picture), (rows, columns), strict=True))
    np.testing.assert_allclose(float((back * picture).sum()), float(there), rtol=1e-13)


def test_power_is_the_spectrum_of_periodic_differences() -> None:
    picture = np.random.default_rng(0).random((6, 9))
    energy = sum(np.sum((np.roll(picture, -1, axis) - picture) ** 2) for axis in (0, 1))
    weight = np.full(5, 2.0)
    weight[0] = 1  # of an odd length, all columns but the first of the half spectrum stand for two
    spectrum = np.abs(np.fft.rfft2(picture)) ** 2 * weight * difference_power(6, 9, torch.float64).numpy()
    np.testing.assert_allclose(spectrum.sum() / picture.size, energy, rtol=1e-12)


def test_total_variation_is_the_sum_over_neighbours() -> None:
    picture = np.random.default_rng(1).random((3, 4, 5))
    expected = [
        sum(abs(p[i + 1, j] - p[i, j]) for i in range(3) for j in range(5))
        + sum(abs(p[i, j + 1] - p[i, j]) for i in range(4) for j in range(4))
        for p in picture
    ]
    np.testing.assert_allclose(total_variation(torch.from_numpy(picture)).numpy(), expected, rtol=1e-13)
