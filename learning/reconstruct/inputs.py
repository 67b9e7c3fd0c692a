"""Reading a measurement, and the image of a PSF: cropped, cleaned and binned by one rule, as they share a sensor."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.dataset_info import FILE
from simulator.dataset.sample import DESCRIPTION, MEASUREMENT, StoredSample
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.io.measurements import read_measurement
from simulator.optics.measured import Background, load_measured_psf
from simulator.optics.stack import PsfStack


def crop_window(crop: str, path: Path, shape: tuple[int, int], option: str = "crop") -> tuple[slice, slice]:
    """Return the rows and columns of a crop of an image of this shape.

    ``crop`` is ``ROWSxCOLUMNS`` about the centre, or ``ROWSxCOLUMNS+TOP+LEFT``; ``path`` and ``option`` are for messages.
    """
    found = re.fullmatch(r"(\d+)x(\d+)(?:\+(\d+)\+(\d+))?", crop.strip())
    if not found:
        wanted = "ROWSxCOLUMNS (about the centre) or ROWSxCOLUMNS+TOP+LEFT, e.g. 1080x1440+60+80"
        raise InputError(option, f"got {crop!r}, expected {wanted}")
    sizes = (int(found[1]), int(found[2]))
    starts = [(whole - size) // 2 for whole, size in zip(shape, sizes, strict=True)]
    if found[3]:
        starts = [int(found[3]), int(found[4])]
    for start, size, whole in zip(starts, sizes, shape, strict=True):
        if size < 1 or start < 0 or start + size > whole:
            of = f"{path} of {shape[0]} x {shape[1]} pixels"
            raise InputError(option, f"got {crop}, which reaches beyond {of}; make it smaller")
    rows, columns = (slice(start, start + size) for start, size in zip(starts, sizes, strict=True))
    return rows, columns


def check_binning(binning: int, path: Path, shape: tuple[int, ...], crop_option: str = "--crop") -> None:
    """Refuse a binning of ``(..., H, W)`` that leaves pixels over: dropped in silence, they would shift image against PSF."""
    rows, columns = shape[-2:]
    if not 1 <= binning <= min(rows, columns):
        raise InputError("binning", f"got {binning}, expected 1 to {min(rows, columns)} pixels per side for {path}")
    if rows % binning or columns % binning:
        cure = f"add {crop_option} {rows // binning * binning}x{columns // binning * binning}"
        raise InputError("binning", f"got {binning}, which does not divide {path} of {rows} x {columns} pixels; {cure}")


def binned(light: NDArray[np.floating[Any]], binning: int, path: Path) -> NDArray[np.float64]:
    """Return the mean of blocks, ``(C, H, W)`` to ``(C, H / binning, W / binning)``."""
    check_binning(binning, path, light.shape)
    rows, columns = light.shape[-2:]
    blocks = light.reshape(-1, rows // binning, binning, columns // binning, binning)
    return blocks.mean(axis=(2, 4), dtype=np.float64)


RGB = ("R", "G", "B")
Frame: TypeAlias = Literal["physical", "stored"]
"""As read from the sensor, or rotated by 180 degrees, so that a pinhole's image is upright."""
_MOST_OF_SHARES = 2.0  # noise that was not clipped goes beyond full scale, but not so far


@dataclass(frozen=True)
class Measurement:
    """What a camera stored: ``values`` ``(C, H, W)`` float32, DN / 2^bits, background removed, cropped, binned, in our frame.

    ``path`` is the file or the sample's folder, ``dataset`` the folder of the data set that it is a sample of; ``channels``
    is ``("grey",)`` for one; ``frame`` is that of the file: samples and copies of their files say ``stored`` themselves, of
    others it is what was told, or None; ``record`` says what was done to the file's numbers and what was assumed.
    """

    values: NDArray[np.float32]
    path: Path
    channels: tuple[str, ...]
    dataset: Path | None
    frame: Frame | None
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
    frame: Frame | None = None,
) -> Measurement:
    """Read a measurement; what is done to it follows the order of the arguments.

    Args:
        path: a sample's folder or its ``measurement.exr``; or a TIFF, PNG, OpenEXR or ``.npy`` file of one linear image,
            grey or RGB, ``(H, W)`` or ``(C, H, W)`` in ``.npy``.
        bits: the numbers are divided by 2^bits. None takes unsigned integers by their type (8, 16 or 32 bits) and floats as
            shares already.
        background: what the sensor shows without light, in the file's numbers: one number, or an image's path.
        crop: ``ROWSxCOLUMNS`` about the centre, or ``ROWSxCOLUMNS+TOP+LEFT``, in the file's pixels.
        binning: pixels per side whose mean becomes one.
        frame: of an image's file: ``physical`` is rotated here; None leaves it as it is, to be told later.

    Raises:
        InputError: a file that cannot be read or holds NaN, numbers above 2^bits, floats far above 1 without
            ``bits``, a background of another size, a crop beyond the image, a size that the binning does not divide, or a
            frame for a sample, which says it itself.
    """
    path = Path(path)
    if bits is not None and not 1 <= bits <= 32:
        raise InputError("bits", f"got {bits}, expected 1 to 32, the sensor's bit depth")
    sample = _sample_folder(path)
    if sample is None:
        values, channels = _channels_first(path)
        scale, assumed = _scale(values, bits, path)
        dataset = label = None
        if frame is None and path.suffix.lower() == ".exr" and "sensor_shape" in read_exr(path)[1]:
            frame = "stored"  # a file of ours that was copied out of its sample says so itself
    else:
        stored = StoredSample(sample)
        values, channels, label = stored.measurement()[0], stored.channels, stored.label
        scale, assumed = (1.0, "as stored: DN / 2^bits") if bits is None else (2.0**bits, "as told")
        if frame is not None:
            raise InputError("frame", f"got {frame}, but {sample} is a sample, whose frame is stored; leave it out")
        frame = "stored"
        dataset = sample.parents[2] if (sample.parents[2] / FILE).is_file() else None
    record: dict[str, Any] = {"file": str(path), "shape": list(values.shape), "divided_by": scale, "scale": assumed}
    if label is not None:
        record["label"] = label
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
    if frame is not None:
        check_frame(frame, "frame")
        record["frame"] = frame
    if frame == "physical":
        light = light[:, ::-1, ::-1]
    return Measurement(light.astype(np.float32), sample or path, channels, dataset, frame, record)


