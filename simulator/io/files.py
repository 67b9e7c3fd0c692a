"""Files and folders that appear whole or not at all, small texts; clear words when the disk or the store says no."""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path

from simulator.errors import InputError
from simulator.io.store import Place, StorePath, size_of
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
def storage_errors(path: Place) -> Iterator[None]:
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
            reason = "its folder (or bucket) does not exist. Make it first, or choose another place."
        elif error.errno in _DENIED:
            cure = f"Give write permission or choose another output folder. {kept}."
            reason = f"{_DENIED[error.errno]}. {cure}"
        else:
            reason = f"{error.strerror or error}. Check the disk. {kept}."
        raise StorageError(str(path), f"cannot be written: {reason}") from error


class UnreadableError(InputError):
    """A file that is there cannot be read just now: the disk, the network or a permission, nothing that its content says."""


@contextmanager
def read_errors(path: Place) -> Iterator[None]:
    """Turn the operating system's refusals to read ``path`` into an ``InputError``; an ``UnreadableError`` if it is there."""
    try:
        yield
    except (FileNotFoundError, NotADirectoryError, IsADirectoryError) as error:
        raise InputError(str(path), f"cannot be read: {error.strerror or error}") from error
    except OSError as error:
        raise UnreadableError(str(path), f"cannot be read: {error.strerror or error}") from error


def make_folder(folder: Path) -> None:
    """Make a folder and those above it, where they are missing, so that they survive a power cut."""
    missing = list(takewhile(lambda place: not place.exists(), (folder, *folder.parents)))
    folder.mkdir(parents=True, exist_ok=True)
    for made in missing:
        sync_folder(made.parent)


