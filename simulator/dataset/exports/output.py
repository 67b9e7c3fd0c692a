"""The folder of an export: files that appear whole, an index that remembers them by hash, and so goes on where it stopped.

``export.json`` says what it is an export of, ``index.jsonl`` has a line per finished file: name, split, first sample, number
of samples, bytes, SHA-256. All follow from the data set and the options alone: no clock times, no names of users.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from simulator.dataset.checksums import CROISSANT
from simulator.dataset.dataset_info import EXPORT
from simulator.dataset.exports.source import Source
from simulator.dataset.manifest import Entry
from simulator.dataset.verification import CheckedSample
from simulator.errors import InputError
from simulator.io.exr import MAX_FILE_BYTES
from simulator.io.files import (
    TEMPORARY_PREFIX,
    committed_file,
    not_plain,
    read_limited,
    remove_leftovers,
    sha256_bytes,
    sha256_file,
    storage_errors,
    write_atomic,
)
from simulator.io.json import readable_json
from simulator.io.lines import AppendedLines, line_of, read_lines

INDEX = "index.jsonl"
Progress = Callable[[int, int], None]  # (samples done, samples in all)
Writer = Callable[[Path], AbstractContextManager[Callable[[CheckedSample], None]]]
"""Opens a file to write to and gives the function that adds a sample."""


@dataclass(frozen=True)
class ExportedFile:
    """A finished file of an export.

    Attributes:
        name: its path below the export's folder.
        split: whose samples it holds; None for all splits.
        first: the id of its first sample.
        samples: how many it holds.
        bytes: its size.
        sha256: of its content.
    """

    name: str
    split: str | None
    first: str
    samples: int
    bytes: int
    sha256: str


class Output:
    """The folder of an export, locked for one writer; a context manager.

    Attributes:
        folder: its path.
        files: the finished files by name, in their order once all are there.
        kept: how many of them an earlier run had written.
    """

    def __init__(self, folder: Path, source: Source, options: Mapping[str, Any]) -> None:
        """Begin an export, or go on with one.

        Args:
            folder: missing, empty, or begun by the same export.
            source: what is exported.
            options: the format and what else decides the bytes.

        Raises:
            InputError: the folder lies in the data set, or holds something else.
            StorageError: it cannot be made.
        """
        if isinstance(source.root, Path) and folder.resolve().is_relative_to(source.root.resolve()):
            raise InputError("--output", f"{folder} lies inside the data set; choose a folder elsewhere")
        head: dict[str, Any] = {"format": "flatlight-export", "format_version": 1, **options}
        head |= {"name": source.info.name, "fingerprint": source.info.fingerprint}
        head |= {"samples": {split: len(entries) for split, entries in source.splits.items()}}
        head |= {"samples_sha256": source.digest, "companions": source.companions}
        self.folder, self.files, self.kept = folder, dict[str, ExportedFile](), 0
        _refuse_others(folder, readable_json(head))
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        self._lines = AppendedLines(folder / INDEX)
        write_atomic(folder / EXPORT, readable_json(head))
        remove_leftovers(folder)
        self._known = {file.name: file for file in read_index(folder)}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._lines.close()

    def has(self, name: str) -> bool:
        """Whether a file is there as an earlier run finished it."""
        known, path = self._known.get(name), self.folder / name
        if known is None or not path.is_file() or sha256_file(path) != known.sha256:
            return False
        self.files[name] = known
        self.kept += 1
        return True

    @contextmanager
    def writing(self, name: str, split: str | None, entries: Sequence[Entry]) -> Iterator[Path]:
        """Give a temporary file to write these samples to; at the end of the block it gets its name and its line.

        Raises:
            StorageError: it cannot be written.
        """
        path = self.folder / name
        with committed_file(path) as temporary:
            yield temporary
        found = ExportedFile(name, split, entries[0].id, len(entries), path.stat().st_size, sha256_file(path))
        self._lines.append_line(asdict(found))
        self.files[name] = found

    def copy_companions(self, source: Source) -> None:
        """Lay beside the files what belongs to all samples, so that the export can do without the data set.

        Raises:
            InputError: such a file has changed since the export began.
        """
        for name, expected in source.companions.items():
            data = read_limited(source.root / name, "a file of the data set", MAX_FILE_BYTES)
            if expected not in (None, sha256_bytes(data)):
                raise InputError(source.root / name, "has changed since the export began; begin it anew")
            with storage_errors(self.folder):
                (self.folder / name).parent.mkdir(exist_ok=True)
            write_atomic(self.folder / name, data)

    def finish(self, describe: Callable[[], bytes]) -> None:
        """Write the index as a whole, since a file that was written anew has two lines, and, last, what describes all."""
        write_atomic(self.folder / INDEX, b"".join(line_of(asdict(file)) for file in self.files.values()))
        write_atomic(self.folder / CROISSANT, describe())


def read_index(folder: Path) -> list[ExportedFile]:
    """Return the finished files of an export.

    Raises:
        InputError: a damaged index.
    """
    path = folder / INDEX
    try:
        return [ExportedFile(**json.loads(line)) for line in read_lines(path) if line.endswith(b"\n")]
    except (ValueError, TypeError, RecursionError) as error:
        raise InputError(path, "damaged; delete the export and begin it anew") from error


def _refuse_others(folder: Path, head: bytes) -> None:
    """Refuse a folder that holds anything but what the same export began, and links in that."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise InputError("--output", f"{folder} is a file; choose a folder")
    if not (folder / EXPORT).exists():
        names = [path.name for path in sorted(folder.iterdir()) if not path.name.startswith(TEMPORARY_PREFIX)]
        if names and not (names == [INDEX] and not read_index(folder)):  # as left by a run that died at once
            raise InputError("--output", f"{folder} holds other files ({names[0]}, ...); choose another folder")
        return
    if read_limited(folder / EXPORT, "the description of an export") != head:
        raise InputError(
            "--output",
            f"{folder} holds another export, or one of the data set as it was before; choose another folder, or delete it",
        )
    for path in not_plain(folder):
        raise InputError("--output", f"{path} is a link or not a file, which no export writes; remove it")


