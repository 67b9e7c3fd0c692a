"""The ray-traced lensless camera: sensor pixel -> mask opening -> scene, an independent check of the forward model.

It shares nothing with convolution: no depth planes, no shift invariance, no pinhole image. What it measures differs from
the layered model by that model's own errors, occlusion first of all, and by Monte-Carlo noise, which is known.

Geometric optics, no diffraction. The irradiance of a sensor point s behind an amplitude mask is an integral over the mask's
points a, with transmittance T (amplitude squared), the radiance L that comes through a towards s, and the angle theta of
that ray to the axis:

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

import functools
import sys
from collections.abc import Sequence
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import LLVM_VARIANT, activate, drjit, mitsuba
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
        scene: what is seen, also outside of the view's image.
        view: mask-sensor distance and pixel pitch; its shape and depths have no influence.
        mask_amplitude: ``(rows, columns)`` amplitude transmission 0..1 of the mask's cells, in world axes (x right, y down,
            seen from behind the sensor); outside of them the mask is opaque.
        mask_pitch_m: pitch of the cells, metres.
        sensor_shape: rows and columns of the sensor.
        samples_per_pixel: rays per pixel and seed, at least 1; rounded up like those of `Renderer.clip`.
        seeds: of independent images, each 0 <= seed < 2**32.
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
    running = sys.modules["mitsuba"].variant() if "mitsuba" in sys.modules else None
    if running not in (None, LLVM_VARIANT):  # only with LLVM may a sensor be written in Python
        raise InputError(
            "variant",
            f"the ray-traced lensless camera needs {LLVM_VARIANT}, and this process renders with {running}; one process has "
            f"one variant: call it in a process that has not rendered, or call activate({LLVM_VARIANT!r}) first",
        )
    activate(LLVM_VARIANT)
    mi = mitsuba()
    loaded = load_scene(scene, view, max_depth)
    rows, columns = sensor_shape
    size = {"width": columns, "height": rows}
    box = {"rfilter": {"type": "box"}, "pixel_format": "rgb", "component_format": "float32"}
    properties = mi.Properties()
    properties["film"] = mi.load_dict({"type": "hdrfilm"} | size | box)
    properties["sampler"] = mi.load_dict({"type": "multijitter"})
    lengths = (UNITS_PER_M * metres for metres in (mask_pitch_m, view.distance_m, view.pixel_pitch_m))
    sensor = _sensor_class()(properties, amplitude**2, sensor_shape, *lengths)
    images = [np.array(mi.render(loaded, sensor=sensor, spp=samples_per_pixel, seed=seed)) for seed in seeds]
    return np.stack(images).astype(np.float32)


def _check(
    amplitude: NDArray[np.float64],
    mask_pitch_m: float,
    sensor_shape: tuple[int, int],
    samples_per_pixel: int,
    seeds: Sequence[int],
) -> None:
    if amplitude.ndim != 2 or not np.all((amplitude >= 0) & (amplitude <= 1)) or not np.any(amplitude):
        values = f"{amplitude.min():g} to {amplitude.max():g}" if amplitude.size else "nothing"
        raise InputError(
            "mask_amplitude",
            f"got an array {amplitude.shape} of {values}, expected (rows, columns) of 0..1 with at least "
            "one opening; divide by its maximum first",
        )
    if not 1e-8 <= mask_pitch_m <= 1e-2:
        raise InputError("mask_pitch_m", f"got {mask_pitch_m!r}, expected metres from 1e-8 to 1e-2 (30 um is 30e-6)")
    if min(sensor_shape) < 1:
        raise InputError("sensor_shape", f"got {sensor_shape}, expected at least 1 x 1")
    if samples_per_pixel < 1:
        raise InputError("samples_per_pixel", f"got {samples_per_pixel}, expected at least 1")
    if not len(seeds) or not all(0 <= seed < 2**32 for seed in seeds):
        raise InputError("seeds", f"got {list(seeds)}, expected at least one, each 0 <= seed < 2**32")


@functools.cache
def _sensor_class() -> Any:
    """Return the class of the sensor; ``mitsuba.Sensor`` is another class in each variant, and exists only in one."""
    dr, mi = drjit(), mitsuba()

    class LenslessSensor(mi.Sensor):
        """Rays from a point in a pixel through a point in an opening, which is drawn with the transmittance's weight.

        The mask's cells ``(rows, columns)`` lie in world axes (x right, y down); lengths are in Mitsuba's units.
        """

        def __init__(
            self,
            properties: Any,
            transmittance: Any,
            shape: tuple[int, int],
            cell: float,
            distance: float,
            pixel: float,
        ) -> None:
            super().__init__(properties)
            openings = transmittance > 0
            row, column = np.nonzero(openings)
            rows, columns = transmittance.shape
            self._left = mi.Float((column - 0.5 * columns) * cell)
            self._top = mi.Float((row - 0.5 * rows) * cell)
            weights = transmittance[openings]
            self._openings = mi.DiscreteDistribution(mi.Float(weights))
            self._open_area = mi.Float(float(weights.sum()) * cell**2)
            self._cell, self._distance = mi.Float(cell), mi.Float(distance)
            self._width, self._height = mi.Float(shape[1] * pixel), mi.Float(shape[0] * pixel)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            del sample1  # of the wavelength
            # The image is the physical sensor's, rotated by 180 degrees.
            x, y = (0.5 - sample2.x) * self._width, (0.5 - sample2.y) * self._height
            number, across = self._openings.sample_reuse(sample3.x, active)
            left, top = (dr.gather(mi.Float, part, number, active) for part in (self._left, self._top))
            opening = mi.Point3f(left + across * self._cell, top + sample3.y * self._cell, 0)
            along = opening - mi.Point3f(x, y, -self._distance)
            squared = dr.squared_norm(along)
            cosine_squared = self._distance * self._distance / squared
            weight = self._open_area * dr.square(cosine_squared / self._distance)
            ray = mi.Ray3f(opening, along * dr.rsqrt(squared), time, [])
            return ray, mi.Color3f(weight)

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def needs_aperture_sample(self) -> bool:
            return True

        def to_string(self) -> str:
            return "LenslessSensor[]"

    return LenslessSensor


Source = Literal["point", "pixel"]


def shadow_psfs(
    mask_amplitude: NDArray[np.floating],
    mask_pitch_m: float,
    distance_m: float,
    depths_m: Sequence[float] | NDArray[np.floating],
    pixel_pitch_m: float,
    *,
    source: Source = "point",
) -> NDArray[np.float64]:
    """Return the shadows of an amplitude mask, in the units and the frame of ``PsfStack.values``.

    A point on the axis at depth z magnifies the mask by m = 1 + d / z; a pixel of irradiance 1 / m^2 behind an opening
    receives the share of its area that the magnified opening covers.

    Args:
        mask_amplitude: ``(rows, columns)`` amplitude transmission of the mask's cells, in world axes; light passes as its
            square.
        mask_pitch_m: pitch of the cells, metres.
        distance_m: mask to sensor, metres.
        depths_m: z of the sources, metres; may be ``inf``.
        pixel_pitch_m: pitch of the sensor's pixels, metres.
        source: ``point``, as PSFs are made and measured; or ``pixel``, an even patch of the size of one scene pixel: with
            these, a scene that is even over each of its pixels is convolved without any error of sampling.

    Returns:
        ``(K, size, size)`` irradiance per irradiance at the mask, rotated by 180 degrees, with the origin on sample
        ``size // 2``; an odd size that holds the largest shadow.

    Raises:
        InputError: for another word than these.
    """
    if source not in get_args(Source):
        raise InputError("source", f"got {source!r}, expected one of {', '.join(get_args(Source))}")
    depths = np.asarray(depths_m, np.float64)
    magnifications = 1 + distance_m / depths
    half_width = 0.5 * max(mask_amplitude.shape) * mask_pitch_m * magnifications.max() / pixel_pitch_m
    reach = 1 + int(np.ceil(half_width))
    transmittance = np.asarray(mask_amplitude, np.float64) ** 2
    shadows = []
    for magnification in magnifications:
        pitch = mask_pitch_m * magnification / pixel_pitch_m
        rows, columns = (_shares(count, pitch, reach, source) for count in transmittance.shape)
        shadows.append(rows @ transmittance @ columns.T / magnification**2)
    return np.flip(np.stack(shadows), (-2, -1))


def _shares(cells: int, pitch: float, reach: int, source: Source) -> NDArray[np.float64]:
    """Return how much of each pixel -reach .. reach every cell covers, ``(pixels, cells)``; ``pitch`` in pixels."""
    edges = (np.arange(cells + 1) - cells / 2) * pitch
    offsets = edges - np.arange(-reach, reach + 1)[:, np.newaxis]
    if source == "point":
        covered = np.clip(offsets, -0.5, 0.5)
    else:  # the even patch of one pixel, seen by the even pixel: a triangle
        near = np.clip(offsets, -1, 1)
        covered = near - 0.5 * np.sign(near) * near**2
    return np.asarray(np.diff(covered, axis=1), np.float64)
