"""manifest.jsonl: one short line per finished sample, appended by the one parent process of a run.

A sample counts as finished once its line is on disk.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from simulator.dataset.sample import SPLITS, SampleRecord, sample_index
from simulator.errors import InputError
from simulator.io.files import AppendedLines, read_lines

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
        msg = f"{path}:{number}: not a manifest line ({names}); delete the line, and its sample is made again"
        raise InputError(msg)
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
