"""Files that appear whole or not at all, files of lines that only grow, small texts; clear words when the disk says no."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from simulator.errors import InputError
from simulator.text import show

TEMPORARY_PREFIX = ".tmp-"
"""Everything whose name starts like this is unfinished work of a writer that died; it may be deleted."""

_FULL = {
    errno.ENOSPC: "the disk is full",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "the file is bigger than allowed here (ulimit -f, or the file system)",
}
_DENIED = {
    errno.EACCES: "no permission to write",
    errno.EPERM: "no permission to write",
    errno.EROFS: "the file system is read-only",
    errno.ENOTDIR: "a part of the path is a file, not a folder",
    errno.EEXIST: "a part of the path is a file, not a folder",
    errno.EISDIR: "a folder has that name",
    errno.ENAMETOOLONG: "the name is too long",
}


_LONGEST_NAME, _LONGEST_PATH = 255, 4000  # bytes; what common file systems take, less room for names of our own


def expanded(text: str | Path, base_dir: Path | None = None) -> Path:
    """Return the path that a user wrote: ``~`` is a home, a relative one starts at ``base_dir``.

    Raises:
        InputError: nobody has that home, or a name is too long for a file system.
    """
    try:
        path = (base_dir or Path()) / Path(text).expanduser()
    except RuntimeError:
        raise InputError(show(str(text)), "no user of that name; write the folder out") from None
    longest = max((len(os.fsencode(part)) for part in path.parts), default=0)
    if longest > _LONGEST_NAME or len(os.fsencode(path)) > _LONGEST_PATH:
        reason = f"a name of {longest} bytes in a path of {len(os.fsencode(path))}"
        raise InputError(
            show(str(text)), f"{reason}; expected at most {_LONGEST_NAME} and {_LONGEST_PATH}; choose a shorter one"
        )
    return path


class StorageError(InputError):
    """The place to write to is full, protected or broken: every further sample would fail the same way."""


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's refusals to write below ``path`` into a ``StorageError`` with a cure.

    Raises:
        StorageError: for every ``OSError`` inside the block.
    """
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        kept = "Nothing already written is lost; run the same command again to resume where it stopped"
        if error.errno in _FULL:
            cure = f"Free space, or choose another folder. {kept}."
            reason = f"{_FULL[error.errno]}. {cure}"
        elif error.errno == errno.ENOENT:
            reason = "its folder does not exist. Make it first, or choose another place."
        elif error.errno in _DENIED:
            cure = f"Give write permission or choose another output folder. {kept}."
            reason = f"{_DENIED[error.errno]}. {cure}"
        else:
            reason = f"{error.strerror or error}. Check the disk. {kept}."
        raise StorageError(path, f"cannot be written: {reason}") from error


@contextmanager
def read_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's refusals to read ``path`` into an ``InputError``."""
    try:
        yield
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error


def sync_folder(folder: Path) -> None:
    """Make renames and new names inside ``folder`` survive a power cut."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def temporary_path(path: Path) -> Path:
    """Return an unused name beside ``path`` that marks unfinished work."""
    return path.with_name(f"{TEMPORARY_PREFIX}{path.name}-{secrets.token_hex(4)}")


def write_all(descriptor: int, data: bytes) -> None:
    """Write every byte; the system may take fewer at a time than it is offered."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def write_atomic(path: Path, data: bytes, check: Callable[[Path], None] | None = None) -> None:
    """Write ``data`` so that ``path`` holds either all of it or what it held before.

    Args:
        path: the final name; its folder must exist.
        data: the whole content.
        check: called with the temporary file, already on disk, before it gets its final name; raises to refuse it.

    Raises:
        StorageError: the folder is missing or protected, or the disk is full. Nothing is left behind.
    """
    temporary = temporary_path(path)
    with storage_errors(path):
        try:
            descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # the user's umask applies
            try:
                write_all(descriptor, data)
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            if check is not None:
                check(temporary)
            os.replace(temporary, path)
            sync_folder(path.parent)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise


@contextmanager
def committed_folder(folder: Path) -> Iterator[Path]:
    """Give a temporary folder to write into; at the end of the block it becomes ``folder`` in one rename.

    When the block raises, the temporary folder is removed and ``folder`` stays as it was. A folder of that name is
    replaced: it is what a run left that died before the manifest knew of it.

    Raises:
        StorageError: the place cannot be written to.
    """
    temporary = temporary_path(folder)
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.mkdir()
            yield temporary
            sync_folder(temporary)
            _replace_folder(temporary, folder)
            sync_folder(folder.parent)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


