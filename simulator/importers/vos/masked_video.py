"""One video with object masks: frames as linear light, black outside the objects.

Masks are applied to linear light at full resolution, so that an edge that is shrunk later mixes object and darkness in the
right shares.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_picture
from simulator.errors import InputError
from simulator.importers.vos.masks import VOID, fit_mask, object_pixels, read_object_numbers
from simulator.io.images import picture_shape, read_picture

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
    """A :class:`simulator.importers.films.video.Video` of pictures and masks of the same names, without its background.

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
