"""Exports of a finished data set to formats that others read: the same data set and options give the same bytes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from simulator.dataset.croissant import Columns, export_croissant
from simulator.dataset.dataset_info import EXPORT
from simulator.dataset.exports import hdf5, npz, parquet_index, webdataset
from simulator.dataset.exports.output import INDEX, Output, Progress
from simulator.dataset.exports.source import Source, open_source
from simulator.errors import InputError
from simulator.io.store import Place, place
from simulator.text import nearest


@dataclass(frozen=True)
class Format:
    """A format that data sets are exported to.

    Attributes:
        write: writes the files of the samples, at most so many bytes each, where the format has shards.
        sharded: whether many samples share a file, whose size can be chosen.
        alone: whether the export can do without the data set: it gets its description and its stacks.
        package: what it needs that only the extra ``export`` installs.
        sets: patterns of the files, where they are too many to be listed one by one.
        columns: reads the columns of a file that is a table.
    """

    write: Callable[[Source, Output, int, Progress], None]
    sharded: bool = False
    alone: bool = True
    package: str | None = None
    sets: tuple[str, ...] = ()
    columns: Callable[[Path], Columns] | None = None


FORMATS = {
    "webdataset": Format(webdataset.write, sharded=True),
    "hdf5": Format(hdf5.write, sharded=True, package="h5py"),
    "npz": Format(npz.write, sets=("*/*/*.npz",)),
    "parquet-index": Format(parquet_index.write, alone=False, package="pyarrow", columns=parquet_index.columns),
}


@dataclass(frozen=True)
class ExportResult:
    """What an export wrote.

    Attributes:
        path: its folder.
        samples: how many it holds.
        shards: files by split; of a file of all splits, under None.
        kept: files that an earlier run had written.
        bytes: of all these files.
    """

    path: Path
    samples: int
    shards: dict[str | None, int]
    kept: int
    bytes: int


_INDEX_COLUMNS = {"name": "string", "split": "string", "first": "string"}
_INDEX_COLUMNS |= {"samples": "int64", "bytes": "int64", "sha256": "string"}


def export(
    path: Place | str,
    to: str,
    output: Path | str,
    *,
    splits: Sequence[str] = (),
    shard_bytes: int | None = None,
    partial: bool = False,
    progress: Progress | None = None,
) -> ExportResult:
    """Export a data set, or go on with an export that was stopped; every sample is checked as `verify` checks it.

    Args:
        path: the data set's folder, or its place in an object store.
        to: one of ``FORMATS``.
        output: the folder to write to: missing, empty, or begun by the same export.
        splits: which splits; by default all.
        shard_bytes: of a file, at most, in formats that put many samples into one; 512e6 by default.
        partial: export what is finished of a data set that is not.
        progress: called with (samples done, samples in all) after each sample.

    Raises:
        InputError: an unknown format, a data set that is damaged, not finished or has links, samples that the format cannot
            hold, or a folder that holds something else. Files that were finished stay.
        StorageError: the folder cannot be written to.
    """
    if to not in FORMATS:
        raise InputError("--to", f"got {to!r}, expected one of {', '.join(FORMATS)}{nearest(to, FORMATS)}")
    if (package := FORMATS[to].package) and find_spec(package) is None:
        cure = "pip install 'flatlight[export]', or in a clone uv run --extra export"
        raise InputError("--to", f"{to} needs the package {package}, which is not installed: {cure}")
    chosen = FORMATS[to]
    if shard_bytes is not None and not chosen.sharded:
        raise InputError("--shard-mb", f"got it with --to {to}, whose files have one size only; leave it out")
    most = 512_000_000 if shard_bytes is None else shard_bytes
    if most < 1:
        raise InputError("--shard-mb", f"got {shard_bytes} bytes, expected more than none")
    source = open_source(place(path), splits, partial_too=partial)
    options = {"to": to} | ({"shard_bytes": most} if chosen.sharded else {})
    with Output(Path(output), source, options) as target:
        chosen.write(source, target, most, progress or (lambda done, total: None))
        if chosen.alone:
            target.copy_companions(source)
        target.finish(lambda: _croissant(chosen, source, target))
    files = target.files.values()
    shards = Counter(file.split for file in files)
    return ExportResult(target.folder, source.samples, dict(shards), target.kept, sum(file.bytes for file in files))


def _croissant(chosen: Format, source: Source, target: Output) -> bytes:
    listed = {EXPORT: None, INDEX: None, **(source.companions if chosen.alone else {})}
    tables: dict[str, Columns] = {INDEX: _INDEX_COLUMNS}
    if chosen.columns is not None:
        tables = {name: chosen.columns(target.folder / name) for name in target.files}
    if not chosen.sets:
        listed |= {name: file.sha256 for name, file in target.files.items()}
    counts = {split: len(entries) for split, entries in source.splits.items()}
    return export_croissant(target.folder, source.info, counts, files=listed, sets=chosen.sets, tables=tables)
