"""WebDataset: tar files that loaders read from front to back; every file of a sample as it is, byte for byte."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from simulator.dataset.exports.output import Output, Progress, by_size, write_files
from simulator.dataset.exports.source import Source
from simulator.dataset.verification import CheckedSample


def write(source: Source, output: Output, shard_bytes: int, progress: Progress) -> None:
    """Write ``train-000000.tar`` and so on, each of at most so many bytes, unless a single sample needs more.

    A sample's files stand together, sorted by name; errors as `write_files`.
    """
    # A tar ends with two empty blocks, and is filled up to whole records.
    room_bytes = shard_bytes // tarfile.RECORDSIZE * tarfile.RECORDSIZE - 2 * tarfile.BLOCKSIZE
    write_files(
        source,
        output,
        progress,
        runs=partial(by_size, source, room_bytes, _tar_bytes),
        name=lambda split, number, _: f"{split}-{number:06d}.tar",
        writer=_open,
    )


def member(identifier: str, file: str) -> str:
    """Return the name of a sample's file in a tar: up to the first dot the sample's key, which groups its files.

    Example:
        >>> member("s00000012", "measurement.exr"), member("s00000012", "frames/ground_truth.0003.exr")
        ('s00000012.measurement.exr', 's00000012.frames.ground_truth.0003.exr')
    """
    return f"{identifier}.{file.replace('/', '.')}"


@contextmanager
def _open(path: Path) -> Iterator[Callable[[CheckedSample], None]]:
    with tarfile.open(path, "w", format=tarfile.USTAR_FORMAT) as tar:

        def add(sample: CheckedSample) -> None:
            names = {member(sample.description["id"], file): file for file in sample.files}
            for name in sorted(names):
                info, data = tarfile.TarInfo(name), sample.files[names[name]]
                info.size = len(data)  # all else is fixed: mode 0644, owner 0 without a name, time 0
                tar.addfile(info, io.BytesIO(data))

        yield add


def _tar_bytes(sizes: Mapping[str, int]) -> int:
    """Return what files need in a tar: a block for the name, and whole blocks for the content."""
    return sum(tarfile.BLOCKSIZE * (1 + -(-size // tarfile.BLOCKSIZE)) for size in sizes.values())
