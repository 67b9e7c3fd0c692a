"""Which clip of a finite source a sample shows, and whether clips last as long as the shutter is open."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence, Sized
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.camera.shutter import ROUNDING, Shutter
from simulator.camera.slivers import frames_seen
from simulator.config.schema import DatasetConfig
from simulator.errors import InputError
from simulator.seeds import SPLITS
from simulator.types import Clip, SceneSource

_FRONT = ("train", "pilot")


class ClipOrder:
    """The order in which each split asks a source for its clips.

    Example:
        >>> order = ClipOrder([0, 0, 1, 1, 2, 2, 3])
        >>> [order.place("train", i) for i in range(3)], [order.place("validation", i) for i in range(3)]
        ([0, 1, 2], [6, 2, 3])
    """

    def __init__(
        self,
        groups: int | Sequence[int] | NDArray[np.integer],
        splits: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        """Prepare the walks.

        Args:
            groups: the number of the video that each clip comes from, never falling; or how many clips there are, each of
                which is a video of its own.
            splits: the clips of splits that the source itself keeps apart, in their order; any other split takes from all.

        Raises:
            InputError: there is no clip, or the numbers are not such.
        """
        self._counted = isinstance(groups, int)
        numbers = np.arange(groups) if isinstance(groups, int) else _checked(groups)
        if numbers.size == 0:
            raise InputError("scene", "its source has no clip; give it the place of a data set that has some")
        self._video = np.unique(numbers, return_inverse=True)[1]
        self.clips, self.videos = len(numbers), int(self._video[-1]) + 1
        self._walks: dict[str, NDArray[np.intp]] = {}
        self._apart = sorted(split for split, own in (splits or {}).items() if len(own))
        for split, own in (splits or {}).items():
            if len(own):
                self._walks |= dict.fromkeys(_FRONT if split in _FRONT else (split,), _places(own, self.clips))

    def place(self, split: str, index: int) -> int:
        """Return which clip of the source a sample shows, from 0; after the last clip the walk begins anew."""
        walk = self._walk(split)
        return int(walk[index % len(walk)])

    def shortage(self, counts: Mapping[str, int]) -> str | None:
        """Say why so many samples would make two splits share a video; None where none is shared.

        One split alone may show clips again.
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
        how = "train from the front, validation and test every second one each from the back"
        if self._apart:
            how = f"{' and '.join(self._apart)} as the source keeps them apart, any other split from all of it"
        return f"no two splits may share a source video, but of {held} {wanted} ({how}); ask for fewer samples{cure}"

    def _walk(self, split: str) -> NDArray[np.intp]:
        """Return the places in the order in which a split takes them."""
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
    if not isinstance(source, Sized):
        return None
    length = len(source)
    groups, splits = getattr(source, "groups", None), getattr(source, "splits", None)
    if groups is None:
        return ClipOrder(length, splits)
    if len(groups) != length:
        raise InputError(
            "scene", f"its source has {length} clips but {len(groups)} groups; groups must hold the video of each clip"
        )
    return ClipOrder(np.asarray(groups), splits)


def _checked(groups: ArrayLike) -> NDArray[np.integer]:
    numbers = np.asarray(groups)
    whole = numbers.size == 0 or np.issubdtype(numbers.dtype, np.integer)
    if numbers.ndim != 1 or not whole or np.any(numbers[1:] < numbers[:-1]):
        raise InputError(
            "scene",
            "the groups of its source must be whole numbers that never fall, one per clip: the number of its video",
        )
    return numbers


def _places(own: Sequence[int], clips: int) -> NDArray[np.intp]:
    if min(own) < 0 or max(own) >= clips:
        raise InputError("scene", f"the splits of its source name clips {min(own)} to {max(own)}, but it has {clips}")
    return np.asarray(own, np.intp)


class ClipTimesError(InputError):
    """A clip does not last as long as the shutter is open, or its frames make no equal slivers."""


