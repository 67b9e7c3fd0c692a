"""Which clip of a finite source a sample shows: no two splits share a video, and raising a count moves no clip.

Training samples walk through the source from its front; validation and test samples take every second video each, from
the back, and all clips of a video before the next one's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.errors import InputError
from simulator.seeds import SPLITS
from simulator.types import SceneSource

_FRONT = ("train", "pilot")


class ClipOrder:
    """The order in which each split asks a source for its clips.

    Example:
        >>> order = ClipOrder([0, 0, 1, 1, 2, 2, 3])
        >>> [order.place("train", i) for i in range(3)], [order.place("validation", i) for i in range(3)]
        ([0, 1, 2], [6, 2, 3])
    """

    def __init__(self, groups: int | Sequence[int] | NDArray[np.integer]) -> None:
        """Prepare the walks.

        Args:
            groups: the number of the video that each clip comes from, never falling; or how many clips there are, each of
                which is a video of its own.

        Raises:
            InputError: there is no clip, or the numbers are not such.
        """
        self._counted = isinstance(groups, int)
        numbers = np.arange(groups) if isinstance(groups, int) else _checked(groups)
        if numbers.size == 0:
            msg = "scene: its source has no clip; give it the place of a data set that has some"
            raise InputError(msg)
        self._video = np.unique(numbers, return_inverse=True)[1]
        self.clips, self.videos = len(numbers), int(self._video[-1]) + 1
        self._walks: dict[str, NDArray[np.intp]] = {}

    def place(self, split: str, index: int) -> int:
        """Return which clip of the source a sample shows, from 0; after the last clip the walk begins anew.

        Args:
            split: ``train``, ``validation``, ``test`` or ``pilot``.
            index: the sample's number within its split.
        """
        return int(self._walk(split)[index % self.clips])

    def shortage(self, counts: Mapping[str, int]) -> str | None:
        """Say why so many samples would make two splits share a video; None where none is shared.

        One split alone may show clips again.

        Args:
            counts: samples per split.
        """
        asked = {split: count for split, count in counts.items() if count > 0}
        taken = {split: np.unique(self._video[self._walk(split)[:count]]) for split, count in asked.items()}
        shared = sum(map(len, taken.values())) - len(np.unique(np.concatenate([*taken.values(), []])))
        if not shared:
            return None
        kind = "clips" if self._counted else "videos"
        held = f"{self.videos} {kind}" + ("" if self._counted else f" ({self.clips} clips)")
        wanted = ", ".join(f"{split} takes {len(taken[split])} for {count} samples" for split, count in asked.items())
        cure = ", bring more clips" if self._counted else ", take more clips of each video, bring more videos"
        return (
            f"no two splits may share a source video, but of {held} {wanted} (train from the front, validation "
            f"and test every second one each from the back); ask for fewer samples{cure}"
        )

    def _walk(self, split: str) -> NDArray[np.intp]:
        """Return all places in the order in which a split takes them."""
        if split not in self._walks:
            if split in _FRONT:
                self._walks[split] = np.arange(self.clips)
            else:
                first = self.videos - SPLITS[split]  # validation begins with the last video, test with the one before
                other = self.videos - 3 + SPLITS[split]
                rank = np.empty(self.videos, np.intp)
                rank[[*range(first, -1, -2), *range(other, -1, -2)]] = np.arange(self.videos)
                self._walks[split] = np.argsort(rank[self._video], kind="stable")
        return self._walks[split]


def clip_order(source: SceneSource) -> ClipOrder | None:
    """Return the order of a source's clips, or None for one without end.

    Raises:
        InputError: the source has no clip, or its ``groups`` do not fit.
    """
    if not hasattr(source, "__len__"):
        return None
    length: int = len(source)  # type: ignore[arg-type]
    groups = getattr(source, "groups", None)
    if groups is None:
        return ClipOrder(length)
    if len(groups) != length:
        msg = f"scene: its source has {length} clips but {len(groups)} groups; groups must hold the video of each clip"
        raise InputError(msg)
    return ClipOrder(np.asarray(groups))


def _checked(groups: ArrayLike) -> NDArray[np.integer]:
    numbers = np.asarray(groups)
    whole = numbers.size == 0 or np.issubdtype(numbers.dtype, np.integer)
    if numbers.ndim != 1 or not whole or np.any(numbers[1:] < numbers[:-1]):
        msg = "scene: the groups of its source must be whole numbers that never fall, one per clip: the number of its video"
        raise InputError(msg)
    return numbers
