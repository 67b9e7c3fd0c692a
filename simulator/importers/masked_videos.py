"""One video with object masks: frames as linear light, black outside the objects.

Masks are applied to linear light at full resolution, so that an edge that is shrunk later mixes object and darkness in the
right shares.

Data sets of videos with object masks: what YouTube-VOS and DAVIS share, from listing their folders to the scene source.

Both keep a folder of pictures and a folder of masks per video, the files of a frame named alike; masks may be fewer.

Reads every frame and mask of a data set of videos with object masks, and says what is there.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_picture
from simulator.errors import InputError
from simulator.importers.inspection import Progress, Survey
from simulator.importers.listing import Fault, examples, grouped, list_folder
from simulator.importers.object_masks import VOID, fit_mask, object_pixels, read_object_numbers
from simulator.importers.videos import ClipPlan, FlatVideos, choose_raiser, flat_videos, plane_depth
from simulator.pictures import picture_shape, read_picture
from simulator.types import View

_WARNED: set[Path] = set()  # data sets whose mask sizes were told of: once for each, not for every mask and reading


@dataclass(frozen=True)
class MaskFacts:
    """What one mask holds.

    Attributes:
        objects: the numbers in it.
        resized: whether it is a pixel larger or smaller than its picture.
        void: whether it has void pixels.
    """

    objects: tuple[int, ...]
    resized: bool
    void: bool


@dataclass(frozen=True)
class MaskedVideo:
    """A :class:`simulator.importers.videos.Video` of pictures and masks of the same names, without its background.

    Attributes:
        name: its folder's name.
        pictures: folder of its pictures.
        masks: folder of its masks.
        frames: names of the pictures that are used, in the order of their numbers.
        mask_names: the name of each frame's mask, by its picture's; empty where masks are not used.
        filmed_at: rate at which pictures are numbered, 1/s.
        categories: of each object, by its number; empty when the data set lists no objects, None in it for one that it lists
            without a category.
        keep_background: take the pictures as they are and read no mask.
    """

    name: str
    pictures: Path
    masks: Path
    frames: tuple[str, ...]
    mask_names: Mapping[str, str]
    filmed_at: float
    categories: Mapping[int, str | None] = field(default_factory=dict)
    keep_background: bool = False
    packages: ClassVar[tuple[str, ...]] = ()

    def __len__(self) -> int:
        """Return how many frames can be used."""
        return len(self.frames)

    @property
    def steps(self) -> list[int]:
        """How far the numbers of neighbouring frames lie apart; all the same in a video that is annotated evenly."""
        return np.diff([frame_number(name) for name in self.frames]).tolist()

    @property
    def frames_per_second(self) -> float:
        """The film's rate over the commonest step between its frames; that of one frame alone is the film's."""
        counts = Counter(self.steps)
        commonest = [step for step, count in counts.items() if count == max(counts.values())]
        return self.filmed_at / min(commonest, default=1)

    @property
    def label(self) -> str | None:
        """The category, where all objects have the same one."""
        found = set(self.categories.values())
        return found.pop() if len(found) == 1 else None

    @property
    def files(self) -> tuple[Path, ...]:
        """All pictures and masks that are used."""
        pictures = tuple(self.pictures / name for name in self.frames)
        return pictures if self.keep_background else (*pictures, *map(self.mask, self.frames))

    def files_of(self, frame: str) -> tuple[Path, ...]:
        """Return a frame's picture and, where it is used, its mask."""
        picture = self.pictures / frame
        return (picture,) if self.keep_background else (picture, self.mask(frame))

    def mask(self, frame: str) -> Path:
        """Return the file of a frame's mask."""
        return self.masks / self.mask_names[frame]

    def read(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Give frames one after the other as linear light ``(H, W, 3)`` in 0..1, black outside the objects.

        Raises:
            InputError: naming the file, when a picture or mask is broken, the two differ in size by more than a pixel, frames
                differ in size, or a mask has an object that the data set does not list.
        """
        size: tuple[int, ...] = ()
        for name in self.frames[start:stop]:
            frame = self._frame(name)
            size = size or frame.shape
            if frame.shape != size:
                msg = (
                    f"{self.pictures / name} is {frame.shape[0]} x {frame.shape[1]} pixels, but {self.frames[start]} "
                    f"before it is {size[0]} x {size[1]}: expected frames of one size; fetch the video again"
                )
                raise InputError(msg)
            yield frame

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return where frames come from and what their masks held; the masks are read for it.

        Raises:
            InputError: as for :meth:`read`, for the masks; and when none of them has an object, so that all would be black.
        """
        names = self.frames[start:stop]
        found: dict[str, Any] = {
            "video": self.name,
            "frames": [Path(name).stem for name in names],
            "categories": {str(number): category for number, category in self.categories.items()},
            "background": "kept" if self.keep_background else "removed",
        }
        if self.keep_background:
            return found
        facts = {Path(name).stem: self.mask_facts(name) for name in names}
        if not any(fact.objects for fact in facts.values()):
            raise InputError(self.nothing_in([self.mask(name) for name in names]))
        return found | {
            "objects": sorted({number for fact in facts.values() for number in fact.objects}),
            "masks_resized_by_a_pixel": [name for name, fact in facts.items() if fact.resized],
            "masks_without_object": [name for name, fact in facts.items() if not fact.objects],
            "masks_with_void": [name for name, fact in facts.items() if fact.void],
        }

    def nothing_in(self, masks: Sequence[Path]) -> str:
        """Return the message about masks without any object."""
        return (
            f"{masks[0]} {f'and the {len(masks) - 1} after it have' if len(masks) > 1 else 'has'} no object, so that nothing "
            f"is left of the pictures (index {VOID} is void): save objects as 1..{VOID - 1}, or leave video {self.name} out"
        )

    def mask_facts(self, frame: str) -> MaskFacts:
        """Read a frame's mask, but of its picture the header only, and say what it holds.

        Raises:
            InputError: as for :meth:`read`, for the mask.
        """
        numbers, picture = self._numbers(frame), self.pictures / frame
        shape = picture_shape(picture)
        fit_mask(numbers, shape, self.mask(frame), picture)
        return MaskFacts(_objects(numbers), numbers.shape != shape, bool(np.any(numbers == VOID)))

    def _frame(self, name: str) -> NDArray[np.float32]:
        picture = self.pictures / name
        values = read_picture(picture)
        linear = decode_srgb_picture(values)
        if linear.ndim == 2:
            linear = np.repeat(linear[..., None], 3, axis=-1)
        if self.keep_background:
            return linear
        numbers = self._numbers(name)
        fitted = fit_mask(numbers, (linear.shape[0], linear.shape[1]), self.mask(name), picture)
        if fitted.shape != numbers.shape:
            _warn_of_size(self.masks.parent, self.mask(name), numbers.shape, fitted.shape)
        return np.where(object_pixels(fitted)[..., None], linear, np.float32(0))

    def _numbers(self, frame: str) -> NDArray[np.uint8]:
        numbers = read_object_numbers(self.mask(frame))
        if not self.categories:
            return numbers
        unknown = [number for number in _objects(numbers) if number not in self.categories]
        if unknown:
            msg = (
                f"{self.mask(frame)} has object {_listed(unknown)}, but meta.json gives video {self.name} only "
                f"{_listed(self.categories)}: fetch masks and meta.json from the same release"
            )
            raise InputError(msg)
        return numbers


def frame_number(picture: str) -> int:
    """Return the number at the end of a picture's name.

    Raises:
        InputError: it has none.

    Example:
        >>> frame_number("00005.jpg")
        5
    """
    digits = re.search(r"(\d+)$", Path(picture).stem)
    if digits is None:
        msg = f"{picture}: expected a name that ends in the frame's number, such as 00005.jpg; rename it"
        raise InputError(msg)
    return int(digits[1])


def _warn_of_size(masks: Path, mask: Path, had: tuple[int, ...], wanted: tuple[int, ...]) -> None:
    if masks in _WARNED:
        return
    _WARNED.add(masks)
    sizes = " instead of ".join(f"{rows} x {columns}" for rows, columns in (had, wanted))
    warnings.warn(
        f"{mask} is {sizes} pixels: it is resized to its picture by nearest neighbour, as others like it will be; they are "
        "named in the samples' records and by flatlight import --check",
        stacklevel=4,
    )


def _objects(numbers: NDArray[np.uint8]) -> tuple[int, ...]:
    counts = np.bincount(numbers.ravel(), minlength=VOID + 1)
    return tuple((np.flatnonzero(counts[1:VOID]) + 1).tolist())


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


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
        InputError: no video can be used, or as `plane_depth` and `choose_raiser` of `simulator.importers.videos`.
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
