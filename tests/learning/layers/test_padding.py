"""Periods, tapers and transforms of the inversions, against their definitions."""

import numpy as np
import pytest

from learning.layers.padding import AxisPlan


@pytest.mark.parametrize(
    ("sensor", "scene", "psf", "field"),
    [(20, 8, 9, 8), (21, 9, 14, 9), (10, 10, 30, 10), (48, 16, 5, 16), (20, 8, 9, 18), (10, 4, 13, 24)],
)
def test_period_holds_all_light_and_the_sensor(sensor, scene, psf, field):
    plan = AxisPlan.fit(sensor, scene, psf, field)
    assert plan.length >= max(sensor, field + psf - 1)
    # The field's light, convolved in one period, is the linear convolution wherever the sensor is.
    rng = np.random.default_rng(0)
    light, kernel = rng.random(field), rng.random(psf)
    placed, margin = np.zeros(plan.length), (field - scene) // 2
    placed[np.arange(plan.scene.start - margin, plan.scene.stop + margin)] = light
    circular = np.fft.ifft(np.fft.fft(placed) * np.fft.fft(plan.place(kernel[:, None], 0)[:, 0])).real
    full = np.convolve(light, kernel)
    start = plan.offset - margin - psf // 2
    linear = np.array([full[i - start] if 0 <= i - start < len(full) else 0.0 for i in range(sensor)])
    # float64 FFT of sums below 30: rounding of 1e-14
    np.testing.assert_allclose(circular[:sensor], linear, atol=1e-12)


def test_placed_kernel_has_its_origin_at_zero_and_keeps_its_sum():
    kernel = np.arange(12.0).reshape(3, 4)
    placed = AxisPlan(3, 7, 0, 3).place(kernel, 0)
    np.testing.assert_array_equal(placed[[6, 0, 1]], kernel)
    folded = AxisPlan(2, 2, 0, 2).place(kernel, 0)  # origin 1: rows 0 and 2 share the place before it
    np.testing.assert_array_equal(folded, [kernel[1], kernel[0] + kernel[2]])
