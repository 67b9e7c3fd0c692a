"""A picture of a data set: measurements, scenes and depths of some samples side by side, with their scales."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.dataset_info import read_info
from simulator.dataset.reader import Dataset, open_dataset
from simulator.dataset.sample import Sample
from simulator.errors import InputError
from simulator.files import write_atomic
from simulator.preview.colours import depth_colours
from simulator.preview.drawing import INK, PAPER, centimetres, encoded, font, png_bytes, resized, white_level
from simulator.preview.legends import draw_depth_legend

_TILE = 192  # height of every picture, pixels
_GAP, _TEXT, _TITLE, _BAR = 12, 22, 64, 96


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
    white = white_level(sample.rgb for sample in samples)
    near_m, far_m = _depth_range(samples)
    rows = [
        [
            resized(encoded(_three_channels(sample)), _TILE),
            resized(encoded(sample.rgb[0], white), _TILE),
            resized(depth_colours(sample.depth_m[0], sample.valid[0], near_m, far_m), _TILE),
        ]
        for sample in samples
    ]
    widths = [max(max(row[column].width for row in rows), 150) for column in range(3)]
    lefts = np.cumsum([_GAP, *(width + _GAP for width in widths)]).tolist()
    row_height = _TILE + _TEXT + _GAP
    sheet = Image.new("RGB", (lefts[3] + _BAR, _TITLE + len(rows) * row_height + _GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    heads = [
        ("measurement", "sRGB, white = full scale"),
        ("scene radiance", f"sRGB, white = {white:.3g}"),
        ("depth from the mask", f"{centimetres(near_m)} to {centimetres(far_m)}"),
    ]
    for left, (head, scale) in zip(lefts, heads, strict=False):
        draw.text((left, 10), head, fill=INK, font=font(15))
        draw.text((left, 34), scale, fill=INK, font=font(12))
    for number, (position, sample, row) in enumerate(zip(positions, samples, rows, strict=True)):
        top = _TITLE + number * row_height
        for left, picture in zip(lefts, row, strict=False):
            sheet.paste(picture, (left, top))
        text = f"{dataset.split} / {dataset.ids[position]}" + (f" / {sample.label}" if sample.label else "")
        draw.text((lefts[0], top + _TILE + 4), text, fill=INK, font=font(12))
    draw_depth_legend(draw, lefts[3], _TITLE, _TILE - 24, near_m, far_m)
    write_atomic(Path(out_png), png_bytes(sheet))
    return Path(out_png)


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
