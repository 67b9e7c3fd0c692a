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
from simulator.errors import InputError
from simulator.io.files import committed_folder, storage_errors

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
        cache = cls(own, _shapes(dataset))
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with _locked(own.with_name(f"{own.name}.lock")):
            if not cache._is_whole():
                cache._write(lambda position: _readable(dataset, position, read))
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

    def _write(self, read: Callable[[int], Arrays]) -> None:
        """Write one sample after another to plain files: a full disk is an error there, to a memory map it is the end."""
        with committed_folder(self._folder) as temporary, ExitStack() as stack:
            files = {name: stack.enter_context(open(temporary / f"{name}.npy", "wb")) for name in self._shapes}
            for name, shape in self._shapes.items():
                kind = np.dtype(bool if name == "valid" else np.float32)
                header = {"descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(files[name], header)
            for position in range(self._shapes["measurement"][0]):
                for name, values in read(position)._asdict().items():
                    files[name].write(values.tobytes())
            for file in files.values():
                file.flush()
                os.fsync(file.fileno())

    def _is_whole(self) -> bool:
        try:
            return all(self._open(name).shape == shape for name, shape in self._shapes.items())
        except (OSError, ValueError):  # absent, or a header or length that is not an array's
            return False


def _readable(dataset: Dataset, position: int, read: Callable[[int], Arrays]) -> Arrays:
    """Return a sample; the system's refusal to read it is not taken for one to write the cache."""
    try:
        return read(position)
    except OSError as error:
        msg = f"{dataset.folder(position)} cannot be read ({error.strerror or error}); check the disk, or restore the sample"
        raise InputError(msg) from error


def _key(dataset: Dataset, kind: str) -> str:
    entries = load_manifest(dataset.root).entries
    digests = [entries[dataset.split, identifier].digest for identifier in dataset.ids]
    identity = repr((_FORMAT, kind, dataset.split, dataset.ids, digests))
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


def _shapes(dataset: Dataset) -> dict[str, tuple[int, ...]]:
    samples, info = len(dataset), dataset.info
    return {
        "measurement": (samples, len(info.channels), *info.sensor_shape),
        "radiance": (samples, 3, *info.scene_shape),
        "depth_m": (samples, 1, *info.scene_shape),
        "valid": (samples, 1, *info.scene_shape),
    }


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of this name; another process that wants it waits."""
    with ExitStack() as stack:
        with storage_errors(path):  # of the lock alone: what goes wrong under it is another matter
            file = stack.enter_context(open(path, "ab"))
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
