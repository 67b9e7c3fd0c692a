"""Files of lines of JSON that only grow: on a disk one file, appended line by line; in a store one object per batch."""

from __future__ import annotations

import json
import os
import secrets
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from simulator.errors import InputError
from simulator.io.files import committed_file, make_folder, read_errors, storage_errors, write_all, write_atomic
from simulator.io.locks import take_lock
from simulator.io.store import Place, StorePath

_LONGEST = 16 << 20  # bytes of a line
_BATCH_LINES, _BATCH_S = 1000, 30.0  # of a store: a batch is sent when it has so many lines, or after so many seconds


def line_of(content: Mapping[str, Any]) -> bytes:
    """Return a line of such a file."""
    return json.dumps(content, separators=(",", ":")).encode() + b"\n"


def read_lines(path: Place) -> Iterator[bytes]:
    """Yield the lines of such a file, each with its end; one without is torn, and the last. A missing file has none.

    Raises:
        InputError: the file cannot be read, or holds something else.
    """
    with read_errors(path):
        try:
            if isinstance(path, Path) and not stat.S_ISREG(path.lstat().st_mode):
                raise InputError(path, "not a file, expected lines of JSON")  # a link leads out; a pipe would block
            file = path.open("rb")
        except FileNotFoundError:
            return
        with file:
            while line := file.readline(_LONGEST):
                if len(line) == _LONGEST:
                    raise _too_long(path)
                yield line


def _too_long(path: Place) -> InputError:
    return InputError(path, f"has a line of more than {_LONGEST >> 20} MiB, expected lines of JSON")


class AppendedLines:
    """Appends lines to a file of a disk; one writer a file.

    Attributes:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        """Open the file (made when missing), take its lock and cut a torn last line.

        Raises:
            InputError: another process is writing to it, or it holds something else.
            StorageError: the folder cannot be written to.
        """
        self.path = path
        self._descriptor, self.locked = open_locked(path)
        try:
            with storage_errors(path):
                self._size = _end_of_last_line(self._descriptor, path)
                os.ftruncate(self._descriptor, self._size)
        except BaseException:
            self.close()
            raise

    def append_line(self, content: Mapping[str, Any]) -> None:
        """Add one line and wait until it is on the disk.

        Raises:
            StorageError: the disk is full; the file stays as it was before.
        """
        line = line_of(content)
        with storage_errors(self.path):
            try:
                write_all(self._descriptor, line)
                os.fsync(self._descriptor)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._descriptor, self._size)
                raise
        self._size += len(line)

    def replace(self, lines: Iterable[bytes]) -> None:
        """Put others in the place of all lines, whole or not at all. The lock is held throughout: no writer comes between.

        Raises:
            StorageError: the disk is full.
        """
        descriptor = -1
        try:
            with committed_file(self.path) as temporary:
                descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
                take_lock(descriptor)  # before the file has its name, by which others find it
                with open(descriptor, "wb", closefd=False) as file:
                    file.writelines(lines)
        except BaseException:
            if descriptor >= 0:
                os.close(descriptor)
            raise
        os.close(self._descriptor)
        self._descriptor, self._size = descriptor, os.fstat(descriptor).st_size

    def __enter__(self) -> Self:
        return self

    def close(self) -> None:
        """Release the file and its lock; may be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class StoredLines:
    """Appends lines in a store, where nothing can be appended: batches become objects ``NAME.TOKEN.0000.jsonl`` and so on.

    What came after the last batch reaches the store on ``close``, and not at all where the writer dies before.
    """

    locked = False

    def __init__(self, path: StorePath) -> None:
        self.path = path
        self._lines: list[bytes] = []
        self._token = secrets.token_hex(4)  # a list may be opened again, by this process or another
        self._number, self._since = 0, time.monotonic()

    def append_line(self, content: Mapping[str, Any]) -> None:
        """Add one line.

        Raises:
            StorageError: the store cannot be written to; the lines are kept for the next try.
        """
        self._lines.append(line_of(content))
        if len(self._lines) >= _BATCH_LINES or time.monotonic() - self._since > _BATCH_S:
            self._send()

    def replace(self, lines: Iterable[bytes]) -> None:
        """Put others in the place of the object that holds all lines; batches stay.

        Raises:
            StorageError: the store cannot be written to.
        """
        write_atomic(self.path, b"".join(lines))

    def _send(self) -> None:
        if self._lines:
            stem = self.path.name.removesuffix(".jsonl")
            batch = self.path.with_name(f"{stem}.{self._token}.{self._number:04d}.jsonl")
            with storage_errors(batch):
                batch.write_bytes(b"".join(self._lines))
            self._lines.clear()
            self._number += 1
        self._since = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def close(self) -> None:
        """Send what is left; may be called twice."""
        self._send()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def open_locked(path: Path, *, shared: bool = False, wait: bool = False) -> tuple[int, bool]:
    """Open a file (made when missing, with its folder) with its lock, and make sure that it is still the file of that name.

    Returns:
        Its descriptor, and whether the lock is held: it is not where the file system knows none.

    Raises:
        InputError: another process holds it, and ``wait`` is false.
        StorageError: the folder cannot be written to.
    """
    while True:
        with storage_errors(path):
            try:
                descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
            except FileNotFoundError:
                if os.path.lexists(path):
                    raise  # a link to nowhere
                make_folder(path.parent)  # such as one that a run took away which was refused
                continue
        try:
            with storage_errors(path):
                taken = take_lock(descriptor, shared=shared, wait=wait)
            if taken is False:
                raise InputError(str(path.parent), "another process is writing; wait, or choose another folder")
            with suppress(FileNotFoundError):  # the one who held the lock has put another file in its place
                if os.path.samestat(os.fstat(descriptor), os.stat(path)):
                    return descriptor, taken is True
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _end_of_last_line(descriptor: int, path: Path) -> int:
    size = os.fstat(descriptor).st_size
    end, step = size, 4096
    while end > 0:
        if size - end > _LONGEST:
            raise _too_long(path)
        start = max(0, end - step)
        found = os.pread(descriptor, end - start, start).rfind(b"\n")
        if found >= 0:
            return start + found + 1
        end = start
    return 0
