"""Where the SceneFlow data sets keep their files: pairs of picture and disparity, in sequences of numbered frames.

FlyingThings3D: ``frames_cleanpass[_webp]/TRAIN/A/0032/left/0006.png`` with ``disparity/TRAIN/A/0032/left/0006.pfm``.
Monkaa: ``frames_cleanpass/<scene>/left/0001.png``; Driving:
``frames_cleanpass/15mm_focallength/scene_forwards/fast/left/0001.png``.
Flattened (as in STTR's sample): ``RGB_cleanpass/left/A-0032-0006.png`` with ``disparity/left/A-0032-0006.pfm``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from simulator.errors import InputError

PicturePass: TypeAlias = Literal["cleanpass", "finalpass"]
Eye: TypeAlias = Literal["left", "right"]
Subset: TypeAlias = Literal["all", "TRAIN", "TEST"]

FOCAL_PX = 1050.0
"""35 mm lens on a 32 mm wide film of 960 pixels (the data sets' documentation)."""
WIDE_FOCAL_PX = 450.0
"""The 15 mm lens of half of Driving, on the same film."""
PASSES: tuple[PicturePass, ...] = ("cleanpass", "finalpass")

_PICTURES = {".png", ".webp"}


@dataclass(frozen=True)
class Frame:
    """One picture with its disparity.

    Attributes:
        picture: file, relative to the data set's root.
        disparity: file, relative to the data set's root.
        sequence: what the sequence is called: the folders below the pass without the eye, or the flattened name's front.
        number: the frame's number in its sequence.
    """

    picture: Path
    disparity: Path
    sequence: str
    number: int

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, by the folder's name; only Driving has two."""
        return WIDE_FOCAL_PX if "15mm_focallength" in self.picture.parts else FOCAL_PX


def list_frames(
    path: Path, picture_pass: PicturePass, eye: Eye, subset: Subset
) -> tuple[Path, tuple[Frame, ...], tuple[str, ...]]:
    """Find all frames of one eye, sequence after sequence in sorted order; no picture is opened.

    Args:
        path: the folder that holds the pictures' and the disparity folder, one of these two folders, or a folder whose
            only such subfolder holds them.
        picture_pass: which rendering.
        eye: which camera.
        subset: ``TRAIN`` or ``TEST`` of FlyingThings3D's original layout, or both.

    Returns:
        The root, the frames that have both files, and a line for each picture that has no disparity.

    Raises:
        InputError: when there is no such folder, or it holds no frame with both files.
    """
    root, pictures = find_root(path, (picture_pass,))
    flattened = pictures.name.startswith("RGB_")
    if flattened and subset != "all":
        msg = f"subset is {subset!r}, but {root} has the flattened layout without TRAIN and TEST: leave subset out"
        raise InputError(msg)
    top = pictures if subset == "all" else pictures / subset
    found = sorted(file.relative_to(pictures) for file in top.rglob(f"{eye}/*") if file.suffix.lower() in _PICTURES)
    if not found:
        msg = (
            f"path: {top} holds no {eye} picture (.png or .webp in a folder named {eye!r}): check path, eye and subset"
        )
        raise InputError(msg)
    sequences: dict[str, list[Frame]] = {}
    problems = []
    for name in found:
        sequence, number = _place(name, flattened)
        disparity = Path("disparity") / name.with_suffix(".pfm")
        frame = Frame(pictures.relative_to(root) / name, disparity, sequence, number)
        if (root / disparity).is_file():
            sequences.setdefault(sequence, []).append(frame)
        else:
            problems.append(f"{root / frame.picture}: has no disparity {disparity}: fetch it or take the picture away")
    if not sequences:
        msg = f"none of the {len(found)} pictures in {top} has a disparity; the first, {problems[0]}"
        raise InputError(msg)
    frames = [frame for held in sequences.values() for frame in sorted(held, key=lambda frame: frame.number)]
    return root, tuple(frames), tuple(problems)


def _place(name: Path, flattened: bool) -> tuple[str, int]:
    """The sequence and the number in it; a picture without a number is a sequence of its own."""
    front, _, last = name.stem.rpartition("-") if flattened else ("", "", name.stem)
    if not last.isdecimal():
        return name.with_suffix("").as_posix(), 0
    return front if flattened else name.parent.parent.as_posix(), int(last)


def find_root(path: Path, passes: tuple[PicturePass, ...]) -> tuple[Path, Path]:
    """Find the data set's root and its folder of pictures; of several passes the first that is there.

    Raises:
        InputError: when there is none, or several data sets are.
    """
    names = tuple(name for each in passes for name in (f"frames_{each}", f"frames_{each}_webp", f"RGB_{each}"))
    if not path.is_dir():
        msg = f"path: there is no folder {path}; expected the one that holds {names[0]} (or {names[2]}) and disparity"
        raise InputError(msg)
    parent = [path.parent] if path.name in (*names, "disparity") else []
    children = sorted(child for child in path.iterdir() if child.is_dir())
    for candidates in ([path, *parent], children):
        roots = [root for root in candidates if any((root / name).is_dir() for name in names)]
        if len(roots) > 1:
            msg = f"path: {path} has several data sets in it ({roots[0].name}, {roots[1].name}): name one of them"
            raise InputError(msg)
        if roots:
            return roots[0], next(roots[0] / name for name in names if (roots[0] / name).is_dir())
    here = ", ".join(child.name for child in children[:6]) or "no folders"
    msg = f"path: {path} has none of {', '.join(names)} (it has {here}): name the data set's root, check picture_pass"
    raise InputError(msg)
