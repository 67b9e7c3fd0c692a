"""Propagation against independent reference numbers (oracles beside the checkout)."""

import numpy as np
import pytest

from simulator.optics.propagation import Transfer, angular_spectrum, even_filter

pytestmark = pytest.mark.shared


def _grid(samples: int, pitch_m: float) -> np.ndarray:
    return (np.arange(samples) - (samples - 1) / 2) * pitch_m


def _coverage(samples: int, pitch_m: float, inside, supersample: int = 8) -> np.ndarray:
    """Share of each sample's cell that lies inside a shape: hard edges weighted by area."""
    fine = _grid(samples * supersample, pitch_m / supersample)
    covered = np.empty((samples, samples))
    for i in range(samples):
        rows = fine[i * supersample : (i + 1) * supersample]
        band = inside(rows[:, None], fine[None, :]).astype(float)
        covered[i] = band.reshape(supersample, samples, supersample).mean((0, 2))
    return covered


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.complex128, 1e-9), (np.complex64, 5e-6)])
@pytest.mark.parametrize("which", [0, 1], ids=["1 cm", "infinity"])
def test_smooth_edge_mask_equals_the_rayleigh_sommerfeld_sum(shared_oracle, dtype, tolerance, which):
    """A band-limited mask is sampled without loss, so only rounding may remain: the tolerances are PHYSICS section 3's."""
    oracle = np.load(shared_oracle / "e2_smooth_aperture_truth.npz")
    wavelength, distance, depth = float(oracle["wavelength"]), float(oracle["z"]), float(oracle["depths"][which])
    pitch, samples = float(oracle["pitch"]) / 3, 3 * int(oracle["n"])
    x = _grid(samples, pitch)
    # Each mode cos(2 pi (fx x + fy y) + phase) is separable, so 400 of them are one matrix product.
    rows = np.exp(2j * np.pi * np.outer(x, oracle["mode_fy"])) * (
        oracle["mode_amp"] * np.exp(1j * oracle["mode_phase"])
    )
    height = (rows @ np.exp(2j * np.pi * np.outer(oracle["mode_fx"], x))).real
    radius = np.hypot(x[:, None], x[None, :])
    phase = np.exp(2j * np.pi * float(oracle["delta_n"]) * height / wavelength)
    np.testing.assert_allclose(phase[1::3, 1::3], np.exp(1j * oracle["phase"]), atol=1e-9)
    field = phase * np.exp(-((radius / float(oracle["waist"])) ** int(oracle["order"])))
    if np.isfinite(depth):
        r = np.sqrt(radius**2 + depth**2)
        field = field * depth / r * np.exp(2j * np.pi / wavelength * (r - depth))
    image = np.abs(angular_spectrum(field.astype(dtype), pitch, wavelength, distance)) ** 2
    rows, columns = 3 * oracle["index_row"] + 1, 3 * oracle["index_col"] + 1
    np.testing.assert_allclose(x[columns], oracle["px"], atol=1e-12)
    truth = oracle["intensity"][which]
    error = np.linalg.norm(image[rows, columns] - truth) / np.linalg.norm(truth)
    assert error < tolerance


def test_circular_aperture_on_axis(shared_oracle):
    """The exact on-axis field of a hard disc, from 1 mm to 10 cm.

    An area-weighted edge blurs the rim by one sample, which weakens the edge wave by 1 - sinc(sin(theta) dx / lambda):
    this predicted error (1.4e-2 at 1 mm, 1e-6 at 10 cm) is the tolerance, plus 5e-4 for the soft band limit.
    """
    oracle = np.load(shared_oracle / "a_circular_aperture.npz")
    wavelength, radius, pitch = float(oracle["wavelength"]), float(oracle["radius"]), 0.5e-6
    disc = _coverage(405, pitch, lambda y, x: x**2 + y**2 <= radius**2, 16)
    field = np.pad(disc.astype(complex), 100)
    for i in np.linspace(0, len(oracle["z_axis"]) - 1, 8).astype(int):
        z = float(oracle["z_axis"][i])
        centre = angular_spectrum(field, pitch, wavelength, z)[302, 302] * np.exp(2j * np.pi / wavelength * z)
        rim_loss = 1 - np.sinc(np.sin(np.arctan(radius / z)) * pitch / wavelength)
        assert abs(centre - oracle["U_axis_rs"][i]) < 1.1 * rim_loss + 5e-4


def test_airy_pattern_of_a_lens(shared_oracle):
    """A perfect spherical lens focuses to the oracle's Rayleigh-Sommerfeld field, and to Airy's pattern within NA^2."""
    oracle = np.load(shared_oracle / "b_airy.npz")
    wavelength, radius, focal = (float(oracle[k]) for k in ("wavelength", "pupil_radius", "focal_length"))
    pitch, samples = 1e-6, 1051
    x = _grid(samples, pitch)
    r = np.sqrt(x[:, None] ** 2 + x[None, :] ** 2 + focal**2)
    pupil = _coverage(samples, pitch, lambda y, x: x**2 + y**2 <= radius**2)
    field = pupil * np.exp(-2j * np.pi / wavelength * (r - focal))
    image = np.abs(angular_spectrum(field, pitch, wavelength, focal)) ** 2
    cut = image[samples // 2, samples // 2 :][: len(oracle["r_rs"])]
    truth = np.abs(oracle["U_rs_spherical_lens"]) ** 2
    assert np.linalg.norm(cut - truth) / np.linalg.norm(truth) < 2e-3
    airy = np.interp(np.arange(40) * pitch, oracle["r"], oracle["I_airy"])
    assert np.linalg.norm(cut[:40] - airy) / np.linalg.norm(airy) < 1e-2  # paraxial: NA^2 = 2.5e-3 in intensity scale


def test_cosine_talbot_self_image(shared_oracle):
    """A cosine grating is three plane waves on exact FFT bins of one period: rounding is the only error left."""
    oracle = np.load(shared_oracle / "d_talbot.npz")
    wavelength = float(oracle["wavelength"])
    pitch = float(oracle["x"][1] - oracle["x"][0])
    grating = np.tile(oracle["U_cos"][0], (2, 1))
    transfer = Transfer(grating.shape, pitch, wavelength, like=grating)
    for z, truth in zip(oracle["z"], oracle["U_cos"], strict=True):
        field = even_filter(grating, grating.shape, transfer.quadrant(float(z)).__getitem__)
        np.testing.assert_allclose(field[0] * np.exp(2j * np.pi / wavelength * z), truth, atol=1e-10)
    again = even_filter(grating, grating.shape, transfer.quadrant(float(oracle["z_talbot_exact"])).__getitem__)
    # Up to a constant phase the grating returns exactly at the non-paraxial Talbot distance.
    np.testing.assert_allclose(np.abs(again[0]), np.abs(grating[0]), atol=1e-10)
