"""Where the SceneFlow data sets keep their files: pairs of picture and disparity in the two layouts that are in use.

Original: ``frames_cleanpass[_webp]/TRAIN/A/0032/left/0006.png`` with ``disparity/TRAIN/A/0032/left/0006.pfm``.
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

_PICTURES = {".png", ".webp"}


@dataclass(frozen=True)
class Frame:
    """One picture with its disparity; the paths are relative to the data set's root."""

    picture: Path
    disparity: Path


def list_frames(path: Path, picture_pass: PicturePass, eye: Eye, subset: Subset) -> tuple[Path, tuple[Frame, ...]]:
    """Find all frames of one eye, in sorted order; no picture is opened.

    Args:
        path: the folder that holds the pictures' and the disparity folder, one of these two folders, or a folder whose
            only such subfolder holds them.
        picture_pass: which rendering.
        eye: which camera.
        subset: ``TRAIN`` or ``TEST`` of the original layout, or both.

    Returns:
        The root and the frames.

    Raises:
        InputError: when there is no such folder, it holds no frame, or a picture has no disparity.
    """
    root, pictures = _find_root(path, picture_pass)
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
    frames = tuple(
        Frame(pictures.relative_to(root) / name, Path("disparity") / name.with_suffix(".pfm")) for name in found
    )
    missing = [frame for frame in frames if not (root / frame.disparity).is_file()]
    if missing:
        msg = (
            f"{len(missing)} of {len(frames)} pictures in {top} have no disparity; the first, {missing[0].picture}, "
            f"needs {missing[0].disparity}: fetch it or take the picture away"
        )
        raise InputError(msg)
    return root, frames


def _find_root(path: Path, picture_pass: PicturePass) -> tuple[Path, Path]:
    """The data set's root and its folder of pictures."""
    names = (f"frames_{picture_pass}", f"frames_{picture_pass}_webp", f"RGB_{picture_pass}")
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
