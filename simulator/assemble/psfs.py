"""The PSF stack of a configuration: computed (and cached), or read from measured pictures."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

from simulator.assemble.camera import build_sensor, distance_m
from simulator.assemble.masks import build_mask, optics_code
from simulator.config.psf import ComputedPsf, MeasuredPsf
from simulator.errors import InputError
from simulator.optics.cache import Entry, cached
from simulator.optics.psf import Progress, PsfConfig, compute_psf_stack, psf_fingerprint
from simulator.optics.psf_stack import PsfStack, depth_planes
from simulator.optics.spectrum import NOMINAL_CAMERA, spectral_response
from simulator.types import CameraGeometry

if TYPE_CHECKING:
    from simulator.config import Config


def build_geometry(config: Config) -> CameraGeometry:
    """Return what the optics need to know of the camera.

    Raises:
        InputError: for an unknown illuminant or spectral response.
    """
    chosen = config.camera.sensor.spectral_response or NOMINAL_CAMERA
    response = spectral_response(chosen, config.camera.illuminant)
    return CameraGeometry(distance_m(config), build_sensor(config).binned_pitch_m, response)


def build_psf_config(config: Config) -> PsfConfig:
    """Return how to compute the stack of a configuration with a computed PSF."""
    chosen = config.psf
    assert isinstance(chosen, ComputedPsf)
    if chosen.depths_cm is not None:
        depths = [depth * 1e-2 for depth in chosen.depths_cm]
    elif chosen.depths == 1:
        depths = [chosen.nearest_cm * 1e-2]
    else:
        assert chosen.near_cm is not None
        assert chosen.far_cm is not None
        assert chosen.depths is not None
        depths = depth_planes(chosen.near_cm * 1e-2, chosen.far_cm * 1e-2, chosen.depths, chosen.spacing)
    return PsfConfig(
        tuple(float(depth) for depth in depths),
        chosen.model,
        chosen.wavelengths_per_channel,
        chosen.oversampling,
        chosen.accept_error,
    )


def build_psf_stack(config: Config, *, threads: int = 1, progress: Progress | None = None) -> PsfStack:
    """Compute the PSF stack (cached) or read the measured one.

    Args:
        config: the configuration.
        threads: depths computed at a time.
        progress: called with (done, total) while PSFs are computed.
    """
    if isinstance(config.psf, MeasuredPsf):
        return _measured_stack(config, config.psf)
    mask = build_mask(config)
    assert mask is not None
    geometry, psf_config = build_geometry(config), build_psf_config(config)
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


def _measured_stack(config: Config, chosen: MeasuredPsf) -> PsfStack:
    from simulator.optics.measured import load_measured_psf

    sensor = build_sensor(config)
    stack = load_measured_psf(
        [config.resolve_path(name) for name in chosen.measured],
        [depth * 1e-2 for depth in chosen.depths_cm],
        sensor.binned_pitch_m,
        frame=chosen.frame,
        binning=chosen.binning,
        background=background_file(config, chosen),
        throughput_m2=chosen.throughput_mm2 * 1e-6,
    )
    for axis, have, physical in zip(("rows", "columns"), stack.values.shape[-2:], sensor.physical_shape, strict=True):
        if have * sensor.binning > physical:
            msg = (
                f"psf.binning: {chosen.binning} leaves pictures of {have} {axis}, but sensor {sensor.name!r} has only "
                f"{physical // sensor.binning} binned ones of {sensor.binned_pitch_m * 1e6:g} um; the PSF's pixels must "
                "become the sensor's binned pixels: raise psf.binning"
            )
            raise InputError(msg)
    return stack


def background_file(config: Config, chosen: MeasuredPsf) -> Any:
    """Return a measured PSF's background as ``load_measured_psf`` takes it, a file as a path."""
    named = isinstance(chosen.background, str) and chosen.background not in ("border", "none")
    return config.resolve_path(str(chosen.background)) if named else chosen.background
