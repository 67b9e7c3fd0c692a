"""A mask's height map as a watertight solid body on a plate, and as the STL file that printers take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.design.staircase import Surface, corner_count, staircase
from simulator.errors import InputError
from simulator.optics.mask import Mask

UNIT_M = 1e-3
"""One unit of an STL file: the format has none, and everyone takes millimetres."""
MAX_TRIANGLES = 10_000_000
"""Largest body that is made: 500 MB of STL, about what mesh programs still open."""
MAX_SIDE = 2**14
"""Most mask pixels per side: beyond it single precision no longer tells the walls of a pixel apart."""


def stl_bytes(mask: Mask, base_m: float, tolerance_m: float = 0.0) -> bytes:
    """Return a binary STL file, in millimetres, of :func:`relief_solid`."""
    import trimesh

    vertices, faces = relief_solid(mask, base_m, tolerance_m)
    data = trimesh.Trimesh(vertices / UNIT_M, faces, process=False).export(file_type="stl")
    assert isinstance(data, bytes)
    return data


def relief_solid(mask: Mask, base_m: float, tolerance_m: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the solid body of a mask's height map on a plate.

    A staircase becomes level blocks, exact but for walls that lean by up to 1/256 of a pixel; equal neighbours are one
    block. A smooth mask is joined linearly between its samples and goes on level for the outer half sample. The lowest
    height lies at z = 0, the plate below it. With a tolerance, a smooth mask keeps every n-th sample only, n as large as
    its heights allow.

    Args:
        mask: its heights; amplitudes have no body.
        base_m: thickness of the plate, metres.
        tolerance_m: greatest height that the body of a smooth mask may be off at any of its samples, metres.

    Returns:
        Vertices ``(N, 3)`` in metres, centred on the mask, and triangles ``(M, 3)``, counter-clockwise seen from outside.

    Raises:
        InputError: for a plate without thickness, a mask without height, or one too large for a mesh.
    """
    if not 0 < base_m < np.inf:
        raise InputError("base_m", f"got {base_m:g}, expected positive metres: the relief needs a plate below it")
    height = np.asarray(to_numpy(mask.height_m), np.float64)
    height = height - height.min()
    if not height.any():
        raise InputError("height_m", f"mask {mask.name!r} is flat: it has no relief; write its layers instead")
    if mask.profile == "staircase":
        _check_size(mask, 2 * corner_count(height))
        surface = staircase(height)
    else:
        kept = _thinned(np.pad(height, 1, mode="edge"), tolerance_m)
        _check_size(mask, 2 * len(kept[0]) * len(kept[1]))
        surface = _sampled(height, *kept)
    return _on_plate(surface.points * [mask.pitch_m, mask.pitch_m, 1], surface, base_m)


def _check_size(mask: Mask, triangles: int) -> None:
    rows, columns = mask.shape
    if triangles > MAX_TRIANGLES or max(mask.shape) > MAX_SIDE:
        side = min(max(mask.shape) * np.sqrt(MAX_TRIANGLES / triangles), MAX_SIDE)
        raise InputError(
            "mask",
            f"{mask.name!r} of {rows} x {columns} pixels needs {triangles} triangles; at most {MAX_TRIANGLES} are written, "
            f"and {MAX_SIDE} pixels per side: crop it to {side * mask.pitch_m * 1e3:.2g} mm",
        )


def _sampled(height: NDArray[np.float64], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Surface:
    """Return the surface through some rows and columns of a padded height map, in pixels, centred."""
    x, y = (
        np.clip(kept - (samples + 1) / 2, -samples / 2, samples / 2)
        for kept, samples in ((columns, height.shape[1]), (rows, height.shape[0]))
    )
    z = np.pad(height, 1, mode="edge")[np.ix_(rows, columns)]
    points = np.stack([*np.broadcast_arrays(x[None, :], -y[:, None]), z], -1).reshape(-1, 3)
    number = np.arange(z.size).reshape(z.shape)
    upper_left, upper_right = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    lower_left, lower_right = number[1:, :-1].ravel(), number[1:, 1:].ravel()
    faces = [(lower_left, lower_right, upper_right), (lower_left, upper_right, upper_left)]
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    return Surface(points, np.concatenate([np.stack(corners, 1) for corners in faces]), rim)


def _thinned(z: NDArray[np.float64], tolerance_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows and columns of a padded height map that a mesh needs to be within a tolerance of all of it."""

    def kept(step: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        rows, columns = (np.unique([0, *range(1, n - 1, step), n - 2, n - 1]) for n in z.shape)
        return rows, columns

    step = 1
    while step < min(z.shape) and np.abs(_meshed(z, *kept(step + 1)) - z).max() <= tolerance_m:
        step += 1
    return kept(step)


def _meshed(z: NDArray[np.float64], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the heights, at all samples, of the triangles that `_sampled` makes of some rows and columns."""
    (top, down), (left, right) = (
        (cell, (np.arange(n) - kept[cell]) / np.diff(kept)[cell])
        for n, kept in zip(z.shape, (rows, columns), strict=True)
        for cell in [np.clip(np.searchsorted(kept, np.arange(n), "right") - 1, 0, len(kept) - 2)]
    )
    coarse, up, right = z[np.ix_(rows, columns)], 1 - down[:, None], right[None, :]
    upper_left, upper_right = coarse[np.ix_(top, left)], coarse[np.ix_(top, left + 1)]
    lower_left, lower_right = coarse[np.ix_(top + 1, left)], coarse[np.ix_(top + 1, left + 1)]
    below = lower_left + (lower_right - lower_left) * right + (upper_right - lower_right) * up
    above = lower_left + (upper_left - lower_left) * up + (upper_right - upper_left) * right
    return np.where(right >= up, below, above)


def _on_plate(
    points: NDArray[np.float64], surface: Surface, base_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the body under a surface whose points are in metres, with its sides and its bottom at -base_m."""
    foot = len(points) + np.arange(len(surface.rim))
    middle = np.full_like(foot, len(points) + len(foot))
    next_rim, next_foot = np.roll(surface.rim, -1), np.roll(foot, -1)
    below = points[surface.rim] * [1, 1, 0] - [0, 0, base_m]
    sides = [(foot, next_foot, next_rim), (foot, next_rim, surface.rim), (middle, next_foot, foot)]
    faces = [surface.faces, *(np.stack(corners, 1) for corners in sides)]
    return np.concatenate([points, below, [[0.0, 0.0, -base_m]]]), np.concatenate(faces)
