"""Folders of pictures with depth charts: which chart belongs to which picture, and which pictures are one sequence.

EndoSLAM's UnityCam: ``Frames/image_0000.png`` beside ``Pixelwise Depths/aov_image_0000.png``; its published sample:
``train_frame/image_0000.png`` beside ``train_depth/aov_image_0000.png``; SimCol3D:
``Frames_S1/FrameBuffer_0000.png`` and ``Frames_S1/Depth_0000.png``. A file is a depth chart when its name, or its folder's,
says so; pairs have the same number, and the same names once the words for pictures and for depth are taken out.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from simulator.errors import InputError

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}
_DEPTH = re.compile(r"depth|aov", re.IGNORECASE)
_WORDS = re.compile(r"pixelwise|depths?|aov|framebuffer|frames?|images?|rgb|colou?r|[\s_-]+", re.IGNORECASE)
_GLANCE = 1000
_NAMED = 3


@dataclass(frozen=True)
class Pair:
    """One picture with its depth chart.

    Attributes:
        picture: file, relative to the data set's root.
        depth: file, relative to the data set's root.
        sequence: the folder of pictures, and what their names begin with where one folder holds several sequences.
        number: the frame's number.
    """

    picture: Path
    depth: Path
    sequence: str
    number: int


def list_pairs(root: Path) -> tuple[tuple[Pair, ...], tuple[str, ...]]:
    """Find all pairs below a folder, sequence after sequence in sorted order; no file is opened.

    Returns:
        The pairs, and a line for each folder without depth charts and each file without partner (the first three of a
        sequence by name, the rest counted).

    Raises:
        InputError: when there is no such folder, or no pair in it.
    """
    if not root.is_dir():
        msg = f"path: there is no folder {root}; expected one with pictures and depth charts somewhere below it"
        raise InputError(msg)
    pictures: dict[tuple[Path, str, str], dict[int, Path]] = {}
    depths: dict[tuple[Path, str, str], dict[int, Path]] = {}
    problems: list[str] = []
    for name in sorted(name for _, names in _numbered(root) for name in names):
        key, number, is_depth = _place(name)
        held = (depths if is_depth else pictures).setdefault(key, {})
        if number in held:
            problems.append(
                f"{root / name}: has the number of {held[number].name}, which is used: take one of them away"
            )
        else:
            held[number] = name
    pairs: list[Pair] = []
    for key, files in pictures.items():
        charts = depths.pop(key, {})
        folder = next(iter(files.values())).parent
        if not charts:
            problems.append(
                f"{root / folder}: holds pictures without any depth chart ({len(files)}): name a narrower path"
            )
            continue
        sequence = "/".join(part for part in (folder.as_posix(), key[2]) if part)
        pairs += [Pair(files[n], charts[n], sequence, n) for n in sorted(files.keys() & charts.keys())]
        problems += _alone(root, [files[n] for n in sorted(files.keys() - charts.keys())], "depth chart")
        problems += _alone(root, [charts[n] for n in sorted(charts.keys() - files.keys())], "picture")
    for charts in depths.values():
        folder = next(iter(charts.values())).parent
        problems.append(
            f"{root / folder}: holds depth charts without any picture ({len(charts)}): name their common folder"
        )
    if not pairs:
        found = f"; {problems[0]}" if problems else ""
        msg = (
            f"path: {root} holds no pictures with depth charts (such as image_0000.png with aov_image_0000.png, or "
            f"FrameBuffer_0000.png with Depth_0000.png){found}"
        )
        raise InputError(msg)
    return tuple(pairs), tuple(problems)


def recognises(path: Path) -> bool:
    """Return whether a folder looks like pictures with depth charts, by the first names in each of its folders alone."""
    keys: dict[bool, set[tuple[Path, str, str]]] = {False: set(), True: set()}
    for _, names in islice(_numbered(path), _GLANCE):
        for name in names[:_GLANCE]:
            key, _, is_depth = _place(name)
            keys[is_depth].add(key)
        if keys[False] & keys[True]:
            return True
    return False


def _numbered(root: Path) -> Iterator[tuple[Path, list[Path]]]:
    """Each folder with its picture files whose names end in a number, relative to the root."""
    for folder, _, files in os.walk(root):
        names = (Path(folder, file).relative_to(root) for file in files)
        yield Path(folder), [n for n in names if n.suffix.lower() in _SUFFIXES and n.stem[-1].isdecimal()]


def _place(name: Path) -> tuple[tuple[Path, str, str], int, bool]:
    """What both files of a pair have in common, the number, and whether it is the depth chart."""
    match = re.fullmatch(r"(.*?)(\d+)", name.stem)
    assert match is not None
    front, number = match.groups()
    is_depth = bool(_DEPTH.search(front) or _DEPTH.search(name.parent.name))
    key = (name.parent.parent, _WORDS.sub("", name.parent.name).lower(), _WORDS.sub("", front).lower())
    return key, int(number), is_depth


def _alone(root: Path, files: list[Path], partner: str) -> list[str]:
    lines = [f"{root / name}: has no {partner} of its number: fetch it or take this away" for name in files[:_NAMED]]
    if len(files) > _NAMED:
        lines.append(f"{root / files[_NAMED].parent}: {len(files) - _NAMED} more files have no {partner}")
    return lines
