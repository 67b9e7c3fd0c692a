"""The PSF stack that a calibration of the configured camera would measure, errors and all."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, replace
from functools import partial

import numpy as np

from simulator import seeds
from simulator.assembly import Assembly
from simulator.camera import calibration
from simulator.camera.calibration import CalibrationSource, Recording, SourcePlaces, captured_light
from simulator.camera.noise import NoNoise, PhysicalNoise
from simulator.config.psf import AsCaptured, ComputedPsf
from simulator.errors import InputError
from simulator.io.cache import Entry, cached, code_digest
from simulator.optics.spectra import Line, check_materials, quantile_lines
from simulator.optics.stack import PsfStack
from simulator.seeds import generator
from simulator.types import CameraGeometry


def captured_stack(assembly: Assembly) -> PsfStack:
    """Return the stack as captured (cached): like the nominal one, but measured with a real source, light and sensor.

    ``provenance`` has the kind ``captured``, the nominal stack's fingerprint, the settings, where the source truly was, and
    what the recordings lost.

    Args:
        assembly: of a configuration with a computed PSF; without ``psf.as_captured`` a careful laboratory's errors are
            taken. Its ``psf_stack`` is the nominal one.

    Raises:
        InputError: when the PSF was measured already, a channel sees nothing of the calibration's light, or an error puts a
            source behind the mask.
    """
    config, chosen, nominal = assembly.config, _chosen(assembly), assembly.psf_stack
    source, recording = _source(chosen), _recording(chosen)
    camera, lines = _lit(assembly, chosen)
    places = _places(assembly, chosen)
    sensor = replace(assembly.sensor, noise=PhysicalNoise() if chosen.noise == "physical" else NoNoise())
    settings = {**asdict(source), **asdict(recording), "noise": chosen.noise, "seed": config.seed}
    response = camera.response
    identity = repr((nominal.fingerprint, settings, response.label, asdict(sensor))).encode()
    identity += response.wavelengths_m.tobytes() + response.weights.tobytes()
    fingerprint = hashlib.sha256(identity).hexdigest()

    def compute() -> Entry:
        assert assembly.mask is not None
        size = nominal.values.shape[-1]  # the calibration's light alone might ask for another
        progress = None if assembly.progress is None else partial(assembly.progress, "captured PSFs")
        light = captured_light(
            assembly.mask, camera, assembly.psf_config, places, size, threads=assembly.threads, progress=progress
        )
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

    key = hashlib.sha256(f"{fingerprint} {code_digest(calibration.__name__, seeds.__name__)}".encode()).hexdigest()
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


def check_calibration(assembly: Assembly) -> None:
    """Refuse a calibration that cannot be simulated, before anything is computed.

    Raises:
        InputError: as :func:`captured_stack`, naming the key.
    """
    with assembly.config.refusals("psf.as_captured"):
        chosen = _chosen(assembly)
        _recording(chosen)
        _lit(assembly, chosen)
        _places(assembly, chosen)


def _chosen(assembly: Assembly) -> AsCaptured:
    psf = assembly.config.psf
    if not isinstance(psf, ComputedPsf):
        raise InputError(
            "psf.as_captured", "this PSF was measured, and its errors are in it; a calibration is simulated from a mask"
        )
    return psf.as_captured or AsCaptured()


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
        raise InputError("psf.as_captured.peak_percent + pedestal_percent + glow_percent", error.reason) from error


def _places(assembly: Assembly, chosen: AsCaptured) -> SourcePlaces:
    """Return where the sources truly are; the configuration's seed decides."""
    rng = generator(assembly.config.seed, "pilot", 0, "calibration")
    try:
        return _source(chosen).place(assembly.depths_m, assembly.mask_to_sensor_m, rng)
    except InputError as error:
        raise InputError("psf.as_captured.depth_offset_mm, depth_std_mm", error.reason) from error


def _lit(assembly: Assembly, chosen: AsCaptured) -> tuple[CameraGeometry, list[Line]]:
    """Return the camera with its channels' response to the calibration's light, and the wavelengths that stand for it."""
    per_channel = assembly.psf_config.wavelengths_per_channel
    if chosen.illuminant == "camera":
        return assembly.geometry, quantile_lines(assembly.response, per_channel)
    camera = assembly.config.camera.model_copy(update={"illuminant": chosen.illuminant})
    try:
        lit = Assembly(assembly.config.model_copy(update={"camera": camera})).geometry
        lines = quantile_lines(lit.response, per_channel)
        check_materials(lit.response, lines, [layer.material for layer in (*lit.gap, *lit.window)])
    except InputError as error:
        raise InputError(
            "psf.as_captured.illuminant", error.reason if error.path == "camera.illuminant" else str(error)
        ) from error
    return lit, lines
