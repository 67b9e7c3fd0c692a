"""What a run made and what it left out: manifest.jsonl and skipped.jsonl, a short line each, appended by one process."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from simulator.dataset.sample import SPLITS, SampleRecord, sample_id, sample_index
from simulator.errors import InputError
from simulator.io.files import AppendedLines, read_lines, write_atomic

MANIFEST = "manifest.jsonl"


@dataclass(frozen=True)
class Entry(SampleRecord):
    """A line of the manifest: the sample's record and the seconds its making took."""

    seconds: float


@dataclass(frozen=True)
class Manifest:
    """The finished samples of a data set.

    Attributes:
        entries: by (split, id), in the order of splits and ids; of duplicate lines the last one wins.
        torn: whether an unfinished last line was dropped.
        duplicates: how many lines were replaced by later ones.
    """

    entries: dict[tuple[str, str], Entry]
    torn: bool
    duplicates: int

    def ids(self, split: str) -> list[str]:
        """Return the ids of a split in increasing order."""
        return [identifier for name, identifier in self.entries if name == split]


def load_manifest(root: Path | str) -> Manifest:
    """Load a data set's manifest; a missing file is an empty one.

    Args:
        root: the data set's folder.

    Raises:
        InputError: unreadable file, or a bad line before the last.
    """
    path = Path(root) / MANIFEST
    lines, torn = read_lines(path)
    entries: dict[tuple[str, str], Entry] = {}
    for number, line in enumerate(lines, start=1):
        entry = _parse(path, number, line)
        entries[entry.split, entry.id] = entry
    ordered = sorted(entries.values(), key=lambda entry: (SPLITS.index(entry.split), entry.id))
    return Manifest({(entry.split, entry.id): entry for entry in ordered}, torn, duplicates=len(lines) - len(entries))


def _parse(path: Path, number: int, line: bytes) -> Entry:
    try:
        content = json.loads(line)
        entry = Entry(**content)
        sample_index(entry.id)
        valid = entry.split in SPLITS and len(entry.digest) == 64 and isinstance(entry.seed, int)
        valid = valid and isinstance(entry.label, str | None) and isinstance(entry.seconds, int | float)
    except (ValueError, TypeError, AttributeError, RecursionError):
        valid, entry = False, None
    if not valid or entry is None:
        names = ", ".join(field.name for field in fields(Entry))
        raise InputError(
            f"{path}:{number}", f"not a manifest line ({names}); delete the line, and its sample is made again"
        )
    return entry


class ManifestWriter(AppendedLines):
    """Appends finished samples; one writer per data set, in the parent process only.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with ManifestWriter(root) as writer:
        ...         writer.append(SampleRecord("s00000000", "train", "0" * 64, 7, None), seconds=0.25)
        ...     load_manifest(root).ids("train")
        ['s00000000']
    """

    def __init__(self, root: Path | str) -> None:
        """Open the manifest in the folder ``root``; see `AppendedLines`."""
        super().__init__(Path(root) / MANIFEST)

    def append(self, record: SampleRecord, seconds: float) -> None:
        """Add one line and wait until it is on the disk.

        Raises:
            StorageError: the disk is full; the manifest stays as it was before.
        """
        self.append_line(asdict(record) | {"seconds": round(float(seconds), 4)})

    def __enter__(self) -> ManifestWriter:
        return self


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
            raise InputError(
                f"{path}:{number}",
                "not a line of skipped samples (id, split, reason); delete it, and its sample is tried",
            )
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
        raise InputError(
            "scene",
            f"its source has {_counted(len(problems))}:\n{shortened(problems)}\nmend or remove what is named, or "
            "leave it out: flatlight generate --skip-bad",
        )


def list_problems(root: Path, problems: Sequence[str]) -> str:
    """Write down what a source cannot use and return it as lines to be read."""
    write_atomic(root / PROBLEMS, "".join(f"{line}\n" for line in problems).encode())
    return f"{_counted(len(problems))} of the source, gone on without ({PROBLEMS} lists all):\n{shortened(problems)}"


def _counted(count: int) -> str:
    return "1 problem" if count == 1 else f"{count} problems"
