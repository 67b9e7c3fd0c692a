"""What shift invariance costs: the PSF on the axis, used off it, against the exact PSF of the oblique source."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from simulator.optics.error_budget.sampling import judged_crop
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, depth_images, stack_size
from simulator.types import CameraGeometry

ANGLES_DEGREES = (0.0, 5.0, 10.0, 20.0, 33.0)
CROP_M = 2e-3  # PHYSICS: errors against the field angle are quoted for a crop, since wide masks wash them out


def field_angle_error(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelength_m: float,
    corner: tuple[float, float] | None = None,
    *,
    crop_m: float = CROP_M,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure the relative L2 difference of the model's PSF on the axis from the exact one off it, on pixels.

    Both are placed as a convolution places them; behind glass, where rays land elsewhere, that displacement is part of it.

    The farthest depth is judged, on a crop of the mask, up to the field's ``corner`` (tangents x, y), which comes last.

    Returns:
        ``error`` (the largest) and ``table``, one row per angle with its direction; JSON-serialisable.
    """
    crop = judged_crop(mask, crop_m)
    config = replace(psf_config, depths_m=psf_config.depths_m[-1:])
    exact = replace(config, model="exact")
    steepest = math.inf if corner is None else math.hypot(*corner)
    directions = [(math.tan(math.radians(angle)), 0.0) for angle in ANGLES_DEGREES]
    directions = [direction for direction in directions if direction[0] < steepest]
    if corner is not None:
        directions.append(corner)
    size = max(stack_size(crop, camera, part) for part in (config, exact))
    on_axis = next(iter(depth_images(crop, camera, config, wavelength_m, size)))
    table = []
    for direction in directions:
        reference = next(iter(depth_images(crop, camera, exact, wavelength_m, size, direction=direction)))
        angle = math.degrees(math.atan(math.hypot(*direction)))
        error = float(np.linalg.norm(on_axis - reference) / np.linalg.norm(reference))
        table.append({"degrees": angle, "direction": list(direction), "error": error})
        if progress is not None:
            progress(len(table), len(directions))
    return {
        "error": max(row["error"] for row in table),
        "wavelength_m": wavelength_m,
        "depth_m": config.depths_m[0],
        "crop_m": max(crop.shape) * crop.pitch_m,
        "table": table,
    }
