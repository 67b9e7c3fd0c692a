"""The PSF explorer: what a point source at any depth and place of the field casts on the sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.camera.field import field_from_record
from simulator.dataset.dataset_info import DatasetInfo
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.plots.drawing import three_channels
from simulator.plots.psf import psf_white
from simulator.plots.report.facts import number_of
from simulator.plots.report.markup import Html, joined, paragraph, shown
from simulator.plots.report.pictures import MANY, picture, shrunk
from simulator.text import length
from simulator.types import View

_DEPTHS, _PLACES = 32, 101  # images, and places along each axis, at most
_SIDE = 512  # greatest number of rows and columns of an image
_CANVAS = 1024  # of the sensor as it is drawn


@dataclass(frozen=True)
class PointSources:
    """Where the PSF of a point source falls and what it weighs, for places of the field along rows and columns.

    Scene pixels and sensor pixels are of one size, and the stored image is upright: a source farther to the right casts its
    PSF farther to the right. The model is shift-invariant on the tangent plane, so shift and weight say all.

    Attributes:
        rows, columns: pixels of the simulated field (the image with its margin), increasing.
        row_shift, column_shift: what takes them to the sensor's rows and columns, under which the PSF's origin falls.
        weights: ``(len(rows), len(columns))`` irradiance at the mask over the greatest one of the field; None where the
            distance of mask and sensor is not known.
        degrees: angles to the axis of rows and columns, positive down and right; None likewise.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    row_shift: int
    column_shift: int
    weights: NDArray[np.float64] | None
    degrees: tuple[NDArray[np.float64], NDArray[np.float64]] | None


