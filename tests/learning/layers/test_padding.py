"""Periods, tapers and transforms of the inversions, against their definitions."""

import numpy as np
import pytest
import torch

from learning.layers.padding import AxisPlan, pad_measurement, scene_of, spectrum_of


@pytest.mark.parametrize(("sensor", "scene", "psf"), [(20, 8, 9), (21, 9, 14), (10, 10, 30), (48, 16, 5)])
def test_period_holds_all_light_and_the_sensor(sensor, scene, psf):
    plan = AxisPlan.fit(sensor, scene, psf)
    assert plan.length >= max(sensor, scene + psf - 1)
    # A scene's light, convolved in one period, is the linear convolution wherever the sensor is.
    rng = np.random.default_rng(0)
    light, kernel = rng.random(scene), rng.random(psf)
    placed = np.zeros(plan.length)
    placed[plan.scene] = light
    circular = np.fft.ifft(np.fft.fft(placed) * np.fft.fft(plan.place(kernel[:, None], 0)[:, 0])).real
    full = np.convolve(light, kernel)
    start = plan.offset - psf // 2
    linear = np.array([full[i - start] if 0 <= i - start < len(full) else 0.0 for i in range(sensor)])
    # float64 FFT of sums below 30: rounding of 1e-14
    np.testing.assert_allclose(circular[:sensor], linear, atol=1e-12)


def test_ends_fade_out_with_a_raised_cosine():
    rows, columns = AxisPlan(5, 5, 1, 3), AxisPlan(4, 11, 1, 2)
    image = torch.rand(2, 5, 4, dtype=torch.float64)
    padded = pad_measurement(image, rows, columns)
    assert padded.shape == (2, 5, 11)
    assert torch.equal(padded[..., :4], image)
    weights = torch.tensor([0.5 * (1 + np.cos(2 * np.pi * s / 8)) for s in (1, 2, 3)])
    for i, weight in enumerate(weights.tolist()):
        torch.testing.assert_close(padded[..., 4 + i], image[..., 3] * weight)
        torch.testing.assert_close(padded[..., 10 - i], image[..., 0] * weight)
    assert padded[..., 7].abs().max() == 0  # the middle of the gap


def test_corners_continue_both_axes():
    plan = AxisPlan(3, 8, 0, 3)
    ones = pad_measurement(torch.ones(3, 3, dtype=torch.float64), plan, plan)
    torch.testing.assert_close(ones, ones[:, :1] * ones[:1])


def test_placed_kernel_has_its_origin_at_zero_and_keeps_its_sum():
    kernel = np.arange(12.0).reshape(3, 4)
    placed = AxisPlan(3, 7, 0, 3).place(kernel, 0)
    np.testing.assert_array_equal(placed[[6, 0, 1]], kernel)
    folded = AxisPlan(2, 2, 0, 2).place(kernel, 0)  # origin 1: rows 0 and 2 share the place before it
    np.testing.assert_array_equal(folded, [kernel[1], kernel[0] + kernel[2]])


@pytest.mark.parametrize("size", [(8, 9), (9, 8), (15, 15)])
def test_spectrum_and_scene_are_inverse(size):
    image = torch.rand(2, *size, dtype=torch.float64)
    rows, columns = AxisPlan(size[0], size[0], 2, 4), AxisPlan(size[1], size[1], 1, 5)
    spectrum = spectrum_of(image)
    full = np.fft.fft2(image.numpy())
    np.testing.assert_allclose(spectrum.numpy(), full[:, : size[0] // 2 + 1], atol=1e-12)
    torch.testing.assert_close(scene_of(spectrum, rows, columns), image[:, 2:6, 1:6])
