"""A mask as the files that fabrication takes: a 16 bit height map, an image per height step, or a watertight mesh."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.design.fabrication import quantise
from simulator.errors import InputError
from simulator.io.files import committed_folder, write_atomic
from simulator.optics.mask import Mask

LAYERS_FILE, APERTURE_FILE = "layers.json", "aperture.png"
MAX_LAYERS = 255
_LARGEST_CODE = 2**16 - 1
_SAME_HEIGHT_M = 1e-12  # heights this close are one step: single precision of a micrometre is 1e-13 m
_FRAME = "row 0 at the top, as seen from behind the sensor"


# ---- a height map as TIFF


def height_tiff(mask: Mask) -> bytes:
    """Return a TIFF of one page, 16 bit grey: 0 is the lowest height of the mask and 65535 the highest.

    The description is JSON: ``metres_per_dn``, ``pitch_m``, material, profile; the resolution tags hold the pitch too.
    Rounding is within half a code, 8 pm of a relief of 1 um. The design ``height_map`` reads the file.

    Raises:
        InputError: for a mask without height.
    """
    import tifffile

    height = _raised(mask)
    per_code = float(height.max()) / _LARGEST_CODE
    described = _described(mask) | {"metres_per_dn": per_code}
    pixels_per_cm = 1e-2 / mask.pitch_m
    file = io.BytesIO()
    tifffile.imwrite(
        file,
        np.rint(height / per_code).astype(np.uint16),
        photometric="minisblack",
        resolution=(pixels_per_cm, pixels_per_cm),
        resolutionunit="CENTIMETER",
        description=json.dumps(described),
        metadata=None,
        software="flatlight",
    )
    return file.getvalue()


def _relief(mask: Mask) -> NDArray[np.float64]:
    height = np.asarray(to_numpy(mask.height_m), np.float64)
    return height - height.min()


def _raised(mask: Mask) -> NDArray[np.float64]:
    """Return the heights above the lowest one; a flat mask is refused."""
    height = _relief(mask)
    if not height.any():
        raise InputError("height_m", f"mask {mask.name!r} is flat: it has no relief; write its layers instead")
    return height


def _described(mask: Mask) -> dict[str, Any]:
    return {
        "mask": mask.name,
        "pitch_m": mask.pitch_m,
        "profile": mask.profile,
        "material": mask.material.name,
        "material_source": mask.material.source,
        "frame": _FRAME,
        "sha256": mask.digest(),
    }


# ---- layers


@dataclass(frozen=True)
class MaskLayers:
    """The black-and-white layers of a mask.

    Attributes:
        mask: whose they are.
        height_m: ``(H, W)`` heights that the layers add up to, metres from the lowest.
        tops_m: where each layer ends, metres from the lowest height, ascending; a layer begins where the one below ends.
    """

    mask: Mask
    height_m: NDArray[np.float64]
    tops_m: tuple[float, ...]

    @property
    def thicknesses_m(self) -> tuple[float, ...]:
        """How thick each layer is, metres, lowest first."""
        return tuple(float(thickness) for thickness in np.diff((0.0, *self.tops_m)))

    def images(self) -> Iterator[NDArray[np.bool_]]:
        """Yield each layer ``(H, W)``, lowest first: True where there is material."""
        for top in self.tops_m:
            yield self.height_m > top - _SAME_HEIGHT_M

    def aperture(self) -> NDArray[np.bool_] | None:
        """Return where light passes, ``(H, W)``: amplitude of a half or more; None when the mask is open everywhere."""
        amplitude = to_numpy(self.mask.amplitude)
        return None if np.all(amplitude == 1) else amplitude >= 0.5


def binary_layers(mask: Mask, step_m: float = 0.0) -> MaskLayers:
    """Return the layers that a mask is built of, or etched in, one per height step.

    Args:
        mask: a mask whose heights are steps.
        step_m: makes steps of any heights first, rounded down; 0 takes the heights as they are.

    Raises:
        InputError: for more than 255 steps, or a mask that is clear glass everywhere.
    """
    height = np.asarray(quantise(_relief(mask), step_m), np.float64)
    grid = np.unique(np.rint(height / _SAME_HEIGHT_M))
    if len(grid) - 1 > MAX_LAYERS:
        raise InputError(
            "step_um",
            f"got {step_m * 1e6:g}, which leaves mask {mask.name!r} {len(grid)} heights; at most {MAX_LAYERS} layers "
            f"are written: give a step of at least {height.max() * 1e6 / MAX_LAYERS:.2g} um",
        )
    layers = MaskLayers(mask, height, tuple(float(level) * _SAME_HEIGHT_M for level in grid[1:]))
    if not layers.tops_m and layers.aperture() is None:
        raise InputError("mask", f"{mask.name!r} is flat and open everywhere: there is nothing to fabricate")
    return layers


def write_layers(folder: Path, layers: MaskLayers) -> list[str]:
    """Write ``layer_001.png`` (lowest) and on, ``aperture.png`` for a mask with opaque parts, and ``layers.json``.

    The images have one bit per pixel, white where there is material (or where light passes), and the pitch as their
    resolution. The folder appears whole or not at all, and replaces one of that name.

    Returns:
        The names of the images.

    Raises:
        StorageError: the place cannot be written to.
    """
    with committed_folder(folder) as temporary:
        entries = []
        for number, (image, top_m, thickness_m) in enumerate(
            zip(layers.images(), layers.tops_m, layers.thicknesses_m, strict=True), start=1
        ):
            name = f"layer_{number:03}.png"
            write_atomic(temporary / name, _png(image, layers.mask.pitch_m))
            entries.append({"file": name, "top_m": top_m, "thickness_m": thickness_m})
        aperture = layers.aperture()
        if aperture is not None:
            write_atomic(temporary / APERTURE_FILE, _png(aperture, layers.mask.pitch_m))
        content = _described(layers.mask) | {"layers": entries, "aperture": None if aperture is None else APERTURE_FILE}
        write_atomic(temporary / LAYERS_FILE, json.dumps(content, indent=2).encode() + b"\n")
    return [entry["file"] for entry in entries] + ([] if aperture is None else [APERTURE_FILE])


def _png(image: NDArray[np.bool_], pitch_m: float) -> bytes:
    from PIL import Image

    file = io.BytesIO()
    dots_per_inch = 0.0254 / pitch_m
    Image.fromarray(image).save(file, format="PNG", dpi=(dots_per_inch, dots_per_inch))
    return file.getvalue()


# ---- a solid body

UNIT_M = 1e-3
"""One unit of an STL file: the format has none, and everyone takes millimetres."""
MAX_TRIANGLES = 10_000_000
"""Largest body that is made: 500 MB of STL, about what mesh programs still open."""
MAX_SIDE = 2**14
"""Most mask pixels per side: beyond it single precision no longer tells the walls of a pixel apart."""
# Walls lean by this share of a pixel to each side. Upright ones would make two pixels that touch at a corner share an edge
# four times, which is not a solid; leaning ones keep every such mesh a single-valued, closed surface of the same volume.
LEAN = 1 / 512


def relief_solid(mask: Mask, base_m: float, tolerance_m: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the solid body of a mask's height map on a plate.

    A staircase becomes flat blocks with walls that are upright but for 1/256 of a pixel; a smooth mask is joined linearly
    between its samples and goes on level for the outer half sample. The lowest height lies at z = 0, the plate below it.
    With a tolerance, a smooth mask keeps every n-th sample only, n as large as its heights allow.

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
    height = _raised(mask)
    rows, columns = (_lines(n, mask) for n in mask.shape)
    z = np.repeat(np.repeat(height, 2, 0), 2, 1) if mask.profile == "staircase" else np.pad(height, 1, mode="edge")
    if mask.profile == "smooth":
        kept = _thinned(z, tolerance_m)
        z, rows, columns = z[np.ix_(*kept)], rows[kept[0]], columns[kept[1]]
    triangles = 2 * (len(rows) * len(columns) + len(rows) + len(columns))
    if triangles > MAX_TRIANGLES or max(mask.shape) > MAX_SIDE:
        side = int(np.sqrt(MAX_TRIANGLES / (8 if mask.profile == "staircase" else 2)))
        raise InputError(
            "mask",
            f"{mask.name!r} of {mask.shape[0]} x {mask.shape[1]} pixels needs {triangles} triangles; at most "
            f"{MAX_TRIANGLES} are written: crop it to {side * mask.pitch_m * 1e3:.2g} mm",
        )
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
    """Return the heights, at all samples, of the triangles that `_closed` makes of some rows and columns."""
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


def stl_bytes(mask: Mask, base_m: float, tolerance_m: float = 0.0) -> bytes:
    """Return a binary STL file, in millimetres, of :func:`relief_solid`."""
    import trimesh

    vertices, faces = relief_solid(mask, base_m, tolerance_m)
    data = trimesh.Trimesh(vertices / UNIT_M, faces, process=False).export(file_type="stl")
    assert isinstance(data, bytes)
    return data
