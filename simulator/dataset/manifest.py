"""manifest.jsonl: one short line per finished sample, appended by the one parent process of a run.

A sample counts as finished once its line is on disk. A crash can tear the last line only; it is dropped on loading and
cut off before the next line is appended.
"""

from __future__ import annotations

import fcntl
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import TracebackType

from simulator.dataset.sample import SPLITS, SampleRecord, sample_index
from simulator.errors import InputError
from simulator.files import storage_errors, write_all

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
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return Manifest({}, torn=False, duplicates=0)
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
    *lines, rest = data.split(b"\n")
    entries: dict[tuple[str, str], Entry] = {}
    for number, line in enumerate(lines, start=1):
        entry = _parse(path, number, line)
        entries[entry.split, entry.id] = entry
    ordered = sorted(entries.values(), key=lambda entry: (SPLITS.index(entry.split), entry.id))
    return Manifest(
        {(entry.split, entry.id): entry for entry in ordered}, bool(rest), duplicates=len(lines) - len(entries)
    )


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


class ManifestWriter:
    """Appends lines; one writer per data set, in the parent process only.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with ManifestWriter(root) as writer:
        ...         writer.append(SampleRecord("s00000000", "train", "0" * 64, 7, None), seconds=0.25)
        ...     load_manifest(root).ids("train")
        ['s00000000']
    """

    def __init__(self, root: Path | str) -> None:
        """Open the manifest in the folder ``root``, take its lock and cut a torn last line.

        Raises:
            InputError: another process is writing to the same data set.
            StorageError: the folder cannot be written to.
        """
        self._path = Path(root) / MANIFEST
        with storage_errors(self._path):
            self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._descriptor)
            msg = f"another process is writing to the data set in {root}; wait for it or choose another dataset.output"
            raise InputError(msg) from error
        except OSError:
            pass  # a file system without locks
        with storage_errors(self._path):
            self._size = _end_of_last_line(self._descriptor)
            os.ftruncate(self._descriptor, self._size)

    def append(self, record: SampleRecord, seconds: float) -> None:
        """Add one line and wait until it is on the disk.

        Raises:
            StorageError: the disk is full; the manifest stays as it was before.
        """
        content = asdict(record) | {"seconds": round(float(seconds), 4)}
        line = json.dumps(content, separators=(",", ":")).encode() + b"\n"
        with storage_errors(self._path):
            try:
                write_all(self._descriptor, line)
                os.fsync(self._descriptor)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._descriptor, self._size)
                raise
        self._size += len(line)

    def close(self) -> None:
        """Release the file and its lock; may be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> ManifestWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def _end_of_last_line(descriptor: int) -> int:
    size = os.fstat(descriptor).st_size
    end, step = size, 4096
    while end > 0:
        start = max(0, end - step)
        found = os.pread(descriptor, end - start, start).rfind(b"\n")
        if found >= 0:
            return start + found + 1
        end = start
    return 0
