"""Where the SceneFlow data sets keep their files: pairs of picture and disparity, in sequences of numbered frames.

FlyingThings3D: ``frames_cleanpass[_webp]/TRAIN/A/0032/left/0006.png`` with ``disparity/TRAIN/A/0032/left/0006.pfm``.
Monkaa: ``frames_cleanpass/<scene>/left/0001.png``; Driving:
``frames_cleanpass/15mm_focallength/scene_forwards/fast/left/0001.png``.
Flattened (as in STTR's sample): ``RGB_cleanpass/left/A-0032-0006.png`` with ``disparity/left/A-0032-0006.pfm``.

What lies in a folder of FlyingThings3D, Monkaa or Driving: every picture and disparity is read once.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias

from simulator.errors import InputError
from simulator.importers.disparity import disparity_range, read_disparity
from simulator.importers.inspection import Progress, Survey
from simulator.importers.listing import Fault, fault_of, grouped, is_folder, list_folder, run_lengths, walk
from simulator.pictures import read_picture

PicturePass: TypeAlias = Literal["cleanpass", "finalpass"]
Eye: TypeAlias = Literal["left", "right"]
Subset: TypeAlias = Literal["all", "TRAIN", "TEST"]

FOCAL_PX = 1050.0
"""35 mm lens on a 32 mm wide film of 960 pixels (the data sets' documentation)."""
WIDE_FOCAL_PX = 450.0
"""The 15 mm lens of half of Driving, on the same film."""
PASSES: tuple[PicturePass, ...] = ("cleanpass", "finalpass")

_PICTURES = {".png", ".webp"}
_DISPARITY = ".pfm"
_WITHOUT_DISPARITY = "has no .pfm at its place below disparity: fetch it or take the picture away"


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
) -> tuple[Path, tuple[Frame, ...], tuple[Fault, ...]]:
    """Find all frames of one eye, sequence after sequence in sorted order; no picture is opened.

    Args:
        path: the folder that holds the pictures' and the disparity folder, one of these two folders, or a folder whose
            only such subfolder holds them.
        picture_pass: which rendering.
        eye: which camera.
        subset: ``TRAIN`` or ``TEST`` of FlyingThings3D's original layout, or both.

    Returns:
        The root, the frames that have both files, and the pictures that have no disparity.

    Raises:
        InputError: when there is no such folder, one cannot be read, or none holds a frame with both files.
    """
    root, pictures = find_root(path, (picture_pass,))
    flattened = pictures.name.startswith("RGB_")
    if flattened and subset != "all":
        msg = f"subset is {subset!r}, but {root} has the flattened layout without TRAIN and TEST: leave subset out"
        raise InputError(msg)
    top = pictures if subset == "all" else pictures / subset
    eyes = ((folder.relative_to(pictures), files) for folder, files in walk(top) if folder.name == eye)
    found = sorted(folder / file for folder, files in eyes for file in files if Path(file).suffix.lower() in _PICTURES)
    if not found:
        msg = (
            f"path: {top} holds no {eye} picture (.png or .webp in a folder named {eye!r}): check path, eye and subset"
        )
        raise InputError(msg)
    sequences: dict[str, list[Frame]] = {}
    faults: list[Fault] = []
    disparities = cache(_disparities)
    for name in found:
        sequence, number = _place(name, flattened)
        picture, folder = pictures.relative_to(root) / name, Path("disparity") / name.parent
        file = disparities(root / folder).get(name.stem)
        if file is not None:
            sequences.setdefault(sequence, []).append(Frame(picture, folder / file, sequence, number))
        else:
            faults.append((str(root / picture), _WITHOUT_DISPARITY))
    if not sequences:
        wanted = Path("disparity") / found[0].with_suffix(_DISPARITY)
        msg = f"none of the {len(found)} pictures in {top} has a disparity; the first wants {root / wanted}: fetch them"
        raise InputError(msg)
    frames = [frame for held in sequences.values() for frame in sorted(held, key=lambda frame: frame.number)]
    return root, tuple(frames), tuple(faults)


def _place(name: Path, flattened: bool) -> tuple[str, int]:
    """The sequence and the number in it; a picture without a number is a sequence of its own."""
    front, _, last = name.stem.rpartition("-") if flattened else ("", "", name.stem)
    if not last.isdecimal():
        return name.with_suffix("").as_posix(), 0
    return front if flattened else name.parent.parent.as_posix(), int(last)


