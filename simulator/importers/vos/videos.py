"""Data sets of videos with object masks: what YouTube-VOS and DAVIS share, from listing their folders to the scene source.

Both keep a folder of pictures and a folder of masks per video, the files of a frame named alike; masks may be fewer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal, TypeAlias

from simulator.errors import InputError
from simulator.importers.films.flat_videos import FlatVideos, choose_raiser, flat_videos, plane_depth
from simulator.importers.films.video import ClipPlan
from simulator.importers.listing import Fault, grouped, list_folder
from simulator.importers.vos.masked_video import MaskedVideo, frame_number
from simulator.types import View

RaiseWith: TypeAlias = Literal["optical_flow", "superslomo"]
Categories: TypeAlias = Mapping[int, str | None]

_PICTURES = {".jpg", ".jpeg", ".png", ".webp"}
_MASK = ".png"


@dataclass(frozen=True)
class Found:
    """The videos of a data set, as the names of its files tell.

    Attributes:
        root: the folder that messages shorten paths by.
        videos: those with a frame that can be used, sorted by name.
        faults: of the others: the video's name and the reason.
        unannotated: how many pictures have no mask.
        stray: how many masks have no picture.
    """

    root: Path
    videos: tuple[MaskedVideo, ...]
    faults: tuple[Fault, ...]
    unannotated: int
    stray: int

    def long_enough(self, plan: ClipPlan) -> Found:
        """Return the same with the videos that are too short for a plan among the faults."""
        short = [video for video in self.videos if len(video) < plan.needed]
        if not short:
            return self
        lengths = sorted(len(video) for video in self.videos)
        kind = "frames" if short[0].keep_background else "frames with a mask"
        raised = f", raised by {plan.raise_by}," if plan.raise_by > 1 else ""
        reason = (
            f"fewer {kind} than the {plan.needed} that a clip of {plan.frames}{raised} takes (videos here have {lengths[0]} "
            f"to {lengths[-1]}): ask for fewer, or raise them by more"
        )
        faults = (*self.faults, *((video.name, reason) for video in short))
        kept = tuple(video for video in self.videos if len(video) >= plan.needed)
        return replace(self, videos=kept, faults=faults)


def masked_source(
    importer: str,
    view: View,
    found: Found,
    plan: ClipPlan,
    *,
    plane_cm: float | None,
    raise_with: RaiseWith,
    superslomo_checkpoint: Path | None,
    other_inputs: Iterable[Path] = (),
) -> FlatVideos:
    """Return the videos as flat scenes; those that are too short are among its problems, in few lines.

    Raises:
        InputError: no video can be used, or as `plane_depth` and `choose_raiser` of `simulator.importers.films.flat_videos`.
    """
    found = found.long_enough(plan)
    return flat_videos(
        importer,
        view,
        found.videos,
        plan=plan,
        plane_m=plane_depth(view, plane_cm),
        raiser=choose_raiser(plan.raise_by, raise_with, superslomo_checkpoint),
        problems=grouped(found.faults),
        other_inputs=other_inputs,
    )


def find_videos(
    root: Path,
    pictures: Path,
    masks: Path,
    filmed_at: float,
    *,
    names: Iterable[str] | None = None,
    categories: Mapping[str, Categories] | None = None,
    keep_background: bool = False,
) -> Found:
    """List videos and match masks with pictures, by name; no file is opened.

    Args:
        root: the data set's folder.
        pictures: folder with a folder of pictures per video.
        masks: folder with a folder of masks per video.
        filmed_at: rate at which pictures are numbered, 1/s.
        names: the videos wanted; None takes all.
        categories: of each video's objects, by the video's name; None when the data set lists none.
        keep_background: use pictures without a mask too.

    Raises:
        InputError: when there is no folder of pictures at all.
    """
    here, _ = list_folder(pictures)
    list_folder(masks)  # one that cannot be read is not the fault of each video
    if not here:
        msg = f"path: {pictures} holds no video; expected a folder of pictures for each, fetch them"
        raise InputError(msg)
    videos: list[MaskedVideo] = []
    faults: list[Fault] = []
    unannotated = stray = 0
    for name in sorted(set(here) | set(categories or ()) if names is None else set(names)):
        try:
            annotated = _masks(masks / name)
            if categories is not None and not categories.get(name):
                msg = "meta.json lists no object of it: fetch pictures and meta.json from the same release"
                raise InputError(msg)
            frames = _frames(pictures / name)
            matched = tuple(frame for frame in frames if Path(frame).stem in annotated)
            if not frames:
                msg = f"no pictures in {pictures.relative_to(root)}: fetch them, or take its name off the list"
                raise InputError(msg)
            if not (matched or keep_background):
                msg = f"no mask in {masks.relative_to(root)} for any picture: fetch them, or use keep_background: true"
                raise InputError(msg)
        except InputError as error:
            faults.append((name, str(error)))
            continue
        unannotated += len(frames) - len(matched)
        stray += len(annotated) - len(matched)
        known = (categories or {}).get(name, {})
        used = frames if keep_background else matched
        of_frames = {} if keep_background else {frame: annotated[Path(frame).stem] for frame in matched}
        videos.append(
            MaskedVideo(name, pictures / name, masks / name, used, of_frames, filmed_at, known, keep_background)
        )
    return Found(root, tuple(videos), tuple(faults), unannotated, stray)


def _masks(folder: Path) -> dict[str, str]:
    """The masks of a video: the file's name by the name of its frame."""
    found: dict[str, str] = {}
    for name in list_folder(folder)[1]:
        path = Path(name)
        if path.suffix.lower() != _MASK:
            continue
        if path.stem in found:
            msg = f"{found[path.stem]} and {name} are both the mask of frame {path.stem}: take one of them away"
            raise InputError(msg)
        found[path.stem] = name
    return found


def _frames(folder: Path) -> tuple[str, ...]:
    """The pictures of a video in the order of their numbers."""
    found = [name for name in list_folder(folder)[1] if Path(name).suffix.lower() in _PICTURES]
    numbered = sorted((frame_number(name), name) for name in found)
    for (number, name), (following, other) in pairwise(numbered):
        if number == following:
            msg = f"{name} and {other} are both frame {number}: take one of them away"
            raise InputError(msg)
    return tuple(name for _, name in numbered)
