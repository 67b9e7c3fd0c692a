"""Clips out of numbered frames: as many frames as a clip takes whose numbers follow one another, never across a gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from simulator.errors import InputError
from simulator.importers.listing import Fault, grouped


@dataclass(frozen=True)
class Runs:
    """Where the clips of a list of frames begin.

    Attributes:
        starts: index of each clip's first frame.
        groups: number of the sequence that each clip comes from; never falls.
        problems: lines about sequences that are too short for a clip, one for all with the same number of frames.
    """

    starts: tuple[int, ...]
    groups: tuple[int, ...]
    problems: tuple[str, ...]


def find_runs(sequences: Sequence[str], numbers: Sequence[int], length: int) -> Runs:
    """Cut sequences into clips that lie one after the other and share no frame.

    Args:
        sequences: the name of each frame's sequence; the frames of one sequence stand together.
        numbers: each frame's number in its sequence, in rising order.
        length: frames of a clip.

    Returns:
        The clips; what is left over at the end of a run of consecutive numbers is not used.

    Raises:
        InputError: when no sequence is long enough.

    Example:
        >>> find_runs(["a"] * 5 + ["b"] * 2, [6, 7, 8, 10, 11, 1, 2], 2)
        Runs(starts=(0, 3, 5), groups=(0, 0, 1), problems=())
    """
    starts: list[int] = []
    groups: list[int] = []
    faults: list[Fault] = []
    longest: tuple[int, str] = (0, "")
    for group, (first, end) in enumerate(_stretches(sequences)):
        before = len(starts)
        breaks = [k for k in range(first + 1, end) if numbers[k] != numbers[k - 1] + 1]
        runs = list(pairwise([first, *breaks, end]))
        for start, stop in runs:
            starts += range(start, stop - length + 1, length)
        groups += [group] * (len(starts) - before)
        most = max(stop - start for start, stop in runs)
        longest = max(longest, (most, sequences[first]))
        if most < length:
            reason = f"has {most} consecutive frames, but a clip takes {length}: ask for fewer frames"
            faults.append((sequences[first], reason))
    if not starts:
        msg = (
            f"frames is {length}, but no sequence has so many with consecutive numbers: the longest, {longest[1]!r}, "
            f"has {longest[0]}; ask for fewer"
        )
        raise InputError(msg)
    return Runs(tuple(starts), tuple(groups), grouped(faults))


def run_lengths(sequences: Sequence[str], numbers: Sequence[int]) -> list[int]:
    """Return the lengths of all runs of consecutive numbers, in order."""
    count = len(numbers)
    breaks = [k for k in range(1, count) if sequences[k] != sequences[k - 1] or numbers[k] != numbers[k - 1] + 1]
    return [stop - start for start, stop in pairwise([0, *breaks, count])]


def fault_of(error: InputError, *files: Path) -> Fault:
    """Return the file and the reason: the file is the one whose name the message begins with, else the first of them."""
    text = str(error)
    named = next((file for file in files if text.startswith(f"{file} ")), files[0])
    return str(named), text.removeprefix(f"{named} ")


def check_rate(frames: int, frames_per_second: float | None) -> None:
    """Refuse a clip without a frame rate, and a still with one.

    Raises:
        InputError: for either.
    """
    if frames > 1 and frames_per_second is None:
        msg = f"frames_per_second is missing: a clip of {frames} frames needs the rate at which they were taken"
        raise InputError(msg)
    if frames == 1 and frames_per_second is not None:
        msg = (
            f"frames_per_second is {frames_per_second:g}, but frames: 1 gives stills, which stand still for as long as the "
            "shutter is open: leave it out or ask for more frames"
        )
        raise InputError(msg)


def _stretches(names: Sequence[str]) -> list[tuple[int, int]]:
    """First index and end of each stretch of equal names."""
    breaks = [k for k in range(1, len(names)) if names[k] != names[k - 1]]
    return list(pairwise([0, *breaks, len(names)]))