def check_parameters(params: Mapping[str, Any], shutter: Shutter, rows: int, chosen: DatasetConfig) -> bool:
    """Refuse, before any work, scenes whose parameters say that their clips do not suit the shutter.

    ``params``: parameters of the scenes; clips last ``frames / frames_per_second``, and one frame stands still.

    Returns:
        Whether the parameters say how long clips last.

    Raises:
        ClipTimesError: with a number of frames that would do.
    """
    frames, rate = params.get("frames"), params.get("frames_per_second")
    if not isinstance(frames, int) or isinstance(frames, bool) or frames < 1:
        return False
    if frames == 1:
        _check_slivers(1, 1, chosen.slivers)
        return True
    if not isinstance(rate, int | float) or isinstance(rate, bool) or not 0 < rate < math.inf:
        return False
    open_s = shutter.duration_s(rows)
    if frames / rate < open_s * (1 - ROUNDING):
        needed = math.ceil(open_s * rate * (1 - ROUNDING))
        raise ClipTimesError(
            "scene.frames",
            f"got {frames} at {rate:g} per second, which last {_time(frames / rate)}, but the shutter is open "
            f"for {_time(open_s)}; expected at least {needed}, or fewer per second, or a faster camera.shutter",
        )
    _check_slivers(count_seen(np.arange(frames + 1) / rate, shutter, rows), frames, chosen.slivers)
    return True


def check_clip(clip: Clip, shutter: Shutter, rows: int, slivers: int | None) -> None:
    """Refuse a clip that does not suit the shutter; a still always does.

    Raises:
        ClipTimesError: naming where the clip comes from.
    """
    frames, edges = len(clip.rgb), clip.frame_edges_s
    if frames == 1:
        _check_slivers(1, 1, slivers)
        return
    first_s, open_s = shutter.span_s(rows)
    if edges[0] <= first_s and edges[-1] < open_s * (1 - ROUNDING):
        needed = math.ceil((open_s - edges[0]) * frames / (edges[-1] - edges[0]) * (1 - ROUNDING))
        raise ClipTimesError(
            "scene",
            f"a clip of {frames} frames lasts {_time(edges[-1])}, but the shutter is open for {_time(open_s)}; take "
            f"{needed} frames, or fewer per second, or a faster camera.shutter. The clip: {clip.source}",
        )
    try:
        shutter.check_covered(rows, edges)
    except InputError as error:
        raise ClipTimesError(
            "scene", f"{error.reason}; times count from the capture's start. The clip: {clip.source}"
        ) from error
    _check_slivers(count_seen(edges, shutter, rows), frames, slivers)


def count_seen(frame_edges_s: NDArray[np.float64], shutter: Shutter, rows: int) -> int:
    """Return how many frames of a clip last while the shutter is open."""
    seen = frames_seen(frame_edges_s, shutter, rows)
    return seen.stop - seen.start


def durations_s(frame_edges_s: NDArray[np.float64]) -> float | list[float]:
    """Return how long frames last, seconds: one number where all last as long."""
    durations = np.diff(frame_edges_s)
    mean = float(durations.mean())
    # Differences of times carry the rounding of the times, which grow along the clip.
    same = np.allclose(durations, mean, rtol=1e-9, atol=4e-16 * float(np.abs(frame_edges_s).max()))
    return float((frame_edges_s[-1] - frame_edges_s[0]) / len(durations)) if same else durations.tolist()


def _check_slivers(seen: int, frames: int, slivers: int | None) -> None:
    if slivers is None or (1 <= slivers <= seen and seen % slivers == 0):
        return
    if frames == 1:
        raise ClipTimesError(
            "dataset.slivers", f"got {slivers}, but the scenes stand still (scene.frames: 1); leave it out"
        )
    fitting = ", ".join(str(number) for number in range(1, seen + 1) if seen % number == 0)
    of = f"{seen} of the {frames}" if seen < frames else f"all {seen}"
    raise ClipTimesError(
        "dataset.slivers",
        f"got {slivers}, but the shutter sees {of} frames of a clip, which do not come out even; expected "
        f"one of {fitting}, or change scene.frames, scene.frames_per_second or the shutter's times",
    )


def _time(seconds: float) -> str:
    return f"{seconds * 1e3:.6g} ms"
