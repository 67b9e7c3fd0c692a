"""YouTube-VOS videos as flat scenes: the labelled objects without their background, with their category as the label.

Source: Xu et al., YouTube-VOS: A Large-Scale Video Object Segmentation Benchmark, arXiv 1809.03327: films of 30 frames per
second, of which every fifth frame is annotated, hence six frames per second.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args

from simulator.errors import InputError
from simulator.importers.inspection import Likeness, Progress, Survey
from simulator.importers.listing import is_folder, list_folder, read_json
from simulator.importers.masked_videos import Categories, MaskedVideos, find_videos
from simulator.importers.videos import ClipPlan, Count, Crop, FlatVideos, InterpolateWith, Positive
from simulator.types import View

FILMED_AT = 30.0
"""Frames per second at which images are numbered: 00000, 00005, 00010, ... (the paper, section 3)."""

Subset = Literal["train", "valid", "test"]
_IMAGES, _MASKS, _META = "JPEGImages", "Annotations", "meta.json"


def youtube_vos(
    view: View,
    *,
    path: Path,
    frames: Count,
    subset: Subset | None = None,
    frames_per_second: Positive | None = None,
    clips_per_video: Count = 1,
    crop: Crop = "centre",
    plane_cm: Positive | None = None,
    keep_background: bool = False,
    interpolate_by: Count = 1,
    interpolate_with: InterpolateWith = "optical_flow",
    superslomo_checkpoint: Path | None = None,
) -> FlatVideos:
    """Read clips of the labelled objects of YouTube-VOS.

    Files are listed at once and read when a clip is asked for. Only annotated frames are used. What is not labelled is black:
    the background is all pixels that belong to no object of the frame's mask. The masks of ``valid`` and ``test`` hold each
    object only in the frame where it appears first.

    Args:
        view: the camera's view: size of the clips, far depth.
        path: the folder that holds ``train`` (or ``valid``), or that folder itself, with JPEGImages, Annotations, meta.json.
        frames: frames of a clip, after interpolation; the published videos have 4 to 36 that are annotated.
        subset: which folder; null takes path itself, or train where path holds it.
        frames_per_second: rate at which a clip is taken to run; null is the video's own, 6 per second, times interpolate_by.
        clips_per_video: clips that one video gives, evenly spread; 1 begins at a random frame.
        crop: where the largest window of the view's proportions is cut out, the same for all frames of a clip.
        plane_cm: depth of the plane that shows the clip; null is the far depth.
        keep_background: leave images as they are; then frames without a mask are used too.
        interpolate_by: frames that one becomes by temporal interpolation, after the background is removed; 1 leaves them.
        interpolate_with: how frames are interpolated.
        superslomo_checkpoint: file of the published network's weights, for superslomo.

    Returns:
        A scene source. A clip's label is its video's category if all objects have the same one, else none; all categories are
        recorded.

    Raises:
        InputError: for missing folders, a damaged meta.json, or when no video is long enough.
    """
    found = find(Path(path), subset, keep_background)
    interpolation = interpolate_by, interpolate_with, superslomo_checkpoint
    plan = ClipPlan.of(view, frames, frames_per_second, clips_per_video, crop, plane_cm, *interpolation)
    return found.source(view, plan, [found.root / _META])


def recognises(path: Path) -> Likeness | None:
    """Whether a folder is laid out like YouTube-VOS; looks at names only."""
    if any((folder / _META).is_file() and (folder / _IMAGES).is_dir() for folder in _candidates(path)):
        return Likeness("sure", f"has {_META} beside {_IMAGES}")
    return None


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    subset: Subset | None = None,
    keep_background: bool = False,
    frames: int | None = None,
    interpolate_by: int = 1,
) -> Survey:
    """Read every annotated frame and its mask once; parameters and errors as for :func:`youtube_vos`."""
    return find(path, subset, keep_background).survey(progress, frames, interpolate_by)


def find(path: Path, subset: Subset | None, keep_background: bool) -> MaskedVideos:
    """List the videos of one subset.

    Raises:
        InputError: for missing folders or a damaged meta.json.
    """
    root = _root(path, subset)
    known = read_categories(root / _META)
    images, masks = root / _IMAGES, root / _MASKS
    return find_videos("youtube_vos", root, images, masks, FILMED_AT, categories=known, keep_background=keep_background)


def read_categories(path: Path) -> dict[str, Categories]:
    """Read ``meta.json``: of each video the category of each object, None where the release gives none (valid of 2019).

    Raises:
        InputError: naming the file, when it is missing or not such a file.
    """
    meta = read_json(path)
    try:
        return {name: _categories(video["objects"]) for name, video in meta["videos"].items()}
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(
            path,
            f'{error!r}; expected {{"videos": {{name: {{"objects": {{"1": {{...}}}}}}}}}}',
        ) from error


def _categories(objects: dict[str, dict[str, Any]]) -> Categories:
    return {int(number): values.get("category") for number, values in objects.items()}


def _candidates(path: Path) -> list[Path]:
    return [path, *(path / name for name in get_args(Subset))]


def _root(path: Path, subset: Subset | None) -> Path:
    """The folder that holds images, masks and meta.json."""
    wanted = _candidates(path) if subset is None else [path / subset, *([path] if path.name == subset else [])]
    root = next((folder for folder in wanted if is_folder(folder / _IMAGES)), None)
    if root is None:
        folders, files = list_folder(path)
        held = ", ".join(sorted(folders + files)[:6]) or "nothing"
        here = f"it holds {held}" if is_folder(path) else "it does not exist"
        raise InputError(
            "path",
            f"{path} with subset: {subset or 'null'} has no folder {_IMAGES}; {here}: name that of train or valid",
        )
    return root
