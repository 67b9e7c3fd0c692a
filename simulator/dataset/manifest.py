"""What a run made, left out and failed to make: a line each, appended by one process to a file for each of the three."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from simulator.dataset.sample import SPLITS, SampleRecord, sample_id, sample_index
from simulator.errors import InputError
from simulator.io.files import AppendedLines, line_of, read_lines, write_atomic
from simulator.io.json import parse_json

MANIFEST = "manifest.jsonl"
Key = tuple[str, str]  # split and id
Result = TypeVar("Result")


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

    Raises:
        InputError: unreadable file, or a bad line before the last.
    """
    lines, torn = read_lines(Path(root) / MANIFEST)
    expected = f"{', '.join(field.name for field in fields(Entry))}; delete the line, and its sample is made again"
    entries = _by_sample(Path(root) / MANIFEST, lines, _entry, expected)
    return Manifest(entries, torn, duplicates=len(lines) - len(entries))


def _entry(content: dict[str, Any]) -> Entry | None:
    entry = Entry(**content)
    typed = isinstance(entry.seed, int) and isinstance(entry.label, str | None) and isinstance(entry.digest, str)
    return entry if typed and len(entry.digest) == 64 and isinstance(entry.seconds, int | float) else None


def _by_sample(
    path: Path, lines: list[bytes], read: Callable[[Any], Result | None], expected: str
) -> dict[Key, Result]:
    """Return what ``read`` makes of each line by (split, id), in order; the last line of a sample wins."""
    found: dict[Key, Result] = {}
    for number, line in enumerate(lines, start=1):
        try:
            content = parse_json(line)
            value, key = read(content), (content["split"], content["id"])
            valid = value is not None and key[0] in SPLITS and sample_index(key[1]) >= 0
        except (ValueError, TypeError, KeyError, AttributeError):
            value, key, valid = None, ("", ""), False
        if value is None or not valid:
            raise InputError(f"{path}:{number}", f"expected {expected}")
        found[key] = value
    return dict(sorted(found.items(), key=lambda item: (SPLITS.index(item[0][0]), item[0][1])))


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
        """Add one line; see `AppendedLines.append_line`."""
        self.append_line(asdict(record) | {"seconds": round(float(seconds), 4)})

    def drop_duplicates(self) -> None:
        """Keep the last line of each sample only; closes the file, so to be called after the last ``append``.

        Raises:
            InputError: see `load_manifest`.
            StorageError: the disk is full; the file stays as it was before.
        """
        manifest = load_manifest(self.path.parent)
        if manifest.duplicates:
            write_atomic(self.path, b"".join(line_of(asdict(entry)) for entry in manifest.entries.values()))
            self.close()  # the file that is locked is no longer the manifest


SKIPPED = "skipped.jsonl"
FAILED = "failed.jsonl"
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
        """Add why a sample cannot be made; see `AppendedLines.append_line`."""
        self.append_line({"id": sample_id(index), "split": split, "reason": reason})


class FailedWriter(AppendedLines):
    """Appends samples that could not be made; the next run tries them again, and begins this list anew.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with FailedWriter(root) as writer:
        ...         writer.append("train", 3, "SystemExit: 0", 3, "Traceback ...")
        ...     print((Path(root) / FAILED).read_text(), end="")
        {"id":"s00000003","split":"train","reason":"SystemExit: 0","attempts":3,"traceback":"Traceback ..."}
    """

    def __init__(self, root: Path | str) -> None:
        """Open the list in the folder ``root``; see `AppendedLines`."""
        super().__init__(Path(root) / FAILED)

    def append(self, split: str, index: int, reason: str, attempts: int, traceback: str) -> None:
        """Add why a sample could not be made; see `AppendedLines.append_line`."""
        self.append_line(
            {"id": sample_id(index), "split": split, "reason": reason, "attempts": attempts, "traceback": traceback}
        )


def load_skipped(root: Path | str) -> dict[Key, str]:
    """Return why samples were left out, by (split, id) in order; empty without a list.

    Raises:
        InputError: unreadable file, or a bad line before the last.
    """
    path = Path(root) / SKIPPED
    expected = "id, split, reason; delete the line, and its sample is tried"
    return _by_sample(path, read_lines(path)[0], _reason, expected)


def _reason(content: dict[str, Any]) -> str | None:
    return content["reason"] if isinstance(content["reason"], str) else None


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