def by_size(
    source: Source, room_bytes: int, cost: Callable[[Mapping[str, int]], int], entries: Sequence[Entry]
) -> Iterator[Sequence[Entry]]:
    """Yield samples in runs that need at most so many bytes; a sample that needs more is alone.

    ``cost``: the bytes that a sample needs, from those of its files by name.
    """
    start = used = 0
    for position, entry in enumerate(entries):
        more = cost(source.describe(entry)[1])
        if position > start and used + more > room_bytes:
            yield entries[start:position]
            start, used = position, 0
        used += more
    yield entries[start:]


def write_files(
    source: Source,
    output: Output,
    progress: Progress,
    *,
    runs: Callable[[Sequence[Entry]], Iterable[Sequence[Entry]]],
    name: Callable[[str, int, Entry], str],
    writer: Writer,
) -> None:
    """Write one file per run of samples, one sample in memory at a time; those that are there already are kept.

    Args:
        source: the samples.
        output: the folder to write to.
        progress: called with (samples done, samples in all).
        runs: takes the samples of a split apart.
        name: a file's name, from split, number of the run in it and first sample.
        writer: opens a file and gives the function that adds a sample to it.

    Raises:
        InputError: a damaged sample, or one that does not fit the format.
        StorageError: a file cannot be written.
    """
    done = 0
    for split, entries in source.splits.items():
        for number, run in enumerate(runs(entries)):
            file = name(split, number, run[0])
            if output.has(file):
                done += len(run)
                progress(done, source.samples)
                continue
            with output.writing(file, split, run) as temporary, writer(temporary) as add:
                for entry in run:
                    add(source.read(entry))
                    done += 1
                    progress(done, source.samples)
