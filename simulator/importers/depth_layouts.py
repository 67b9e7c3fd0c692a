"""How folders that nobody documented hold images with depth: which files look like charts, and which images go with them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from simulator.errors import InputError
from simulator.importers.camera_models import nearest_file
from simulator.importers.depth_files import DEPTH_SUFFIXES, read_chart
from simulator.importers.depth_sequences import Pair
from simulator.importers.file_pairs import WORDS, pairs_of_folders
from simulator.importers.film_files import IMAGE_SUFFIXES
from simulator.importers.inspection import Likeness
from simulator.importers.listing import is_folder, natural, walk
from simulator.text import length

_DEPTH = re.compile(r"depth|disp|aov", re.IGNORECASE)
_STEREO = re.compile(r"(?:im|disp)([01])(?:GT)?")  # Middlebury's numbers are those of the cameras
_FOLDERS, _NAMES, _UNNAMED = 100, 200, 8
"""How much is looked at before anything is paired: folders, names in each, and kinds of files that no word tells apart."""


@dataclass(frozen=True)
class Meaning:
    """What charts are likely to hold.

    Attributes:
        depth: what their numbers mean, as ``rgb_depth`` takes it, or None where nothing tells.
        because: what that is concluded from, or what to give.
        intrinsics_file: name of a file with intrinsics beside the images or above them, or None.
    """

    depth: dict[str, Any] | None
    because: str
    intrinsics_file: str | None


@dataclass(frozen=True)
class Layout:
    """Images and charts that seem to belong together.

    Attributes:
        images: folder or pattern, as ``rgb_depth`` takes it.
        depths: the same of charts.
        pairs: what both match.
        meaning: of the charts.
        likeness: how sure all that is.
    """

    images: str
    depths: str
    pairs: tuple[Pair, ...]
    meaning: Meaning
    likeness: Likeness


@dataclass(frozen=True)
class _Series:
    """Files of one folder whose names have the same form, such as ``Depth_*.png``."""

    folder: Path
    form: str
    names: tuple[str, ...]

    @cached_property
    def keys(self) -> frozenset[tuple[tuple[int, str], ...]]:
        """What the first names have in common with those of their partners."""
        return frozenset(
            tuple(natural(WORDS.sub("", Path(name).stem).lower())) for name in sorted(self.names, key=natural)[:_NAMES]
        )

    def differing(self, other: _Series) -> tuple[str, ...] | None:
        """The parts of its folder's path that differ from the other's, None where they lie on different levels."""
        if len(self.folder.parts) != len(other.folder.parts):
            return None
        return tuple(own for own, its in zip(self.folder.parts, other.folder.parts, strict=True) if own != its)

    def says_depth(self, other: _Series) -> bool:
        """Whether its name and those of its folders say so more often than the other's."""
        mine, its = (len(_DEPTH.findall(f"{one.folder.as_posix()}/{one.form}")) for one in (self, other))
        return mine > its


def find_layouts(root: Path) -> list[Layout]:
    """Return the ways to pair the files in a folder and below it, the surest first; one chart of each kind is opened.

    Raises:
        InputError: a folder cannot be read.
    """
    if not is_folder(root):
        return []
    series = [one for folder, names in islice(walk(root), _FOLDERS) for one in _series(folder.relative_to(root), names)]
    found: dict[Any, list[tuple[_Series, _Series]]] = {}
    for charts in series:
        if Path(charts.form).suffix.lower() in DEPTH_SUFFIXES and (images := _partner(charts, series)) is not None:
            alike = images.form, charts.form, images.differing(charts), charts.differing(images)
            found.setdefault(alike, []).append((images, charts))
    named = [both for both in found.values() if both[0][1].says_depth(both[0][0])]
    unnamed = [both for both in found.values() if both not in named][:_UNNAMED]
    layouts = [layout for both in named + unnamed if (layout := _layout(root, both)) is not None]
    return sorted(layouts, key=lambda layout: (layout.likeness.rank, len(layout.pairs)), reverse=True)


def _series(folder: Path, names: Sequence[str]) -> list[_Series]:
    """Sort the names of a folder by what they have in common: words for images and depth, and the ending."""
    forms: dict[str, list[str]] = {}
    for name in names:
        path = Path(name)
        if path.suffix.lower() in IMAGE_SUFFIXES | DEPTH_SUFFIXES:
            stem = path.stem if _STEREO.fullmatch(path.stem) else _form(path.stem)
            forms.setdefault(stem + path.suffix, []).append(name)
    return [_Series(folder, form, tuple(held)) for form, held in forms.items()]


def _form(stem: str) -> str:
    """A name's words and what parts them, stars for the rest.

    Example:
        >>> [_form(stem) for stem in ("FrameBuffer_0000", "0012_color", "IMG_2044 (2)", "Adirondack")]
        ['FrameBuffer_*', '*_color', 'IMG_* *', '*']
    """
    parts, last = [], 0
    for word in WORDS.finditer(stem):
        parts += ["*"] * (word.start() > last) + [word[0]]
        last = word.end()
    return "".join([*parts, *["*"] * (len(stem) > last)])


