"""The direct sum against closed forms, independent reference numbers and a plain sum of refined points."""

import math

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.error_budget import direct_sum
from simulator.optics.error_budget.direct_sum import llvm_works, mask_cells, mask_field, reference_intensity, run_kernel
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld
from simulator.optics.resample import cubic_interpolation

WAVELENGTH_M, K = 532e-9, 2 * np.pi / 532e-9
SOURCES = [(math.inf, (0.0, 0.0)), (0.01, (0.0, 0.0)), (0.02, (0.2, -0.1)), (math.inf, (0.2, -0.1))]


def _mask(profile, samples=(24, 20), pitch_m=2e-6):
    rng = np.random.default_rng(3)
    if profile == "staircase":
        height = rng.integers(0, 6, samples) * 0.2e-6
    else:
        y, x = ((np.arange(n) - (n - 1) / 2) / n for n in samples)
        height = 0.3e-6 * np.cos(5 * x[None, :] + 4 * y[:, None] + 7 * x[None, :] * y[:, None])
    return Mask(height, np.linspace(0.5, 1, height.size).reshape(samples), pitch_m, FUSED_SILICA, profile)


def _points(count=6, half_m=5e-5):
    return np.random.default_rng(1).uniform(-half_m, half_m, (count, 2))


def _plain_sum(mask, factor, distance_m, depth_m, points_m, direction):
    """The mask as points under an incident wave written out as it stands in textbooks, cancellation and all."""
    if mask.profile == "staircase":
        height, amplitude = (np.kron(part, np.ones((factor, factor))) for part in (mask.height_m, mask.amplitude))
    else:
        rows, columns = (cubic_interpolation(n, factor) for n in mask.shape)
        height, amplitude = (columns.apply(rows.apply(part, -2), -1) for part in (mask.height_m, mask.amplitude))
    cell, amplitude = mask.pitch_m / factor, np.clip(amplitude, 0, 1)
    y, x = np.meshgrid(*((np.arange(n) - (n - 1) / 2) * cell for n in height.shape), indexing="ij")
    if np.isfinite(depth_m):
        sx, sy = direction[0] * depth_m, direction[1] * depth_m
        r, r0 = np.sqrt((x - sx) ** 2 + (y - sy) ** 2 + depth_m**2), np.sqrt(sx**2 + sy**2 + depth_m**2)
        wave, cosine = r0 / r * np.exp(1j * K * (r - r0)), depth_m / r
    else:
        slant = np.sqrt(1 + direction[0] ** 2 + direction[1] ** 2)
        wave, cosine = np.exp(-1j * K * (x * direction[0] + y * direction[1]) / slant), 1 / slant
    index = mask.material.index(WAVELENGTH_M)
    phase = K * height * (np.sqrt(index**2 - 1 + cosine**2) - cosine)
    shadow = points_m - np.array(direction) * distance_m
    return rayleigh_sommerfeld(amplitude * wave * np.exp(1j * phase), cell, WAVELENGTH_M, distance_m, shadow)


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["staircase", "smooth"])
@pytest.mark.parametrize(("depth_m", "direction"), SOURCES, ids=["plane", "near", "off axis", "oblique plane"])
def test_the_sum_and_its_uncertainty_against_a_plain_sum_of_points(profile, depth_m, direction):
    """Points err with the square of their distance: 6 and 12 per mask sample, extrapolated, are right to 3e-5."""
    mask, d, points = _mask(profile), 0.5e-3, _points()
    few, many = (_plain_sum(mask, n, d, depth_m, points, direction) for n in (6, 12))
    truth = np.abs(many + (many - few) / 3) ** 2
    found, uncertainty = reference_intensity(mask, WAVELENGTH_M, d, depth_m, points, direction)
    error = np.linalg.norm(found - truth) / np.linalg.norm(truth)
    stated = np.linalg.norm(uncertainty) / np.linalg.norm(truth)
    assert error < 3e-4
    assert error < stated + 3e-5
    assert stated < 1e-3  # the tolerance that it was asked to keep


