"""The geometric trace as one Dr.Jit kernel: a lane per ray, its power scattered into the pixel that it hits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.optics.ray_trace import Rays, place, trace

_LANES = 2**22  # rays at a time


def kernel(
    dr: Any,
    *,
    height_m: NDArray[np.floating],
    amplitude: NDArray[np.floating],
    rays_per_sample: int,
    size: int,
    **numbers: float,
) -> NDArray[np.float64]:
    """Return the power per pixel ``(size, size)``; arguments as in ``ray_trace.trace_numpy`` and ``ray_trace.Rays``."""
    from drjit.llvm import Float32, Float64, Int32, UInt32

    rays = Rays(**{name: dr.opaque(Float64, value) for name, value in numbers.items()})
    height, width = height_m.shape
    stored = [
        (Float32 if part.dtype == np.float32 else Float64)(np.ascontiguousarray(part).ravel())
        for part in (height_m, amplitude)
    ]

    def take(part: int, row: Any, column: Any) -> Any:
        at = dr.clip(Int32(row), 0, height - 1) * width + dr.clip(Int32(column), 0, width - 1)
        return Float64(dr.gather(type(stored[part]), stored[part], UInt32(at)))

    across, total = width * rays_per_sample, height * width * rays_per_sample**2
    power = dr.zeros(Float64, size * size)
    for start in range(0, total, _LANES):
        index = Float64(dr.arange(UInt32, min(_LANES, total - start))) + dr.opaque(Float64, start)
        row, column = place(dr, index, across, rays_per_sample)
        x, y, intensity = trace(dr, rays, math.isinf(numbers["depth_m"]), (height, width), row, column, take)
        pixel_x, pixel_y = (dr.floor(part / rays.pixel_m + 0.5) + size // 2 for part in (x, y))
        inside = (pixel_x >= 0) & (pixel_x < size) & (pixel_y >= 0) & (pixel_y < size)
        at = dr.select(inside, pixel_y * size + pixel_x, 0.0)
        dr.scatter_add(power, intensity, UInt32(at), inside)
        dr.eval(power)
    return np.array(power).reshape(size, size) * (numbers["pitch_m"] / rays_per_sample) ** 2