def point_sources(info: DatasetInfo, stack: PsfStack, places: int = _PLACES) -> PointSources:
    """Return up to ``places`` places along each axis of a data set's field.

    Raises:
        InputError: a damaged record of the field.
    """
    margin = _margin(info)
    distance_m = _mask_to_sensor_m(info, stack)
    near_m, far_m = float(stack.depths_m[0]), float(stack.depths_m[-1])
    view = View(info.scene_shape, stack.pixel_pitch_m, distance_m or math.nan, near_m, far_m, margin).field
    rows, columns = (_even(size, places) for size in view.shape)
    down, right = ((sensor - field) // 2 for sensor, field in zip(info.sensor_shape, view.shape, strict=True))
    if distance_m is None:
        return PointSources(rows, columns, down, right, None, None)
    y, x = (np.degrees(np.arctan(tangents)) for tangents in view.tangents)
    light = field_from_record(info.field_of_view).irradiance(view).astype(np.float64)
    weights = light[np.ix_(rows, columns)] / light.max()
    return PointSources(rows, columns, down, right, weights, (y[rows], x[columns]))


def _even(length: int, most: int) -> NDArray[np.int64]:
    """Return up to ``most`` of the first ``length`` numbers, evenly spaced, both ends among them."""
    return np.linspace(0, length - 1, min(length, most)).round().astype(np.int64)


def _margin(info: DatasetInfo) -> tuple[int, int]:
    margin = info.field_of_view.get("margin", [0, 0])
    if not isinstance(margin, list) or len(margin) != 2 or not all(type(n) is int and 0 <= n <= 20_000 for n in margin):
        raise InputError("field_of_view.margin", "damaged: expected two whole numbers")
    return margin[0], margin[1]


def _mask_to_sensor_m(info: DatasetInfo, stack: PsfStack) -> float | None:
    """Return the distance that the stack was computed for, or a plain one of the configuration; None otherwise."""
    recorded_m, camera = number_of(stack.provenance, "mask_to_sensor_m"), info.config.get("camera")
    if recorded_m is None and isinstance(camera, dict) and not camera.get("gap") and not camera.get("substrate"):
        recorded_m = (number_of(camera, "mask_to_sensor_mm") or 0.0) * 1e-3
    return recorded_m if recorded_m is not None and recorded_m > 0 else None


# ---- as HTML


def explorer(info: DatasetInfo, stack: PsfStack) -> tuple[Html, dict[str, Any]]:
    """Return the explorer and the data that its sliders need.

    Raises:
        InputError: a damaged record of the field.
    """
    sources = point_sources(info, stack)
    values = to_numpy(stack.values)
    chosen = _even(len(values), _DEPTHS).tolist()
    names = [length(float(stack.depths_m[k])) for k in chosen]
    whites = [psf_white([values[k]]) for k in chosen]
    images = joined(
        Html(f"<figure>{_image(values[k], stack.channels, white, name)}<figcaption>{name}</figcaption></figure>")
        for k, white, name in zip(chosen, whites, names, strict=True)
    )
    size = values.shape[-2:]
    data = {
        "depths": names,
        "whites": whites,
        "size": list(size),
        "origin": [n // 2 for n in size],
        "sensor": list(info.sensor_shape),
        "rows": (sources.rows + sources.row_shift).tolist(),
        "columns": (sources.columns + sources.column_shift).tolist(),
        "rowNames": _names(info, sources, 0),
        "columnNames": _names(info, sources, 1),
        "weights": None if sources.weights is None else sources.weights.round(4).tolist(),
    }
    return Html(f"{_words(info, stack, len(chosen))}{_controls(info, data)}<div class='strip'>{images}</div>"), data


def _image(psf: NDArray[np.float32], channels: tuple[str, ...], white: float, name: str) -> Html:
    stretched = np.sqrt(np.clip(three_channels(psf, channels) / white, 0, 1))
    pixels = shrunk((stretched * 255).round().astype(np.uint8), _SIDE)
    described = f"PSF at {name} on the axis, white is {white:.2g} times the light at the mask, square-root stretch"
    return picture(pixels, described, MANY)


def _names(info: DatasetInfo, sources: PointSources, axis: int) -> list[str]:
    """Return each place along an axis in words: its angle to the axis, and where it lies in the image."""
    places, margin, size = (sources.rows, sources.columns)[axis], _margin(info)[axis], info.scene_shape[axis]
    line, sides = (("row", ("above", "below")), ("column", ("left", "right")))[axis]
    names = []
    for number, place in enumerate((places - margin).tolist()):
        where = f"{line} {place + 1} of {size}" if 0 <= place < size else f"{line} {place + 1}, beside the image"
        if sources.degrees is not None:
            angle = float(sources.degrees[axis][number])
            where = f"{abs(angle):.1f}° {sides[angle > 0]}, {where}"
        names.append(where)
    return names


def _words(info: DatasetInfo, stack: PsfStack, drawn: int) -> Html:
    depths = len(stack.depths_m)
    chosen = f"{drawn} of {depths} depths, evenly chosen" if drawn < depths else f"all {depths} depths"
    kind = "" if depths == 1 else f" ({chosen})"
    return paragraph(
        f"What a point source that stays on casts on the sensor, {info.sensor_shape[0]} × {info.sensor_shape[1]} pixels of "
        f"{length(stack.pixel_pitch_m)}{kind}. As stored: the physical image rotated by 180 degrees, so that a source "
        "farther to the right casts its PSF farther to the right. Move the source with the sliders, or drag it in one of "
        "the two images."
    )


def _controls(info: DatasetInfo, data: dict[str, Any]) -> Html:
    sliders = joined(
        _slider(name, title, names, value)
        for name, title, names, value in (
            ("depth", "Depth", data["depths"], 0),
            ("column", "Across the field", data["columnNames"], len(data["columns"]) // 2),
            ("row", "Down the field", data["rowNames"], len(data["rows"]) // 2),
        )
        if len(names) > 1
    )
    height, width = (min(size, round(size * _CANVAS / max(info.sensor_shape))) for size in info.sensor_shape)
    box = Html(
        '<label class="check"><input type="checkbox" name="own"> Each depth on a brightness scale of its own</label>'
    )
    return Html(
        '<div class="explorer"><canvas role="img" aria-label="Image of the point source on the sensor" '
        f'width="{width}" height="{height}"></canvas><div class="controls">{_map(info, data)}{sliders}'
        f"{box if len(data['depths']) > 1 else ''}<output class='small' aria-live='polite'></output></div></div>"
    )


def _slider(name: str, title: str, values: list[str], at: int) -> Html:
    return Html(
        f'<label><span>{title}: <b>{shown(values[at])}</b></span><input type="range" name="{name}" min="0" '
        f'max="{len(values) - 1}" value="{at}" aria-valuetext="{shown(values[at])}"></label>'
    )


def _map(info: DatasetInfo, data: dict[str, Any]) -> Html:
    """Return the field, the image in it and the source, in the sensor's pixels."""
    (top, bottom), (left, right) = ((data[name][0], data[name][-1] + 1) for name in ("rows", "columns"))
    height, width = bottom - top, right - left
    around = 0.02 * max(height, width)
    up, aside = ((sensor - scene) / 2 for sensor, scene in zip(info.sensor_shape, info.scene_shape, strict=True))
    box = f"{left - around:g} {top - around:g} {width + 2 * around:g} {height + 2 * around:g}"
    return Html(
        f'<figure class="map"><svg viewBox="{box}" aria-hidden="true">'
        f'<rect class="field" x="{left}" y="{top}" width="{width}" height="{height}"/>'
        f'<rect class="image" x="{aside:g}" y="{up:g}" width="{info.scene_shape[1]}" height="{info.scene_shape[0]}"/>'
        f'<circle r="{max(height, width) / 40:g}" cx="{(left + right) / 2:g}" cy="{(top + bottom) / 2:g}"/></svg>'
        "<figcaption>The field: solid what the ground truth shows, pale the margin from which light is simulated"
        "</figcaption></figure>"
    )
