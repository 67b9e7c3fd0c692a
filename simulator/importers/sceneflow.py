"""Where the SceneFlow data sets keep their files: pairs of image and disparity, in sequences of numbered frames.

FlyingThings3D: ``frames_cleanpass[_webp]/TRAIN/A/0032/left/0006.png`` with ``disparity/TRAIN/A/0032/left/0006.pfm``.
Monkaa: ``frames_cleanpass/<scene>/left/0001.png``; Driving:
``frames_cleanpass/15mm_focallength/scene_forwards/fast/left/0001.png``.
Flattened (as in STTR's sample): ``RGB_cleanpass/left/A-0032-0006.png`` with ``disparity/left/A-0032-0006.pfm``.
"""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

from simulator.errors import InputError
from simulator.importers.depth_sequences import Pair
from simulator.importers.listing import Fault, is_folder, list_folder, walk

PicturePass: TypeAlias = Literal["cleanpass", "finalpass"]
Eye: TypeAlias = Literal["left", "right"]
Subset: TypeAlias = Literal["all", "TRAIN", "TEST"]

FOCAL_PX = 1050.0
"""35 mm lens on a 32 mm wide film of 960 pixels (the data sets' documentation)."""
WIDE_FOCAL_PX = 450.0
"""The 15 mm lens of half of Driving, on the same film."""
PASSES: tuple[PicturePass, ...] = ("cleanpass", "finalpass")

_IMAGES = {".png", ".webp"}
_DISPARITY = ".pfm"
_WITHOUT_DISPARITY = "has no .pfm at its place below disparity: fetch it or take the image away"


def focal_px(pair: Pair) -> float:
    """Return the focal length in pixels, by the folder's name; only Driving has two."""
    return WIDE_FOCAL_PX if "15mm_focallength" in pair.image.parts else FOCAL_PX


def list_frames(
    path: Path, picture_pass: PicturePass, eye: Eye, subset: Subset
) -> tuple[Path, tuple[Pair, ...], tuple[Fault, ...]]:
    """Find all frames of one eye, sequence after sequence in sorted order; no image is opened.

    Args:
        path: the folder that holds the images' and the disparity folder, one of these two folders, or a folder whose
            only such subfolder holds them.
        picture_pass: which rendering.
        eye: which camera.
        subset: ``TRAIN`` or ``TEST`` of FlyingThings3D's original layout, or both.

    Returns:
        The root, the frames that have both files, and the images that have no disparity.

    Raises:
        InputError: when there is no such folder, one cannot be read, or none holds a frame with both files.
    """
    root, images = find_root(path, (picture_pass,))
    flattened = images.name.startswith("RGB_")
    if flattened and subset != "all":
        raise InputError("subset", f"got {subset!r}, but {root} is flattened, without TRAIN and TEST: leave it out")
    top = images if subset == "all" else images / subset
    eyes = ((folder.relative_to(images), files) for folder, files in walk(top) if folder.name == eye)
    found = sorted(folder / file for folder, files in eyes for file in files if Path(file).suffix.lower() in _IMAGES)
    if not found:
        raise InputError("path", f"{top} holds no .png or .webp in a folder {eye!r}: check path, eye and subset")
    sequences: dict[str, list[Pair]] = {}
    faults: list[Fault] = []
    disparities = cache(_disparities)
    for name in found:
        sequence, number = _place(name, flattened)
        image, folder = images.relative_to(root) / name, Path("disparity") / name.parent
        file = disparities(root / folder).get(name.stem)
        if file is not None:
            sequences.setdefault(sequence, []).append(Pair(image, folder / file, sequence, number))
        else:
            faults.append((str(root / image), _WITHOUT_DISPARITY))
    if not sequences:
        wanted = Path("disparity") / found[0].with_suffix(_DISPARITY)
        raise InputError("path", f"no image in {top} has a disparity; the first wants {root / wanted}: fetch them")
    frames = [frame for held in sequences.values() for frame in sorted(held, key=lambda frame: frame.number)]
    return root, tuple(frames), tuple(faults)


def _place(name: Path, flattened: bool) -> tuple[str, int]:
    """The sequence and the number in it; an image without a number is a sequence alone."""
    front, _, last = name.stem.rpartition("-") if flattened else ("", "", name.stem)
    if not last.isdecimal():
        return name.with_suffix("").as_posix(), 0
    return front if flattened else name.parent.parent.as_posix(), int(last)


def _disparities(folder: Path) -> dict[str, str]:
    """The disparity files in a folder, by their names without the ending."""
    paths = (Path(name) for name in list_folder(folder)[1])
    return {path.stem: path.name for path in paths if path.suffix.lower() == _DISPARITY}


def find_root(path: Path, passes: tuple[PicturePass, ...]) -> tuple[Path, Path]:
    """Find the data set's root and its folder of images; of several passes the first that is there.

    Raises:
        InputError: when there is none, or several data sets are.
    """
    names = tuple(name for each in passes for name in (f"frames_{each}", f"frames_{each}_webp", f"RGB_{each}"))
    if not is_folder(path):
        raise InputError("path", f"{path} does not exist; expected the folder of {names[0]} and disparity")
    parent = [path.parent] if path.name in (*names, "disparity") else []
    children = [path / name for name in list_folder(path)[0]]
    for candidates in ([path, *parent], children):
        # A neighbour that cannot be read is no reason to refuse the data set beside it.
        roots = [root for root in candidates if any(os.path.isdir(root / name) for name in names)]
        if len(roots) > 1:
            raise InputError("path", f"{path} holds several data sets ({roots[0].name}, {roots[1].name}): name one")
        if roots:
            return roots[0], next(roots[0] / name for name in names if is_folder(roots[0] / name))
    here = ", ".join(child.name for child in children[:6]) or "no folders"
    raise InputError(
        "path", f"{path} has none of {', '.join(names)} (it has {here}): name the root, check picture_pass"
    )
