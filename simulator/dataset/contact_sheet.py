"""A picture of a data set: measurements, scenes and depths of some samples side by side, with their scales."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.dataset.dataset_info import read_info
from simulator.dataset.reader import Dataset, open_dataset
from simulator.dataset.sample import Sample
from simulator.errors import InputError
from simulator.files import write_atomic
from simulator.types import FARTHEST_M

if TYPE_CHECKING:
    from PIL import Image

_TILE = 192  # height of every picture, pixels
_GAP, _TEXT, _TITLE, _BAR = 12, 22, 64, 96
_PAPER, _INK, _UNSEEN = (250, 250, 250), (25, 25, 25), (120, 120, 120)
_WHITE_PERCENTILE = 99.5
# Nine anchors from near (light) to far (dark), even in lightness so that depth also reads in greyscale.
_COLOURS = np.array(
    [
        (253, 231, 37),
        (173, 220, 48),
        (94, 201, 98),
        (40, 174, 128),
        (33, 145, 140),
        (44, 114, 142),
        (59, 82, 139),
        (71, 45, 123),
        (68, 1, 84),
    ],
    np.float64,
)


def contact_sheet(dataset_path: Path | str, out_png: Path | str, count: int = 8, split: str | None = None) -> Path:
    """Draw up to ``count`` samples, evenly chosen from a split, one per row.

    Measurements are shown with full scale (1.0) as white, scenes with one stated radiance as white, both sRGB-encoded;
    depths in colour over one range for all rows, grey where nothing was seen.

    Args:
        dataset_path: the data set's folder.
        out_png: the picture to write; its folder must exist.
        count: rows at most.
        split: which split; by default the first that has samples.

    Returns:
        The path of the picture.

    Raises:
        InputError: no finished sample, or a damaged one.
        StorageError: the picture cannot be written.
    """
    from PIL import Image, ImageDraw

    if count < 1:
        msg = f"count must be at least 1, got {count}"
        raise InputError(msg)
    dataset = _chosen_split(Path(dataset_path), split)
    positions = sorted(set(np.linspace(0, len(dataset) - 1, min(count, len(dataset))).round().astype(int).tolist()))
    samples = [dataset[position] for position in positions]
    white = float(np.percentile(np.concatenate([sample.rgb.ravel() for sample in samples]), _WHITE_PERCENTILE)) or 1.0
    near_m, far_m = _depth_range(samples)
    rows = [
        [
            _picture(_three_channels(sample)),
            _picture(sample.rgb[0] / np.float32(white)),
            _resized(depth_colours(sample.depth_m[0], sample.valid[0], near_m, far_m)),
        ]
        for sample in samples
    ]
    widths = [max(max(row[column].width for row in rows), 150) for column in range(3)]
    lefts = np.cumsum([_GAP, *(width + _GAP for width in widths)]).tolist()
    row_height = _TILE + _TEXT + _GAP
    sheet = Image.new("RGB", (lefts[3] + _BAR, _TITLE + len(rows) * row_height + _GAP), _PAPER)
    draw = ImageDraw.Draw(sheet)
    heads = [
        ("measurement", "sRGB, white = full scale"),
        ("scene radiance", f"sRGB, white = {white:.3g}"),
        ("depth from the mask", f"{_centimetres(near_m)} to {_centimetres(far_m)}"),
    ]
    for left, (head, scale) in zip(lefts, heads, strict=False):
        draw.text((left, 10), head, fill=_INK, font=_font(15))
        draw.text((left, 34), scale, fill=_INK, font=_font(12))
    for number, (position, sample, row) in enumerate(zip(positions, samples, rows, strict=True)):
        top = _TITLE + number * row_height
        for left, picture in zip(lefts, row, strict=False):
            sheet.paste(picture, (left, top))
        text = f"{dataset.split} / {dataset.ids[position]}" + (f" / {sample.label}" if sample.label else "")
        draw.text((lefts[0], top + _TILE + 4), text, fill=_INK, font=_font(12))
    _draw_legend(draw, lefts[3], near_m, far_m)
    stream = io.BytesIO()
    sheet.save(stream, "PNG", optimize=True)
    write_atomic(Path(out_png), stream.getvalue())
    return Path(out_png)


def depth_colours(
    depth_m: NDArray[np.float32], valid: NDArray[np.bool_], near_m: float, far_m: float
) -> NDArray[np.uint8]:
    """Colour depths evenly in disparity (1/z, what a camera resolves) from near (yellow) to far (violet); grey is unseen.

    Args:
        depth_m: ``(h, w)`` metres.
        valid: ``(h, w)``.
        near_m: depth of the first colour.
        far_m: depth of the last colour.

    Returns:
        ``(h, w, 3)`` uint8.
    """
    range_per_m = max(1 / near_m - 1 / far_m, 1e-12)
    share = np.clip((1 / near_m - 1 / depth_m.astype(np.float64)) / range_per_m, 0, 1)
    places = np.linspace(0, 1, len(_COLOURS))
    colours = np.stack([np.interp(share, places, _COLOURS[:, channel]) for channel in range(3)], axis=-1)
    return np.where(valid[..., None], colours.round(), np.array(_UNSEEN)).astype(np.uint8)


def _chosen_split(path: Path, split: str | None) -> Dataset:
    splits = [split] if split is not None else list(read_info(path).counts)
    for name in splits:
        dataset = open_dataset(path, name)
        if len(dataset):
            return dataset
    msg = f"{path} has no finished sample in {', '.join(splits) or 'any split'}; nothing to draw"
    raise InputError(msg)


def _depth_range(samples: list[Sample]) -> tuple[float, float]:
    seen = np.concatenate([sample.depth_m[sample.valid] for sample in samples])
    if seen.size == 0:
        seen = np.concatenate([sample.depth_m.ravel() for sample in samples])
    return float(seen.min()), float(seen.max())


def _three_channels(sample: Sample) -> NDArray[np.float32]:
    """The measurement as ``(H, W, 3)``: R, G, B where they exist, else the first three channels, else grey."""
    planes, names = sample.measurement, sample.channels
    if {"R", "G", "B"} <= set(names):
        return np.stack([planes[names.index(name)] for name in "RGB"], axis=-1)
    if len(planes) >= 3:
        return np.moveaxis(planes[:3], 0, -1)
    return np.repeat(planes.mean(axis=0)[..., None], 3, axis=-1)


def _picture(linear: NDArray[np.float32]) -> Image.Image:
    encoded = linear_to_srgb(np.clip(linear, 0, 1))
    return _resized((encoded * 255).round().astype(np.uint8))


def _resized(pixels: NDArray[np.uint8]) -> Image.Image:
    from PIL import Image

    rows, columns = pixels.shape[:2]
    rule = Image.Resampling.BOX if rows > _TILE else Image.Resampling.NEAREST  # enlarged pixels stay visible
    return Image.fromarray(pixels).resize((max(1, round(columns * _TILE / rows)), _TILE), rule)


def _draw_legend(draw: Any, left: int, near_m: float, far_m: float) -> None:
    top, width, height = _TITLE, 16, _TILE - 24
    steps = (1 / np.linspace(1 / near_m, 1 / far_m, height))[:, None].astype(np.float32)
    for row, colour in enumerate(depth_colours(steps, np.ones_like(steps, dtype=bool), near_m, far_m)[:, 0]):
        draw.line([(left, top + row), (left + width, top + row)], fill=tuple(colour.tolist()))
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        height_here = top + share * (height - 1)
        depth_m = 1 / ((1 - share) / near_m + share / far_m)
        draw.text((left + width + 6, height_here), _centimetres(depth_m), fill=_INK, font=_font(12), anchor="lm")
    draw.rectangle([(left, top + height + 8), (left + width, top + height + 24)], fill=_UNSEEN)
    draw.text((left + width + 6, top + height + 16), "no surface", fill=_INK, font=_font(12), anchor="lm")


def _centimetres(depth_m: float) -> str:
    return "infinity" if depth_m >= FARTHEST_M * (1 - 1e-6) else f"{depth_m * 100:.3g} cm"


def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)
