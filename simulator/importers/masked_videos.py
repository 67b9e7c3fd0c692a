"""Videos with object masks: what DAVIS and YouTube-VOS share, from listing their folders to the scene source and the survey.

Both keep a folder of images and a folder of masks per video, the files of a frame named alike; masks may be fewer. Masks
are applied to linear light at full resolution, so that an edge that is shrunk later mixes object and darkness in the right
shares.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_image
from simulator.errors import InputError
from simulator.importers.inspection import Progress, Survey, frames_hint, told
from simulator.importers.listing import Fault, examples, fault_of, grouped, list_folder
from simulator.importers.object_masks import VOID, fit_mask, object_pixels, read_object_numbers
from simulator.importers.videos import ClipPlan, FlatVideos
from simulator.io.images import image_shape, read_image
from simulator.types import View

Categories: TypeAlias = Mapping[int, str | None]

_IMAGES = {".jpg", ".jpeg", ".png", ".webp"}
_MASK = ".png"
_WARNED: set[Path] = set()  # data sets whose mask sizes were told of: once for each, not for every mask and reading


@dataclass(frozen=True)
class MaskFacts:
    """What one mask holds.

    Attributes:
        objects: the numbers in it.
        resized: whether it is a pixel larger or smaller than its image.
        void: whether it has void pixels.
    """

    objects: tuple[int, ...]
    resized: bool
    void: bool


@dataclass(frozen=True)
class MaskedVideo:
    """A :class:`simulator.importers.videos.Video` of images and masks of the same names, without its background.

    Attributes:
        name: its folder's name.
        images: folder of its images.
        masks: folder of its masks.
        frames: names of the images that are used, in the order of their numbers.
        mask_names: the name of each frame's mask, by its image's; empty where masks are not used.
        filmed_at: rate at which images are numbered, 1/s.
        categories: of each object, by its number; empty when the data set lists no objects, None in it for one that it lists
            without a category.
        keep_background: take the images as they are and read no mask.
    """

    name: str
    images: Path
    masks: Path
    frames: tuple[str, ...]
    mask_names: Mapping[str, str]
    filmed_at: float
    categories: Categories = field(default_factory=dict)
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
        """All images and masks that are used."""
        images = tuple(self.images / name for name in self.frames)
        return images if self.keep_background else (*images, *map(self.mask, self.frames))

    def mask(self, frame: str) -> Path:
        """Return the file of a frame's mask."""
        return self.masks / self.mask_names[frame]

    def read(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Give frames one after the other as linear light ``(H, W, 3)`` in 0..1, black outside the objects.

        Raises:
            InputError: naming the file, when an image or mask is broken, the two differ in size by more than a pixel, frames
                differ in size, or a mask has an object that the data set does not list.
        """
        size: tuple[int, ...] = ()
        for name in self.frames[start:stop]:
            frame = decode_srgb_image(read_image(self.images / name))
            if frame.ndim == 2:
                frame = np.repeat(frame[..., None], 3, axis=-1)
            if not self.keep_background:
                numbers = self._numbers(name)
                fitted = fit_mask(numbers, frame.shape[:2], self.mask(name), self.images / name)
                if fitted.shape != numbers.shape:
                    _warn_of_size(self.masks.parent, self.mask(name), numbers.shape, fitted.shape)
                frame = np.where(object_pixels(fitted)[..., None], frame, np.float32(0))
            size = size or frame.shape
            if frame.shape != size:
                raise InputError(
                    self.images / name,
                    f"got {frame.shape[:2]}, but {self.frames[start]} before it is {size[:2]}: fetch the video again",
                )
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
            raise self.nothing_in(names)
        return found | {
            "objects": sorted({number for fact in facts.values() for number in fact.objects}),
            "masks_resized_by_a_pixel": [name for name, fact in facts.items() if fact.resized],
            "masks_without_object": [name for name, fact in facts.items() if not fact.objects],
            "masks_with_void": [name for name, fact in facts.items() if fact.void],
        }

    def nothing_in(self, frames: Sequence[str]) -> InputError:
        """Return the error of frames whose masks are all without any object."""
        after = f", nor in the {len(frames) - 1} masks after it" if len(frames) > 1 else ""
        return InputError(
            self.mask(frames[0]),
            f"no object in it{after}, so nothing is left of the images (index {VOID} is void): save objects as "
            f"1..{VOID - 1}, or leave video {self.name} out",
        )

    def mask_facts(self, frame: str) -> MaskFacts:
        """Read a frame's mask, but of its image the header only, and say what it holds.

        Raises:
            InputError: as for :meth:`read`, for the mask.
        """
        numbers, image = self._numbers(frame), self.images / frame
        shape = image_shape(image)
        fit_mask(numbers, shape, self.mask(frame), image)
        return MaskFacts(_objects(numbers), numbers.shape != shape, bool(np.any(numbers == VOID)))

    def _numbers(self, frame: str) -> NDArray[np.uint8]:
        numbers = read_object_numbers(self.mask(frame))
        unknown = [number for number in _objects(numbers) if number not in self.categories]
        if self.categories and unknown:
            raise InputError(
                self.mask(frame),
                f"has objects {unknown}, which meta.json does not list for {self.name}: fetch both again",
            )
        return numbers


@dataclass(frozen=True)
class MaskedVideos:
    """The videos of a data set, as the names of its files tell.

    Attributes:
        importer: the importer's name.
        root: the folder that messages shorten paths by.
        videos: those with a frame that can be used, sorted by name.
        faults: of the others: the video's name and the reason.
        unannotated: how many images have no mask.
        stray: how many masks have no image.
    """

    importer: str
    root: Path
    videos: tuple[MaskedVideo, ...]
    faults: tuple[Fault, ...]
    unannotated: int
    stray: int

    def source(self, view: View, plan: ClipPlan, other_inputs: Iterable[Path] = ()) -> FlatVideos:
        """Return the videos as flat scenes; those that are too short are among its problems, in few lines.

        Raises:
            InputError: no video can be used.
        """
        found = self._long_enough(plan)
        return FlatVideos.of(self.importer, view, found.videos, plan, grouped(found.faults), other_inputs)

    def survey(self, progress: Progress | None, frames: int | None, interpolate_by: int) -> Survey:
        """Read every image and mask once and say what is in them; a video is usable when all its frames can be read.

        Args:
            progress: called with the number of frames done and of all frames.
            frames: of a clip; with it, videos that are too short are among the problems and not read.
            interpolate_by: frames that one becomes.
        """
        found = self if frames is None else self._long_enough(ClipPlan(frames, interpolate_by=interpolate_by))
        every = [(video.name, frame) for video in found.videos for frame in video.frames]
        results = {video.name: _Read(video, found.root) for video in found.videos}
        for name, frame in told(every, len(every), progress):
            results[name].add(frame)
        for result in results.values():
            result.judge()
        good = [result for result in results.values() if not result.faults]
        faults = [*found.faults, *(fault for result in results.values() for fault in result.faults)]
        hints = frames_hint([len(result.video) for result in good])
        return Survey(
            self.importer, found.root, len(good), _facts(good), grouped(faults), _notes(found, good), hints=hints
        )

    def _long_enough(self, plan: ClipPlan) -> MaskedVideos:
        """The same with the videos that are too short for a plan among the faults."""
        short = [video for video in self.videos if len(video) < plan.needed]
        if not short:
            return self
        lengths = sorted(len(video) for video in self.videos)
        kind = "frames" if short[0].keep_background else "frames with a mask"
        clip = f"{plan.frames}{plan.interpolated}{',' if plan.interpolated else ''}"
        reason = (
            f"fewer {kind} than the {plan.needed} that a clip of {clip} takes (videos here have {lengths[0]} to "
            f"{lengths[-1]}): ask for fewer, or a larger interpolate_by"
        )
        faults = (*self.faults, *((video.name, reason) for video in short))
        return replace(self, videos=tuple(v for v in self.videos if len(v) >= plan.needed), faults=faults)


def find_videos(
    importer: str,
    root: Path,
    images: Path,
    masks: Path,
    filmed_at: float,
    *,
    names: Iterable[str] | None = None,
    categories: Mapping[str, Categories] | None = None,
    keep_background: bool = False,
) -> MaskedVideos:
    """List videos and match masks with images, by name; no file is opened.

    ``filmed_at``: rate at which images are numbered, 1/s.
    ``categories``: of each video's objects, by the video's name; None when the data set lists none.

    Raises:
        InputError: when there is no folder of images at all.
    """
    here, _ = list_folder(images)
    list_folder(masks)  # one that cannot be read is not the fault of each video
    if not here:
        raise InputError("path", f"{images} holds no video; expected a folder of images for each, fetch them")
    videos: list[MaskedVideo] = []
    faults: list[Fault] = []
    unannotated = stray = 0
    for name in sorted(set(here) | set(categories or ()) if names is None else set(names)):
        try:
            annotated = _masks(masks / name)
            if categories is not None and not categories.get(name):
                raise InputError(name, "meta.json lists no object of it: fetch images and meta.json of one release")
            frames = _frames(images / name)
            matched = tuple(frame for frame in frames if Path(frame).stem in annotated)
            if not frames:
                raise InputError(name, f"no images in {images.relative_to(root)}: fetch them")
            if not (matched or keep_background):
                raise InputError(name, f"no mask in {masks.relative_to(root)}: use keep_background: true")
        except InputError as error:
            faults.append((name, error.reason if error.path == name else str(error)))
            continue
        unannotated += len(frames) - len(matched)
        stray += len(annotated) - len(matched)
        known = (categories or {}).get(name, {})
        used = frames if keep_background else matched
        of_frames = {} if keep_background else {frame: annotated[Path(frame).stem] for frame in matched}
        videos.append(
            MaskedVideo(name, images / name, masks / name, used, of_frames, filmed_at, known, keep_background)
        )
    return MaskedVideos(importer, root, tuple(videos), tuple(faults), unannotated, stray)


def _masks(folder: Path) -> dict[str, str]:
    """The masks of a video: the file's name by the name of its frame."""
    found: dict[str, str] = {}
    for name in list_folder(folder)[1]:
        path = Path(name)
        if path.suffix.lower() != _MASK:
            continue
        if path.stem in found:
            raise InputError(folder.name, f"{found[path.stem]} and {name} are both the mask of a frame: remove one")
        found[path.stem] = name
    return found


def _frames(folder: Path) -> tuple[str, ...]:
    """The images of a video in the order of their numbers."""
    found = [name for name in list_folder(folder)[1] if Path(name).suffix.lower() in _IMAGES]
    numbered = sorted((frame_number(name), name) for name in found)
    for (number, name), (following, other) in pairwise(numbered):
        if number == following:
            raise InputError(folder.name, f"{name} and {other} are both frame {number}: remove one")
    return tuple(name for _, name in numbered)


def frame_number(image: str) -> int:
    """Return the number at the end of an image's name.

    Raises:
        InputError: it has none.

    Example:
        >>> frame_number("00005.jpg")
        5
    """
    digits = re.search(r"(\d+)$", Path(image).stem)
    if digits is None:
        raise InputError(image, "expected a name that ends in the frame's number, such as 00005.jpg; rename it")
    return int(digits[1])


def _warn_of_size(masks: Path, mask: Path, had: tuple[int, ...], wanted: tuple[int, ...]) -> None:
    if masks in _WARNED:
        return
    _WARNED.add(masks)
    sizes = " instead of ".join(f"{rows} x {columns}" for rows, columns in (had, wanted))
    warnings.warn(
        f"{mask} is {sizes} pixels: it is resized to its image by nearest neighbour, as others like it will be; they are "
        "named in the samples' records and by flatlight import --check",
        stacklevel=3,
    )


def _objects(numbers: NDArray[np.uint8]) -> tuple[int, ...]:
    counts = np.bincount(numbers.ravel(), minlength=VOID + 1)
    return tuple((np.flatnonzero(counts[1:VOID]) + 1).tolist())


@dataclass
class _Read:
    """What reading one video shows; masks by their file, shortened by the data set's folder."""

    video: MaskedVideo
    root: Path
    faults: list[Fault] = field(default_factory=list)
    sizes: Counter[tuple[int, ...]] = field(default_factory=Counter)
    objects: set[int] = field(default_factory=set)
    resized: list[str] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)
    void: list[str] = field(default_factory=list)

    def add(self, frame: str) -> None:
        """Read a frame and its mask."""
        files = [self.video.images / frame, *([] if self.video.keep_background else [self.video.mask(frame)])]
        try:
            self.sizes[read_image(files[0]).shape[:2]] += 1
            if not self.video.keep_background:
                facts, where = self.video.mask_facts(frame), files[1].relative_to(self.root).as_posix()
                self.objects.update(facts.objects)
                self.resized += [where] * facts.resized
                self.empty += [where] * (not facts.objects)
                self.void += [where] * facts.void
        except InputError as error:
            self.faults.append(fault_of(error, *files, root=self.root))

    def judge(self) -> None:
        """Find what only all frames together show."""
        if len(self.sizes) > 1:
            listed = ", ".join(f"{count} of {rows} x {columns}" for (rows, columns), count in self.sizes.items())
            self.faults.append((self.video.name, f"frames of several sizes ({listed}): fetch the video again"))
        if len(self.empty) == len(self.video):
            nothing = self.video.nothing_in(self.video.frames)
            self.faults.append(fault_of(nothing, self.video.mask(self.video.frames[0]), root=self.root))


def _notes(found: MaskedVideos, good: list[_Read]) -> tuple[str, ...]:
    """What is used all the same but should be known, with counts and examples."""
    keeps = any(result.video.keep_background for result in good)
    uneven = [result.video.name for result in good if len(set(result.video.steps)) > 1]
    named = {
        "masks a pixel larger or smaller than their image, resized": [name for read in good for name in read.resized],
        "masks without an object, which make black frames": [name for read in good for name in read.empty],
        "masks with void (index 255), which is taken as background": [name for read in good for name in read.void],
        "videos annotated at uneven steps, which are taken as even": uneven,
    }
    counts = {
        "images without a mask, left out": 0 if keeps else found.unannotated,
        "masks without an image, left out": found.stray,
    }
    lines = [f"{what}: {count}" for what, count in counts.items() if count]
    return (*lines, *(f"{what}: {len(where)} ({examples(where)})" for what, where in named.items() if where))


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
