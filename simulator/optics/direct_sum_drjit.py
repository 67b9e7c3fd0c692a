"""The direct sum as one Dr.Jit loop: a lane per point and row of cells, a step per column."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.optics.direct_sum import Light, cell_wave

_LANES = 2**20  # at a time: their state is a few tens of MB


def kernel(
    dr: Any,
    *,
    points_m: NDArray[np.float64],
    plane: bool,
    height_m: NDArray[np.floating],
    amplitude: NDArray[np.floating],
    slope_y: NDArray[np.floating],
    slope_x: NDArray[np.floating],
    repeat: int,
    **light: float,
) -> NDArray[np.complex128]:
    """Return the wave at the points, ``(N,)``; arguments as in ``direct_sum.Cells`` and ``direct_sum.Light``."""
    from drjit.llvm import Float32, Float64, UInt32

    numbers = Light(**{name: dr.opaque(Float64, value) for name, value in light.items()})
    samples_high, samples_wide = height_m.shape
    rows, columns = samples_high * repeat, samples_wide * repeat
    # Transposed, so that neighbouring lanes, which are rows, read neighbouring memory.
    stored = [
        (Float32 if part.dtype == np.float32 else Float64)(np.ascontiguousarray(part.T).ravel())
        for part in (height_m, amplitude, slope_y, slope_x)
    ]
    several, high = dr.opaque(UInt32, repeat), dr.opaque(UInt32, samples_high)
    count = dr.opaque(UInt32, columns)
    middle_x, middle_y = (dr.opaque(Float64, (n - 1) / 2) for n in (columns, rows))
    values = np.empty(len(points_m), np.complex128)
    batch = max(1, _LANES // rows)
    for start in range(0, len(points_m), batch):
        some = points_m[start : start + batch]
        lane = dr.arange(UInt32, len(some) * rows)
        row = lane % rows
        px, py = (dr.gather(Float64, Float64(np.ascontiguousarray(some[:, axis])), lane // rows) for axis in (0, 1))
        y = (Float64(row) - middle_y) * numbers.cell_m
        first = row // several

        def step(column: Any, real: Any, imaginary: Any, px=px, py=py, y=y, first=first) -> tuple[Any, Any, Any]:
            at = (column // several) * high + first
            sample = tuple(
                Float64(dr.gather(type(part), part, at if dr.width(part) > 1 else UInt32(0))) for part in stored
            )
            x = (Float64(column) - middle_x) * numbers.cell_m
            more_real, more_imaginary = cell_wave(dr, numbers, plane, x, y, sample, px, py)  # pyright: ignore[reportArgumentType]
            return column + 1, real + more_real, imaginary + more_imaginary

        state = (UInt32(0), dr.zeros(Float64, dr.width(lane)), dr.zeros(Float64, dr.width(lane)))
        _, real, imaginary = dr.while_loop(state, lambda column, *_: column < count, step)
        dr.eval(real, imaginary)
        parts = [np.array(part).reshape(len(some), rows).sum(1) for part in (real, imaginary)]
        values[start : start + batch] = parts[0] + 1j * parts[1]
    return values
