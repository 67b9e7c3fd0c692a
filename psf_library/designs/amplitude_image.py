"""Your own amplitude mask, from an image (PNG, TIFF, EXR) or an array (npy)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from simulator.design.height_maps import read_unit_map
from simulator.design.patterns import amplitude_mask
from simulator.optics.mask import Mask

FINE_UM = 2.0
"""A grid as fine as this keeps the sampling error of hard-edged features near 2 % on sensor pixels of 9.6 um and more."""


def amplitude_image(
    *,
    file: Path,
    feature_um: Annotated[float, Field(ge=0.1, le=500)],
    pixel_um: Annotated[float, Field(ge=0.05, le=20)] | None = None,
    values: Literal["transmittance", "amplitude"] = "transmittance",
    threshold: Annotated[float, Field(gt=0, lt=1)] | None = None,
) -> Mask:
    """Return the mask of an image, seen from behind the sensor: row 0 is the top, black is opaque, white is open.

    Args:
        file: the image; a relative path starts at the YAML file's folder.
        feature_um: side of the square that one pixel of the image becomes.
        pixel_um: sample of the mask's grid, of which a feature is a whole number; left out, at most 2 um.
        values: what the image holds: transmittance (the square of the amplitude) or the amplitude itself.
        threshold: makes the image binary: open from this value on; left out, greys stay.
    """
    image = read_unit_map(file)
    if threshold is not None:
        image = (image >= threshold).astype(np.float32)
    amplitude = np.sqrt(image) if values == "transmittance" else image
    sample_um = feature_um / math.ceil(feature_um / FINE_UM) if pixel_um is None else pixel_um
    return amplitude_mask(amplitude, feature_um * 1e-6, sample_um * 1e-6, "amplitude_image")
