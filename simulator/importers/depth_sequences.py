"""Images with depth in numbered sequences: pairs of files, clips of consecutive numbers, and all of them read once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.inspection import Progress, sizes_text, told
from simulator.importers.listing import Fault, fault_of, grouped
from simulator.types import View


@dataclass(frozen=True)
class Pair:
    """One image with its depth or disparity.

    Attributes:
        image: file, relative to the data set's root.
        depth: file, relative to the data set's root.
        sequence: what the sequence is called.
        number: the frame's number in its sequence.
        mask: file that is black where the depth is unknown, or None.
        label: of what is done in its sequence, or None.
    """

    image: Path
    depth: Path
    sequence: str
    number: int
    mask: Path | None = None
    label: str | None = None


@dataclass(frozen=True)
class DepthClips:
    """What scene sources of such pairs share; picklable, it holds names and numbers only.

    Attributes:
        view: the camera's view.
        root: the data set's folder.
        pairs: sequence after sequence.
        starts: index of each clip's first pair.
        groups: number of the sequence that each clip comes from; never falls.
        length: frames of a clip.
        frames_per_second: of clips; None for stills.
        problems: what was found and cannot be used.
    """

    view: View
    root: Path
    pairs: tuple[Pair, ...]
    starts: tuple[int, ...]
    groups: tuple[int, ...]
    length: int
    frames_per_second: float | None
    problems: tuple[str, ...]

    def __len__(self) -> int:
        """Return how many different clips there are."""
        return len(self.starts)

    @property
    def inputs(self) -> list[Path]:
        """All images, depths and masks: which of them a data set uses depends on its size only."""
        return [self.root / file for pair in self.pairs for file in (pair.image, pair.depth, pair.mask) if file]

    @property
    def frame_edges_s(self) -> NDArray[np.float64]:
        """When the frames of a clip begin and end; a still lasts 1 s."""
        return np.arange(self.length + 1) / (self.frames_per_second or 1.0)

    def pairs_of(self, index: int) -> tuple[Pair, ...]:
        """Return the pairs of a clip; the index is taken modulo their number."""
        start = self.starts[index % len(self.starts)]
        return self.pairs[start : start + self.length]


def find_runs(pairs: Sequence[Pair], length: int) -> tuple[tuple[int, ...], tuple[int, ...], tuple[str, ...]]:
    """Cut sequences into clips of consecutive numbers that lie one after the other and share no frame.

    ``pairs``: those of one sequence stand together, in the order of their numbers.

    Returns:
        The index of each clip's first pair, and the number of the sequence that it comes from. What is left over at the end
        of a run of consecutive numbers is not used. Then lines about sequences that are too short for a clip, one for all
        with the same number of frames.

    Raises:
        InputError: when no sequence is long enough.

    Example:
        >>> frames = [*zip("aaaaa", (6, 7, 8, 10, 11)), *zip("bb", (1, 2))]
        >>> find_runs([Pair(Path(), Path(), name, number) for name, number in frames], 2)
        ((0, 3, 5), (0, 0, 1), ())
    """
    starts: list[int] = []
    groups: list[int] = []
    faults: list[Fault] = []
    longest: tuple[int, str] = (0, "")
    ends = [k for k in range(1, len(pairs)) if pairs[k].sequence != pairs[k - 1].sequence]
    for group, (first, end) in enumerate(pairwise([0, *ends, len(pairs)])):
        before, most = len(starts), 0
        for start, stop in _runs(pairs, first, end):
            starts += range(start, stop - length + 1, length)
            most = max(most, stop - start)
        groups += [group] * (len(starts) - before)
        longest = max(longest, (most, pairs[first].sequence))
        if most < length:
            reason = f"has {most} consecutive frames, but a clip takes {length}: ask for fewer frames"
            faults.append((pairs[first].sequence, reason))
    if not starts:
        raise InputError(
            "frames",
            f"got {length}, but the longest run, in {longest[1]!r}, has {longest[0]}: ask for fewer",
        )
    return tuple(starts), tuple(groups), grouped(faults)


def _runs(pairs: Sequence[Pair], first: int, end: int) -> list[tuple[int, int]]:
    """First index and end of each run of consecutive numbers in one sequence."""
    breaks = [k for k in range(first + 1, end) if pairs[k].number != pairs[k - 1].number + 1]
    return list(pairwise([first, *breaks, end]))


def check_rate(frames: int, frames_per_second: float | None) -> None:
    """Refuse a clip without a frame rate, and a still with one.

    Raises:
        InputError: for either.
    """
    if frames > 1 and frames_per_second is None:
        raise InputError("frames_per_second", f"missing: a clip of {frames} frames needs its rate")
    if frames == 1 and frames_per_second is not None:
        raise InputError("frames_per_second", f"got {frames_per_second:g}, but frames: 1 gives stills: leave it out")


def read_pairs(
    root: Path,
    pairs: Sequence[Pair],
    unpaired: Sequence[Fault],
    read: Callable[[Pair], tuple[int, ...]],
    progress: Progress | None,
) -> tuple[list[Pair], list[Fault], dict[str, str], list[str]]:
    """Read every pair once, for a survey; ``read`` returns a pair's rows and columns, its errors are faults.

    Returns:
        The pairs that can be used; the faults of the others, after ``unpaired``; facts on sequences and sizes; and notes.
    """
    good: list[Pair] = []
    faults, sizes = list(unpaired), set[tuple[int, ...]]()
    for pair in told(pairs, len(pairs), progress):
        try:
            sizes.add(read(pair))
            good.append(pair)
        except InputError as error:
            faults.append(fault_of(error, root / pair.image, root / pair.depth))
    sequences = len({pair.sequence for pair in good})
    ends = [k for k in range(1, len(good)) if good[k].sequence != good[k - 1].sequence]
    runs = [run for span in pairwise([0, *ends, len(good)]) for run in _runs(good, *span)] if good else []
    lengths = [stop - start for start, stop in runs]
    facts = {
        "sequences": str(sequences),
        "frames": str(len(good)),
        "consecutive frames": f"{min(lengths)} to {max(lengths)}" if lengths else "none",
        "sizes": sizes_text(sizes),
    }
    gaps = len(lengths) - sequences
    return good, faults, facts, [f"gaps in the numbering: {gaps}, which no clip crosses"] if gaps else []
