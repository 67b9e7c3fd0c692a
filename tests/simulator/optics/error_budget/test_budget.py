"""The error budget: each number is the real difference, and the full check knows a wrong model from a right one."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.error_budget import budget as check
from simulator.optics.error_budget.budget import full_errors, quick_errors
from simulator.optics.error_budget.field import field_angle_error
from simulator.optics.error_budget.model import direct_error, pixel_error
from simulator.optics.error_budget.sampling import sampling_error
from simulator.optics.error_budget.spectrum import common_lines, spectral_error
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.psf import PsfConfig, depth_images, stack_size
from simulator.plots.psf_facts import budget_tables
from simulator.types import CameraGeometry, Layer, SpectralResponse

D, PITCH_M = 0.5e-3, 6e-6
AT = np.arange(450e-9, 651e-9, 5e-9)
BAND = SpectralResponse(AT, np.exp(-(((AT - [[520e-9], [600e-9]]) / 40e-9) ** 2)), ("G", "R"), "two bands")
CAMERA = CameraGeometry(D, PITCH_M, BAND)


def _mask(samples=60):
    """Soft-edged random steps of a fifth of a micrometre, 8 um wide: a small PhlatCam whose light stays near."""
    steps = np.random.default_rng(2).integers(0, 6, (samples // 4, samples // 4)) * 0.2e-6
    height = np.kron(steps, np.ones((4, 4)))
    return Mask(height, np.ones_like(height), 2e-6, FUSED_SILICA)


def _config(*depths_m, model="scaled_distance", lines=1):
    return PsfConfig(depths_m or (0.02, 0.1, np.inf), model, lines)


def _image(mask, camera, config, wavelength_m, size, **settings):
    return next(iter(depth_images(mask, camera, config, wavelength_m, size, **settings)))


def test_common_lines_are_a_quadrature_of_every_channel():
    """They integrate a smooth function of wavelength as a fine sum over the response does."""
    wavelengths_m, weights = common_lines(BAND, 40)
    np.testing.assert_allclose(weights.sum(1), 1, rtol=1e-12)
    fine = np.linspace(AT[0], AT[-1], 20001)
    for shares, response in zip(weights, BAND.weights, strict=True):
        density = np.interp(fine, AT, response)
        reference = np.sum(density * np.cos(fine * 6e7)) / density.sum()
        assert shares @ np.cos(wavelengths_m * 6e7) == pytest.approx(reference, abs=2e-3)  # of 1; tails hold 1e-3


def test_the_spectral_error_is_the_distance_from_a_sum_over_many_quantile_lines():
    """Another quadrature altogether, 30 quantile lines per channel, is as far away, to a tenth."""
    from simulator.optics.spectra import quantile_lines

    mask, config = _mask(), _config(np.inf)
    found = spectral_error(mask, CAMERA, config)
    size = stack_size(mask, CAMERA, config)
    images = {
        count: [
            sum(
                line.weight * _image(mask, CAMERA, config, line.wavelength_m, size)
                for line in quantile_lines(BAND, count)
                if line.channel == channel
            )
            for channel in (0, 1)
        ]
        for count in (1, 30)
    }
    for channel, few, many in zip(BAND.channels, images[1], images[30], strict=True):
        expected = np.linalg.norm(few - many) / np.linalg.norm(many)
        assert found["channels"][channel] == pytest.approx(expected, rel=0.1)
    assert found["error"] == max(found["channels"].values()) > 0.02


def test_wavelengths_without_material_data_are_left_out():
    class Narrow:
        name, source = "narrow", "none"

        def index(self, wavelength_m):
            if wavelength_m > 600e-9:
                raise InputError("material", "no data")
            return 1.5

    green = replace(CAMERA, response=SpectralResponse(AT, BAND.weights[:1], ("G",), "one band"))
    found = spectral_error(replace(_mask(), material=Narrow()), green, _config(np.inf))
    assert found["lines"] < spectral_error(_mask(), green, _config(np.inf))["lines"]


def test_the_exact_model_agrees_with_the_direct_sum_and_a_wrong_one_does_not():
    """``scaled_psf`` forgets that diffraction shortens with depth (PHYSICS section 4); at infinity both are right."""
    mask, wavelengths_m = _mask(), [532e-9]
    errors = {
        model: {
            row["depth_m"]: row["error"]
            for row in direct_error(mask, CAMERA, _config(0.01, np.inf, model=model), wavelengths_m)["table"]
        }
        for model in ("exact", "scaled_psf")
    }
    assert errors["exact"][0.01] < 1e-3
    assert errors["exact"][np.inf] < 1e-3
    assert errors["scaled_psf"][np.inf] < 1e-3
    assert errors["scaled_psf"][0.01] > 0.02


def test_the_pixel_error_is_the_difference_of_the_images():
    mask, config = _mask(), _config(0.02, np.inf, model="scaled_psf")
    found = pixel_error(mask, CAMERA, config, [532e-9])
    exact = replace(config, model="exact")
    size = max(stack_size(mask, CAMERA, part) for part in (config, exact))
    pairs = zip(*(depth_images(mask, CAMERA, part, 532e-9, size) for part in (config, exact)), strict=True)
    expected = [np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in pairs]
    assert [row["error"] for row in found["table"]] == pytest.approx(expected, rel=1e-9)
    assert found["error"] == max(expected)


def test_the_error_grows_with_the_field_angle_and_ends_at_the_corner():
    found = field_angle_error(_mask(), CAMERA, _config(np.inf, model="exact"), 532e-9, (0.3, 0.2))
    assert [round(row["degrees"], 6) for row in found["table"][:-1]] == [0, 5, 10]
    assert found["table"][-1]["direction"] == [0.3, 0.2]
    errors = [row["error"] for row in found["table"]]
    assert errors[0] == 0  # on the axis the exact model is compared with itself
    assert errors[0] < errors[1] < errors[2] < errors[3]


@pytest.mark.slow
def test_a_phlatcam_errs_off_axis_as_published():
    """PHYSICS section 4: 2 mm of a PhlatCam at 19.2 um pixels, 532 nm: 0.05, 0.13, 0.37 at 5, 10, 20 degrees.

    The figures there come from another crop and another grid; a third of them is the spread among crops.
    """
    from psf_library.designs.phlatcam import phlatcam

    camera = replace(CAMERA, mask_to_sensor_m=1.9e-3, pixel_pitch_m=19.2e-6)
    found = field_angle_error(phlatcam(width_mm=2.0), camera, _config(np.inf), 532e-9)
    for row, expected in zip(found["table"][1:4], (0.05, 0.13, 0.37), strict=True):
        assert row["error"] == pytest.approx(expected, rel=0.35)


@pytest.fixture
def few_wavelengths(monkeypatch):
    """Tests of the budget's make-up need no accurate reference."""
    monkeypatch.setattr(check, "spectral_error", partial(spectral_error, many=4))


