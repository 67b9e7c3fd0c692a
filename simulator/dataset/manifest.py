"""What runs made, left out and failed to make: a line each, in a file for each of the three.

A run that is alone appends to the lists of the data set; each of several at a time to lists of its own, below ``writers/``.
What a data set holds is the union of all. The last run to end merges them.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import chain, pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from simulator.dataset.sample import SPLITS, SampleRecord, sample_id, sample_index
from simulator.errors import InputError
from simulator.io.files import read_errors, refuse_link, remove_file, remove_folder, write_atomic
from simulator.io.lines import AppendedLines, StoredLines, line_of, read_lines
from simulator.io.store import Place, StorePath, place

MANIFEST, SKIPPED, FAILED = "manifest.jsonl", "skipped.jsonl", "failed.jsonl"
WRITERS = "writers"
STAGES = ("scene", "exposure", "files")
"""What a sample's time goes into: the scene's clip, its light on the sensor, noise and files."""

Key = tuple[str, str]  # split and id
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Entry(SampleRecord):
    """A line of the manifest.

    Attributes:
        seconds: that the making of the sample took, wall time.
        stages: how much of it each of ``STAGES`` took; empty in data sets of versions that did not measure it.
        cpu: level of the processor that made it, where that is another than ``versions.cpu`` of ``dataset.json``.
    """

    seconds: float
    stages: tuple[float, ...] = ()
    cpu: str | None = None


@dataclass(frozen=True)
class Manifest:
    """The finished samples of a data set.

    Attributes:
        entries: by (split, id), in the order of splits and ids; of duplicate lines the last one wins.
        torn: whether an unfinished last line was dropped.
        duplicates: how many lines were replaced by later ones.
    """

    entries: dict[Key, Entry]
    torn: bool
    duplicates: int

    def ids(self, split: str) -> list[str]:
        """Return the ids of a split in increasing order."""
        return [identifier for name, identifier in self.entries if name == split]


@dataclass(frozen=True)
class FailedSample:
    """Why a sample could not be made: the last error, how often it was tried, and the traceback as text."""

    reason: str
    attempts: int
    traceback: str


# ---- reading


def load_manifest(root: Place | str) -> Manifest:
    """Load a data set's manifest; a missing file is an empty one.

    Raises:
        InputError: unreadable file, or a bad line before the last.
    """
    return _settled(place(root), lambda: _manifest(place(root)))


def _manifest(root: Place) -> Manifest:
    entries: dict[Key, Entry] = {}
    lines, torn = 0, False
    for where, line in _lines(root, MANIFEST):
        if not line.endswith(b"\n"):
            torn = True
            continue
        content, key = _content(where, line, _is_entry, _ENTRY)
        content["stages"] = tuple(content.get("stages", ()))
        entries[key] = Entry(**content)
        lines += 1
    return Manifest(_in_order(entries), torn, lines - len(entries))


@dataclass(frozen=True)
class Survey:
    """What a manifest says in all, without its entries: little memory for a million samples.

    Attributes:
        finished: the numbers of the finished samples by split, all splits.
        labels: how many lines have each label.
        tidy: whether there is one line a sample, and none torn.
    """

    finished: dict[str, set[int]]
    labels: Counter[str]
    tidy: bool

    @property
    def samples(self) -> int:
        """How many samples are finished."""
        return sum(map(len, self.finished.values()))


def survey(root: Place | str) -> Survey:
    """Read a data set's manifest for what it says in all.

    Raises:
        InputError: see `load_manifest`.
    """
    return _settled(place(root), lambda: _survey(place(root)))


def _survey(root: Place) -> Survey:
    found: dict[str, set[int]] = {split: set() for split in SPLITS}
    labels, lines, whole = Counter[str](), 0, True
    for where, line in _lines(root, MANIFEST):
        if not line.endswith(b"\n"):
            whole = False
            continue
        content, (split, name) = _content(where, line, _is_entry, _ENTRY)
        found[split].add(int(name[1:]))
        lines += 1
        if content["label"] is not None:
            labels[content["label"]] += 1
    return Survey(found, labels, whole and lines == sum(map(len, found.values())))


def finished_samples(root: Place | str) -> dict[str, set[int]]:
    """Return the numbers of the finished samples by split; errors as `load_manifest`."""
    return survey(root).finished


def accounted_samples(
    root: Place | str, finished: dict[str, set[int]] | None = None, *, failed: bool = False
) -> dict[str, set[int]]:
    """Return the numbers of the samples that are finished or were left out for good, by split; each counts once.

    Args:
        root: the data set.
        finished: what `finished_samples` gave, where that is known; it stays as it is.
        failed: those, too, that could not be made; another run tries them again.

    Raises:
        InputError: see `load_manifest`.
    """
    finished = finished_samples(root) if finished is None else finished
    others: dict[str, set[int]] = {split: set() for split in finished}
    for split, name in [*load_skipped(root), *(load_failed(root) if failed else ())]:
        others[split].add(sample_index(name))
    return {split: own | others[split] if others[split] else own for split, own in finished.items()}


def load_skipped(root: Place | str) -> dict[Key, str]:
    """Return why samples were left out, by (split, id) in order; empty without a list.

    Raises:
        InputError: unreadable file, or a bad line before the last.
    """
    found = _by_sample(place(root), SKIPPED, lambda content: _is_text(content["reason"]), "id, split, reason")
    return {key: content["reason"] for key, content in found.items()}


def load_failed(root: Place | str) -> dict[Key, FailedSample]:
    """Return the samples that could not be made, and were neither made nor left out since; errors as `load_skipped`."""
    root = place(root)

    def is_failure(content: dict[str, Any]) -> bool:
        return all(_is_text(content[name]) for name in ("reason", "traceback")) and type(content["attempts"]) is int

    found = _by_sample(root, FAILED, is_failure, "id, split, reason, attempts, traceback")
    if not found:
        return {}
    since = accounted_samples(root)
    names = ("reason", "attempts", "traceback")
    return {
        key: FailedSample(*(content[name] for name in names))
        for key, content in found.items()
        if sample_index(key[1]) not in since[key[0]]
    }


_ENTRY = "id, split, digest, seed, label, seconds"
_KEYS = frozenset(_ENTRY.split(", "))
_LONGEST_S = 1e9  # of a sample: thirty years


def _is_entry(content: dict[str, Any]) -> bool:
    stages = content.get("stages", ())
    return (
        content.keys() - {"stages", "cpu"} == _KEYS
        and isinstance(content["seed"], int)
        and (content["label"] is None or _is_text(content["label"]))
        and isinstance(content["digest"], str)
        and len(content["digest"]) == 64
        and all(
            isinstance(seconds, int | float) and 0 <= seconds < _LONGEST_S for seconds in (content["seconds"], *stages)
        )
        and ("cpu" not in content or _is_text(content["cpu"]))
    )


def _is_text(value: object) -> bool:
    """Whether a value is text; half a surrogate pair, which nothing could print, is refused by a ``ValueError``."""
    return isinstance(value, str) and value.encode() is not None


def _by_sample(
    root: Place, name: str, fits: Callable[[dict[str, Any]], bool], expected: str
) -> dict[Key, dict[str, Any]]:
    """Return the content of each line by (split, id), in order; the last line of a sample wins."""

    def collect() -> dict[Key, dict[str, Any]]:
        whole = ((where, line) for where, line in _lines(root, name) if line.endswith(b"\n"))
        pairs = (_content(where, line, fits, expected) for where, line in whole)
        return _in_order({key: content for content, key in pairs})

    return _settled(root, collect)


def _content(
    where: tuple[Place, int], line: bytes, fits: Callable[[dict[str, Any]], bool], expected: str
) -> tuple[dict[str, Any], Key]:
    """Return what a line holds, and its sample.

    Raises:
        InputError: naming the file and the line.
    """
    try:
        content = json.loads(line)
        key = content["split"], content["id"]
        if fits(content) and key[0] in SPLITS and sample_index(key[1]) >= 0:
            return content, key
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        pass
    raise InputError(f"{where[0]}:{where[1]}", f"expected {expected}; delete the line, and its sample is made again")


def _lines(root: Place, name: str) -> Iterator[tuple[tuple[Place, int], bytes]]:
    """Yield the lines of a list and of every writer's with the file and the number of each."""
    others = writers_files(root, name)  # listed before anything is read: what is merged meanwhile is missed from them
    own = root / name
    yield from (((own, number), line) for number, line in enumerate(read_lines(own), start=1))
    for path in others:
        lines = read_lines(path)
        if (first := next(lines, None)) is None and not path.exists():
            raise _MergedError
        yield from (((path, number), line) for number, line in enumerate(chain(filter(None, [first]), lines), start=1))