def is_own_folder(folder: Path, description: str, kind: str, option: str = "output") -> bool:
    """Return whether a folder holds a job's description; a new or empty one does not.

    ``description`` names the file that says whose the folder is; ``kind`` ("training") and ``option`` are for messages.

    Raises:
        InputError: a file, or a folder of other things.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(option, f"{folder} is a file; choose another folder")
    if (folder / description).exists():
        return True
    names = [each.name for each in sorted(folder.iterdir())] if folder.exists() else []
    foreign = [name for name in names if not name.startswith(TEMPORARY_PREFIX)]
    if foreign:
        there = f"{folder} is not empty and holds no {kind} ({foreign[0]}, ...)"
        raise InputError(option, f"{there}; choose another folder, or empty it")
    return False


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


def write_atomic(path: Place, data: bytes, check: Callable[[Path], None] | None = None) -> None:
    """Write ``data`` so that ``path`` holds either all of it or what it held before.

    Args:
        path: the final name; its folder must exist.
        data: the whole content.
        check: called with the temporary file, already on disk, before it gets its final name; raises to refuse it. Not for
            object stores.

    Raises:
        StorageError: the folder is missing or protected, or the disk is full. Nothing is left behind.
    """
    if isinstance(path, StorePath):
        assert check is None
        with storage_errors(path):
            path.write_bytes(data)
        return
    with _renamed(path) as temporary:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # the user's umask applies
        try:
            write_all(descriptor, data)
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        if check is not None:
            check(temporary)


@contextmanager
def _renamed(path: Path) -> Iterator[Path]:
    """Give a temporary name; at the end of the block its file, which is on the disk by then, becomes ``path``."""
    temporary = temporary_path(path)
    with storage_errors(path):
        try:
            yield temporary
            os.replace(temporary, path)
            sync_folder(path.parent)
        except BaseException:
            with suppress(OSError):
                temporary.unlink()
            raise


@contextmanager
def committed_folder(folder: Place, last: str = "") -> Iterator[Path]:
    """Give a temporary folder to write into; at the end of the block it becomes ``folder``.

    On a disk that is one rename, and a folder of that name is replaced: it is what a run left that died before the manifest
    knew of it. Into a store, the files are written first and the one that describes them last, and never over another.

    When the block raises, the temporary folder is removed and ``folder`` stays as it was.

    Args:
        folder: the final name.
        last: name of the file that describes the others; needed for a store.

    Raises:
        StorageError: the place cannot be written to, or the store holds another ``last``.
    """
    if isinstance(folder, StorePath):
        with tempfile.TemporaryDirectory(prefix="flatlight-") as made:
            yield Path(made)
            _upload(Path(made), folder, last)
        return
    temporary = temporary_path(folder)
    with storage_errors(folder):
        make_folder(folder.parent)
        try:
            temporary.mkdir()
            yield temporary
            sync_folder(temporary)
            _replace_folder(temporary, folder)
            sync_folder(folder.parent)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise


_AT_A_TIME = 8  # files on their way to a store, which waits longer than it works


def _upload(made: Path, folder: StorePath, last: str) -> None:
    """Write the files of a folder into a store, ``last`` in the end; what is there under that name already stays.

    Raises:
        StorageError: another ``last`` is there, or came while the files were written.
    """
    names = [path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file()]
    description = (made / last).read_bytes()
    with storage_errors(folder):
        there = (folder / last).read_bytes() if (folder / last).is_file() else None
        if there is None:
            with ThreadPoolExecutor(_AT_A_TIME) as pool:
                sent = [
                    pool.submit((folder / name).write_bytes, (made / name).read_bytes())
                    for name in names
                    if name != last
                ]
            for one in sent:
                one.result()
            if not (folder / last).create(description):
                there = (folder / last).read_bytes()
    if there not in (None, description):
        raise StorageError(
            str(folder),
            f"another writer made this {last} otherwise, such as on a processor of another kind; let one kind of machine "
            "make the data set. If both wrote at the same moment, `flatlight generate --repair` finds what does not fit",
        )


@contextmanager
def committed_file(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to; at the end of the block that file becomes ``path`` in one rename.

    For writers that want a file of their own, such as HDF5's; what is in memory goes through `write_atomic`. When the block
    raises, the temporary file is removed and ``path`` stays as it was. Folders above it are made.

    Raises:
        StorageError: the place cannot be written to.
    """
    with storage_errors(path):
        make_folder(path.parent)
    with _renamed(path) as temporary:
        yield temporary
        descriptor = os.open(temporary, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _replace_folder(temporary: Path, folder: Path) -> None:
    """Rename a folder; what has that name goes aside first. Others may do the same at once: the last one's folder stays."""
    aside = temporary_path(folder)
    while True:
        try:
            os.rename(temporary, folder)
            break
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # rename() replaces nothing but an empty folder
                if aside.exists():
                    os.rename(aside, folder)
                raise
        shutil.rmtree(aside, ignore_errors=True)  # of the round before
        with suppress(FileNotFoundError):
            os.rename(folder, aside)
    shutil.rmtree(aside, ignore_errors=True)


def remove_file(path: Place) -> None:
    """Remove a file, if it is there, so that it stays away after a power cut.

    Raises:
        StorageError: the folder is protected.
    """
    with storage_errors(path):
        path.unlink(missing_ok=True)
        if isinstance(path, Path):
            sync_folder(path.parent)


def remove_folder(folder: Place) -> None:
    """Remove a folder and all that is in it; what cannot be removed stays."""
    if isinstance(folder, StorePath):
        folder.remove_all()
    else:
        shutil.rmtree(folder, ignore_errors=True)


def remove_leftovers(root: Path, levels: int = 100) -> int:
    """Delete unfinished files and folders that died writers left up to so many levels below ``root``; return how many."""
    found = list(leftovers(root, levels))
    for path in found:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            with suppress(OSError):
                path.unlink()
    return len(found)


def leftovers(root: Path, levels: int = 100) -> Iterator[Path]:
    """Yield the unfinished files and folders up to so many levels below ``root``, none inside unfinished folders."""
    for folder, folders, files in os.walk(root):
        for name in [*folders, *files]:
            if name.startswith(TEMPORARY_PREFIX):
                yield Path(folder) / name
        deepest = len(Path(folder).relative_to(root).parts) + 1 >= levels
        folders[:] = [] if deepest else [name for name in folders if not name.startswith(TEMPORARY_PREFIX)]


def not_plain(root: Place) -> Iterator[Path]:
    """Yield everything below ``root`` that is neither a file nor a folder: links, pipes, sockets, devices; follows none.

    Stores hold objects only.

    Raises:
        InputError: a folder cannot be read.
    """
    folders = [root] if isinstance(root, Path) else []
    while folders:
        folder = folders.pop()
        with read_errors(folder), os.scandir(folder) as entries:
            for entry in sorted(entries, key=lambda entry: entry.name):
                if entry.is_dir(follow_symlinks=False):
                    folders.append(Path(entry.path))
                elif not entry.is_file(follow_symlinks=False):
                    yield Path(entry.path)


def refuse_link(path: Place) -> None:
    """Refuse a link in a data set, through which something outside would be read.

    Raises:
        InputError: it is one.
    """
    if path.is_symlink():
        raise InputError(
            path,
            "a link, which is not followed: put a copy of what it leads to there (cp -rL follows links), or remove it",
        )


def sha256_bytes(data: bytes) -> str:
    """Return the SHA-256 of some bytes in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Place) -> str:
    """Return the SHA-256 of a file's content in hexadecimal.

    Raises:
        InputError: the file cannot be read.
    """
    with read_errors(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


MAX_BYTES = 16 << 20


def read_limited(path: Place, holds: str, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file that somebody else may have made: no link is followed, no pipe waited for.

    ``holds``, ``max_bytes``: as `read_text`.

    Raises:
        InputError: when it cannot be read, is not a file or too large.
    """
    with read_errors(path):
        if isinstance(path, Path) and not stat.S_ISREG(path.lstat().st_mode):
            raise InputError(path, f"not a file, expected {holds}")
        size = size_of(path)
        if size > max_bytes:
            raise InputError(path, f"larger than {max_bytes >> 10} KiB, expected {holds}; restore it from a copy")
        with path.open("rb") as file:
            return file.read(size + 1)


def read_text(path: Place, holds: str, max_bytes: int = MAX_BYTES) -> str:
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
        raise InputError(str(path), f"larger than {max_bytes >> 10} KiB, expected {holds}; is this the right file?")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            str(path), f"not UTF-8 text (byte 0x{error.object[error.start]:02x}); expected {holds}"
        ) from error
