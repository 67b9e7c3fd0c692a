"""Smooth masks whose phase is steeper than their own samples can tell: what the refusal advises must be right."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.optics.mask import Mask, steepest_frequency
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.psf import PsfConfig, compute_psf_stack, sampled_intensity
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld
from simulator.types import CameraGeometry, SpectralResponse

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")
WAVELENGTH_M, PITCH_M, SAMPLES = 532e-9, 2e-6, 160
PER_TURN = WAVELENGTH_M / (FUSED_SILICA.index(WAVELENGTH_M) - 1)


def lens(turns: float) -> Mask:
    """A lens whose phase turns by ``turns`` per sample at 80 % of its half-width, where its soft aperture ends."""
    x = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * PITCH_M
    radius = np.hypot(x[:, None], x[None, :])
    rim = 0.8 * SAMPLES * PITCH_M / 2
    height = -(radius**2) * turns * PER_TURN / (2 * PITCH_M * rim)
    return Mask(height - height.min(), np.exp(-((radius / rim) ** 12)), PITCH_M, FUSED_SILICA, "smooth")


@pytest.mark.parametrize("model", ["scaled_distance", "exact"])
@pytest.mark.parametrize("turns", [0.3, 0.6, 0.8])
def test_oversampling_two_equals_the_direct_sum(turns, model):
    """All the light arrives, at the right places. Truth: the same cubic surface at six samples per mask sample, 2e-3."""
    camera, config = CameraGeometry(1e-3, 19.2e-6, GREEN), PsfConfig((np.inf,), model, oversampling=2)
    mask, rng = lens(turns), np.random.default_rng(0)
    points, found = sampled_intensity(mask, camera, config, WAVELENGTH_M, np.inf, 8, rng)
    truth = (
        np.abs(rayleigh_sommerfeld(mask.transmission(WAVELENGTH_M, 6), PITCH_M / 6, WAVELENGTH_M, 1e-3, points)) ** 2
    )
    assert np.linalg.norm(found - truth) / np.linalg.norm(truth) < 0.01
    stack = compute_psf_stack(mask, camera, replace(config, wavelengths_per_channel=1))
    assert stack.energy_m2()[0, 0] == pytest.approx(mask.transmitted_area_m2, rel=2e-3)


def test_only_open_samples_are_steep():
    """A prism of 0.4 turns per sample; a step of ten turns where no light passes does not count."""
    height = np.broadcast_to(np.arange(40) * 0.4 * PER_TURN, (40, 40)).copy()
    amplitude = np.ones((40, 40))
    height[:, 30:] += 10 * PER_TURN
    amplitude[:, 30] = 0
    mask = Mask(height, amplitude, PITCH_M, FUSED_SILICA, "smooth")
    assert steepest_frequency(mask, WAVELENGTH_M) * PITCH_M == pytest.approx(0.4, rel=1e-9)
    open_ = replace(mask, amplitude=np.ones((40, 40)))
    assert steepest_frequency(open_, WAVELENGTH_M) * PITCH_M == pytest.approx(10.4, rel=1e-9)
