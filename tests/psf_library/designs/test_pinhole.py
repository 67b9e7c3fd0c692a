"""The pinhole is as large as asked; that its aperture is round and centred is tested in `simulator.design.patterns`."""

import numpy as np
import pytest

from psf_library.designs.pinhole import pinhole


@pytest.mark.parametrize(("diameter_um", "pixel_um"), [(40.0, 0.5), (30.0, 0.7), (25.3, 0.5)])
def test_the_pinholes_area_is_that_of_its_circle(diameter_um, pixel_um):
    mask = pinhole(diameter_um=diameter_um, pixel_um=pixel_um)
    area_m2 = float(np.sum(mask.amplitude, dtype=float)) * mask.pitch_m**2
    assert area_m2 == pytest.approx(np.pi / 4 * (diameter_um * 1e-6) ** 2, rel=1e-3)