@pytest.mark.parametrize("profile", ["staircase", "smooth"])
@pytest.mark.parametrize(("depth_m", "direction"), SOURCES[2:], ids=["off axis", "oblique plane"])
def test_compiled_and_plain_loops_agree(profile, depth_m, direction, monkeypatch):
    """Float64 both, but for the order of additions and the last bits of sine and cosine."""
    if not llvm_works():
        pytest.skip("no libLLVM that Dr.Jit can use: the NumPy loop is all there is")
    arguments = (_mask(profile), 3, WAVELENGTH_M, 1.9e-3, depth_m, _points(), direction)
    calls = []
    monkeypatch.setattr(direct_sum, "run_kernel", lambda *a, **b: calls.append(a) or run_kernel(*a, **b))
    compiled = mask_field(*arguments)
    monkeypatch.setattr(direct_sum, "run_kernel", lambda *_, **__: None)
    plain = mask_field(*arguments)
    assert len(calls) == 1
    assert np.abs(compiled - plain).max() < 1e-12 * np.abs(plain).max()


def test_numpy_bands_do_not_change_the_sum(monkeypatch):
    mask, points = _mask("smooth"), _points()
    monkeypatch.setattr(direct_sum, "run_kernel", lambda *_, **__: None)
    whole = mask_field(mask, 2, WAVELENGTH_M, 1e-3, math.inf, points)
    monkeypatch.setattr(direct_sum, "_CHUNK", 100)
    np.testing.assert_allclose(mask_field(mask, 2, WAVELENGTH_M, 1e-3, math.inf, points), whole, rtol=1e-12)


def test_a_disc_on_axis():
    """I = |exp(ikd) - d / R exp(ikR)|^2 on the axis of a disc, exactly (Goodman's first Rayleigh-Sommerfeld integral).

    Weighing the rim's cells by area blurs it by two boxes, which weakens the edge wave by (k h sin(theta))^2 / 12.
    """
    a, pitch, n = 20e-6, 0.25e-6, 162
    fine = (np.arange(n * 16) - (n * 16 - 1) / 2) * pitch / 16
    disc = (fine[:, None] ** 2 + fine[None, :] ** 2 <= a**2).astype(float).reshape(n, 16, n, 16).mean((1, 3))
    mask = Mask(np.zeros_like(disc), disc, pitch)
    for d in (0.2e-3, 1.3e-3):
        far = np.hypot(a, d)
        expected = abs(1 - d / far * np.exp(1j * K * (far - d))) ** 2
        found, _ = reference_intensity(mask, WAVELENGTH_M, d, math.inf, np.zeros((1, 2)))
        weaker = (K * pitch * a / far) ** 2 / 12
        assert found[0] == pytest.approx(expected, abs=2 * np.sqrt(expected) * weaker + 1e-4)


def test_smooth_cells_know_their_slope():
    """A prism's slope is the same in every cell; a staircase has none."""
    ramp = np.broadcast_to(np.arange(12) * 0.1e-6, (8, 12)).copy()
    cells = mask_cells(Mask(ramp, np.ones_like(ramp), 2e-6, profile="smooth"), 3)
    np.testing.assert_allclose(cells.slope_x[:, 6:-6], 0.05, rtol=1e-9)
    assert np.abs(cells.slope_y).max() < 1e-12
    assert mask_cells(Mask(ramp, np.ones_like(ramp), 2e-6), 3).slope_x.tolist() == [[0.0]]


def test_bad_input_is_named():
    mask = _mask("staircase")
    with pytest.raises(InputError, match=r"^points_m: "):
        reference_intensity(mask, WAVELENGTH_M, 1e-3, math.inf, np.zeros(2))
    with pytest.raises(InputError, match=r"^depth_m: "):
        reference_intensity(mask, WAVELENGTH_M, 1e-3, -0.1, np.zeros((1, 2)))
    with pytest.raises(InputError, match=r"^distance_m: "):
        reference_intensity(mask, WAVELENGTH_M, math.nan, 0.1, np.zeros((1, 2)))


def test_a_kernel_that_fails_is_told_though_llvm_works():
    if not llvm_works():
        pytest.skip("no libLLVM that Dr.Jit can use")
    with pytest.raises(RuntimeError, match="the kernel failed in a process of its own"):
        run_kernel(points_m=np.zeros((1, 2)))


def test_without_llvm_there_is_no_kernel(monkeypatch):
    monkeypatch.setattr("simulator.optics.error_budget.direct_sum.llvm_works", lambda: False)
    assert run_kernel(points_m=np.zeros((1, 2))) is None
