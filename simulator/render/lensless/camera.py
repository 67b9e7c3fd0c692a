"""What a bare sensor behind an amplitude mask measures of a scene, by tracing rays: geometric optics, no diffraction.

The irradiance of a sensor point s is an integral over the mask's points a, with transmittance T (amplitude squared), the
radiance L that comes through a towards s, and the angle theta of that ray to the axis:

    E(s) = int T(a) L(a, s - a) cos^2(theta) / |s - a|^2 da = int T(a) L(a, s - a) cos^4(theta) / d^2 da,

one cosine for the sensor, one for the mask, and |s - a| = d / cos(theta). With a drawn in proportion to T, each ray's
weight is (open area) cos^4(theta) / d^2; a pixel is the mean over its area.

The forward model (`simulator.camera.forward`, with ``mask_irradiance`` and no shutter) has the same units. It differs in
taking what the mask's centre sees for what every point of the mask sees:

- on a surface parallel to the mask it has cos^4 of the ray from the surface point X to the mask's centre, tan(theta) =
  X / z, and here it is that of the ray itself, tan(theta) = (X - a) / z: relatively 4 a X / (z^2 + X^2) to first order in a;
- a slanted surface n . (X, Y, z) = 1 sends 1 - n . a times the light towards a that it sends to the centre, because it is
  seen under another slant; over the whole sensor this adds up to n . (centroid of the openings);
- what hides what: at the edges of near things other points of the mask see more or less of what is behind;
  ``benchmarks/lensless_camera.py`` measures it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import LLVM_VARIANT, activate
from simulator.render.lensless.sensor import MaskedSensor, mitsuba_sensor
from simulator.render.library import mitsuba
from simulator.render.mitsuba_scene import UNITS_PER_M, load_scene
from simulator.render.renderer import DEFAULT_MAX_DEPTH
from simulator.render.scene import Scene
from simulator.types import View


def lensless_render(
    scene: Scene,
    view: View,
    mask_amplitude: NDArray[np.floating],
    mask_pitch_m: float,
    sensor_shape: tuple[int, int],
    *,
    samples_per_pixel: int,
    seeds: Sequence[int],
    max_depth: int = DEFAULT_MAX_DEPTH,
) -> NDArray[np.float32]:
    """Return the sensor's irradiance, once for each seed: their scatter is the Monte-Carlo noise.

    A million rays take 0.03 CPU-s into an empty scene, 0.15 CPU-s onto a lit surface.

    Args:
        scene: what is seen, also outside of the view's picture.
        view: mask-sensor distance and pixel pitch; its shape and depths have no influence.
        mask_amplitude: ``(rows, columns)`` amplitude transmission 0..1 of the mask's cells, in world axes (x right, y down,
            seen from behind the sensor); outside of them the mask is opaque.
        mask_pitch_m: pitch of the cells, metres.
        sensor_shape: rows and columns of the sensor.
        samples_per_pixel: rays per pixel and seed, at least 1; rounded up like those of `Renderer.clip`.
        seeds: of independent pictures, each 0 <= seed < 2**32.
        max_depth: longest light path, in segments.

    Returns:
        ``(seeds, H, W, 3)`` float32, linear RGB, in the units and the orientation of ``ForwardModel.forward_clip`` without
        a shutter.

    Raises:
        InputError: for amplitudes outside of 0..1 or all zero, sizes that are not positive, seeds out of range; when LLVM
            is missing, or this process renders with the scalar variant.
    """
    amplitude = np.asarray(mask_amplitude, np.float64)
    _check(amplitude, mask_pitch_m, sensor_shape, samples_per_pixel, seeds)
    _activate_llvm()
    mi = mitsuba()

    loaded = load_scene(scene, view, max_depth)
    camera = MaskedSensor(
        transmittance=amplitude**2,
        cell=mask_pitch_m * UNITS_PER_M,
        distance=view.distance_m * UNITS_PER_M,
        pixel=view.pixel_pitch_m * UNITS_PER_M,
        shape=sensor_shape,
    )
    sensor = mitsuba_sensor(camera)
    pictures = [np.array(mi.render(loaded, sensor=sensor, spp=samples_per_pixel, seed=seed)) for seed in seeds]
    return np.stack(pictures).astype(np.float32)


def _activate_llvm() -> None:
    """Make this process render with LLVM, in which alone a sensor may be written in Python."""
    running = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    if running not in (None, LLVM_VARIANT):
        msg = (
            f"the ray-traced lensless camera needs {LLVM_VARIANT}, and this process renders with {running}; one process has "
            f"one variant: call it in a process that has not rendered, or call activate({LLVM_VARIANT!r}) first"
        )
        raise InputError(msg)
    activate(LLVM_VARIANT)


def _check(
    amplitude: NDArray[np.float64],
    mask_pitch_m: float,
    sensor_shape: tuple[int, int],
    samples_per_pixel: int,
    seeds: Sequence[int],
) -> None:
    if amplitude.ndim != 2 or not np.all((amplitude >= 0) & (amplitude <= 1)) or not np.any(amplitude):
        values = f"{amplitude.min():g} to {amplitude.max():g}" if amplitude.size else "nothing"
        msg = (
            f"mask_amplitude: got an array {amplitude.shape} of {values}, expected (rows, columns) of 0..1 with at least "
            "one opening; divide by its maximum first"
        )
        raise InputError(msg)
    if not 1e-8 <= mask_pitch_m <= 1e-2:
        msg = f"mask_pitch_m: got {mask_pitch_m!r}, expected metres from 1e-8 to 1e-2 (30 um is 30e-6)"
        raise InputError(msg)
    if min(sensor_shape) < 1 or samples_per_pixel < 1:
        msg = f"got sensor_shape {sensor_shape} and samples_per_pixel {samples_per_pixel}, expected numbers from 1"
        raise InputError(msg)
    if not len(seeds) or not all(0 <= seed < 2**32 for seed in seeds):
        msg = f"seeds: got {list(seeds)}, expected at least one, each 0 <= seed < 2**32"
        raise InputError(msg)