@contextmanager
def committed_file(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; at the end of the block that file becomes ``path`` in one rename.

    For writers that want a file of their own, such as HDF5's; what is in memory goes through `write_atomic`. When the block
    raises, the temporary file is removed and ``path`` stays as it was. Folders above it are made.

    Raises:
        StorageError: the place cannot be written to.
    """
    temporary = temporary_path(path)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            descriptor = os.open(temporary, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            os.replace(temporary, path)
            sync_folder(path.parent)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise


def _replace_folder(temporary: Path, folder: Path) -> None:
    if not folder.exists():
        os.rename(temporary, folder)
        return
    aside = temporary_path(folder)  # rename() cannot replace a folder that is not empty
    os.rename(folder, aside)
    try:
        os.rename(temporary, folder)
    except OSError:
        os.rename(aside, folder)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def remove_leftovers(root: Path) -> int:
    """Delete unfinished files and folders that died writers left anywhere below ``root``; return how many."""
    found = list(leftovers(root))
    for path in found:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()
    return len(found)


def leftovers(root: Path) -> Iterator[Path]:
    """Yield every unfinished file or folder below ``root``, without looking inside unfinished folders."""
    for folder, folders, files in os.walk(root):
        for name in [*folders, *files]:
            if name.startswith(TEMPORARY_PREFIX):
                yield Path(folder) / name
        folders[:] = [name for name in folders if not name.startswith(TEMPORARY_PREFIX)]


def not_plain(root: Path) -> Iterator[Path]:
    """Yield everything below ``root`` that is neither a file nor a folder: links, pipes, sockets, devices; follows none.

    Raises:
        InputError: a folder cannot be read.
    """
    folders = [root]
    while folders:
        folder = folders.pop()
        with read_errors(folder), os.scandir(folder) as entries:
            for entry in sorted(entries, key=lambda entry: entry.name):
                if entry.is_dir(follow_symlinks=False):
                    folders.append(Path(entry.path))
                elif not entry.is_file(follow_symlinks=False):
                    yield Path(entry.path)


def sha256_bytes(data: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal.

    Raises:
        InputError: the file cannot be read.
    """
    with read_errors(path), open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


MAX_BYTES = 16 << 20


def read_limited(path: Path, holds: str, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file that somebody else may have made: nothing larger is read, and no pipe is waited for.

    ``holds``, ``max_bytes``: as `read_text`.

    Raises:
        InputError: when it cannot be read, is not a file or too large.
    """
    with read_errors(path):
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):
            raise InputError(path, f"not a file, expected {holds}")
        if status.st_size > max_bytes:
            raise InputError(path, f"larger than {max_bytes >> 10} KiB, expected {holds}; restore it from a copy")
        with path.open("rb") as file:
            return file.read(status.st_size + 1)


def read_text(path: Path, holds: str, max_bytes: int = MAX_BYTES) -> str:
    """Return the text of a small file, without a byte-order mark.

    Args:
        path: the file.
        holds: what it should hold, for the messages, such as ``a table of wavelengths``.
        max_bytes: more than this is another file.

    Raises:
        InputError: when it cannot be read, is not UTF-8 text or too large.
    """
    with read_errors(path), path.open("rb") as file:
        raw = file.read(max_bytes + 1)
    if len(raw) > max_bytes:
        raise InputError(path, f"larger than {max_bytes >> 10} KiB, expected {holds}; is this the right file?")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(path, f"not UTF-8 text (byte 0x{error.object[error.start]:02x}); expected {holds}") from error


class AppendedLines:
    """Appends lines of JSON to a file; one writer per data set, in the parent process only.

    Attributes:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        """Open the file (made when missing), take its lock and cut a torn last line.

        Raises:
            InputError: another process is writing to the same data set.
            StorageError: the folder cannot be written to.
        """
        self.path = path
        with storage_errors(path):
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(self._descriptor)
            raise InputError(path.parent, "another process is writing; wait, or choose another folder") from error
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


def line_of(content: Mapping[str, Any]) -> bytes:
    """Return a line of such a file."""
    return json.dumps(content, separators=(",", ":")).encode() + b"\n"


MAX_LINES_BYTES = 4 << 30
"""Of a file of lines: twenty million samples."""


def read_lines(path: Path) -> tuple[list[bytes], bool]:
    """Return the whole lines of such a file and whether a torn one follows them; a missing file has none.

    Raises:
        InputError: the file cannot be read, or is larger than any list of samples.
    """
    if not os.path.lexists(path):
        return [], False
    data = read_limited(path, "lines of JSON", MAX_LINES_BYTES)
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
