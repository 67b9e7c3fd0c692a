"""Places in object stores (S3, Google Cloud Storage, Azure), written and read like the files and folders of a disk.

An object appears whole or not at all. There are no folders, no renames and no locks; what a data set needs instead is one
write that fails where an object exists (``If-None-Match: *``), which `check_store` tries before anything relies on it.
"""

from __future__ import annotations

import errno
import io
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from functools import cache
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

from simulator.errors import InputError
from simulator.text import show

_PART_BYTES = 8 << 20
_URL = re.compile(r"(?P<store>(s3|gs|az)://[^/]+)/*(?P<path>.*)")


class StorePath:
    """A place in an object store, with those methods of ``pathlib.Path`` that have a meaning there.

    What is missing, such as ``open`` for writing or a file descriptor, fails loudly rather than touch the disk.

    Example:
        >>> place = StorePath("s3://bucket/sets/one") / "train"
        >>> str(place), place.name, str(place.parent)
        ('s3://bucket/sets/one/train', 'train', 's3://bucket/sets/one')
    """

    def __init__(self, text: str) -> None:
        """Name a place.

        Raises:
            InputError: it is not the address of one.
        """
        match = _URL.fullmatch(text)
        path = PurePosixPath(match["path"]) if match else PurePosixPath()
        if match is None or ".." in path.parts or not path.parts:
            raise InputError(show(text), "expected s3://BUCKET/FOLDER (or gs://, az://), without '..'")
        self._store, self._path = match["store"], path

    def __truediv__(self, name: str) -> StorePath:
        return StorePath(f"{self._store}/{self._path / str(name)}")

    def __str__(self) -> str:
        return f"{self._store}/{self._path}"

    def __repr__(self) -> str:
        return f"StorePath({str(self)!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StorePath) and str(self) == str(other)

    def __lt__(self, other: StorePath) -> bool:
        return str(self) < str(other)

    def __hash__(self) -> int:
        return hash(str(self))

    @property
    def name(self) -> str:
        """The last part."""
        return self._path.name

    @property
    def parent(self) -> StorePath:
        """The place that holds this one; the uppermost holds itself."""
        return self.with_name("") if len(self._path.parts) > 1 else self

    def with_name(self, name: str) -> StorePath:
        """Return another place beside this one."""
        return StorePath(f"{self._store}/{self._path.parent / name}")

    def relative_to(self, other: StorePath) -> PurePosixPath:
        """Return the way from a place to this one.

        Raises:
            ValueError: it does not lie below that place.
        """
        if self._store != other._store:
            msg = f"{self} does not lie below {other}"
            raise ValueError(msg)
        return self._path.relative_to(other._path)

    def resolve(self) -> StorePath:
        """Return itself: an address is complete."""
        return self

    absolute = resolve

    # ---- reading

    def read_bytes(self) -> bytes:
        """Return an object's content.

        Raises:
            OSError: there is none, or the store cannot be reached.
        """
        with _os_errors():
            return bytes(_obstore().get(self._client, str(self._path)).bytes())

    def open(self, mode: str = "rb") -> io.BufferedIOBase:
        """Return an object's content as a file to be read: at once, or a large one part by part; errors as `read_bytes`."""
        if mode != "rb":
            msg = f"mode: got {mode!r}, expected 'rb'"
            raise ValueError(msg)
        with _os_errors():
            found = _obstore().get(self._client, str(self._path))
            if found.meta["size"] <= _PART_BYTES:
                return io.BytesIO(bytes(found.bytes()))
            return io.BufferedReader(_Parts(self._client, found.meta), _PART_BYTES)

    def is_file(self) -> bool:
        """Whether there is an object of this name.

        Raises:
            InputError: the store cannot be reached; the same for the methods below.
        """
        try:
            with self._asked():
                _obstore().head(self._client, str(self._path))
        except FileNotFoundError:
            return False
        return True

    def size(self) -> int:
        """Return how many bytes an object has; errors as `read_bytes`."""
        with _os_errors():
            return _obstore().head(self._client, str(self._path))["size"]

    def is_dir(self) -> bool:
        """Whether there is any object below this place."""
        return next(self._below(), None) is not None

    def exists(self) -> bool:
        """Whether there is an object of this name, or any below."""
        return self.is_file() or self.is_dir()

    def is_symlink(self) -> bool:
        """Whether it is a link: stores have none."""
        return False

    def iterdir(self) -> Iterator[StorePath]:
        """Yield what lies directly below."""
        with self._asked():
            found = _obstore().list_with_delimiter(self._client, str(self._path))
        for path in [*found["common_prefixes"], *(entry["path"] for entry in found["objects"])]:
            yield StorePath(f"{self._store}/{path}")

    def glob(self, pattern: str) -> Iterator[StorePath]:
        """Yield the objects below whose way from here has as many parts as a pattern, and each part fits."""
        parts = pattern.split("/")
        for path in self._below():
            way = PurePosixPath(path).relative_to(self._path).parts
            if len(way) == len(parts) and all(map(fnmatchcase, way, parts)):
                yield StorePath(f"{self._store}/{path}")

    def rglob(self, pattern: str) -> Iterator[StorePath]:
        """Yield the objects at any depth below whose name fits a pattern."""
        for path in self._below():
            if fnmatchcase(PurePosixPath(path).name, pattern):
                yield StorePath(f"{self._store}/{path}")

    @contextmanager
    def _asked(self) -> Iterator[None]:
        """Turn what a store answers to a question, but that there is no such object, into an ``InputError``."""
        try:
            with _os_errors():
                yield
        except FileNotFoundError:
            raise
        except OSError as error:
            raise InputError(
                self, f"the store cannot be asked ({error.strerror}); check the address, credentials and the network"
            ) from error

    def _below(self) -> Iterator[str]:
        with self._asked():
            for chunk in _obstore().list(self._client, f"{self._path}/"):
                yield from (entry["path"] for entry in chunk)

    # ---- writing

    def write_bytes(self, data: bytes) -> None:
        """Write an object, whole or not at all, in place of one of that name."""
        with _os_errors():
            _obstore().put(self._client, str(self._path), data)

    def create(self, data: bytes) -> bool:
        """Write an object unless there is one of that name; returns whether it was written."""
        obstore = _obstore()
        try:
            with _os_errors():
                obstore.put(self._client, str(self._path), data, mode="create")
        except FileExistsError:
            return False
        return True

    def unlink(self, missing_ok: bool = True) -> None:
        """Remove an object; one that is not there is removed already."""
        assert missing_ok
        with _os_errors():
            _obstore().delete(self._client, str(self._path))

    def remove_all(self) -> None:
        """Remove every object below."""
        with _os_errors():
            for chunk in _obstore().list(self._client, f"{self._path}/"):
                _obstore().delete(self._client, [entry["path"] for entry in chunk])

    @property
    def _client(self) -> Any:
        return _client(self._store)