def test_the_quick_budget_travels_as_json(few_wavelengths):
    errors = quick_errors(_mask(), CAMERA, _config())
    assert json.loads(json.dumps(errors)) == errors
    assert errors["check"] == "quick"
    assert [row["depth_m"] for row in errors["model"]["table"]] == [0.02, np.inf]
    assert "model" not in quick_errors(_mask(), CAMERA, _config(np.inf, model="exact"))


def test_the_full_budget_is_a_table_of_everything(few_wavelengths):
    mask, config = _mask(24), _config(0.02, np.inf)
    told = []
    progress = {
        part: lambda done, total, part=part: told.append((part, done, total)) for part in ("model", "direct_sum")
    }
    errors = full_errors(mask, CAMERA, config, (0.2, 0.1), progress=progress)
    sampling = sampling_error(mask, CAMERA, config)
    text = budget_tables(errors, sampling)
    for expected in ("model vs exact", "points vs direct sum", "sampling s = 1 vs 2", "field angle", "∞", "2 cm"):
        assert expected in text
    assert len(errors["direct_sum"]["table"]) == len(errors["model"]["table"]) == 4  # 2 depths, 2 wavelengths
    assert told[-1] == ("direct_sum", 4, 4)
    assert json.loads(json.dumps(errors)) == errors
    layered = replace(CAMERA, gap=(Layer(D, FUSED_SILICA),))
    assert "direct_sum" not in full_errors(mask, layered, _config(np.inf), (0.1, 0.1))


def test_without_llvm_the_direct_sum_judges_a_crop(few_wavelengths, monkeypatch):
    monkeypatch.setattr(check, "llvm_works", lambda: False)
    monkeypatch.setattr(check, "PLAIN_CROP_M", 40e-6)
    monkeypatch.setattr("simulator.optics.error_budget.direct_sum.llvm_works", lambda: False)
    errors = full_errors(_mask(40), CAMERA, _config(np.inf, model="exact"))
    assert errors["direct_sum"]["crop_m"] == pytest.approx(40e-6)
    assert errors["direct_sum"]["error"] < 0.05
