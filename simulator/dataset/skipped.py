"""What ``generate --skip-bad`` leaves out: samples in skipped.jsonl, files of the source in source_problems.txt."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from simulator.dataset.sample import SPLITS, sample_id, sample_index
from simulator.errors import InputError
from simulator.io.files import AppendedLines, read_lines, write_atomic

SKIPPED = "skipped.jsonl"
PROBLEMS = "source_problems.txt"
_SHOWN = 20


class SkippedWriter(AppendedLines):
    """Appends samples that were left out; to be used by whoever holds the manifest's lock.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with SkippedWriter(root) as writer:
        ...         writer.append("train", 3, "clip.webm is truncated")
        ...     load_skipped(root)
        {('train', 's00000003'): 'clip.webm is truncated'}
    """

    def __init__(self, root: Path | str) -> None:
        """Open the list in the folder ``root``; see `AppendedLines`."""
        super().__init__(Path(root) / SKIPPED)

    def append(self, split: str, index: int, reason: str) -> None:
        """Add one line and wait until it is on the disk.

        Args:
            split: of the sample.
            index: its number within the split.
            reason: why it cannot be made, naming the file.

        Raises:
            StorageError: the disk is full; the list stays as it was before.
        """
        self.append_line({"id": sample_id(index), "split": split, "reason": reason})

    def __enter__(self) -> SkippedWriter:
        return self


def load_skipped(root: Path | str) -> dict[tuple[str, str], str]:
    """Return why samples were left out, by (split, id) in order; empty without a list.

    Args:
        root: the data set's folder.

    Raises:
        InputError: unreadable file, or a bad line before the last.
    """
    path = Path(root) / SKIPPED
    lines, _ = read_lines(path)
    reasons: dict[tuple[str, str], str] = {}
    for number, line in enumerate(lines, start=1):
        try:
            content = json.loads(line)
            split, identifier, reason = content["split"], content["id"], content["reason"]
            valid = split in SPLITS and isinstance(reason, str) and sample_index(identifier) >= 0
        except (ValueError, TypeError, KeyError, RecursionError):
            valid = False
        if not valid:
            msg = f"{path}:{number}: not a line of skipped samples (id, split, reason); delete it, and its sample is tried"
            raise InputError(msg)
        reasons[split, identifier] = reason
    return dict(sorted(reasons.items(), key=lambda item: (SPLITS.index(item[0][0]), item[0][1])))


def shortened(lines: Sequence[str]) -> str:
    """Return lines as text, of many only the first, and how many more there are."""
    more = len(lines) - _SHOWN
    return "\n".join([*(f"  {line}" for line in lines[:_SHOWN]), *([f"  and {more} more"] if more > 0 else [])])


def refuse_problems(problems: Sequence[str]) -> None:
    """Refuse a source that cannot use some of its files.

    Raises:
        InputError: naming them and why.
    """
    if problems:
        msg = (
            f"scene: its source has {_counted(len(problems))}:\n{shortened(problems)}\nmend or remove what is named, or "
            "leave it out: flatlight generate --skip-bad"
        )
        raise InputError(msg)


def list_problems(root: Path, problems: Sequence[str]) -> str:
    """Write down what a source cannot use and return it as lines to be read."""
    write_atomic(root / PROBLEMS, "".join(f"{line}\n" for line in problems).encode())
    return f"{_counted(len(problems))} of the source, gone on without ({PROBLEMS} lists all):\n{shortened(problems)}"


def _counted(count: int) -> str:
    return "1 problem" if count == 1 else f"{count} problems"
