"""HDF5: the arrays of many samples stacked, one file per split or several by size; compressed, a chunk per image."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.exports.output import Output, Progress, by_size, write_files
from simulator.dataset.exports.source import Source, arrays
from simulator.dataset.sample import DESCRIPTION
from simulator.dataset.verification import CheckedSample
from simulator.errors import InputError
from simulator.io.files import write_all

_VERSIONS = ("earliest", "v110")  # of the file format; newer forms of its groups store the time
_PER_FRAME = ("rgb", "depth_m", "valid", "global_measurements")  # a chunk holds one of their frames

Layout = dict[str, tuple[tuple[int, ...], np.dtype[Any]]]


def write(source: Source, output: Output, shard_bytes: int, progress: Progress) -> None:
    """Write ``train-000000.h5`` and so on, each of samples whose own files have at most so many bytes.

    Datasets are named as in `arrays`, with the samples as first axis. Of fixed-length UTF-8: ``id``, ``label`` (empty for
    None), ``sample_json`` (the samples' descriptions), and ``channels``, the names along the measurement's axis C.

    Raises:
        InputError: samples of different shapes; and as `write_files`.
        StorageError: as `write_files`.
    """
    first = next(iter(source.splits.values()))[0]
    expected = _layout(source.read(first))

    def check(found: Layout, sample: CheckedSample) -> None:
        name = next((name for name in expected | found if expected.get(name) != found.get(name)), None)
        if name is None:
            return
        own, other = f"{first.split}/{first.id}", f"{sample.description['split']}/{sample.description['id']}"
        raise InputError(
            "--to",
            f"hdf5 stacks samples of one shape, but {name} is {_shown(expected.get(name))} in {own} and "
            f"{_shown(found.get(name))} in {other}; webdataset and npz take samples as they are",
        )

    write_files(
        source,
        output,
        progress,
        runs=partial(by_size, source, shard_bytes, lambda sizes: sum(sizes.values())),
        name=lambda split, number, _: f"{split}-{number:06d}.h5",
        writer=partial(_open, source, check),
    )


@contextmanager
def _open(
    source: Source, check: Callable[[Layout, CheckedSample], None], path: Path
) -> Iterator[Callable[[CheckedSample], None]]:
    import h5py

    texts: dict[str, list[str]] = {"id": [], "label": [], "sample_json": []}
    with _Written(path, "x+") as stream, h5py.File(stream, "w", libver=_VERSIONS) as file:

        def add(sample: CheckedSample) -> None:
            assert sample.sample is not None
            check(_layout(sample), sample)
            position = len(texts["id"])
            for name, values in arrays(sample.sample).items():
                stack = file[name] if name in file else _stack(file, name, values)
                assert isinstance(stack, h5py.Dataset)
                stack.resize(position + 1, axis=0)
                stack[position] = values
            texts["id"].append(sample.description["id"])
            texts["label"].append(sample.sample.label or "")
            texts["sample_json"].append(sample.files[DESCRIPTION].decode())
            stream.check()

        yield add
        for name, lines in (texts | {"channels": source.info.channels}).items():
            encoded = [line.encode() for line in lines]
            kind = h5py.string_dtype("utf-8", max(1, *map(len, encoded)))
            file.create_dataset(name, data=np.array(encoded, kind), track_times=False, **_COMPRESSED)


class _Written(io.FileIO):
    """A file that takes whatever comes after its first error for done: HDF5 crashes where it cannot write what it closes."""

    error: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of the data, as HDF5 expects."""
        self._try(lambda: write_all(self.fileno(), data))
        return len(data)

    def truncate(self, size: int | None = None) -> int:
        """Set the file's size."""
        self._try(lambda: super(_Written, self).truncate(size))
        return size or 0

    def check(self) -> None:
        """Raise the first error."""
        if self.error is not None:
            raise self.error

    def _try(self, change: Callable[[], object]) -> None:
        try:
            if self.error is None:
                change()
        except OSError as error:
            self.error = error

    def __exit__(self, *raised: Any) -> None:
        super().__exit__(*raised)
        self.check()


_COMPRESSED: dict[str, Any] = {"compression": "gzip", "compression_opts": 4, "shuffle": True}


def _stack(file: Any, name: str, values: NDArray[Any]) -> Any:
    """Return a new dataset for arrays like this one, with none in it yet."""
    framed = name in _PER_FRAME or "/" in name
    return file.create_dataset(
        name,
        shape=(0, *values.shape),
        maxshape=(None, *values.shape),
        chunks=(1, 1, *values.shape[1:]) if framed else (1, *values.shape),
        dtype=values.dtype,
        track_times=False,
        **_COMPRESSED,
    )


def _layout(sample: CheckedSample) -> Layout:
    assert sample.sample is not None
    return {name: (values.shape, values.dtype) for name, values in arrays(sample.sample).items()}


def _shown(found: tuple[tuple[int, ...], np.dtype[Any]] | None) -> str:
    return "absent" if found is None else f"{found[1]} {found[0]}"
