"""The pinhole is as large as asked; that its aperture is round and centred is tested in `simulator.design.patterns`."""

import numpy as np
import pytest

from psf_library.designs.pinhole import pinhole
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld


@pytest.mark.parametrize(("diameter_um", "pixel_um"), [(40.0, 0.5), (30.0, 0.7), (25.3, 0.5)])
def test_the_pinholes_area_is_that_of_its_circle(diameter_um, pixel_um):
    mask = pinhole(diameter_um=diameter_um, pixel_um=pixel_um)
    area_m2 = float(np.sum(mask.amplitude, dtype=float)) * mask.pitch_m**2
    assert area_m2 == pytest.approx(np.pi / 4 * (diameter_um * 1e-6) ** 2, rel=1e-3)


@pytest.mark.parametrize("diameter_um", [60, 40, 20])
def test_the_edge_s_weights_are_amplitudes(diameter_um):
    """Against a sharp hole of cells of 0.1 um, by direct sums; square roots of the weights err more."""
    along = (np.arange(10 * diameter_um + 1) - 5 * diameter_um) / 10
    sharp = (np.hypot(along[:, None], along[None, :]) <= diameter_um / 2).astype(complex)
    points_m = np.linspace(0, 40e-6, 30)[:, None] * [0.8, 0.6]
    mask = pinhole(diameter_um=diameter_um)
    truth, found, square_roots = (
        np.abs(rayleigh_sommerfeld(field, pitch_m, 532e-9, 1.9e-3, points_m)) ** 2
        for field, pitch_m in (
            (sharp, 0.1e-6),
            (mask.amplitude.astype(complex), mask.pitch_m),
            (np.sqrt(mask.amplitude).astype(complex), mask.pitch_m),
        )
    )
    assert np.linalg.norm(found - truth) < 2e-3 * np.linalg.norm(truth)
    assert np.linalg.norm(square_roots - truth) > 4 * np.linalg.norm(found - truth)