def writers_files(root: Place, name: str) -> list[Place]:
    """Return the files of a list that writers of their own have not merged yet.

    Raises:
        InputError: they cannot be read, or a folder of theirs is a link.
    """
    writers = root / WRITERS
    with read_errors(writers):
        while writers.is_dir():
            with suppress(FileNotFoundError):  # they are merged meanwhile: what is left is listed again
                for folder in writers.iterdir() if isinstance(writers, Path) else ():
                    refuse_link(folder)
                return sorted(writers.glob(f"*/{name.removesuffix('.jsonl')}*.jsonl"))
    return []


class _MergedError(Exception):
    """A writer's list is gone since the folder was listed: the run that ended last has merged it."""


def _settled(root: Place, collect: Callable[[], Result]) -> Result:
    for _ in range(_TIMES):
        with suppress(_MergedError):
            return collect()
    raise InputError(root / WRITERS, "holds lists that cannot be read, such as links to nowhere; remove them")


_TIMES = 20  # in a row that lists are merged while they are read: more often than all runs end together


def _in_order(found: dict[Key, Result]) -> dict[Key, Result]:
    def rank(key: Key) -> tuple[int, str]:
        return SPLITS.index(key[0]), key[1]

    if all(rank(first) < rank(second) for first, second in pairwise(found)):
        return found
    return {key: found[key] for key in sorted(found, key=rank)}


# ---- writing