def _disparities(folder: Path) -> dict[str, str]:
    """The disparity files in a folder, by their names without the ending."""
    paths = (Path(name) for name in list_folder(folder)[1])
    return {path.stem: path.name for path in paths if path.suffix.lower() == _DISPARITY}


def find_root(path: Path, passes: tuple[PicturePass, ...]) -> tuple[Path, Path]:
    """Find the data set's root and its folder of pictures; of several passes the first that is there.

    Raises:
        InputError: when there is none, or several data sets are.
    """
    names = tuple(name for each in passes for name in (f"frames_{each}", f"frames_{each}_webp", f"RGB_{each}"))
    if not is_folder(path):
        msg = f"path: there is no folder {path}; expected the one that holds {names[0]} (or {names[2]}) and disparity"
        raise InputError(msg)
    parent = [path.parent] if path.name in (*names, "disparity") else []
    children = [path / name for name in list_folder(path)[0]]
    for candidates in ([path, *parent], children):
        # A neighbour that cannot be read is no reason to refuse the data set beside it.
        roots = [root for root in candidates if any(os.path.isdir(root / name) for name in names)]
        if len(roots) > 1:
            msg = f"path: {path} has several data sets in it ({roots[0].name}, {roots[1].name}): name one of them"
            raise InputError(msg)
        if roots:
            return roots[0], next(roots[0] / name for name in names if is_folder(roots[0] / name))
    here = ", ".join(child.name for child in children[:6]) or "no folders"
    msg = f"path: {path} has none of {', '.join(names)} (it has {here}): name the data set's root, check picture_pass"
    raise InputError(msg)


def recognises(path: Path) -> bool:
    """Return whether a folder looks like a SceneFlow data set, by the names in it alone."""
    try:
        root, _ = find_root(path, PASSES)
    except (InputError, OSError):
        return False
    return (root / "disparity").is_dir()


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    picture_pass: PicturePass | None = None,
    eye: Eye = "left",
    subset: Subset = "all",
) -> Survey:
    """Read every pair of one eye once.

    Args:
        path: as for the importer.
        progress: called with how many pairs were read, and of how many.
        picture_pass: which rendering; None is the first that is there.
        eye: which camera.
        subset: ``TRAIN`` or ``TEST``, or both.

    Returns:
        Sequences and their lengths, sizes, disparities; broken and unpaired files are its problems.

    Raises:
        InputError: when there is no such folder or no pair in it.
    """
    path = Path(path)
    root, pictures = find_root(path, (picture_pass,) if picture_pass else PASSES)
    used: PicturePass = "finalpass" if "finalpass" in pictures.name else "cleanpass"
    _, frames, unpaired = list_frames(path, used, eye, subset)
    faults = list(unpaired)
    good, sizes, ranges, holes = [], set(), [], 0
    for done, frame in enumerate(frames, 1):
        name = root / frame.disparity
        try:
            disparity = read_disparity(name)
            ranges.append(disparity_range(disparity, name))
            shape = read_picture(root / frame.picture).shape
            if shape != (*disparity.shape, 3):
                sizes_text = f"{' x '.join(map(str, shape))}, its disparity {' x '.join(map(str, disparity.shape))}"
                faults.append((str(root / frame.picture), f"is {sizes_text}: fetch both again"))
            else:
                good.append(frame)
                sizes.add(disparity.shape)
                holes += int((disparity == 0).sum())
        except InputError as error:
            faults.append(fault_of(error, name, root / frame.picture))
        if progress is not None:
            progress(done, len(frames))
    names = [frame.sequence for frame in good]
    lengths = run_lengths(names, [frame.number for frame in good]) if good else []
    facts = {
        "pictures": f"{pictures.name}, {eye} eye",
        "sequences": str(len(set(names))),
        "frames": str(len(good)),
        "consecutive frames": f"{min(lengths)} to {max(lengths)}" if lengths else "none",
        "sizes": ", ".join(f"{rows} x {columns}" for rows, columns in sorted(sizes)),
    }
    if ranges:
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        facts["disparity"] = f"{lowest:.4g} to {highest:.4g} px"
    if holes:
        facts["without disparity"] = f"{holes} pixels (valid is false there)"
    if len({frame.focal_px for frame in good}) > 1:
        facts["focal lengths"] = "450 and 1050 px (15 and 35 mm)"
    gaps = len(lengths) - len(set(names))
    notes = [f"gaps in the numbering: {gaps}, which no clip crosses"] if gaps else []
    return Survey("flyingthings3d", path, len(good), facts, grouped(faults), tuple(notes))
