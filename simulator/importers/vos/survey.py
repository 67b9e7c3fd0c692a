"""Reads every frame and mask of a data set of videos with object masks, and says what is there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from simulator.errors import InputError
from simulator.importers.films.video import ClipPlan
from simulator.importers.listing import Fault, examples, grouped
from simulator.importers.survey import Progress, Survey
from simulator.importers.vos.masked_video import MaskedVideo
from simulator.importers.vos.videos import Found
from simulator.io.images import read_picture


@dataclass
class _Read:
    """What reading one video showed; masks by their file."""

    video: MaskedVideo
    faults: list[Fault] = field(default_factory=list)
    objects: set[int] = field(default_factory=set)
    resized: list[str] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)
    void: list[str] = field(default_factory=list)


def survey_videos(importer: str, found: Found, progress: Progress | None, frames: int | None, raise_by: int) -> Survey:
    """Read every picture and mask of a data set once and say what is in it.

    Args:
        importer: the importer's name.
        found: its videos.
        progress: called with the number of frames done and of all frames.
        frames: of a clip; with it, videos that are too short are among the problems and not read.
        raise_by: frames that one becomes by interpolation.

    Returns:
        The survey; a video counts as usable when all its frames can be read.
    """
    if frames is not None:
        found = found.long_enough(ClipPlan(frames, raise_by=raise_by))
    total, done = sum(len(video) for video in found.videos), 0

    def step() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    results = [_read(video, found.root, step) for video in found.videos]
    good = [result for result in results if not result.faults]
    faults = [*found.faults, *(fault for result in results for fault in result.faults)]
    return Survey(importer, found.root, len(good), _facts(good), grouped(faults), _notes(found, good))


def _read(video: MaskedVideo, root: Path, step: Callable[[], None]) -> _Read:
    result, sizes = _Read(video), Counter[tuple[int, ...]]()
    for frame in video.frames:
        picture, *mask = video.files_of(frame)
        try:
            sizes[read_picture(picture).shape[:2]] += 1
            if not video.keep_background:
                facts, where = video.mask_facts(frame), mask[0].relative_to(root).as_posix()
                result.objects.update(facts.objects)
                result.resized += [where] * facts.resized
                result.empty += [where] * (not facts.objects)
                result.void += [where] * facts.void
        except InputError as error:
            result.faults.append(_fault(str(error), root, picture, *mask))
        step()
    if len(sizes) > 1:
        listed = ", ".join(f"{count} of {rows} x {columns}" for (rows, columns), count in sizes.items())
        result.faults.append((video.name, f"frames of several sizes ({listed}): fetch the video again"))
    if len(result.empty) == len(video):
        masks = [video.mask(frame) for frame in video.frames]
        result.faults.append(_fault(video.nothing_in(masks), root, masks[0]))
    return result


def _fault(message: str, root: Path, *files: Path) -> Fault:
    """A message that begins with its file, apart from it, so that the same fault of many files makes one line."""
    for file in files:
        if message.startswith(f"{file} "):
            return file.relative_to(root).as_posix(), message.removeprefix(f"{file} ").replace(f"{root}/", "")
    return files[0].relative_to(root).as_posix(), message


def _notes(found: Found, good: list[_Read]) -> tuple[str, ...]:
    """What is used all the same but should be known, with counts and examples."""
    keeps = any(result.video.keep_background for result in good)
    uneven = [result.video.name for result in good if len(set(result.video.steps)) > 1]
    counted = (
        ("pictures without a mask, left out", 0 if keeps else found.unannotated, []),
        ("masks without a picture, left out", found.stray, []),
        *(
            (what, len(where), where)
            for what, where in (
                ("masks a pixel larger or smaller than their picture, resized", [n for r in good for n in r.resized]),
                ("masks without an object, which make black frames", [n for r in good for n in r.empty]),
                ("masks with void (index 255), which is taken as background", [n for r in good for n in r.void]),
                ("videos annotated at uneven steps, which are taken as even", uneven),
            )
        ),
    )
    return tuple(
        f"{what}: {count}{f' ({examples(where)})' if where else ''}" for what, count, where in counted if count
    )


def _facts(good: list[_Read]) -> dict[str, str]:
    """What the usable videos are like."""
    if not good:
        return {"videos": "0"}
    videos = [result.video for result in good]
    lengths, objects = sorted(map(len, videos)), [len(result.objects) for result in good]
    rates = Counter(video.frames_per_second for video in videos).most_common(5)
    facts = {
        "videos": str(len(videos)),
        "frames": f"{sum(lengths)} ({lengths[0]} to {lengths[-1]} per video, median {median(lengths):g})",
        "frame rate": ", ".join(f"{rate:g}/s ({count} videos)" for rate, count in rates),
    }
    if any(objects):
        facts["objects"] = f"{sum(objects)} ({min(objects)} to {max(objects)} per video)"
    categories = Counter(category for video in videos for category in video.categories.values() if category)
    if categories:
        most = ", ".join(f"{category} {count}" for category, count in categories.most_common(8))
        facts["categories"] = f"{len(categories)}: {most}{', ...' if len(categories) > 8 else ''}"
        facts["labelled"] = f"{sum(video.label is not None for video in videos)} videos (all objects of one category)"
    return facts