def check_frame(frame: str, option: str) -> None:
    """Refuse other words than those of `Frame`; ``option`` is for the message."""
    if frame not in get_args(Frame):
        raise InputError(option, f"got {frame!r}, expected physical (as read from the sensor) or stored (rotated)")


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
        ours = "a data set: give one of its samples"
        what = ours if (path / FILE).is_file() else f"not a sample: it has no {DESCRIPTION}"
        raise InputError(path, f"{what}, e.g. train/0000/s00000000, or an image's file")
    return None


def _channels_first(path: Path) -> tuple[NDArray[Any], tuple[str, ...]]:
    values = read_measurement(path, RGB)
    return values, RGB if len(values) == 3 else ("grey",)


def _scale(values: NDArray[Any], bits: int | None, path: Path) -> tuple[float, str]:
    """Return what full scale is in the file's numbers, and why."""
    kind = values.dtype
    if bits is None and kind.kind == "f":
        if (brightest := float(values.max())) > _MOST_OF_SHARES:
            wanted = "shares of full scale, 0 to 1; or give --bits, which divides numbers by 2^bits"
            raise InputError(path, f"got floats up to {brightest:g}, expected {wanted}")
        return 1.0, "floats, taken as DN / 2^bits"
    if bits is None and kind.kind == "i":
        raise InputError(path, f"got signed integers ({kind}), which have no full scale; give --bits, the bit depth")
    scale = 2.0 ** (bits or 8 * kind.itemsize)
    top = float(values.max())
    if top >= scale:
        raise InputError(path, f"got numbers up to {top:g}, expected at most {scale - 1:g} (--bits {bits})")
    return scale, "as told" if bits else f"assumed from the file's type, {kind}"


def _dark(background: str | float, values: NDArray[Any], path: Path) -> tuple[NDArray[np.float64] | float, str]:
    """Return what to subtract, and what it is in words."""
    try:
        level = float(background)
    except ValueError:
        image = Path(str(background))
    else:
        if not np.isfinite(level):
            raise InputError("background", f"got {background}, expected a finite number, or an image")
        return level, f"{level:g}"
    dark, _ = _channels_first(image)
    if dark.shape[1:] != values.shape[1:] or len(dark) not in (1, len(values)):
        dark_size, size = (
            f"{h} x {w} with {c} channel{'s' if c > 1 else ''}" for c, h, w in (dark.shape, values.shape)
        )
        wanted = "a dark image of the same camera and size, before crop and binning"
        raise InputError("background", f"{image} is {dark_size}, but {path} is {size}; expected {wanted}")
    return dark.astype(np.float64), str(image)


_PITCH_M = 1e-5  # nothing here depends on it: values are scaled to a sum of 1


def load_psf_image(
    path: Path,
    channels: tuple[str, ...],
    *,
    background: str | None = None,
    crop: str | None = None,
    binning: int = 1,
    frame: Frame = "stored",
) -> PsfStack:
    """Return the linear image of a PSF as a stack of one plane, infinitely far, with values that add up to 1 on average.

    ``background`` is ``border`` (also None), the median of the cropped image's outer frame; ``none``; counts; or an image of
    darkness, of the same size before the crop. ``crop`` see `crop_window`: the PSF's origin is the centre of what is left.
    ``frame`` is the file's; a physical image is rotated.

    Raises:
        InputError: a file that cannot be read, a crop beyond it, a binning that does not divide it, or no light.
    """
    image = read_measurement(path, channels)
    window = (slice(None), slice(None)) if crop is None else crop_window(crop, path, image.shape[-2:], "psf-crop")
    cut = image[(slice(None), *window)]
    check_binning(binning, path, cut.shape, "--psf-crop")
    level = _level(background)
    options: dict[str, Any] = {"frame": frame, "binning": binning, "channels": channels}
    options["throughput_m2"] = _PITCH_M**2
    if crop is None:
        return load_measured_psf([path], [np.inf], _PITCH_M, background=level, **options)
    with TemporaryDirectory() as folder:
        np.save(place := Path(folder, "psf.npy"), cut)
        told = {"background": background} if isinstance(level, Path) else {}
        if isinstance(level, Path):
            dark = read_measurement(level, channels)
            dark_window = crop_window(crop, level, dark.shape[-2:], "psf-crop")
            np.save(level := Path(folder, "dark.npy"), dark[(slice(None), *dark_window)])
        stack = load_measured_psf([place], [np.inf], _PITCH_M, background=level, **options)
    images = [record | {"file": path.name} for record in stack.provenance["images"]]
    return replace(stack, provenance={**stack.provenance, **told, "images": images, "crop": crop})


def _level(background: str | None) -> Background:
    if background in (None, "border", "none"):
        return "none" if background == "none" else "border"
    try:
        return float(background)
    except ValueError:
        return Path(background)
