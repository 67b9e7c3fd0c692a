"""YouTube-VOS videos as flat scenes: the labelled objects without their background, with their category as the label.

Source: Xu et al., YouTube-VOS: A Large-Scale Video Object Segmentation Benchmark, arXiv 1809.03327: films of 30 frames per
second, of which every fifth frame is annotated, hence six frames per second.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from simulator.errors import InputError
from simulator.importers.inspection import Progress, Survey
from simulator.importers.listing import is_folder, list_folder
from simulator.importers.masked_videos import Categories, Found, RaiseWith, find_videos, masked_source, survey_videos
from simulator.importers.videos import ClipPlan, FlatVideos
from simulator.types import View

FILMED_AT = 30.0
"""Frames per second at which pictures are numbered: 00000, 00005, 00010, ... (the paper, section 3)."""

Subset = Literal["train", "valid", "test"]
_SUBSETS = ("train", "valid", "test")
_PICTURES, _MASKS, _META = "JPEGImages", "Annotations", "meta.json"


def youtube_vos(
    view: View,
    *,
    path: Path,
    frames: Annotated[int, Field(ge=1)],
    subset: Subset | None = None,
    frames_per_second: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    clips_per_video: Annotated[int, Field(ge=1)] = 1,
    crop: Literal["centre", "random"] = "centre",
    plane_cm: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    keep_background: bool = False,
    raise_by: Annotated[int, Field(ge=1)] = 1,
    raise_with: RaiseWith = "optical_flow",
    superslomo_checkpoint: Path | None = None,
) -> FlatVideos:
    """Read clips of the labelled objects of YouTube-VOS.

    Files are listed at once and read when a clip is asked for. Only annotated frames are used. What is not labelled is black:
    the background is all pixels that belong to no object of the frame's mask. The masks of ``valid`` and ``test`` hold each
    object only in the frame where it appears first.

    Args:
        view: the camera's view: size of the clips, far depth.
        path: the folder that holds ``train`` (or ``valid``), or that folder itself, with JPEGImages, Annotations, meta.json.
        frames: frames of a clip, after raising; videos have 4 to 36 that are annotated.
        subset: which folder; null takes path itself, or train where path holds it.
        frames_per_second: rate at which a clip is taken to run; null is the video's own, 6 per second, times raise_by.
        clips_per_video: clips that one video gives, evenly spread; 1 begins at a random frame.
        crop: where the largest window of the view's proportions is cut out, the same for all frames of a clip.
        plane_cm: depth of the plane that shows the clip; null is the far depth.
        keep_background: leave pictures as they are; then frames without a mask are used too.
        raise_by: frames that one becomes by interpolation, after the background is removed; 1 leaves them.
        raise_with: how frames are interpolated.
        superslomo_checkpoint: file of the published network's weights, for superslomo.

    Returns:
        A scene source. A clip's label is its video's category if all objects have the same one, else none; all categories are
        recorded.

    Raises:
        InputError: for missing folders, a damaged meta.json, or when no video is long enough.
    """
    found = find(Path(path), subset=subset, keep_background=keep_background)
    plan = ClipPlan(frames, frames_per_second, raise_by, clips_per_video, crop)
    return masked_source(
        "youtube_vos",
        view,
        found,
        plan,
        plane_cm=plane_cm,
        raise_with=raise_with,
        superslomo_checkpoint=superslomo_checkpoint,
        other_inputs=[found.root / _META],
    )


def recognises(path: Path) -> bool:
    """Whether a folder is laid out like YouTube-VOS; looks at names only."""
    return any((folder / _META).is_file() and (folder / _PICTURES).is_dir() for folder in _candidates(path))


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    subset: Subset | None = None,
    keep_background: bool = False,
    frames: int | None = None,
    raise_by: int = 1,
) -> Survey:
    """Read every annotated frame and its mask once and say what is there.

    Args:
        path: as all others, see :func:`youtube_vos`.
        progress: called with the number of frames done and of all frames.
        subset: which folder.
        keep_background: whether frames without a mask count.
        frames: of a clip; with it, videos that are too short are among the problems.
        raise_by: counts with ``frames``.

    Raises:
        InputError: as :func:`youtube_vos`.
    """
    found = find(path, subset=subset, keep_background=keep_background)
    return survey_videos("youtube_vos", found, progress, frames, raise_by)


def find(path: Path, *, subset: Subset | None = None, keep_background: bool = False) -> Found:
    """List the videos of one subset.

    Raises:
        InputError: for missing folders or a damaged meta.json.
    """
    root = _root(path, subset)
    categories = read_categories(root / _META)
    return find_videos(
        root, root / _PICTURES, root / _MASKS, FILMED_AT, categories=categories, keep_background=keep_background
    )


def read_categories(path: Path) -> dict[str, Categories]:
    """Read ``meta.json``: of each video the category of each object, None where the release gives none (valid of 2019).

    Raises:
        InputError: naming the file, when it is missing or not such a file.
    """
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        msg = f"{path} is missing, which lists the videos' objects and categories: fetch it from the data set's release"
        raise InputError(msg) from None
    except (OSError, ValueError) as error:
        msg = f"{path} cannot be read as JSON ({error}): fetch it again"
        raise InputError(msg) from error
    try:
        return {name: _categories(video["objects"]) for name, video in meta["videos"].items()}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        msg = (
            f"{path} is not laid out like YouTube-VOS ({type(error).__name__}: {error}): expected "
            '{"videos": {name: {"objects": {"1": {"category": ..., "frames": [...]}}}}}'
        )
        raise InputError(msg) from error


def _categories(objects: dict[str, dict[str, Any]]) -> Categories:
    return {int(number): values.get("category") for number, values in objects.items()}


def _candidates(path: Path) -> list[Path]:
    return [path, *(path / name for name in _SUBSETS)]


def _root(path: Path, subset: Subset | None) -> Path:
    """The folder that holds pictures, masks and meta.json."""
    wanted = _candidates(path) if subset is None else [path / subset, *([path] if path.name == subset else [])]
    root = next((folder for folder in wanted if is_folder(folder / _PICTURES)), None)
    if root is None:
        here = "it does not exist" if not is_folder(path) else f"it holds {', '.join(_names(path)) or 'nothing'}"
        msg = (
            f"path: {path} with subset: {subset or 'null'} has no folder {_PICTURES}; {here}: name the folder that holds "
            f"train or valid, or one of these, with {_PICTURES}, {_MASKS} and {_META} in it"
        )
        raise InputError(msg)
    return root


def _names(path: Path) -> list[str]:
    folders, files = list_folder(path)
    return sorted(folders + files)[:6]
