"""Every design, as it comes, at the distance it is made for: sampled well enough to be accepted without a word."""

import inspect
from dataclasses import replace

import pytest

from psf_library.designs import diffusercam, fresnel_zone, lens, phlatcam, random_lenslets, spiral, vortex
from simulator.optics.error_budget.sampling import REFUSE, prove_sampling
from simulator.optics.psf import PsfConfig
from simulator.optics.spectra import NOMINAL_CAMERA, spectral_response
from simulator.types import CameraGeometry

DESIGNS = [lens.lens, vortex.vortex, spiral.spiral, fresnel_zone.fresnel_zone, random_lenslets.random_lenslets]

ONE_DEPTH = PsfConfig((0.036,), wavelengths_per_channel=1)  # the nearest is the worst


@pytest.fixture(scope="module")
def camera():
    """The default camera: 19.2 um pixels, 1.9 mm."""
    return CameraGeometry(1.9e-3, 19.2e-6, spectral_response(NOMINAL_CAMERA, "D65"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the PSF's sampling error")
@pytest.mark.parametrize("design", DESIGNS, ids=lambda design: design.__name__)
def test_defaults_are_accepted(design, camera):
    """Below Nyquist if smooth, and 5 % between oversampling 1 and 2: ``prove_sampling`` raises otherwise."""
    assert prove_sampling(design(), camera, ONE_DEPTH)["error"] < REFUSE


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the PSF's sampling error")
def test_large_designs_are_accepted_as_crops(camera):
    """The proof looks at the middle 1.5 mm anyway; of a random mask 1 mm says as much."""
    assert prove_sampling(phlatcam.phlatcam(width_mm=1.0, iterations=8), camera, ONE_DEPTH)["error"] < REFUSE
    far = replace(camera, mask_to_sensor_m=10e-3)
    assert prove_sampling(diffusercam.diffusercam(width_mm=1.0), far, ONE_DEPTH)["error"] < 0.01


def test_shared_parameters_are_called_alike():
    """A key that two designs share means the same in both, so that masks can be swapped."""
    shared = {"width_mm", "pixel_um", "distance_um", "wavelength_nm", "material", "seed"}
    kinds: dict[str, set[str]] = {}
    for design in (*DESIGNS, phlatcam.phlatcam, diffusercam.diffusercam):
        parameters = inspect.signature(design).parameters
        assert {"width_mm", "pixel_um"} <= set(parameters)
        for name in shared & set(parameters):
            kinds.setdefault(name, set()).add(str(parameters[name].annotation).split(",")[0])
    assert all(len(found) == 1 for found in kinds.values()), kinds
