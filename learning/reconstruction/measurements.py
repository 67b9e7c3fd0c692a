"""Reading a measurement to reconstruct from: ours, or a real camera's file, as shares of the sensor's full scale."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.reconstruction.pixels import binned, crop_window
from simulator.dataset.dataset_info import FILE
from simulator.dataset.sample import DESCRIPTION, MEASUREMENT, StoredSample
from simulator.errors import InputError
from simulator.io.measurements import read_measurement

RGB = ("R", "G", "B")
_MOST_OF_SHARES = 2.0  # noise that was not clipped goes beyond full scale, but not so far


@dataclass(frozen=True)
class Measurement:
    """What a camera stored.

    Attributes:
        values: ``(C, H, W)`` float32, DN / 2^bits, background removed, cropped and binned.
        path: the file, or the sample's folder.
        channels: one name per channel; ``("grey",)`` for one.
        dataset: the data set's folder, where it is a sample of one.
        record: what was done to the file's numbers and what was assumed, JSON-serialisable.
    """

    values: NDArray[np.float32]
    path: Path
    channels: tuple[str, ...]
    dataset: Path | None
    record: dict[str, Any]

    @property
    def sensor_shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[1], self.values.shape[2]


def load_measurement(
    path: Path | str,
    *,
    bits: int | None = None,
    background: str | float | None = None,
    crop: str | None = None,
    binning: int = 1,
) -> Measurement:
    """Read a measurement; what is done to it follows the order of the arguments.

    Args:
        path: a sample's folder or its ``measurement.exr``; or a TIFF, PNG, OpenEXR or ``.npy`` file of one linear picture,
            grey or RGB, ``(H, W)`` or ``(C, H, W)`` in ``.npy``.
        bits: the numbers are divided by 2^bits. None takes unsigned integers by their type (8, 16 or 32 bits) and floats as
            shares already.
        background: what the sensor shows without light, in the file's numbers: one number, or a picture's path.
        crop: ``ROWSxCOLUMNS`` about the centre, or ``ROWSxCOLUMNS+TOP+LEFT``, in the file's pixels.
        binning: pixels per side whose mean becomes one.

    Raises:
        InputError: a file that cannot be read or holds NaN, a clip, numbers above 2^bits, floats far above 1 without
            ``bits``, a background of another size, a crop beyond the picture, or a size that the binning does not divide.
    """
    path = Path(path)
    if bits is not None and not 1 <= bits <= 32:
        msg = f"bits: got {bits}, expected 1 to 32, the sensor's bit depth"
        raise InputError(msg)
    sample = _sample_folder(path)
    if sample is None:
        values, channels = _channels_first(path)
        scale, assumed = _scale(values, bits, path)
        dataset = None
    else:
        stored = StoredSample(sample)
        if stored.frames != 1:
            msg = f"{sample} is a clip of {stored.frames} frames; reconstruct takes stills, of one frame"
            raise InputError(msg)
        values, channels = stored.measurement()[0], stored.channels
        scale, assumed = (1.0, "as stored: DN / 2^bits") if bits is None else (2.0**bits, "as told")
        dataset = sample.parents[2] if (sample.parents[2] / FILE).is_file() else None
    record: dict[str, Any] = {"file": str(path), "shape": list(values.shape), "divided_by": scale, "scale": assumed}
    light = values / scale
    if background is not None:
        dark, words = _dark(background, values, path)
        light = light - dark / scale
        record["background"] = words
    if crop is not None:
        light = light[(slice(None), *crop_window(crop, path, (light.shape[-2], light.shape[-1])))]
        record["crop"] = crop
    if binning != 1:
        light = binned(light, binning, path)
        record["binning"] = binning
    return Measurement(light.astype(np.float32), sample or path, channels, dataset, record)


def _sample_folder(path: Path) -> Path | None:
    """Return the folder of one of our samples, or None for other files."""
    folder = path.absolute()
    if path.name == MEASUREMENT:
        folder = folder.parent
    elif not path.is_dir():
        return None
    if (folder / DESCRIPTION).is_file():
        return folder
    if path.is_dir():
        what = (
            "a data set: give one of its samples" if (path / FILE).is_file() else f"no sample: it has no {DESCRIPTION}"
        )
        msg = f"{path} is {what}, e.g. train/0000/s00000000, or a picture's file"
        raise InputError(msg)
    return None


def _channels_first(path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    values = read_measurement(path, RGB)
    return values, RGB if len(values) == 3 else ("grey",)


def _scale(values: NDArray[Any], bits: int | None, path: Path) -> tuple[float, str]:
    """Return what full scale is in the file's numbers, and why."""
    kind = values.dtype
    if bits is None and kind.kind == "f":
        if (brightest := float(values.max())) > _MOST_OF_SHARES:
            msg = (
                f"{path} holds floats up to {brightest:g}; expected shares of the sensor's full scale, 0 to 1: give --bits, "
                "the sensor's bit depth, by which numbers are divided by 2^bits"
            )
            raise InputError(msg)
        return 1.0, "floats, taken as DN / 2^bits"
    if bits is None and kind.kind == "i":
        msg = f"{path} holds signed integers ({kind}), which have no full scale; give --bits, the sensor's bit depth"
        raise InputError(msg)
    scale = 2.0 ** (bits or 8 * kind.itemsize)
    top = float(values.max())
    if top >= scale:
        msg = f"{path} holds numbers up to {top:g}, more than --bits {bits} can hold ({scale - 1:g}); give more bits"
        raise InputError(msg)
    return scale, "as told" if bits else f"assumed from the file's type, {kind}"


def _dark(background: str | float, values: NDArray[Any], path: Path) -> tuple[NDArray[np.float64] | float, str]:
    """Return what to subtract, and what it is in words."""
    try:
        level = float(background)
    except ValueError:
        picture = Path(str(background))
    else:
        if not np.isfinite(level):
            msg = f"background: got {background}, expected a finite number in the file's units, or a picture"
            raise InputError(msg)
        return level, f"{level:g}"
    dark, _ = _channels_first(picture)
    if dark.shape[1:] != values.shape[1:] or len(dark) not in (1, len(values)):
        msg = (
            f"background: {picture} is {_size(dark.shape)}, but {path} is {_size(values.shape)}; expected a dark picture of "
            "the same camera and size, before crop and binning"
        )
        raise InputError(msg)
    return dark.astype(np.float64), str(picture)


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[2]} with {shape[0]} channel{'s' if shape[0] > 1 else ''}"