def _partner(charts: _Series, series: Sequence[_Series]) -> _Series | None:
    """The series of images that charts go with: in the same folder, or in one that differs in one part of its path."""
    camera = _STEREO.fullmatch(Path(charts.form).stem)
    best: tuple[tuple[bool, int, bool], _Series] | None = None
    for images in series:
        parts = images.differing(charts)
        is_image = images is not charts and Path(images.form).suffix.lower() in IMAGE_SUFFIXES
        if parts is None or len(parts) > 1 or not is_image or images.says_depth(charts):
            continue
        says = charts.says_depth(images)
        if camera is not None:
            both = int(not parts and says and Path(images.form).stem == f"im{camera[1]}")
        else:
            both = len(charts.keys & images.keys)
        rank = says, both, not parts
        if both and (best is None or rank > best[0]):
            best = rank, images
    return None if best is None else best[1]


def _layout(root: Path, both: list[tuple[_Series, _Series]]) -> Layout | None:
    """Judge images and charts of the same forms, in whatever folders; None where the charts are none."""
    images, charts = both[0]
    kind, says_depth = _chart(root / charts.folder / charts.names[0]), charts.says_depth(images)
    if kind is None or not (says_depth or kind.strong):
        return None
    if not says_depth and _is_strong(root / images.folder / images.names[0]):
        return None  # images of the same kind: nothing tells which of them are the charts
    patterns = [_pattern([pair[place] for pair in both]) for place in (0, 1)]
    try:
        pairs, faults = pairs_of_folders(root, *patterns)
    except InputError:
        return None
    total = len(pairs) + sum("has no image" in reason for _, reason in faults)
    meaning = find_meaning(root, pairs[0])
    said = "named as depth" if says_depth else "not named as depth, but images are not stored so"
    why = f"{len(pairs)} of {total} charts pair with an image by {_how(pairs)}; charts are {kind.text}, {said}"
    sure = says_depth and kind.strong and len(pairs) == total
    likeness = Likeness("sure" if sure else "likely" if 2 * len(pairs) >= total else "possible", why)
    return Layout(patterns[0], patterns[1], pairs, meaning, likeness)


def _how(pairs: Sequence[Pair]) -> str:
    if all(pair.image.stem == pair.depth.stem for pair in pairs):
        return "name"
    return "folder" if len({pair.image.name for pair in pairs}) == 1 < len(pairs) else "number"


def _pattern(series: Sequence[_Series]) -> str:
    """The folder of one series that is named by its folder, else a pattern for all of them."""
    folders = [one.folder.parts for one in series]
    if len({len(parts) for parts in folders}) > 1:
        return f"**/{series[0].form}"
    parts = [held[0] if len(set(held)) == 1 else "*" for held in zip(*folders, strict=True)]
    return "/".join([*parts, series[0].form])


@dataclass(frozen=True)
class _Kind:
    """What a chart holds: in words, whether images hardly ever do, and its largest number."""

    text: str
    strong: bool
    highest: float
    whole: bool


def _chart(path: Path) -> _Kind | None:
    """What a file would hold as a chart; None where it is none."""
    try:
        values = read_chart(path)
    except (InputError, OSError):
        return None
    known = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    low, high = (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)
    unknown = 1 - known.size / values.size
    whole = values.dtype.kind != "f"
    text = f"{8 * values.dtype.itemsize} bit codes" if whole else f"{path.suffix[1:].upper()} in floating point,"
    text += f" {low:.5g} to {high:.5g}" + (f", {unknown:.1%} of pixels inf or NaN" if unknown else "")
    return _Kind(text, not whole or values.dtype.itemsize > 1, high, whole)


def _is_strong(path: Path) -> bool:
    kind = _chart(path)
    return kind is not None and kind.strong


def find_meaning(root: Path, pair: Pair) -> Meaning:
    """Return what the numbers of a chart are likely to mean, by its name, its kind and the files beside its image."""
    file, kind = nearest_file(root, (root / pair.image).parent), _chart(root / pair.depth)
    name = None if file is None else file.name
    if pair.image.name.startswith("FrameBuffer") and pair.depth.name.startswith("Depth"):
        depth = {"type": "linear", "full_cm": 20, "full_code": 65280}
        return Meaning(depth, "as SimCol3D's own code reads it, code / 65280 x 20 cm", name)
    if re.search("disp", pair.depth.as_posix(), re.IGNORECASE):
        if name == "calib.txt":
            return Meaning({"type": "disparity"}, "disparity; calib.txt holds focal length, baseline and doffs", name)
        return Meaning(None, "named as disparity: {type: disparity, focal_px: ..., baseline_mm: ...}", name)
    if kind is None or not kind.strong:
        reason = (
            "8 bits say nothing of the unit: {type: linear, full_cm: ...}, or {type: inverse, ...} where bright is near"
        )
        return Meaning(None, reason, name)
    unit, metres = ("mm", kind.highest * 1e-3) if kind.whole else ("m", kind.highest)
    guess = (
        f"{unit} is a guess, by which the first chart reaches {length(metres)}: compare the data set's documentation"
    )
    other = "; TUM's have 5000 per m: {type: metric, unit: m, codes_per_unit: 5000}" if kind.whole else ""
    return Meaning({"type": "metric", "unit": unit}, guess + other, name)
