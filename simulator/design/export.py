"""A mask as the files that lithography takes: a 16 bit height map, or an image per height step (solid bodies: solid.py)."""

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