class _Parts(io.RawIOBase):
    """A large object's content, a request for each part; an error where the object is replaced meanwhile."""

    def __init__(self, client: Any, meta: Any) -> None:
        self._client, self._meta, self._at = client, meta, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = max(0, offset + (0, self._at, self._meta["size"])[whence])
        return self._at

    def readinto(self, buffer: Any) -> int:
        end = min(self._at + len(buffer), self._meta["size"])
        if end <= self._at:
            return 0
        options = {"range": (self._at, end), "if_match": self._meta["e_tag"]}
        with _os_errors():
            part = bytes(_obstore().get(self._client, self._meta["path"], options=options).bytes())
        buffer[: len(part)] = part
        self._at += len(part)
        return len(part)


Place = Path | StorePath
"""Where a data set lies: a folder of a disk, or a place in an object store."""


def place(text: str | Place) -> Place:
    """Return the place that a text names.

    Raises:
        InputError: it begins like an address, but is none.

    Example:
        >>> place("out/set"), place("s3://bucket/set")
        (PosixPath('out/set'), StorePath('s3://bucket/set'))
    """
    if isinstance(text, Path | StorePath):
        return text
    return StorePath(text) if "://" in text else Path(text)


def relative_name(path: Place, root: Place) -> str:
    """Return the way from a place to one below it, with slashes.

    Example:
        >>> relative_name(StorePath("s3://bucket/set/psf/psf.json"), StorePath("s3://bucket/set"))
        'psf/psf.json'
    """
    if isinstance(path, StorePath):
        assert isinstance(root, StorePath)
        return str(path.relative_to(root))
    assert isinstance(root, Path)
    return path.relative_to(root).as_posix()


def size_of(path: Place) -> int:
    """Return how many bytes a file has.

    Raises:
        OSError: there is none, or the store cannot be reached.
    """
    return path.size() if isinstance(path, StorePath) else path.stat().st_size


def check_store(root: StorePath) -> None:
    """Write one object twice, the second time only if there is none, and take it away again.

    Raises:
        InputError: the store takes the second write: two writers would undo each other's work in silence.
        OSError: the store cannot be reached or written to.
    """
    probe = root / f".tmp-store-check-{secrets.token_hex(8)}"
    first = probe.create(b"1")
    second = probe.create(b"2")
    content = probe.read_bytes()
    probe.unlink()
    if not first or second or content != b"1":
        raise InputError(
            str(root),
            "this store overwrites an object that exists though asked not to (If-None-Match: *), so two writers would undo "
            "each other's work in silence; update the server, or write to a folder and copy it",
        )


@cache
def _client(url: str) -> Any:
    return _obstore("obstore.store").from_url(url)


def _obstore(module: str = "obstore") -> Any:
    """Import a module of the package, by name: no cached result (`simulator.io.cache`) depends on its version."""
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            "dataset.output",
            f"object stores need obstore ({error}); pip install 'flatlight[cloud]', or choose a folder",
        ) from error


@contextmanager
def _os_errors() -> Iterator[None]:
    """Turn what obstore raises into the ``OSError`` that the same on a disk would be.

    Raises:
        InputError: a listing has names that would lead elsewhere.
    """
    known = _obstore("obstore.exceptions")
    try:
        yield
    except FileNotFoundError as error:  # without a number
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT)) from error
    except known.AlreadyExistsError as error:
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from error
    except (known.PermissionDeniedError, known.UnauthenticatedError) as error:
        raise PermissionError(errno.EACCES, _first_line(error)) from error
    except known.InvalidPathError as error:
        raise InputError(
            "object store", f"holds a name that is not one of a file: {_first_line(error)}; remove that object"
        ) from error
    except known.BaseError as error:
        raise OSError(errno.EIO, _first_line(error)) from error


def _first_line(error: Exception) -> str:
    """Return what went wrong without the request's details."""
    return show(str(error).strip().splitlines()[0])
