"""Your own height map, from an image (PNG, TIFF, EXR), an array (npy) or a body (STL)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from simulator.design.fabrication import quantise
from simulator.design.height_maps import read_height_map, read_stl_height
from simulator.design.solid import UNIT_M
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def height_map(
    *,
    file: Path,
    pixel_um: Annotated[float, Field(ge=0.05, le=100)],
    max_height_um: Annotated[float, Field(gt=0, le=1e4)] | None = None,
    unit_um: Annotated[float, Field(gt=0, le=1e7)] | None = None,
    material: str = "fused-silica",
    profile: Literal["staircase", "smooth"] = "staircase",
    step_um: Annotated[float, Field(ge=0, le=10)] = 0.0,
) -> Mask:
    """Return the mask of a height map, seen from behind the sensor: row 0 is the top, heights count from the lowest.

    Args:
        file: the map; a relative path starts at the YAML file's folder.
        pixel_um: mask pixel: the map's sample, or the grid on which a body's surface is sampled.
        max_height_um: height of the largest code of a file of integers (255 or 65535).
        unit_um: micrometres per unit of a file of floats or an STL; left out, floats are metres and STL millimetres.
        material: what the height is made of.
        profile: staircase when each pixel is flat, smooth when heights are samples of a smooth surface.
        step_um: height step of the fabrication (heights are rounded down); 0 leaves them as they are.
    """
    unit_m = None if unit_um is None else unit_um * 1e-6
    max_height_m = None if max_height_um is None else max_height_um * 1e-6
    if file.suffix.lower() == ".stl":
        if max_height_um is not None:
            raise InputError(
                "max_height_um", f"got {max_height_um:g}, but {file} is a body with heights of its own; use unit_um"
            )
        height_m = read_stl_height(file, pixel_um * 1e-6, UNIT_M if unit_m is None else unit_m)
    else:
        height_m = read_height_map(file, unit_m, max_height_m)
    height_m = quantise(height_m - height_m.min(), step_um * 1e-6)
    return Mask(
        height_m, np.ones_like(height_m), pixel_um * 1e-6, load_material(material), profile=profile, name="height_map"
    )
