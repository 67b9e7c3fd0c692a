"""Files of lines that only ever grow: each line is on the disk before the next thing happens.

A crash can tear the last line only; it counts as absent and is cut off before the next line is appended.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from simulator.errors import InputError
from simulator.files import storage_errors, write_all


class AppendedLines:
    """Appends lines of JSON to a file; one writer per data set, in the parent process only."""

    def __init__(self, path: Path) -> None:
        """Open the file (made when missing), take its lock and cut a torn last line.

        Raises:
            InputError: another process is writing to the same data set.
            StorageError: the folder cannot be written to.
        """
        self._path = path
        with storage_errors(path):
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._descriptor)
            msg = f"another process is writing to the data set in {path.parent}; wait for it or choose another dataset.output"
            raise InputError(msg) from error
        except OSError:
            pass  # a file system without locks
        with storage_errors(path):
            self._size = _end_of_last_line(self._descriptor)
            os.ftruncate(self._descriptor, self._size)

    def append_line(self, content: Mapping[str, Any]) -> None:
        """Add one line and wait until it is on the disk.

        Raises:
            StorageError: the disk is full; the file stays as it was before.
        """
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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def read_lines(path: Path) -> tuple[list[bytes], bool]:
    """Return the whole lines of such a file and whether a torn one follows them; a missing file has none.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return [], False
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
    *lines, rest = data.split(b"\n")
    return lines, bool(rest)


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
