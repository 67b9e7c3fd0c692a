"""The noise of a measurement, from the measurement alone: against noise that was put there."""

import numpy as np
import pytest
import torch

from learning.layers.noise import noise_level, noise_ratio

# A quarter of every second row's every second value, of three channels: 12 000 differences. Their median is right to 1 % at
# most times (a median uses 37 % of what its values know, and neighbours share values); four times as much is allowed.
SHAPE, TOLERANCE = (3, 256, 256), 0.04


def smooth(seed: int = 0) -> np.ndarray:
    """Return light of low frequencies and several brightnesses, whose second differences are far below any noise here."""
    y, x = np.linspace(0, np.pi, SHAPE[1])[:, None], np.linspace(0, 2 * np.pi, SHAPE[2])
    phases, levels = np.random.default_rng(seed).uniform(0, 6, (2, 3, 1, 1))
    return (levels + 1) * (0.5 + 0.1 * np.sin(y + phases) * np.cos(x - phases))


def noisy(light: np.ndarray, sigma: float, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(light + sigma * np.random.default_rng(seed).standard_normal(light.shape))


@pytest.mark.parametrize("sigma", [1e-3, 1e-2, 0.1])
def test_white_noise_on_smooth_light_is_found(sigma):
    assert noise_level(noisy(smooth(), sigma)[None]).item() == pytest.approx(sigma, rel=TOLERANCE)


@pytest.mark.parametrize("dark", [0.5, 0.7])
def test_what_is_clipped_in_the_dark_does_not_count(dark):
    """There, noise has half its values at 0: what all of the image says is too little, what the bright part says is right."""
    light, sigma = smooth(), 0.02
    light[:, : int(dark * SHAPE[1])] = 0
    clipped = noisy(light, sigma).clamp_min(0)
    assert noise_level(clipped[None]).item() == pytest.approx(sigma, rel=TOLERANCE)
    everywhere = np.diff(np.diff(clipped.numpy(), 2, axis=1), 2, axis=2) / 6
    assert np.median(np.abs(everywhere)) / 0.6745 < 0.8 * sigma


def test_every_measurement_of_a_batch_has_its_own():
    sigmas = [1e-3, 0.05, 7e-3]
    batch = torch.stack([noisy(smooth(seed), sigma, seed) for seed, sigma in enumerate(sigmas)])
    together = noise_level(batch)
    assert together.tolist() == pytest.approx(sigmas, rel=TOLERANCE)
    for one, measurement in zip(together, batch, strict=True):
        assert noise_level(measurement[None]).item() == one.item()


def test_it_follows_the_unit_and_no_constant_light():
    light = noisy(smooth(), 0.01)[None]
    assert noise_level(300 * light).item() == pytest.approx(300 * noise_level(light).item(), rel=1e-9)
    assert noise_level(light + 5).item() == pytest.approx(noise_level(light).item(), rel=1e-9)


def test_the_ratio_is_of_powers_and_of_each_channel():
    batch = torch.stack([noisy(smooth(seed), sigma, seed) for seed, sigma in enumerate((0.01, 0.1))])
    power = np.mean(batch.numpy() ** 2, axis=(2, 3))
    wanted = noise_level(batch).numpy()[:, None] ** 2 / power
    np.testing.assert_allclose(noise_ratio(batch).numpy(), wanted, rtol=1e-12)
    assert noise_ratio(torch.zeros(1, 3, 8, 8)).tolist() == [[0.0, 0.0, 0.0]]


def test_nothing_learns_from_it():
    light = noisy(smooth(), 0.01)[None].requires_grad_()
    assert not noise_level(light).requires_grad
    assert not noise_ratio(light).requires_grad
