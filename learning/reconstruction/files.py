"""What a reconstruction looks like on disk: pictures to look at, and OpenEXR files to measure in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.capture import CaptureModel
from learning.reconstruct import Reconstruction
from simulator.errors import InputError
from simulator.io.exr import write_exr
from simulator.io.files import committed_folder, write_atomic
from simulator.io.json import plain, readable_json
from simulator.plots.drawing import LEGEND_WIDTH, PAPER, depth_colours, draw_depth_legend, png_bytes, resized
from simulator.types import FARTHEST_M

RECORD = "reconstruction.json"
_LEAST_HEIGHT, _MARGIN = 240, 12


def check_place(folder: Path) -> None:
    """Refuse a folder that holds anything else than an earlier reconstruction, which is replaced.

    Raises:
        InputError: it is a file, or a folder of other things.
    """
    if folder.is_dir() and any(folder.iterdir()) and not (folder / RECORD).is_file():
        msg = f"--output: {folder} holds other files than a reconstruction; choose another folder"
        raise InputError(msg)
    if folder.exists() and not folder.is_dir():
        msg = f"--output: {folder} is a file; choose another folder"
        raise InputError(msg)


def write_reconstruction(
    folder: Path, result: Reconstruction, capture: CaptureModel, record: dict[str, Any]
) -> list[str]:
    """Write a reconstruction; the folder appears whole or not at all.

    ``picture.png`` (sRGB, 8 bit), ``picture.exr`` (linear R, G, B), ``depth.exr`` (Z, metres), ``depth.png`` (colours and
    what they mean), ``volume.exr`` (channels ``plane00.R`` and so on, nearest first) and ``reconstruction.json``, as far as
    there is something to write.

    Args:
        folder: is made; an earlier reconstruction in it is replaced.
        result: what to write.
        capture: the camera, for the depths.
        record: how it came about.

    Returns:
        The files' names.

    Raises:
        InputError: the folder holds other things.
        StorageError: it cannot be written.
    """
    check_place(folder)
    with committed_folder(folder) as place:
        _write_picture(place, result)
        if result.depth_m is not None:
            write_exr(place / "depth.exr", {"Z": result.depth_m}, {"unit": "m", "z": "from the mask plane"})
            near_m, far_m = capture.near_m, min(capture.far_m, FARTHEST_M)
            write_atomic(place / "depth.png", _depth_picture(result.depth_m, near_m, far_m))
        if result.volume is not None:
            names = capture.stack.channels
            planes = {
                f"plane{k:02d}.{name}": np.ascontiguousarray(values)
                for k, plane in enumerate(result.volume)
                for name, values in zip(names, plane, strict=True)
            }
            depths_m = plain([float(depth) for depth in capture.stack.depths_m])
            write_exr(place / "volume.exr", planes, {"depths_m": depths_m})
        files = sorted([*(path.name for path in place.iterdir()), RECORD])
        content = record | {"files": files, "white": result.white}
        write_atomic(place / RECORD, readable_json(content | {"seconds": result.seconds}))
    return files


def _write_picture(place: Path, result: Reconstruction) -> None:
    from PIL import Image

    codes = np.round(np.moveaxis(result.picture, 0, -1) * 255).astype(np.uint8)
    write_atomic(place / "picture.png", png_bytes(Image.fromarray(codes)))
    channels = {name: np.ascontiguousarray(values) for name, values in zip("RGB", result.radiance, strict=True)}
    write_exr(place / "picture.exr", channels, {"white": result.white})


def _depth_picture(depth_m: NDArray[np.float32], near_m: float, far_m: float) -> bytes:
    """Return the depth in colours beside their legend, small ones enlarged by a whole number."""
    from PIL import Image, ImageDraw

    rows = len(depth_m)
    pixels = depth_colours(depth_m, np.ones_like(depth_m, dtype=bool), near_m, far_m)
    shown = resized(pixels, rows * max(1, -(-_LEAST_HEIGHT // rows)))
    # As high as the picture: the legend's grey, for where nothing was seen, has no meaning here and falls off the paper.
    paper = Image.new("RGB", (shown.width + LEGEND_WIDTH + _MARGIN, shown.height), PAPER)
    paper.paste(shown, (0, 0))
    top = 8
    draw_depth_legend(ImageDraw.Draw(paper), shown.width + _MARGIN, top, shown.height - 2 * top, near_m, far_m)
    return png_bytes(paper)
