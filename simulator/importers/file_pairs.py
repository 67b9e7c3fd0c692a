"""Which depth chart belongs to which image: two folders or patterns, matched by names or numbers, or a table of pairs."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TypeAlias

from simulator.errors import InputError
from simulator.importers.depth_files import DEPTH_SUFFIXES
from simulator.importers.depth_sequences import Pair
from simulator.importers.film_files import IMAGE_SUFFIXES
from simulator.importers.listing import Fault, examples, is_folder, natural, walk
from simulator.io.files import read_text

COLUMNS = ("image", "depth", "mask", "clip", "frame", "label")
"""Of a table of pairs; the first two must be there."""

WORDS = re.compile(
    r"pixelwise|depth_?maps?|depths?|disparity|disparities|disp|aov|framebuffer|frames?|images?|imgs?|rgb|colou?r|masks?"
    r"|[\s_.-]+",
    re.IGNORECASE,
)
"""What names of images and of charts may differ by."""

_STAR = re.compile(r"(?:\\\*)+")  # stars as re.escape leaves them
_Key: TypeAlias = tuple[tuple[tuple[int, str], ...], ...]


@dataclass(frozen=True)
class _File:
    """A file found: its path from the root, and what varies in its folders and in its name."""

    path: Path
    folder: str
    name: str


def pairs_of_table(table: Path) -> tuple[tuple[Pair, ...], tuple[Fault, ...]]:
    """Read a CSV file of pairs, whose first line names the columns `COLUMNS`; paths start at the table's folder.

    Rows of one ``clip`` are its frames, numbered by ``frame``, else as they come; without either column each row is a still.
    ``mask`` is black where the depth is unknown, ``label`` says what is done in the clip.

    Returns:
        The pairs, clip after clip; and rows whose files do not exist.

    Raises:
        InputError: naming the file and the line.
    """
    lines = read_text(table, "a table of images and depths").splitlines()
    reader = csv.reader(("" if line.startswith("#") else line for line in lines), strict=True)
    try:
        rows = [
            (reader.line_num, [cell.strip() for cell in row]) for row in reader if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise InputError(f"{table}:{reader.line_num}", f"not a line of a CSV file ({error})") from error
    columns = [name.lower() for name in rows[0][1]] if rows else []
    if not {"image", "depth"} <= set(columns) <= set(COLUMNS) or len(set(columns)) < len(columns):
        got = ", ".join(columns)[:80]
        raise InputError(
            table, f"got the columns {got}; expected image and depth, and perhaps {', '.join(COLUMNS[2:])}"
        )
    numbered, pairs, faults = "frame" in columns or "clip" in columns, list[Pair](), list[Fault]()
    counts: dict[str, int] = {}
    for line, cells in rows[1:]:
        row = dict(zip(columns, cells, strict=False))
        if len(cells) != len(columns) or not row["image"] or not row["depth"]:
            raise InputError(f"{table}:{line}", f"got {','.join(cells)[:80]!r}, expected {','.join(columns)}")
        clip = row.get("clip", "") if numbered else row["image"]
        number = row.get("frame", str(counts.get(clip, 0)))
        if not number.isdecimal():
            raise InputError(f"{table}:{line}", f"got the frame {number!r}, expected a whole number")
        counts[clip] = counts.get(clip, 0) + 1
        mask = Path(row["mask"]) if row.get("mask") else None
        files = Path(row["image"]), Path(row["depth"])
        pair = Pair(*files, clip, int(number), mask, row.get("label") or None)
        missing = [file for file in (*files, mask) if file and not os.path.isfile(table.parent / file)]
        if missing:
            faults.append((f"{table.name}:{line}", f"there is no file {missing[0]}: correct the row or take it away"))
        else:
            pairs.append(pair)
    if not pairs:
        found = f"; {': '.join(faults[0])}" if faults else ""
        raise InputError(table, f"names no pair of files that exist{found}")
    return _ordered(pairs, str(table)), tuple(faults)


def pairs_of_folders(
    root: Path, images: str, depths: str, masks: str | None = None
) -> tuple[tuple[Pair, ...], tuple[Fault, ...]]:
    """Match the files of two folders or patterns.

    Args:
        root: where both start.
        images: a folder, all images in which and below it are taken, or a pattern such as ``*/im0.png`` or
            ``**/FrameBuffer_*.png``: ``*`` is any part of a name, ``**`` any folders.
        depths: the same of charts. What the patterns leave open must be the same, in folders the names, else the names
            without words such as rgb and depth, else their last numbers.
        masks: the same of masks.

    Returns:
        The pairs, sequence after sequence: what varies before the last number of a file's name is its sequence. Then files
        without partner, each with the reason.

    Raises:
        InputError: a folder is missing or cannot be read, no files belong together, or more than two do.
    """
    if not is_folder(root):
        raise InputError(
            "path", f"{root} does not exist; expected a folder, or a CSV file with the columns image and depth"
        )
    found = find_files(root, "images", images, IMAGE_SUFFIXES), find_files(root, "depths", depths, DEPTH_SUFFIXES)
    if {file.path for file in found[0]} & {file.path for file in found[1]}:
        raise InputError("images, depths", f"{images} and {depths} are the same files: name two folders or patterns")
    matched = _match(*found, ("images", images), ("depths", depths))
    faults = [
        (str(root / file.path), f"has no {kind} of its name or number: fetch it or take this away")
        for files, taken, kind in zip(found, zip(*matched, strict=True), ("depth chart", "image"), strict=True)
        for file in sorted(set(files) - set(taken), key=lambda file: natural(file.path.as_posix()))
    ]
    of_image: dict[_File, _File] = {}
    if masks is not None:
        others = find_files(root, "masks", masks, DEPTH_SUFFIXES)
        of_image = dict(_match(found[0], others, ("images", images), ("masks", masks)))
        lacking = [file for file, _ in matched if file not in of_image]
        faults += [(str(root / file.path), "has no mask of its name or number: fetch it") for file in lacking]
        matched = [(image, depth) for image, depth in matched if image in of_image]
    pairs = []
    for image, depth in matched:
        front, digits = _numbered(image.name)
        sequence = "/".join(part for part in (image.folder, front) if part) or image.path.parent.name or root.name
        mask = of_image[image].path if image in of_image else None
        pairs.append(Pair(image.path, depth.path, sequence, int(digits or 0), mask))
    return _ordered(pairs, str(root)), tuple(faults)


def find_files(root: Path, key: str, where: str, suffixes: frozenset[str]) -> list[_File]:
    """Return the files of a folder or pattern.

    Raises:
        InputError: naming the key, when there is none.
    """
    place = root / where
    if is_folder(place):
        found = [
            _File(Path(where, *parts, name), "/".join(parts), Path(name).stem)
            for folder, names in walk(place)
            for parts in (folder.relative_to(place).parts,)
            for name in names
            if Path(name).suffix.lower() in suffixes
        ]
        if not found:
            raise InputError(key, f"{place} holds nothing that ends in {' '.join(sorted(suffixes))}")
        return found
    if place.is_file():
        return [_File(Path(where), "", "")]
    if "*" not in where:
        raise InputError(
            key, f"there is no folder {place}; expected one, or a pattern such as */im0.png or **/Depth_*.png"
        )
    parts = Path(where).parts
    fixed = next(k for k, part in enumerate(parts) if "*" in part)
    top = root.joinpath(*parts[:fixed])
    expressions = [_expression(part) for part in parts[fixed:-1]] + [_STAR.sub("([^/]*)", re.escape(parts[-1]))]
    expression = re.compile("".join(expressions))
    in_folders = re.compile("".join(expressions[:-1])).groups
    ending_is_open = parts[-1].endswith("*") or "*" in Path(parts[-1]).suffix
    found = []
    for folder, names in walk(top):
        for name in names:
            path = (folder / name).relative_to(top)
            match = expression.fullmatch(path.as_posix())
            if match is None or (ending_is_open and path.suffix.lower() not in suffixes):
                continue
            stem_end = len(path.with_suffix("").as_posix())
            spans = [match.span(group) for group in range(1, expression.groups + 1)]
            texts = [path.as_posix()[start : min(end, stem_end)] for start, end in spans]
            kept = "/".join(filter(None, texts[:in_folders]))
            found.append(_File(Path(*parts[:fixed], path), kept, "".join(texts[in_folders:])))
    if not found:
        raise InputError(key, f"{where} matches no file in {root}")
    return found


def _expression(folder: str) -> str:
    """The regular expression of a folder in a pattern, a group for each star."""
    return "(?:(.+)/)?" if folder == "**" else _STAR.sub("([^/]*)", re.escape(folder)) + "/"


def _match(left: Sequence[_File], right: Sequence[_File], *names: tuple[str, str]) -> list[tuple[_File, _File]]:
    """Return the files that belong together by the first rule that matches most of them.

    Raises:
        InputError: none do, or the best rule gives one of them several partners.
    """
    best: list[tuple[list[_File], list[_File]]] = []
    for rule in (_whole, _without_words, _last_number):
        groups = _groups(left, rule), _groups(right, rule)
        common = [(groups[0][key], groups[1][key]) for key in groups[0] if key in groups[1]]
        single = [both for both in common if len(both[0]) == len(both[1]) == 1]
        if len(single) > sum(len(both[0]) == len(both[1]) == 1 for both in best) or not best:
            best = common
    keys = ", ".join(key for key, _ in names)
    if not best:
        (_, these), (_, those) = names
        raise InputError(
            keys,
            f"no file of {these} ({left[0].path} and so on) has the name or number of one of {those} ({right[0].path}): "
            "give patterns such as */im0.png and */disp0.pfm, whose stars are the same, or a CSV table of pairs",
        )
    for both in best:
        for files in both:
            if len(files) > 1:
                listed = examples([file.path.as_posix() for file in files])
                other = (both[0] if files is both[1] else both[1])[0].path
                raise InputError(
                    keys, f"{listed} all belong to {other}: name those that are meant by a pattern such as */im0.png"
                )
    return [(images[0], charts[0]) for images, charts in best]


def _groups(files: Sequence[_File], rule: Callable[[_File], _Key | None]) -> dict[_Key, list[_File]]:
    found: dict[_Key, list[_File]] = {}
    for file in files:
        if (key := rule(file)) is not None:
            found.setdefault(key, []).append(file)
    return found


def _whole(file: _File) -> _Key:
    return tuple(tuple(natural(text)) for text in (file.folder, file.name))


def _without_words(file: _File) -> _Key:
    return tuple(tuple(natural(WORDS.sub("", text).lower())) for text in (file.folder, file.name))


def _last_number(file: _File) -> _Key | None:
    digits = re.findall(r"[0-9]+", file.name)
    return (tuple(natural(WORDS.sub("", file.folder).lower())), ((int(digits[-1]), ""),)) if digits else None


def _numbered(name: str) -> tuple[str, str]:
    """What a name begins with, and its last number; words after it, as in 0001_color, tell nothing of a sequence.

    Example:
        >>> _numbered("a_0007_color"), _numbered("Adirondack")
        (('a', '0007'), ('Adirondack', ''))
    """
    match = re.fullmatch(r"(.*?)[\s_.-]*([0-9]+)([^0-9]*)", name)
    if match is None or WORDS.sub("", match[3]):
        return name, ""
    return WORDS.sub("", match[1]), match[2]


def _ordered(pairs: list[Pair], name: str) -> tuple[Pair, ...]:
    """Return pairs sequence after sequence, by their numbers.

    Raises:
        InputError: naming where they come from, when a number comes twice in a sequence.
    """
    ordered = sorted(pairs, key=lambda pair: (natural(pair.sequence), pair.sequence, pair.number))
    for pair, following in pairwise(ordered):
        if (pair.sequence, pair.number) == (following.sequence, following.number):
            both = f"{pair.image} and {following.image}"
            raise InputError(name, f"{both} are both frame {pair.number} of {pair.sequence or 'the clip'}: keep one")
    return tuple(ordered)
