"""DAVIS 2016 and 2017 videos as flat scenes: the annotated objects without their background.

Source: Perazzi et al., A Benchmark Dataset and Evaluation Methodology for Video Object Segmentation, CVPR 2016 (one binary
mask per frame), and Pont-Tuset et al., The 2017 DAVIS Challenge on Video Object Segmentation, arXiv 1704.00675 (one number
per object). Films of 24 frames per second.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from simulator.errors import InputError
from simulator.importers.inspection import Likeness, Progress, Survey
from simulator.importers.listing import examples, is_folder, list_folder
from simulator.importers.masked_videos import MaskedVideos, find_videos
from simulator.importers.videos import ClipPlan, Count, Crop, FlatVideos, InterpolateWith, Positive
from simulator.types import View

FILMED_AT = 24.0
"""Frames per second (Perazzi et al., section 3)."""

Resolution = Literal["480p", "1080p", "Full-Resolution"]
_FLAT = ("images", "masks")


def davis(
    view: View,
    *,
    path: Path,
    frames: Count,
    subset: str | None = None,
    resolution: Resolution = "480p",
    frames_per_second: Positive | None = None,
    clips_per_video: Count = 1,
    crop: Crop = "centre",
    plane_cm: Positive | None = None,
    keep_background: bool = False,
    interpolate_by: Count = 1,
    interpolate_with: InterpolateWith = "optical_flow",
    superslomo_checkpoint: Path | None = None,
) -> FlatVideos:
    """Read clips of the annotated objects of DAVIS.

    Files are listed at once and read when a clip is asked for. Only annotated frames are used. What belongs to no object is
    black, void (index 255 of a palette) included.

    Args:
        view: the camera's view: size of the clips, far depth.
        path: the folder that holds JPEGImages and Annotations (or Annotations_unsupervised); or ``images`` and ``masks``
            with a folder per video.
        frames: frames of a clip, after interpolation; the published videos have 25 to 104.
        subset: a list of ImageSets, such as train or val (of 2017 where both years have it), or 2016/val; null takes all.
        resolution: which folder of JPEGImages.
        frames_per_second: rate at which a clip is taken to run; null is the video's own, 24 per second, times interpolate_by.
        clips_per_video: clips that one video gives, evenly spread; 1 begins at a random frame.
        crop: where the largest window of the view's proportions is cut out, the same for all frames of a clip.
        plane_cm: depth of the plane that shows the clip; null is the far depth.
        keep_background: leave images as they are; then frames without a mask are used too.
        interpolate_by: frames that one becomes by temporal interpolation, after the background is removed; 1 leaves them.
        interpolate_with: how frames are interpolated.
        superslomo_checkpoint: file of the published network's weights, for superslomo.

    Returns:
        A scene source; its clips have no label, as DAVIS names no categories.

    Raises:
        InputError: for missing folders and lists, or when no video is long enough.
    """
    found = find(Path(path), subset, resolution, keep_background)
    interpolation = interpolate_by, interpolate_with, superslomo_checkpoint
    plan = ClipPlan.of(view, frames, frames_per_second, clips_per_video, crop, plane_cm, *interpolation)
    return found.source(view, plan)


def recognises(path: Path) -> Likeness | None:
    """Whether a folder is laid out like DAVIS; looks at names only."""
    for resolution in get_args(Resolution):
        if (path / "JPEGImages" / resolution).is_dir():
            return Likeness("sure", f"has a folder JPEGImages/{resolution}")
    images, masks = (list_folder(path / name)[0] for name in _FLAT)
    both = sorted(set(images) & set(masks))
    return Likeness("likely", f"images and masks hold the same videos: {examples(both)}") if both else None


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    subset: str | None = None,
    resolution: Resolution = "480p",
    keep_background: bool = False,
    frames: int | None = None,
    interpolate_by: int = 1,
) -> Survey:
    """Read every annotated frame and its mask once; parameters and errors as for :func:`davis`."""
    return find(path, subset, resolution, keep_background).survey(progress, frames, interpolate_by)


def find(path: Path, subset: str | None, resolution: Resolution, keep_background: bool) -> MaskedVideos:
    """List the videos.

    Raises:
        InputError: for missing folders and lists.
    """
    if is_folder(path / _FLAT[0]) and not is_folder(path / "JPEGImages"):
        if subset is not None:
            raise InputError("subset", f"got {subset!r}, but {path} has no ImageSets: leave subset out")
        images, masks = (path / name for name in _FLAT)
        if not (is_folder(masks) or keep_background):
            raise InputError("path", f"{path} has no folder masks: fetch it, or use keep_background: true")
        return find_videos("davis", path, images, masks, FILMED_AT, keep_background=keep_background)
    images = path / "JPEGImages" / resolution
    if not is_folder(images):
        there = ", ".join(list_folder(path / "JPEGImages")[0]) or "none"
        raise InputError(
            "path",
            f"{path} has no folder JPEGImages/{resolution} (resolutions there: {there}): name another",
        )
    annotations = next((name for name in ("Annotations", "Annotations_unsupervised") if is_folder(path / name)), None)
    masks = path / (annotations or "Annotations") / resolution
    names = None if subset is None else read_image_set(path / "ImageSets", subset, resolution)
    return find_videos("davis", path, images, masks, FILMED_AT, names=names, keep_background=keep_background)


def read_image_set(folder: Path, subset: str, resolution: str) -> list[str]:
    """Return the names of the videos that a list holds.

    ``subset``: a list's name, looked for in ``2017``, ``2016`` and the resolution's folder, or with its folder in front.
    ``resolution``: names the folder of the original release of 2016, whose lists name each frame's image and mask.

    Raises:
        InputError: there is no such list, or it names no video.
    """
    lists = [Path(year, name) for year in list_folder(folder)[0] for name in list_folder(folder / year)[1]]
    files = {file.with_suffix("").as_posix(): folder / file for file in lists if file.suffix.lower() == ".txt"}
    wanted = [f"2017/{subset}", f"2016/{subset}", f"{resolution}/{subset}", subset]
    name = next((name for name in wanted if name in files), None)
    if name is None:
        raise InputError("subset", f"got {subset!r}, expected a list of {folder}: {', '.join(files) or 'none'}")
    try:
        text = files[name].read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(files[name], f"cannot be read as a list of names ({error}): fetch it again") from error
    lines = [line.split() for line in text.splitlines() if line.strip()]
    names = [Path(line[0]).parent.name if "/" in line[0] else line[0] for line in lines]
    if not names:
        raise InputError(files[name], "names no video: fetch it again")
    return list(dict.fromkeys(names))
