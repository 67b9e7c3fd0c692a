"""The pictures of a calibration: which distance, exposure and darkness each belongs to, averaged and judged one by one."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import read_text
from simulator.io.measurements import (
    READABLE,
    Cfa,
    check_binning,
    full_pixels,
    full_scale,
    in_colours,
    read_measured_image,
)
from simulator.optics.measured import binned, border_level
from simulator.text import counted, show

TABLE = "distances.csv"
"""Name of the table that is taken, where the folder has one."""
_UNITS_M = {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0}
_UNITS_S = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
_DISTANCE = re.compile(r"(?<![\d.])(\d+(?:[.,]\d+)?)[ _-]?(um|mm|cm|m)(?![a-z])", re.IGNORECASE)
_EXPOSURE = re.compile(r"(?<![\d.])(\d+(?:[.,]\d+)?)[ _-]?(us|ms|s)(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True)
class Group:
    """The files of one distance, or of darkness (``distance_m`` None), all of one exposure (None where nobody said)."""

    distance_m: float | None
    exposure_s: float | None
    files: tuple[Path, ...]


@dataclass
class Picture:
    """What was recorded of one distance.

    Attributes:
        distance_m: as stated.
        exposure_s: as stated; None where it is not.
        files: that were averaged.
        light: ``(1 or C, H, W)`` float64 counts, darkness taken off (negative values are noise), binned.
        pixels: of the sensor, per side of one of ``light``.
        brightest: number in the files, darkness included.
        peak: the same as a share of full scale.
        guessed: whether full scale is only what the files' type holds, 16 bits or more.
        saturated: share of the pixels that are full in any file.
        noise: standard deviation of a pixel of ``light`` where it is dark, counts.
        background: what was taken off, in words.
        notes: what is doubtful about it.
    """

    distance_m: float
    exposure_s: float | None
    files: tuple[Path, ...]
    light: NDArray[np.float64]
    pixels: int
    brightest: float
    peak: float
    guessed: bool
    saturated: float
    noise: float
    background: str
    notes: list[str] = field(default_factory=list)


def find_groups(folder: Path, table: Path | None = None) -> tuple[list[Group], list[Group]]:
    """Return the groups of pictures, nearest first, and those of dark frames.

    Args:
        folder: with the pictures. A name tells the distance (``12.5cm.tif``, ``z120mm_001.png``) and may tell the exposure
            (``30cm_4ms_2.tif``); names that begin with ``dark`` are frames with the source covered.
        table: CSV, separated by commas or semicolons, with a head of ``file`` and ``distance_cm`` (or ``_mm``, ``_m``), and
            perhaps ``exposure_ms`` (``_s``, ``_us``), for names that do not tell; rows with no distance, or ``dark``, are
            dark frames. None takes ``distances.csv`` of the folder, if it is there.

    Raises:
        InputError: naming the file or line, for what cannot be told, or no pictures at all.
    """
    if not folder.is_dir():
        raise InputError(folder, "expected a folder with pictures of a point source, one or more for each distance")
    if table is None and (folder / TABLE).is_file():
        table = folder / TABLE
    told = _of_table(folder, table) if table else _of_names(folder)
    groups: dict[tuple[float | None, float | None], list[Path]] = {}
    for file, distance_m, exposure_s in told:
        groups.setdefault((distance_m, exposure_s), []).append(file)
    found = [Group(z, t, tuple(files)) for (z, t), files in groups.items()]
    pictures = sorted(
        (group for group in found if group.distance_m is not None), key=lambda group: group.distance_m or 0
    )
    if not pictures:
        raise InputError(table or folder, "holds no pictures with a distance, such as 12.5cm.tif or z120mm_001.png")
    for before, after in pairwise(pictures):
        if before.distance_m == after.distance_m:
            files = f"{before.files[0].name} and {after.files[0].name}"
            raise InputError(table or folder, f"{files} are of one distance, but of two exposures: keep one of them")
    return pictures, [group for group in found if group.distance_m is None]


def left_out(folder: Path, files: Iterable[Path]) -> str:
    """Return how many files of which kinds a folder has beside those that were taken, in words, or nothing."""
    there = {path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")}
    kinds = Counter(path.suffix.lower() or path.name for path in there - {*files, folder / TABLE})
    return ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))


def read_picture(
    group: Group,
    dark: Sequence[Group],
    *,
    bits: int | None = None,
    cfa: Cfa | None = None,
    binning: int = 1,
) -> Picture:
    """Average the files of a distance, take darkness off and judge what is left.

    Args:
        group: the files.
        dark: dark frames; those of the group's exposure are taken, or else the only ones there are.
        bits: see `full_scale`; a sensor that is full below that is recognised all the same, see `full_pixels`.
        cfa: of a colour sensor's mosaic; each 2 x 2 becomes a pixel.
        binning: pixels per side that become one.

    Raises:
        InputError: a file that cannot be read, is of another size, holds numbers beyond full scale or does not tell it; or a
            binning that does not divide the images.
    """
    recorded = _average(group.files, cfa, bits)
    check_binning(binning, group.files[0], recorded.mean.shape, crop=None)
    darkness, dark_noise, words, notes = _darkness(group, dark, cfa, recorded.mean)
    notes = [*recorded.notes, *notes]
    if recorded.plateau is not None:
        notes.append(
            f"many pixels are {recorded.plateau:g}, the brightest value, and count as full"
            + ("" if bits else "; --bits says what full scale is")
        )
    return Picture(
        distance_m=float(group.distance_m or 0),
        exposure_s=group.exposure_s,
        files=group.files,
        light=binned(recorded.mean - darkness, binning),
        pixels=binning * (2 if recorded.mosaic else 1),
        brightest=recorded.brightest,
        peak=recorded.peak,
        guessed=recorded.guessed,
        saturated=recorded.full_share,
        noise=float(np.hypot(recorded.noise, dark_noise)) / binning,
        background=words,
        notes=notes,
    )


@dataclass(frozen=True)
class _Recorded:
    """The mean of some files: ``mean`` ``(C, H, W)`` counts, its noise where it is dark, and how full its pixels are."""

    mean: NDArray[np.float64]
    mosaic: bool
    noise: float
    brightest: float
    peak: float
    guessed: bool
    full_share: float
    plateau: float | None
    notes: tuple[str, ...]


def _average(files: tuple[Path, ...], cfa: Cfa | None, bits: int | None = None, *, dark: bool = False) -> _Recorded:
    """Average files; ``dark`` ones are not judged."""
    total: Any = 0.0
    squares: Any = 0.0
    full: Any = False
    brightest, peak, guessed, plateau, first, mosaic = 0.0, 0.0, False, None, None, False
    notes: list[str] = []
    for file in files:
        read = read_measured_image(file)
        image = in_colours(read, cfa, file, "--cfa", judge=not dark)
        first = image if first is None else first
        if image.shape != first.shape:
            raise InputError(file, f"got {image.shape}, but {files[0].name} has {first.shape}; expected one size")
        total, squares = total + image, squares + np.asarray(image, np.float64) ** 2
        if dark:
            continue
        mosaic = image.shape != read.values.shape
        notes += read.notes
        scale, top = full_scale(read, bits, file), float(read.values.max())
        brightest, peak, guessed = max(brightest, top), max(peak, top / scale.full), scale.guessed
        # A mosaic's colours are means of two greens: what is full shows in the pixels as they were read.
        filled, level = full_pixels(read.values, scale.full)
        plateau = level if level < scale.full else plateau
        rows, columns = image.shape[-2:]
        side = 2 if mosaic else 1
        full = full | filled[: rows * side, : columns * side].reshape(rows, side, columns, side).any(axis=(1, 3))
    n, mean = len(files), np.asarray(total / len(files), np.float64)
    faint = mean <= np.median(mean)
    if n > 1:
        noise = np.sqrt(max(float(np.mean((squares / n - mean**2)[faint])), 0.0) / (n - 1))
    else:  # neighbours differ by sqrt(2) of the noise, whose mean absolute value is sqrt(2 / pi) of it
        step = np.abs(np.diff(mean, axis=-1)[faint[..., 1:]])
        noise = step.mean() * np.sqrt(np.pi) / 2 if step.size else 0.0
    of_files = tuple(dict.fromkeys(notes))
    return _Recorded(mean, mosaic, float(noise), brightest, peak, guessed, float(np.mean(full)), plateau, of_files)


def _darkness(
    group: Group, dark: Sequence[Group], cfa: Cfa | None, mean: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, str, list[str]]:
    """Return what to take off, its noise, what it is in words, and what is doubtful about it."""
    if not dark:
        note = "no dark frames: the median of its border was taken off, which leaves glow and hot pixels"
        return border_level(mean), 0.0, "border", [note]
    own = [one for one in dark if one.exposure_s == group.exposure_s]
    notes = []
    if not own:
        ratios = [
            abs(math.log((one.exposure_s or math.inf) / group.exposure_s)) if group.exposure_s else 0.0 for one in dark
        ]
        own = [dark[int(np.argmin(ratios))]]
        if group.exposure_s is not None or own[0].exposure_s is not None:
            notes.append("its dark frames are of another exposure: record some of its own")
    darkness = _average(own[0].files, cfa, dark=True)
    level, count = darkness.mean, len(own[0].files)
    if level.shape[-2:] != mean.shape[-2:] or len(level) not in (1, len(mean)):
        files = f"{own[0].files[0].name} has {level.shape}, {group.files[0].name} {mean.shape}"
        raise InputError(own[0].files[0], f"{files}; expected dark frames of the pictures' size")
    return level, darkness.noise, counted(count, "dark frame"), notes


# ---- what names and tables tell


def _of_names(folder: Path) -> list[tuple[Path, float | None, float | None]]:
    told = []
    for file in sorted(path for path in folder.iterdir() if path.suffix.lower() in READABLE):
        if file.name.lower().startswith("dark"):
            told.append((file, None, _only(_EXPOSURE, _UNITS_S, file)))
            continue
        distance_m = _only(_DISTANCE, _UNITS_M, file)
        if distance_m is None:
            reason = "its name tells no distance, such as 12.5cm; name it so, move it away, or list the pictures in "
            raise InputError(file, f"{reason}{TABLE} with the columns file and distance_cm")
        told.append((file, distance_m, _only(_EXPOSURE, _UNITS_S, file)))
    return told


def _only(pattern: re.Pattern[str], units: dict[str, float], file: Path) -> float | None:
    """Return the one number with a unit that a name tells, in SI units."""
    found = {_si(number, units[unit.lower()]) for number, unit in pattern.findall(file.stem)}
    if len(found) > 1:
        raise InputError(file, f"its name tells {len(found)} numbers of one kind; list the pictures in {TABLE} instead")
    return next(iter(found), None)


def _si(number: str, unit: float) -> float:
    return float(f"{float(number.replace(',', '.')) * unit:.12g}")  # 12.5 cm and 125 mm are one distance


def _of_table(folder: Path, table: Path) -> list[tuple[Path, float | None, float | None]]:
    lines = read_text(table, "a table of pictures").splitlines()
    separator, decimal = (";", ",") if lines and ";" in lines[0] else (",", ".")  # as spreadsheets of a country save it
    reader = csv.DictReader(lines, skipinitialspace=True, delimiter=separator)
    heads = {head.strip().lower(): head for head in reader.fieldnames or []}
    distance, unit_m = _column(heads, "distance", _UNITS_M)
    exposure, unit_s = _column(heads, "exposure", _UNITS_S)
    if "file" not in heads or distance is None:
        got = ", ".join(heads) or "nothing"
        raise InputError(table, f"its head is {got}; expected file, distance_cm and, if you like, exposure_ms")
    told: dict[Path, tuple[Path, float | None, float | None]] = {}
    for row in reader:
        place = f"{table}:{reader.line_num}"
        name = (row[heads["file"]] or "").strip()
        file = folder / name
        if not name or not file.is_file():
            raise InputError(place, f"got the file {show(name)}, which is not in {folder}")
        if file in told:
            raise InputError(place, f"got the file {show(name)} again; keep one line of each file")
        distance_m = _cell(row[distance], unit_m, place, decimal, darkness=True)
        exposure_s = None if exposure is None else _cell(row[exposure], unit_s, place, decimal)
        told[file] = (file, distance_m, exposure_s)
    return list(told.values())


def _column(heads: dict[str, str], what: str, units: dict[str, float]) -> tuple[str | None, float]:
    for unit, factor in units.items():
        if f"{what}_{unit}" in heads:
            return heads[f"{what}_{unit}"], factor
    return None, 1.0


def _cell(text: str | None, unit: float, place: str, decimal: str, *, darkness: bool = False) -> float | None:
    words = (text or "").strip().lower()
    if not words or (darkness and words == "dark"):
        return None
    try:
        value = float(words.replace(decimal, ".")) * unit
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise InputError(place, f"got {show(text)}, expected a positive number" + (", or dark" if darkness else ""))
    return float(f"{value:.12g}")
