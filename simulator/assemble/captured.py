"""The PSF stack that a calibration of the configured camera would measure, errors and all."""

from __future__ import annotations

import hashlib
import inspect
from dataclasses import asdict, replace
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from simulator.assemble.camera import build_sensor, distance_m
from simulator.assemble.masks import build_mask, optics_code
from simulator.assemble.psfs import build_geometry, build_psf_config
from simulator.camera import calibration, noise
from simulator.camera import sensor as sensor_module
from simulator.camera.calibration import CalibrationSource, Recording, SourcePlaces, captured_light
from simulator.camera.noise import NoNoise, PhysicalNoise
from simulator.config.psf import AsCaptured, ComputedPsf
from simulator.errors import InputError
from simulator.io.cache import Entry, cached
from simulator.optics.psf import Progress
from simulator.optics.spectra import Line, check_materials, quantile_lines
from simulator.optics.stack import PsfStack
from simulator.seeds import generator
from simulator.types import CameraGeometry

if TYPE_CHECKING:
    from simulator.config import Config


def build_captured_stack(
    config: Config, nominal: PsfStack, *, threads: int = 1, progress: Progress | None = None
) -> PsfStack:
    """Return the stack as captured (cached): like the nominal one, but measured with a real source, light and sensor.

    ``provenance`` has the kind ``captured``, the nominal stack's fingerprint, the settings, where the source truly was, and
    what the recordings lost.

    Args:
        config: a configuration with a computed PSF; without ``psf.as_captured`` a careful laboratory's errors are taken.
        nominal: the true stack, as ``build_psf_stack`` returns it.
        threads: depths computed at a time.
        progress: called with (done, total) while PSFs are computed.

    Raises:
        InputError: when the PSF was measured already, a channel sees nothing of the calibration's light, or an error puts a
            source behind the mask.
    """
    chosen, psf_config = _chosen(config), build_psf_config(config)
    source, recording = _source(chosen), _recording(chosen)
    camera, lines = _lit(config, chosen)
    places = _places(config, chosen)
    sensor = replace(build_sensor(config), noise=PhysicalNoise() if chosen.noise == "physical" else NoNoise())
    settings = {**asdict(source), **asdict(recording), "noise": chosen.noise, "seed": config.seed}
    response = camera.response
    identity = repr((nominal.fingerprint, settings, response.label, asdict(sensor))).encode()
    identity += response.wavelengths_m.tobytes() + response.weights.tobytes()
    fingerprint = hashlib.sha256(identity).hexdigest()

    def compute() -> Entry:
        mask = build_mask(config)
        assert mask is not None
        size = nominal.values.shape[-1]  # the calibration's light alone might ask for another
        light = captured_light(mask, camera, psf_config, places, size, threads=threads, progress=progress)
        photons = response.weights.sum(axis=1)
        values, records = np.empty(light.shape, np.float32), []
        for k, plane in enumerate(light):
            rng = generator(config.seed, "pilot", 1 + k, "calibration")
            values[k], record = recording.record(plane, photons / photons.max(), sensor, rng)
            records.append(record)
        measured = {
            "true_depths_m": [float(depth) if np.isfinite(depth) else "inf" for depth in places.depths_m],
            "shifts_m": places.shifts_m.tolist(),
            "blurs_m": places.blurs_m.tolist(),
            "recordings": records,
        }
        return {"values": values}, measured

    key = hashlib.sha256(f"{fingerprint} {optics_code()} {_camera_code()}".encode()).hexdigest()
    arrays, measured = cached("captured", key, compute)
    return replace(
        nominal,
        values=arrays["values"],
        fingerprint=fingerprint,
        provenance=nominal.provenance
        | {
            "kind": "captured",
            "nominal_fingerprint": nominal.fingerprint,
            "response": response.label,
            "lines": [[response.channels[line.channel], line.wavelength_m, line.weight] for line in lines],
            "sensor": sensor.name,
            "settings": settings,
        }
        | measured,
    )


def check_calibration(config: Config) -> None:
    """Refuse a calibration that cannot be simulated, before anything is computed.

    Raises:
        InputError: as :func:`build_captured_stack`, naming the key.
    """
    chosen = _chosen(config)
    _recording(chosen)
    _lit(config, chosen)
    _places(config, chosen)


def _chosen(config: Config) -> AsCaptured:
    if not isinstance(config.psf, ComputedPsf):
        msg = "psf.as_captured: this PSF was measured, and its errors are in it; a calibration is simulated from a mask"
        raise InputError(msg)
    return config.psf.as_captured or AsCaptured()


def _source(chosen: AsCaptured) -> CalibrationSource:
    return CalibrationSource(
        chosen.source_um * 1e-6,
        chosen.depth_offset_mm * 1e-3,
        chosen.depth_std_mm * 1e-3,
        chosen.shift_std_um * 1e-6,
        (float(np.radians(chosen.tilt_deg[0])), float(np.radians(chosen.tilt_deg[1]))),
    )


def _recording(chosen: AsCaptured) -> Recording:
    try:
        return Recording(
            chosen.peak_percent * 1e-2,
            chosen.frames,
            chosen.pedestal_percent * 1e-2,
            chosen.glow_percent * 1e-2,
            chosen.background,
        )
    except InputError as error:
        _, _, reason = str(error).partition(": ")  # behind the names of the recording's attributes
        msg = f"psf.as_captured.peak_percent + pedestal_percent + glow_percent: {reason}"
        raise InputError(msg) from error


def _places(config: Config, chosen: AsCaptured) -> SourcePlaces:
    """Return where the sources truly are; the configuration's seed decides."""
    rng = generator(config.seed, "pilot", 0, "calibration")
    try:
        return _source(chosen).place(build_psf_config(config).depths_m, distance_m(config), rng)
    except InputError as error:
        _, _, reason = str(error).partition(": ")  # behind the names of the source's attributes
        msg = f"psf.as_captured.depth_offset_mm, depth_std_mm: {reason}"
        raise InputError(msg) from error


def _lit(config: Config, chosen: AsCaptured) -> tuple[CameraGeometry, list[Line]]:
    """Return the camera with its channels' response to the calibration's light, and the wavelengths that stand for it."""
    per_channel = build_psf_config(config).wavelengths_per_channel
    own = build_geometry(config)
    if chosen.illuminant == "camera":
        return own, quantile_lines(own.response, per_channel)
    camera = config.camera.model_copy(update={"illuminant": chosen.illuminant})
    try:
        lit = build_geometry(config.model_copy(update={"camera": camera}))
        lines = quantile_lines(lit.response, per_channel)
        check_materials(lit.response, lines, [layer.material for layer in (*lit.gap, *lit.window)])
    except InputError as error:
        msg = f"psf.as_captured.illuminant: {str(error).removeprefix('illuminant: ')}"
        raise InputError(msg) from error
    return lit, lines


@cache
def _camera_code() -> str:
    """Return a hash of the code that records: a cached result must not outlive a change there."""
    modules: tuple[ModuleType, ...] = (calibration, noise, sensor_module)
    return hashlib.sha256("".join(map(inspect.getsource, modules)).encode()).hexdigest()
