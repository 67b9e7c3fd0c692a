"""Files that appear whole or not at all: temporary name, fsync, rename; and clear words when the disk says no.

A reader therefore never meets a half-written file under its final name, whatever dies and whenever.
"""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from simulator.errors import InputError

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
            cure = f"Free space (or choose another dataset.output). {kept}."
            msg = f"cannot write {path}: {_FULL[error.errno]}. {cure}"
        elif error.errno == errno.ENOENT:
            msg = f"cannot write {path}: its folder does not exist. Make it first, or choose another place."
        elif error.errno in _DENIED:
            cure = f"Give write permission or choose another output folder. {kept}."
            msg = f"cannot write {path}: {_DENIED[error.errno]}. {cure}"
        else:
            msg = f"cannot write {path}: {error.strerror or error}. Check the disk. {kept}."
        raise StorageError(msg) from error


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


def sha256_bytes(data: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}"
        raise InputError(msg) from error
