"""Radiance as a picture: sRGB codes 0..1 of radiance / white, as networks, metrics and perceptual losses see it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from simulator.dataset.reader import Dataset
from simulator.errors import InputError

_PERCENTILE = 99.0
_SAMPLES = 64


def encode(radiance: Tensor, white: float) -> Tensor:
    """Return sRGB codes of linear radiance, any shape: 0 for nothing, 1 for ``white``; values outside are clipped.

    Source: IEC 61966-2-1:1999 with amendment 1.
    """
    linear = (radiance / white).clamp(0, 1)
    return torch.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def decode(picture: Tensor, white: float) -> Tensor:
    """Return the linear radiance of sRGB codes, the inverse of `encode`; codes are clipped to 0..1."""
    codes = picture.clamp(0, 1)
    linear = torch.where(codes <= 0.04045, codes / 12.92, ((codes.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)
    return linear * white


def measure_white(dataset: Dataset) -> float:
    """Return the radiance that pictures of a data set show as 1: the 99th percentile of its first 64 samples.

    One number for the whole data set; brighter light is clipped in pictures, as a camera's is.

    Raises:
        InputError: an empty split, or one whose scenes are black.
    """
    if len(dataset) == 0:
        msg = f"split {dataset.split!r} of {dataset.root} is empty; generate some of its samples first"
        raise InputError(msg)
    values = [dataset.stored(position).frame(0).rgb for position in range(min(len(dataset), _SAMPLES))]
    white = float(np.percentile(np.stack(values), _PERCENTILE))
    if white <= 0:
        msg = f"split {dataset.split!r} of {dataset.root}: its scenes are black, so pictures of them have no scale"
        raise InputError(msg)
    return white