class _ListWriter:
    """Appends to one of the lists in a folder: that of a data set, or a writer's own below ``writers/``.

    Attributes:
        folder: where the list lies.
        locked: whether no other process can write to it: not known where the file system has no locks.
    """

    name: str

    def __init__(self, folder: Place | str) -> None:
        """Open the list (made when missing).

        Raises:
            InputError: another process is writing to it.
            StorageError: the folder cannot be written to.
        """
        self.folder = place(folder)
        path = self.folder / self.name
        self._lines = StoredLines(path) if isinstance(path, StorePath) else AppendedLines(path)
        self.locked = self._lines.locked

    def _append(self, split: str, identifier: str, content: dict[str, Any]) -> None:
        self._lines.append_line({"id": identifier, "split": split} | content)

    def close(self) -> None:
        """Release the list; may be called twice."""
        self._lines.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class ManifestWriter(_ListWriter):
    """Appends finished samples.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with ManifestWriter(root) as writer:
        ...         writer.append(SampleRecord("s00000000", "train", "0" * 64, 7, None), seconds=0.25)
        ...     load_manifest(root).ids("train")
        ['s00000000']
    """

    name = MANIFEST

    def append(
        self, record: SampleRecord, seconds: float, stages: tuple[float, ...] = (), cpu: str | None = None
    ) -> None:
        """Add one line; see `Entry` and `AppendedLines.append_line`."""
        content = asdict(record) | {"seconds": round(float(seconds), 4)}
        if stages:
            content["stages"] = tuple(round(float(part), 4) for part in stages)
        if cpu is not None:
            content["cpu"] = cpu
        self._lines.append_line(content)

    def replace(self, lines: Iterable[bytes]) -> None:
        """Put others in the place of all lines; see `AppendedLines.replace`."""
        self._lines.replace(lines)


class SkippedWriter(_ListWriter):
    """Appends samples that were left out.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with SkippedWriter(root) as writer:
        ...         writer.append("train", 3, "clip.webm is truncated")
        ...     load_skipped(root)
        {('train', 's00000003'): 'clip.webm is truncated'}
    """

    name = SKIPPED

    def append(self, split: str, index: int, reason: str) -> None:
        """Add why a sample cannot be made; see `AppendedLines.append_line`."""
        self._append(split, sample_id(index), {"reason": reason})


class FailedWriter(_ListWriter):
    """Appends samples that could not be made; a later run tries them again.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with FailedWriter(root) as writer:
        ...         writer.append("train", 3, "SystemExit: 0", 3, "Traceback ...")
        ...     load_failed(root)
        {('train', 's00000003'): FailedSample(reason='SystemExit: 0', attempts=3, traceback='Traceback ...')}
    """

    name = FAILED

    def append(self, split: str, index: int, reason: str, attempts: int, traceback: str) -> None:
        """Add why a sample could not be made; see `AppendedLines.append_line`."""
        self._append(split, sample_id(index), {"reason": reason, "attempts": attempts, "traceback": traceback})


def rewrite_manifest(manifest: ManifestWriter, *, without: Container[Key] = (), skip_bad: bool = False) -> None:
    """Replace a data set's manifest by one line a sample, the last of each, of all writers' lists, in order.

    Args:
        manifest: the data set's, held by the one who writes alone.
        without: samples that are left out.
        skip_bad: drop lines that hold no entry.

    Raises:
        InputError: see `load_manifest`.
        StorageError: the disk is full; the manifest stays as it was before.
    """
    found: dict[str, dict[int, bytes]] = {split: {} for split in SPLITS}
    for where, line in _lines(manifest.folder, MANIFEST):
        try:
            if line.endswith(b"\n"):
                _, key = _content(where, line, _is_entry, _ENTRY)
                if key not in without:
                    found[key[0]][sample_index(key[1])] = line
        except InputError:
            if not skip_bad:
                raise
    manifest.replace(own[index] for own in found.values() for index in sorted(own))


def merge_lists(manifest: ManifestWriter, *, skip_bad: bool = False) -> None:
    """Merge all writers' lists into those of the data set, one line a sample.

    Args:
        manifest: the data set's, held by the one who writes alone.
        skip_bad: drop lines that hold no entry.

    Raises:
        InputError: see `load_manifest`.
        StorageError: the disk is full; the lists stay as they were before.
    """
    root = manifest.folder
    with read_errors(root / WRITERS):
        many = (root / WRITERS).exists()
    if many or skip_bad or not survey(root).tidy:
        rewrite_manifest(manifest, skip_bad=skip_bad)
    if not many:
        return
    rest: dict[str, dict[Key, dict[str, Any]]] = {
        SKIPPED: {key: {"reason": reason} for key, reason in load_skipped(root).items()},
        FAILED: {key: asdict(failure) for key, failure in load_failed(root).items()},
    }
    for name, found in rest.items():
        if found:
            lines = (line_of({"id": key[1], "split": key[0]} | content) for key, content in found.items())
            write_atomic(root / name, b"".join(lines))
        elif (root / name).exists():
            remove_file(root / name)  # what failed was made since
    remove_folder(root / WRITERS)
