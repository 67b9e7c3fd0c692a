"""A contact sheet of a data set: measurements, scenes and depths of some samples side by side, with their scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.dataset_info import read_info
from simulator.dataset.reader import Dataset, open_dataset
from simulator.dataset.sample import SceneFrame, StoredSample
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.io.store import Place, place
from simulator.plots.drawing import (
    INK,
    PAPER,
    depth_colours,
    depth_range,
    draw_depth_legend,
    encoded,
    fitted,
    font,
    png_bytes,
    resized,
    seen_range_m,
    three_channels,
    time_span,
    white_level,
)

if TYPE_CHECKING:
    from PIL import Image

_FRAMES = 5  # of a clip that are shown at most
_TILE = 192  # height of every image, pixels
_GAP, _TEXT, _LINE, _TITLE, _BAR = 12, 22, 16, 64, 96


def contact_sheet(dataset_path: Place | str, out_png: Place | str, count: int = 8, split: str | None = None) -> Place:
    """Draw up to ``count`` samples, evenly chosen from a split, one per row.

    Measurements are shown with full scale (1.0) as white, scenes with one stated radiance as white, both sRGB-encoded;
    depths in colour over one range for all rows, grey where nothing was seen. Of a clip up to five frames are shown, with
    their times, and the depth of the middle one.

    Args:
        dataset_path: the data set's folder.
        out_png: the image to write; its folder must exist.
        count: rows at most.
        split: which split; by default the first that has samples.

    Returns:
        The path of the image.

    Raises:
        InputError: no finished sample, or a damaged one.
        StorageError: the image cannot be written.
    """
    from PIL import Image, ImageDraw

    if count < 1:
        raise InputError("count", f"expected at least 1, got {count}")
    dataset = _chosen_split(place(dataset_path), split)
    positions = sorted(set(np.linspace(0, len(dataset) - 1, min(count, len(dataset))).round().astype(int).tolist()))
    rows = [_Row.of(dataset.stored(position)) for position in positions]
    white = white_level(frame.rgb for row in rows for frame in row.frames)
    near_m, far_m = seen_range_m([(row.middle.depth_m, row.middle.valid) for row in rows])
    depth_column = 1 + max(len(row.frames) for row in rows)
    tiles = [_tiles(row, depth_column, white, (near_m, far_m)) for row in rows]
    widths = [max(150, *(row[column].width for row in tiles if column in row)) for column in range(depth_column + 1)]
    lefts = np.cumsum([_GAP, *(width + _GAP for width in widths)]).tolist()
    row_height = _TILE + _TEXT + (_LINE if any(row.times for row in rows) else 0) + _GAP
    sheet = Image.new("RGB", (lefts[-1] + _BAR, _TITLE + len(rows) * row_height + _GAP), PAPER)
    draw = ImageDraw.Draw(sheet)
    heads = {
        0: ("measurement", "sRGB, white = full scale"),
        1: ("scene radiance" + (" over time" if depth_column > 2 else ""), f"sRGB, white = {white:.3g}"),
        depth_column: ("depth from the mask", depth_range(near_m, far_m)),
    }
    for column, (head, scale) in heads.items():
        draw.text((lefts[column], 10), head, fill=INK, font=font(15))
        draw.text((lefts[column], 34), scale, fill=INK, font=font(12))
    for number, (position, row, images) in enumerate(zip(positions, rows, tiles, strict=True)):
        top = _TITLE + number * row_height
        below = top + _TILE + 4
        for column, image in images.items():
            sheet.paste(image, (lefts[column], top))
        for column, time in zip(images, row.times, strict=False):
            draw.text((lefts[column], below), fitted(time, 12, widths[column]), fill=INK, font=font(12))
        text = f"{dataset.split} / {dataset.ids[position]}" + (f" / {row.label}" if row.label else "")
        draw.text((lefts[0], below + (_LINE if row.times else 0)), text, fill=INK, font=font(12))
    draw_depth_legend(draw, lefts[-1], _TITLE, _TILE - 24, near_m, far_m)
    write_atomic(place(out_png), png_bytes(sheet))
    return place(out_png)


@dataclass(frozen=True)
class _Row:
    """What is shown of a sample.

    Attributes:
        measurement: ``(H, W, 3)``.
        frames: some of its frames, in order, evenly chosen; the only one of a still.
        middle: the one of them whose depth is shown.
        label: class name, or None.
        times: what is written below measurement, frames and depth; nothing for a still.
    """

    measurement: NDArray[np.float32]
    frames: list[SceneFrame]
    middle: SceneFrame
    label: str | None
    times: list[str]

    @classmethod
    def of(cls, stored: StoredSample) -> _Row:
        count, edges_s = stored.frames, stored.frame_edges_s
        numbers = np.linspace(0, count - 1, min(count, _FRAMES)).round().astype(int).tolist()
        frames = [stored.frame(number) for number in numbers]
        middle = len(frames) // 2
        times = []
        if edges_s is not None:
            shown = [f"{number + 1} of {count}: {time_span(edges_s[number : number + 2])}" for number in numbers]
            times = [time_span(edges_s), *shown, shown[middle]]
        measurement = three_channels(stored.measurement()[0], stored.channels)
        return cls(measurement, frames, frames[middle], stored.label, times)


def _tiles(row: _Row, depth_column: int, white: float, range_m: tuple[float, float]) -> dict[int, Image.Image]:
    """Return the images of a row by column: measurement, frames, and in the last one the depth."""
    shown = [encoded(row.measurement), *(encoded(frame.rgb, white) for frame in row.frames)]
    tiles = {column: resized(pixels, _TILE) for column, pixels in enumerate(shown)}
    colours = depth_colours(row.middle.depth_m, row.middle.valid, *range_m)
    return tiles | {depth_column: resized(colours, _TILE)}


def _chosen_split(path: Place, split: str | None) -> Dataset:
    splits = [split] if split is not None else list(read_info(path).counts)
    for name in splits:
        dataset = open_dataset(path, name)
        if len(dataset):
            return dataset
    raise InputError(path, f"has no finished sample in {', '.join(splits) or 'any split'}; nothing to draw")
