"""Peers' propagation in the mode that their documentation gives for a field that must not wrap around.

Each factory returns a function from a field ``(N, N)`` to the intensity in the same window. All are given just enough
padding (a window's width in total), so that nobody pays for room that the result does not need.
"""

from __future__ import annotations

import sys
import types
from collections.abc import Callable
from importlib import metadata

import numpy as np

Propagate = Callable[[np.ndarray], np.ndarray]


def torchoptics_asm(pitch_m: float, wavelength_m: float, distance_m: float, shape: tuple[int, int]) -> Propagate:
    """Angular spectrum with ``asm_pad`` of half a window per side (its default is two windows per side)."""
    import torch
    import torchoptics

    def run(field: np.ndarray) -> np.ndarray:
        torchoptics.set_default_dtype(torch.float32 if field.dtype == np.complex64 else torch.float64)
        source = torchoptics.Field(torch.from_numpy(field), wavelength=wavelength_m, z=0, spacing=pitch_m)
        there = source.propagate_to_z(distance_m, propagation_method="ASM", asm_pad=[n // 2 for n in shape])
        return there.intensity().numpy()

    return run


def waveprop_numpy(pitch_m: float, wavelength_m: float, distance_m: float, shape: tuple[int, int]) -> Propagate:
    """Band-limited angular spectrum on NumPy; pads by half a window per side itself."""
    from waveprop.rs import angular_spectrum

    def run(field: np.ndarray) -> np.ndarray:
        there, _, _ = angular_spectrum(field, wavelength_m, pitch_m, distance_m, dtype=field.dtype)
        return np.abs(there) ** 2

    return run


def waveprop_torch(pitch_m: float, wavelength_m: float, distance_m: float, shape: tuple[int, int]) -> Propagate:
    """The same on torch tensors."""
    import torch
    from waveprop.rs import angular_spectrum

    def run(field: np.ndarray) -> np.ndarray:
        tensor = torch.from_numpy(field)
        there, _, _ = angular_spectrum(tensor, wavelength_m, pitch_m, distance_m, dtype=tensor.dtype, device="cpu")
        return (there.abs() ** 2).numpy()

    return run


def prysm_asm(pitch_m: float, wavelength_m: float, distance_m: float, shape: tuple[int, int]) -> Propagate:
    """``angular_spectrum`` with its default Q = 2; its kernel is the paraxial one. Millimetres and microns."""
    # prysm asks pkg_resources for its own version, which current Python environments no longer carry.
    if "pkg_resources" not in sys.modules:
        stand_in = types.ModuleType("pkg_resources")
        setattr(stand_in, "get_distribution", metadata.distribution)  # noqa: B010 (a module that types cannot know)
        sys.modules["pkg_resources"] = stand_in
    from prysm.conf import config
    from prysm.propagation import angular_spectrum

    top, left = ((n + 1) // 2 for n in shape)

    def run(field: np.ndarray) -> np.ndarray:
        config.precision = 32 if field.dtype == np.complex64 else 64
        there = angular_spectrum(field, wavelength_m * 1e6, pitch_m * 1e3, distance_m * 1e3)
        return np.abs(there[top : top + shape[0], left : left + shape[1]]) ** 2

    return run


PEERS = {
    "torchoptics": torchoptics_asm,
    "waveprop (numpy)": waveprop_numpy,
    "waveprop (torch)": waveprop_torch,
    "prysm (paraxial)": prysm_asm,
}


def phase_contour_retrieval(
    target: np.ndarray, pitch_m: float, wavelength_m: float, distance_m: float, iterations: int
) -> np.ndarray:
    """Return the mask phase as LenslessPiCam's PhaseContour retrieves it, on waveprop's Fresnel convolution.

    Written from the published algorithm (Boominathan et al., IEEE TPAMI 42, 1618, 2020, algorithm 1): back to the mask,
    unit modulus, forward to the sensor, modulus of the target.
    """
    from waveprop.fresnel import fresnel_conv

    modulus = np.sqrt(target)
    wave, mask = modulus, modulus
    for _ in range(iterations):
        back = fresnel_conv(wave, wavelength_m, pitch_m, -distance_m, dtype=np.float32)[0]
        mask = np.exp(1j * np.angle(back))
        there = fresnel_conv(mask, wavelength_m, pitch_m, distance_m, dtype=np.float32)[0]
        wave = modulus * np.exp(1j * np.angle(there))
    return np.angle(mask)
