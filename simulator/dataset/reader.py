"""Reading a finished (or still growing) data set; never runs code that the data set names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from simulator.camera.shutter import Shutter
from simulator.dataset.dataset_info import FILE, DatasetInfo, read_info
from simulator.dataset.manifest import load_manifest
from simulator.dataset.sample import (
    SPLITS,
    Sample,
    StoredSample,
    read_description,
    sample_folder,
    sample_index,
    stored_folder,
)
from simulator.errors import InputError
from simulator.io.store import Place, place


class Dataset(Sequence[Sample]):
    """One split of a data set: map-style, lazy, picklable; fits a torch ``DataLoader`` as it is.

    Its batches are dicts of tensors with a leading B, by the names of ``Sample``: ``batch["measurement"]`` is
    ``(B, C, H, W)``, ``batch["rgb"]`` ``(B, T, h, w, 3)``, ``batch["label"]`` a list of B names where samples have one.

    Attributes:
        root: the data set's folder.
        split: ``train``, ``validation`` or ``test``.
        ids: ids of the finished samples, increasing; position ``i`` is ``ids[i]``.
        info: the content of ``dataset.json``.
    """

    def __init__(self, root: Place, split: str, ids: tuple[str, ...], info: DatasetInfo) -> None:
        self.root, self.split, self.ids, self.info = root, split, ids, info

    @property
    def config(self) -> dict[str, Any]:
        """The configuration that made the data set, as plain values."""
        return self.info.config

    @property
    def fingerprint(self) -> str:
        """SHA-256 of what decides the samples' bytes."""
        return self.info.fingerprint

    @property
    def metadata(self) -> dict[str, Any]:
        """Exposure, versions, backend, sizes, channels and times of the data set."""
        return {
            "name": self.info.name,
            "exposure": self.info.exposure,
            "versions": self.info.versions,
            "backend": self.info.backend,
            "scene_shape": self.info.scene_shape,
            "sensor_shape": self.info.sensor_shape,
            "channels": self.info.channels,
            "time": self.info.time,
        }

    def folder(self, position: int) -> Place:
        """Return the folder of the sample at a position.

        Raises:
            IndexError: no such position.
        """
        if not -len(self.ids) <= position < len(self.ids):
            msg = f"sample {position} asked, split {self.split!r} of {self.root} has {len(self.ids)}"
            raise IndexError(msg)
        return sample_folder(self.root, self.split, sample_index(self.ids[position]))

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, position: int) -> Sample: ...
    @overload
    def __getitem__(self, position: slice) -> Dataset: ...
    def __getitem__(self, position: int | slice) -> Sample | Dataset:
        """Read the sample at a position, or select a part of the split without reading.

        Raises:
            IndexError: no such position.
            InputError: the sample's files are missing or damaged.
        """
        if isinstance(position, slice):
            return Dataset(self.root, self.split, self.ids[position], self.info)
        return self.stored(position).sample()

    def spread(self, count: int) -> Dataset:
        """Select so many samples, all of them at most, evenly spread over the split: families vary kinds with the index."""
        return Dataset(
            self.root, self.split, tuple(self.ids[at] for at in spread_positions(len(self), count)), self.info
        )

    def stored(self, position: int) -> StoredSample:
        """Return the sample at a position for reading only a part of it: its measurement, its label, single frames.

        Raises:
            IndexError: no such position.
            InputError: the sample's ``sample.json`` is missing or damaged.
        """
        self.folder(position)
        folder = stored_folder(self.root, self.split, self.ids[position])
        if not folder.is_dir():
            raise InputError(
                folder, f"in the manifest but not on disk; `flatlight verify {self.root}` lists all faults"
            )
        return StoredSample(folder)

    @property
    def shutter(self) -> Shutter | None:
        """The shutter through which the measurements were exposed; None where ``dataset.json`` names none.

        Raises:
            InputError: a damaged or foreign record.
        """
        return self.info.shutter

    def sliver_weights(self, sample: Sample | StoredSample) -> NDArray[np.float64]:
        """Return the share of each sliver's time in which each row was open, ``(N, H)``, in the stored orientation.

        With `simulator.camera.slivers.split_measurement`, the slivers of the sample's measurement. As S is the share of an
        interval, S of a whole sliver is the mean of S over the time of its frames. The one sliver of a still, which lasts as
        long as any row is open, is the measurement itself: ones.

        Raises:
            InputError: a clip in a data set that records no shutter, or times that do not cover its capture.
        """
        rows = self.info.sensor_shape[0]
        if sample.frame_edges_s is None:
            return np.ones((1, rows))
        if (shutter := self.shutter) is None:
            raise InputError(self.root / FILE, "time.shutter is missing, which slivers need; make the data set again")
        # Shutter rows are physical; the stored image is rotated by 180 degrees.
        return shutter.weights(rows, sample.frame_edges_s)[:, ::-1]

    def __iter__(self) -> Iterator[Sample]:
        return (self[position] for position in range(len(self)))

    def __repr__(self) -> str:
        return f"Dataset({str(self.root)!r}, split={self.split!r}, {len(self)} samples)"


def open_dataset(path: Place | str, split: str = "train") -> Dataset:
    """Open one split of a data set; samples are read when they are asked for.

    Args:
        path: the folder, or the place in an object store, that ``flatlight generate`` wrote.
        split: ``train``, ``validation`` or ``test``.

    Raises:
        InputError: no such folder, not a data set, or a split that it does not have.
    """
    root = place(path)
    info = read_info(root)
    if split not in SPLITS or split not in info.counts:
        raise InputError("split", f"expected one of {', '.join(info.counts)} for {root}, got {split!r}")
    return Dataset(root, split, tuple(load_manifest(root).ids(split)), info)


def all_metadata(root: Place | str, most: int | None = None) -> Iterator[dict[str, Any]]:
    """Yield the metadata of each finished sample of a data set; damaged ones, which `verify` names, are left out.

    Args:
        root: the data set's folder.
        most: of more samples only so many, evenly spread.
    """
    samples = list(load_manifest(root).entries)
    for at in spread_positions(len(samples), len(samples) if most is None else most):
        split, name = samples[at]
        with suppress(InputError):
            yield read_description(stored_folder(place(root), split, name))[0]["metadata"]


def spread_positions(length: int, count: int) -> list[int]:
    """Return so many positions, all of them at most, evenly spread: the middles of as many parts of the whole."""
    count = min(count, length)
    return [(2 * part + 1) * length // (2 * count) for part in range(count)]
