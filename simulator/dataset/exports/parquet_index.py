"""Parquet: a row per sample with what is known of it without an image, to search a million of them in a second."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulator.dataset.croissant import Columns
from simulator.dataset.exports.output import Output, Progress
from simulator.dataset.exports.source import Source
from simulator.dataset.manifest import Entry
from simulator.dataset.sample import DESCRIPTION
from simulator.errors import InputError
from simulator.io.files import sha256_bytes
from simulator.io.store import relative_name

if TYPE_CHECKING:
    import pyarrow

NAME = "samples.parquet"
_PREFIX = "metadata."
_MOST_COLUMNS = 1000
_GROUP_FILES = 1 << 16  # of a row group: what is in memory at a time
_WHOLE = range(-(2**63), 2**63)

Row = dict[str, Any]


def write(source: Source, output: Output, shard_bytes: int, progress: Progress) -> None:
    """Write ``samples.parquet``; ``shard_bytes`` decides nothing.

    Columns: split, id, folder (below the data set's), digest, seed, label, seconds; files, a list of name, sha256 and bytes;
    and ``metadata.*``, the texts and numbers of the samples' metadata, null where a sample has none.

    Raises:
        InputError: a damaged ``sample.json``, a file that is gone, or metadata of too many names.
        StorageError: the file cannot be written.
    """
    import pyarrow as pa
    from pyarrow.parquet import ParquetWriter

    entries = [entry for entries in source.splits.values() for entry in entries]
    if output.has(NAME):
        progress(len(entries), len(entries))
        return
    schema = _schema(source)
    with (
        output.writing(NAME, None, entries) as temporary,
        ParquetWriter(temporary, schema, compression="zstd", version="2.6") as writer,
    ):
        group: list[Row] = []
        held = 0
        for done, entry in enumerate(entries, start=1):
            row = _row(source, entry, schema)
            group.append(row)
            held += len(row["files"])
            if held >= _GROUP_FILES or done == len(entries):
                writer.write_table(pa.Table.from_pylist(group, schema))
                group, held = [], 0
            progress(done, len(entries))


def columns(path: Path) -> Columns:
    """Return the types of an index's columns by name."""
    from pyarrow.parquet import read_schema

    return {
        field.name: {part.name: str(part.type) for part in field.type.value_type}
        if field.name == "files"
        else str(field.type)
        for field in read_schema(path)
    }


def _row(source: Source, entry: Entry, schema: pyarrow.Schema) -> Row:
    sample, sizes = source.describe(entry)
    hashes = sample.description["files"] | {DESCRIPTION: sha256_bytes(sample.files[DESCRIPTION])}
    row = {
        "split": entry.split,
        "id": entry.id,
        "folder": relative_name(source.folder(entry), source.root),
        "digest": entry.digest,
        "seed": entry.seed,
        "label": entry.label,
        "seconds": entry.seconds,
        "files": [{"name": name, "sha256": hashes[name], "bytes": sizes[name]} for name in sorted(sizes)],
    }
    for name, value in scalars(sample.description["metadata"]):
        column = f"{_PREFIX}{name}"
        if schema.field(column).type == "string":
            row[column] = value if isinstance(value, str) else json.dumps(value)
        else:
            row[column] = float(value) if schema.field(column).type == "double" else value
    return row


def scalars(metadata: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, bool | int | float | str]]:
    """Yield the single values in nested metadata by dotted name; lists and None are left out.

    Example:
        >>> list(scalars({"psf": "71a8", "scene": {"objects": 30, "lights_m": [1, 2], "fog": None}}))
        [('psf', '71a8'), ('scene.objects', 30)]
    """
    for key in sorted(metadata):
        value = metadata[key]
        if isinstance(value, dict):
            yield from scalars(value, f"{prefix}{key}.")
        elif isinstance(value, bool | int | float | str):
            yield f"{prefix}{key}", value


def _schema(source: Source) -> pyarrow.Schema:
    """Return the columns: of metadata those of all samples, which are read once more for it."""
    import pyarrow as pa

    kinds: dict[str, set[str]] = {}
    for entries in source.splits.values():
        for entry in entries:
            found = list(scalars(source.describe(entry)[0].description["metadata"]))
            if len(dict(found)) < len(found):
                names = [name for name, _ in found]
                twice = next(name for name in names if names.count(name) > 1)
                raise InputError(source.folder(entry), f"its metadata has two values called {twice}; rename a key")
            for name, value in found:
                kinds.setdefault(name, set()).add(_kind(value))
            if len(kinds) > _MOST_COLUMNS:
                raise InputError(
                    source.folder(entry),
                    f"got more than {_MOST_COLUMNS} different names in the metadata up to here, which make no columns; "
                    "keep what varies from sample to sample in lists",
                )
    entry = {"split": "string", "id": "string", "folder": "string", "digest": "string"}
    entry |= {"seed": "int64", "label": "string", "seconds": "double"}
    file = pa.struct([("name", pa.string()), ("sha256", pa.string()), ("bytes", pa.int64())])
    metadata = {f"{_PREFIX}{name}": _type(kinds[name]) for name in sorted(kinds)}
    return pa.schema([*entry.items(), ("files", pa.list_(file)), *metadata.items()])


def _kind(value: bool | int | float | str) -> str:
    """Return the narrowest type that holds a value; infinite numbers are the texts ``inf`` and ``-inf`` in JSON."""
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, int) and value in _WHOLE:
        return "int64"
    return "double" if isinstance(value, float) or value in ("inf", "-inf") else "string"


def _type(kinds: set[str]) -> str:
    """Return the type of a column: numbers are as wide as needed, and what agrees in nothing is text."""
    if len(kinds) == 1:
        return next(iter(kinds))
    return "double" if kinds == {"int64", "double"} else "string"
