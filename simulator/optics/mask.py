"""The mask: a thin element of height and amplitude on a square grid, and its complex transmission."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from simulator.arrays import Array, namespace, to_numpy, unit_phasor
from simulator.errors import InputError
from simulator.optics.materials import FUSED_SILICA, Material
from simulator.optics.resample import cubic_interpolation

UNNAMED = "custom"


@dataclass(frozen=True)
class Mask:
    """A thin mask in world axes (x right, y down, seen from behind the sensor); outside its grid it is opaque.

    Sample (i, j) of (H, W) lies at ``((j - (W - 1) / 2) pitch_m, (i - (H - 1) / 2) pitch_m)``.

    Attributes:
        height_m: ``(H, W)`` height of the material, metres; NumPy or torch, float32 or float64.
        amplitude: ``(H, W)`` amplitude transmission, 0..1; hard edges weighted by area.
        pitch_m: sample pitch, metres.
        material: what the height is made of.
        profile: ``staircase`` (fabricated: constant over each mask pixel) or ``smooth`` (interpolated when oversampled).
        name: what it is, for provenance.
        notes: how it was made, for provenance; JSON-serialisable and without influence on the light.

    Raises:
        InputError: for wrong shapes, complex numbers, NaN, amplitudes outside 0..1, an opaque mask, or an implausible pitch.
    """

    height_m: Array
    amplitude: Array
    pitch_m: float
    material: Material = FUSED_SILICA
    profile: Literal["staircase", "smooth"] = "staircase"
    name: str = UNNAMED
    notes: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.height_m.ndim != 2 or tuple(self.height_m.shape) != tuple(self.amplitude.shape):
            raise InputError(
                "height_m, amplitude",
                f"got {tuple(self.height_m.shape)} and {tuple(self.amplitude.shape)}, expected one (H, W)",
            )
        height, amplitude = to_numpy(self.height_m), to_numpy(self.amplitude)
        for name, values in (("height_m", height), ("amplitude", amplitude)):
            if np.iscomplexobj(values):
                raise InputError(
                    name,
                    "holds complex numbers, expected real ones: a phase is a height, h = phase lambda / (2 pi (n - 1))",
                )
        if not np.all(np.isfinite(height)):
            bad = np.count_nonzero(~np.isfinite(height))
            raise InputError("height_m", f"holds {bad} NaN or infinite values; every height must be finite metres")
        if not np.all((amplitude >= 0) & (amplitude <= 1)):
            raise InputError(
                "amplitude",
                f"expected 0..1, got {np.nanmin(amplitude)} to {np.nanmax(amplitude)} with "
                f"{np.count_nonzero(np.isnan(amplitude))} NaN; divide by its maximum first",
            )
        if not np.any(amplitude > 0):
            raise InputError("amplitude", "zero everywhere: no light passes; open at least one mask pixel")
        if not 1e-8 <= self.pitch_m <= 1e-3:
            raise InputError("pitch_m", f"got {self.pitch_m:g}, expected metres from 1e-8 to 1e-3 (2 um is 2e-6)")
        if self.profile not in ("staircase", "smooth"):
            raise InputError("profile", f"got {self.profile!r}, expected 'staircase' or 'smooth'")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the mask grid."""
        return self.height_m.shape[0], self.height_m.shape[1]

    @property
    def transmitted_area_m2(self) -> float:
        """Transmittance times aperture area, square metres: the power that passes per unit irradiance."""
        return float(np.sum(to_numpy(self.amplitude).astype(np.float64) ** 2) * self.pitch_m**2)

    def crop(self, shape: tuple[int, int]) -> Mask:
        """Return the central part of the mask, at most ``shape`` rows and columns."""
        rows, columns = (
            slice(start, start + want)
            for have, want in zip(self.shape, shape, strict=True)
            for start in [max((have - want) // 2, 0)]
        )
        return replace(self, height_m=self.height_m[rows, columns], amplitude=self.amplitude[rows, columns])

    def transmission(self, wavelength_m: float, oversample: int = 1, sine: float = 0.0) -> Array:
        """Return the complex transmission t = a exp(i 2 pi (n - 1) h / lambda) of a thin element.

        At the angle of incidence theta the path is h [sqrt(n^2 - sin^2 theta) - cos theta] instead of h (n - 1).
        Source: Goodman, Introduction to Fourier Optics, section 5.1.

        Args:
            wavelength_m: vacuum wavelength, metres.
            oversample: samples per mask pixel and axis; the grid becomes that much finer over the same extent.
            sine: sine of the angle of incidence.

        Returns:
            ``(H * oversample, W * oversample)`` complex64 for float32 masks, complex128 for float64.
        """
        if oversample < 1:
            raise InputError("oversample", f"got {oversample}, expected a whole number from 1")
        xp = namespace(self.height_m)
        height, amplitude = self.height_m, self.amplitude
        if oversample > 1 and self.profile == "smooth":
            rows, columns = (cubic_interpolation(length, oversample) for length in self.shape)
            height, amplitude = (columns.apply(rows.apply(part, -2), -1) for part in (height, amplitude))
            amplitude = xp.clip(amplitude, 0, 1)
        # In turns and reduced to one turn before the exponential: float32 keeps its digits at any height.
        per_height = np.sqrt(self.material.index(wavelength_m) ** 2 - sine**2) - np.sqrt(1 - sine**2)
        turns = height * float(per_height / wavelength_m)
        turns -= xp.round(turns)
        turns *= 2 * np.pi
        field = xp.astype(amplitude, height.dtype, copy=False) * unit_phasor(turns)
        if oversample > 1 and self.profile == "staircase":
            field = xp.repeat(xp.repeat(field, oversample, axis=0), oversample, axis=1)
        return field

    def digest(self) -> str:
        """Return a hash of everything that decides the transmission."""
        sha = hashlib.sha256(repr((self.pitch_m, self.material, self.profile, self.shape)).encode())
        for part in (self.height_m, self.amplitude):
            array = np.ascontiguousarray(to_numpy(part))
            sha.update(array.dtype.str.encode() + array.tobytes())
        return sha.hexdigest()

    def provenance(self) -> dict[str, Any]:
        """Return what a data set records of the mask; JSON-serialisable."""
        return {
            "name": self.name,
            "notes": dict(self.notes),
            "shape": list(self.shape),
            "pitch_m": self.pitch_m,
            "profile": self.profile,
            "material": self.material.name,
            "material_source": self.material.source,
            "transmitted_area_m2": self.transmitted_area_m2,
            "sha256": self.digest(),
        }


def steepest_frequency(mask: Mask, wavelength_m: float) -> float:
    """Return the steepest phase gradient between neighbouring open samples, along either axis, cycles per metre."""
    height, open_ = to_numpy(mask.height_m), to_numpy(mask.amplitude) > 0
    steps = [
        float(np.abs(np.diff(height, axis=axis))[both].max(initial=0))
        for axis in (0, 1)
        for both in [np.delete(open_, 0, axis) & np.delete(open_, -1, axis)]
    ]
    return max(steps) * (mask.material.index(wavelength_m) - 1) / wavelength_m / mask.pitch_m


def followed_frequency(mask: Mask, wavelength_m: float, oversampling: int) -> float:
    """Return the frequency per axis (cycles per metre) up to which a smooth mask's light is followed.

    The mask's own samples hold their Nyquist frequency. A finer grid holds more, but only a phase that is steeper than the
    mask's own samples can tell puts light there: else all that it would add is the waves of a hard aperture edge.
    """
    nyquist = 1 / (2 * mask.pitch_m)
    if oversampling == 1:
        return nyquist
    return min(max(nyquist, steepest_frequency(mask, wavelength_m)), oversampling * nyquist)
