"""The PSF stack of a configuration: computed (and cached), or read from measured pictures."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from simulator.assemble.camera import build_sensor, distance_m
from simulator.assemble.layers import build_gap, build_window
from simulator.assemble.light import build_response
from simulator.assemble.masks import build_mask, optics_code
from simulator.assemble.measured import measured_depths_m, measured_stack
from simulator.assemble.planes import plane_depths_m
from simulator.config.psf import ComputedPsf
from simulator.io.cache import Entry, cached
from simulator.optics.psf import Progress, PsfConfig, compute_psf_stack, psf_fingerprint
from simulator.optics.spectra import check_materials, quantile_lines
from simulator.optics.stack import PsfStack
from simulator.types import CameraGeometry

if TYPE_CHECKING:
    from simulator.config import Config


def build_geometry(config: Config) -> CameraGeometry:
    """Return what the optics need to know of the camera.

    Raises:
        InputError: for an unknown illuminant, spectral response or material, or an unreadable file of one.
    """
    return CameraGeometry(
        distance_m(config),
        build_sensor(config).binned_pitch_m,
        build_response(config),
        build_gap(config),
        build_window(config),
    )


def build_psf_config(config: Config) -> PsfConfig:
    """Return how to compute the stack of a configuration with a computed PSF."""
    chosen = config.psf
    assert isinstance(chosen, ComputedPsf)
    return PsfConfig(
        plane_depths_m(chosen),
        chosen.model,
        chosen.wavelengths_per_channel,
        chosen.oversampling,
        chosen.accept_error,
    )


def stack_depths_m(config: Config) -> tuple[float, ...]:
    """Return the depths of the configuration's stack, metres, without making it."""
    if isinstance(config.psf, ComputedPsf):
        return plane_depths_m(config.psf)
    return measured_depths_m(config, config.psf)


def build_psf_stack(config: Config, *, threads: int = 1, progress: Progress | None = None) -> PsfStack:
    """Compute the PSF stack (cached) or read the measured one.

    Args:
        config: the configuration.
        threads: depths computed at a time.
        progress: called with (done, total) while PSFs are computed.
    """
    if not isinstance(config.psf, ComputedPsf):
        return measured_stack(config, config.psf)
    mask = build_mask(config)
    assert mask is not None
    geometry, psf_config = build_geometry(config), build_psf_config(config)
    lines = quantile_lines(geometry.response, psf_config.wavelengths_per_channel)
    layers = [layer.material for layer in (*geometry.gap, *geometry.window)]
    check_materials(geometry.response, lines, [mask.material, *layers])
    fingerprint = psf_fingerprint(mask, geometry, psf_config)

    def compute() -> Entry:
        stack = compute_psf_stack(mask, geometry, psf_config, threads=threads, progress=progress)
        described = {"channels": stack.channels, "provenance": stack.provenance}
        return {"values": stack.values, "depths_m": stack.depths_m}, described

    # The limit is no part of the values, but a stack cached under a loose one must not pass a tight one.
    key = hashlib.sha256(repr((fingerprint, psf_config.accept_error, optics_code())).encode()).hexdigest()
    arrays, described = cached("psf", key, compute)
    return PsfStack(
        arrays["values"],
        arrays["depths_m"],
        geometry.pixel_pitch_m,
        tuple(described["channels"]),
        fingerprint,
        described["provenance"],
    )
