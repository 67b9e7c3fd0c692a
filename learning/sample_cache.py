"""Decoded samples in memory-mapped files: an epoch then costs no decoding, and processes share the memory."""

from __future__ import annotations

import fcntl
import hashlib
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset
from simulator.files import committed_folder, storage_errors

_FORMAT = 1


class Arrays(NamedTuple):
    """What is kept of a sample.

    Attributes:
        measurement: ``(C, H, W)`` float32, as stored or without noise.
        radiance: ``(3, h, w)`` float32.
        depth_m: ``(1, h, w)`` float32.
        valid: ``(1, h, w)`` bool.
    """

    measurement: NDArray[np.float32]
    radiance: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    valid: NDArray[np.bool_]


class SampleCache:
    """Samples of one split, an .npy file per kind of array; opened anew in every process.

    The folder's name is a hash of the samples' digests, so samples that were made again are never served from an older
    cache. It appears in one rename when all of it is on the disk; processes that want the same one wait for its writer.
    """

    def __init__(self, folder: Path, shapes: dict[str, tuple[int, ...]]) -> None:
        """Name a cache that was filled; see `filled`."""
        self._folder, self._shapes = folder, shapes
        self._maps: list[NDArray[np.generic]] | None = None

    @classmethod
    def filled(cls, folder: Path, dataset: Dataset, kind: str, read: Callable[[int], Arrays]) -> SampleCache:
        """Return the cache of a split, which is written first where it is not there or not whole.

        Args:
            folder: holds the caches of all data sets; made where it is absent.
            dataset: the split.
            kind: what ``measurement`` is: caches of different kinds lie apart.
            read: gives a sample.

        Raises:
            InputError: a sample cannot be read.
            StorageError: the cache cannot be written.
        """
        own = folder / _key(dataset, kind)
        first = read(0)
        shapes = {name: (len(dataset), *values.shape) for name, values in first._asdict().items()}
        cache = cls(own, shapes)
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with _locked(own.with_name(f"{own.name}.lock")):
            if not cache._is_whole():
                _write(own, first, shapes, read)
        return cache

    def read(self, position: int) -> Arrays:
        """Return a sample's arrays, copied: what the caller changes stays the caller's."""
        if self._maps is None:
            self._maps = [self._open(name) for name in Arrays._fields]
        return Arrays(*(np.array(values[position]) for values in self._maps))

    def __getstate__(self) -> dict[str, Any]:
        """Leave the maps out: pickled, they would be the whole data set."""
        return self.__dict__ | {"_maps": None}

    def _open(self, name: str) -> NDArray[np.generic]:
        return np.load(self._folder / f"{name}.npy", mmap_mode="r", allow_pickle=False)

    def _is_whole(self) -> bool:
        try:
            return all(self._open(name).shape == shape for name, shape in self._shapes.items())
        except (OSError, ValueError):  # absent, or a header or length that is not an array's
            return False


def _key(dataset: Dataset, kind: str) -> str:
    entries = load_manifest(dataset.root).entries
    digests = [entries[dataset.split, identifier].digest for identifier in dataset.ids]
    identity = repr((_FORMAT, kind, dataset.split, dataset.ids, digests))
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


def _write(own: Path, first: Arrays, shapes: dict[str, tuple[int, ...]], read: Callable[[int], Arrays]) -> None:
    """Write sample after sample to plain files: a full disk is then an error, where a memory map would kill the process."""
    with committed_folder(own) as temporary, ExitStack() as files:
        opened = {name: files.enter_context(open(temporary / f"{name}.npy", "wb")) for name in shapes}
        for name, shape in shapes.items():
            descr = np.lib.format.dtype_to_descr(getattr(first, name).dtype)
            header = {"descr": descr, "fortran_order": False, "shape": shape}
            np.lib.format.write_array_header_1_0(opened[name], header)
        for position in range(shapes["measurement"][0]):
            for name, values in (read(position) if position else first)._asdict().items():
                opened[name].write(values.tobytes())
        for file in opened.values():
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of this name; another process that wants it waits."""
    with storage_errors(path), open(path, "ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
