"""Folders of images with depth charts: which chart belongs to which image, and which images are one sequence.

EndoSLAM's UnityCam: ``Frames/image_0000.png`` beside ``Pixelwise Depths/aov_image_0000.png``; its published sample:
``train_frame/image_0000.png`` beside ``train_depth/aov_image_0000.png``; SimCol3D:
``Frames_S1/FrameBuffer_0000.png`` and ``Frames_S1/Depth_0000.png``. A file is a depth chart when its name, or its folder's,
says so; pairs have the same number, and the same names once the words for images and for depth are taken out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from simulator.errors import InputError
from simulator.importers.depth_sequences import Pair
from simulator.importers.inspection import Likeness
from simulator.importers.listing import Fault, is_folder, walk

_SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}
_DEPTH = re.compile(r"depth|aov", re.IGNORECASE)
_OWN = re.compile(r"aov_image|Pixelwise Depths")
_WORDS = re.compile(r"pixelwise|depths?|aov|framebuffer|frames?|images?|rgb|colou?r|[\s_-]+", re.IGNORECASE)
_ALONE = "has no {} of its number: fetch it or take this away"
_GLANCE = 1000


def list_pairs(root: Path) -> tuple[tuple[Pair, ...], tuple[Fault, ...]]:
    """Find all pairs below a folder, sequence after sequence in sorted order; no file is opened.

    Returns:
        The pairs; and folders without depth charts and files without partner, each with the reason.

    Raises:
        InputError: when there is no such folder, one cannot be read, or none holds a pair.
    """
    if not is_folder(root):
        raise InputError("path", f"{root} does not exist; expected a folder with images and depth charts")
    images: dict[tuple[Path, str, str], dict[int, Path]] = {}
    depths: dict[tuple[Path, str, str], dict[int, Path]] = {}
    faults: list[Fault] = []
    for name in sorted(name for _, names in _numbered(root) for name in names):
        key, number, is_depth = _place(name)
        held = (depths if is_depth else images).setdefault(key, {})
        if number in held:
            reason = f"has the number of {held[number].name}, which is used: take one of them away"
            faults.append((str(root / name), reason))
        else:
            held[number] = name
    pairs: list[Pair] = []
    for key, files in images.items():
        charts = depths.pop(key, {})
        folder = next(iter(files.values())).parent
        if not charts:
            reason = f"holds images without any depth chart ({len(files)}): name a narrower path"
            faults.append((str(root / folder), reason))
            continue
        sequence = "/".join(part for part in (folder.as_posix(), key[2]) if part)
        pairs += [Pair(files[n], charts[n], sequence, n) for n in sorted(files.keys() & charts.keys())]
        faults += [(str(root / files[n]), _ALONE.format("depth chart")) for n in sorted(files.keys() - charts.keys())]
        faults += [(str(root / charts[n]), _ALONE.format("image")) for n in sorted(charts.keys() - files.keys())]
    for charts in depths.values():
        folder = next(iter(charts.values())).parent
        reason = f"holds depth charts without any image ({len(charts)}): name their common folder"
        faults.append((str(root / folder), reason))
    if not pairs:
        found = f"; {': '.join(faults[0])}" if faults else ""
        raise InputError("path", f"{root} holds no image_0000.png with aov_image_0000.png or the like{found}")
    return tuple(pairs), tuple(faults)


def recognises(path: Path) -> Likeness | None:
    """How much a folder looks like images with depth charts, by the first names in each of its folders alone."""
    names: dict[bool, dict[tuple[Path, str, str], Path]] = {False: {}, True: {}}
    for _, found in islice(_numbered(path), _GLANCE):
        for name in found[:_GLANCE]:
            key, _, is_depth = _place(name)
            names[is_depth].setdefault(key, name)
        both = next((key for key in names[False] if key in names[True]), None)
        if both is not None:
            image, chart = names[False][both], names[True][both]
            own = _OWN.search(chart.as_posix()) is not None or image.name.startswith("FrameBuffer")
            why = f"has {image} and {chart}"
            return Likeness("sure" if own else "possible", f"{why}, as EndoSLAM and SimCol3D call them" if own else why)
    return None


def _numbered(root: Path) -> Iterator[tuple[Path, list[Path]]]:
    """Each folder with its image files whose names end in a number, relative to the root."""
    for folder, files in walk(root):
        names = (folder.relative_to(root) / file for file in files)
        yield folder, [n for n in names if n.suffix.lower() in _SUFFIXES and n.stem[-1].isdecimal()]


def _place(name: Path) -> tuple[tuple[Path, str, str], int, bool]:
    """What both files of a pair have in common, the number, and whether it is the depth chart."""
    match = re.fullmatch(r"(.*?)(\d+)", name.stem)
    assert match is not None
    front, number = match.groups()
    is_depth = bool(_DEPTH.search(front) or _DEPTH.search(name.parent.name))
    key = (name.parent.parent, _WORDS.sub("", name.parent.name).lower(), _WORDS.sub("", front).lower())
    return key, int(number), is_depth
