"""A height map as a solid body: the watertight triangle mesh that printers, slicers and meshing tools take.

x goes right, y up and z along the height, so that the body seen from above looks like the map. One STL unit is 1 mm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.optics.mask import Mask

UNIT_M = 1e-3
"""One unit of an STL file: the format has none, and everyone takes millimetres."""
MAX_TRIANGLES = 10_000_000
"""Largest body that is made: 500 MB of STL, about what mesh programs still open."""
MAX_SIDE = 2**14
"""Most mask pixels per side: beyond it single precision no longer tells the walls of a pixel apart."""
# Walls lean by this share of a pixel to each side. Upright ones would make two pixels that touch at a corner share an edge
# four times, which is no solid; leaning ones keep every such mesh a single-valued, closed surface of the same volume.
LEAN = 1 / 512


def relief_solid(mask: Mask, base_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the solid body of a mask's height map on a plate.

    A staircase becomes flat blocks with walls that are upright but for 1/256 of a pixel; a smooth mask is joined linearly
    between its samples and goes on level for the outer half sample. The lowest height lies at z = 0, the plate below it.

    Args:
        mask: its heights; amplitudes have no body.
        base_m: thickness of the plate, metres.

    Returns:
        Vertices ``(N, 3)`` in metres, centred on the mask, and triangles ``(M, 3)``, counter-clockwise seen from outside.

    Raises:
        InputError: for a plate without thickness, a mask without height, or one too large for a mesh.
    """
    if not 0 < base_m < np.inf:
        msg = f"base_m: got {base_m:g}, expected a finite thickness above zero: a body needs a plate under its lowest height"
        raise InputError(msg)
    height = np.asarray(to_numpy(mask.height_m), np.float64)
    height = height - height.min()
    if not height.any():
        msg = f"height_m: mask {mask.name!r} is flat, so it has no relief; write its opening as layers instead"
        raise InputError(msg)
    rows, columns = (_lines(n, mask) for n in mask.shape)
    triangles = 2 * (len(rows) * len(columns) + len(rows) + len(columns))
    if triangles > MAX_TRIANGLES or max(mask.shape) > MAX_SIDE:
        side = int(np.sqrt(MAX_TRIANGLES / (8 if mask.profile == "staircase" else 2)))
        msg = (
            f"mask {mask.name!r} of {mask.shape[0]} x {mask.shape[1]} pixels needs {triangles} triangles; at most "
            f"{MAX_TRIANGLES} are written: crop it to {side * mask.pitch_m * 1e3:.2g} mm"
        )
        raise InputError(msg)
    z = np.repeat(np.repeat(height, 2, 0), 2, 1) if mask.profile == "staircase" else np.pad(height, 1, mode="edge")
    return _closed(columns, -rows, z, base_m)


def _lines(samples: int, mask: Mask) -> NDArray[np.float64]:
    """Return where the vertices lie along an axis, metres: both ends of every pixel, or every sample and the rim."""
    if mask.profile == "smooth":
        lines = np.arange(samples + 2) - (samples + 1) / 2
        lines[[0, -1]] = -samples / 2, samples / 2
    else:
        lines = np.repeat(np.arange(samples + 1) - samples / 2, 2)[1:-1]
        lines[1:-1:2] -= LEAN
        lines[2:-1:2] += LEAN
    return np.asarray(lines * mask.pitch_m, np.float64)


def _closed(
    x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64], base_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the surface z ``(rows, columns)`` over x and falling y, with its sides and its bottom at -base_m."""
    rows, columns = z.shape
    surface = np.stack([*np.broadcast_arrays(x[None, :], y[:, None]), z], -1).reshape(-1, 3)
    number = np.arange(rows * columns).reshape(rows, columns)
    upper_left, upper_right = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    lower_left, lower_right = number[1:, :-1].ravel(), number[1:, 1:].ravel()
    # Round the rim, counter-clockwise seen from above, which begins at the upper left and goes down.
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    foot = len(surface) + np.arange(len(rim))
    middle = np.full_like(foot, len(surface) + len(rim))
    next_rim, next_foot = np.roll(rim, -1), np.roll(foot, -1)
    below = surface[rim] * [1, 1, 0] - [0, 0, base_m]
    faces = [
        (lower_left, lower_right, upper_right),
        (lower_left, upper_right, upper_left),
        (foot, next_foot, next_rim),
        (foot, next_rim, rim),
        (middle, next_foot, foot),
    ]
    vertices = np.concatenate([surface, below, [[0.0, 0.0, -base_m]]])
    return vertices, np.concatenate([np.stack(corners, 1) for corners in faces])


def stl_bytes(mask: Mask, base_m: float) -> bytes:
    """Return a binary STL file, in millimetres, of :func:`relief_solid`.

    Raises:
        InputError: as :func:`relief_solid`.
    """
    import trimesh

    vertices, faces = relief_solid(mask, base_m)
    data = trimesh.Trimesh(vertices / UNIT_M, faces, process=False).export(file_type="stl")
    assert isinstance(data, bytes)
    return data
