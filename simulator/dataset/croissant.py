"""croissant.json: what a data set or an export holds, in MLCommons' vocabulary, with the hashes of its files.

Croissant 1.0, https://docs.mlcommons.org/croissant/docs/croissant-spec.html. It has no decoder for OpenEXR, tar members or
HDF5, so images are sets of files; lists and tables are record sets, which ``mlcroissant`` reads. No dates, and no licence:
a data set records neither.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path
from typing import Any
from urllib.parse import quote

from simulator.dataset.checksums import CROISSANT
from simulator.dataset.dataset_info import FILE, DatasetInfo, read_info
from simulator.dataset.manifest import MANIFEST, finished_samples
from simulator.dataset.sample import (
    DESCRIPTION,
    FRAMES,
    GROUND_TRUTH,
    MEASUREMENT,
    SPLITS,
    SURROUNDINGS,
    read_description,
    sample_folder,
)
from simulator.io.files import sha256_file, write_atomic
from simulator.io.json import readable_json
from simulator.io.store import Place, size_of
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER
from simulator.optics.stack_files import DESCRIPTION as STACK

Node = dict[str, Any]

_TERMS = (
    "citeAs column equivalentProperty extract field fileObject fileProperty fileSet format includes isLiveDataset jsonPath "
    "key md5 parentField path recordSet references regex repeated replace samplingRate separator source subField transform"
)
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS.split()},
}
"""The specification's own, whole, as it recommends."""
_MEDIA_TYPES = {
    ".json": "application/json",
    ".jsonl": "application/jsonlines",
    ".parquet": "application/x-parquet",
    ".tar": "application/x-tar",
    ".h5": "application/x-hdf5",
    ".npz": "application/zip",
    ".exr": "image/x-exr",
}
_TYPES = {"string": "sc:Text", "double": "sc:Float", "int64": "sc:Integer", "bool": "sc:Boolean"}

Columns = Mapping[str, "str | Mapping[str, str]"]
"""Types by name: of single values one of `_TYPES`, of lists of records those of their parts by name."""


def write_croissant(root: Place) -> None:
    """Write ``croissant.json`` into a data set's folder; errors as `croissant`.

    Raises:
        StorageError: the folder is protected, or the disk is full.
    """
    write_atomic(root / CROISSANT, croissant(root))


def croissant(root: Place) -> bytes:
    """Return the content of ``croissant.json`` for a data set's folder, whose ``manifest.jsonl`` is as it will stay.

    Raises:
        InputError: not a data set, or a damaged one.
    """
    info, finished = read_info(root), finished_samples(root)
    counts = {split: len(finished[split]) for split in info.counts}
    splits = [split for split in SPLITS if split in counts]
    hashed = f"its SHA-256 stands in the sample's {DESCRIPTION}, whose digest stands in {MANIFEST}"
    kinds = {
        "measurements": ([MEASUREMENT], f"what the camera measured, R, G, B = {info.unit}, and noiseless; {hashed}"),
        "ground-truth": (
            [GROUND_TRUTH, f"{FRAMES}/ground_truth.*.exr"],
            f"linear radiance R, G, B, depth Z in metres from the mask plane, valid, per frame; {hashed}",
        ),
        "global-measurements": ([f"{FRAMES}/global.*.exr"], f"each frame as a global shutter measures it; {hashed}"),
        "surroundings": ([SURROUNDINGS, f"{FRAMES}/surroundings.*.exr"], f"light from beside the image; {hashed}"),
        "descriptions": ([DESCRIPTION], f"metadata of a sample, and the SHA-256 of its files; digest in {MANIFEST}"),
    }
    distribution = [_file(root, FILE, "configuration, exposure, sizes and versions"), _file(root, MANIFEST, "samples")]
    for folder, what in ((PSF_FOLDER, "as used"), (CAPTURED_FOLDER, "as a calibration measures them")):
        name = f"{folder}/{STACK}"
        if (root / name).exists():
            distribution.append(_file(root, name, f"the PSFs {what}: depths, errors and SHA-256 of each"))
            distribution.append(_files(folder, [f"{folder}/*.exr"], f"a PSF per depth; SHA-256 in {name}"))
    there = _names(root, finished)
    for name, (files, text) in kinds.items():
        found = [file for file in files if any(fnmatchcase(one, file) for one in there)]
        if found:
            distribution.append(_files(name, [f"{split}/*/*/{file}" for split in splits for file in found], text))
    types = {"id": "string", "split": "string", "digest": "string", "seed": "int64", "label": "string"}
    records = [_splits(splits), _records("samples", MANIFEST, types)]
    return _document(info, counts, distribution, records)


def _names(root: Place, finished: Mapping[str, Collection[int]]) -> set[str]:
    """Return what the files of a sample are called, as the first of each split has them."""
    first = [(split, min(indices)) for split, indices in finished.items() if indices]
    found = [read_description(sample_folder(root, *key))[0]["files"] for key in first]
    return {DESCRIPTION, *chain.from_iterable(found)}


def export_croissant(
    folder: Place,
    info: DatasetInfo,
    counts: Mapping[str, int],
    *,
    files: Mapping[str, str | None],
    sets: Sequence[str],
    tables: Mapping[str, Columns],
) -> bytes:
    """Return the content of ``croissant.json`` for an export.

    Args:
        folder: the export's folder.
        info: the data set's description.
        counts: exported samples by split.
        files: the files to list by name, with their SHA-256 where it is known.
        sets: patterns of files that are too many to be listed.
        tables: by name of one of the files the types of its columns by name: what it holds is a record set.

    Raises:
        InputError: a file cannot be read.
    """
    distribution = [_file(folder, name, "", digest) for name, digest in files.items()]
    distribution += [_files(pattern, [pattern], "a sample each; its SHA-256 stands in index.jsonl") for pattern in sets]
    records = [_splits(list(counts)), *(_records(Path(name).stem, name, types) for name, types in tables.items())]
    return _document(info, counts, distribution, records)


def _file(folder: Place, name: str, text: str, digest: str | None = None) -> Node:
    path = folder / name
    node = {"@type": "cr:FileObject", "@id": name, "name": name, "contentUrl": name}
    node |= {"contentSize": f"{size_of(path)} B", "encodingFormat": _MEDIA_TYPES[Path(name).suffix]}
    return node | {"sha256": digest or sha256_file(path)} | ({"description": text} if text else {})


def _files(name: str, patterns: list[str], text: str) -> Node:
    media_type = _MEDIA_TYPES[Path(patterns[0]).suffix]
    node = {"@type": "cr:FileSet", "@id": name, "name": name, "description": text}
    return node | {"encodingFormat": media_type, "includes": patterns}


def _splits(splits: Sequence[str]) -> Node:
    """Return the enumeration of the splits, to which other record sets refer."""
    name = {"@type": "cr:Field", "@id": "splits/name", "name": "splits/name", "dataType": "sc:Text"}
    node = {"@type": "cr:RecordSet", "@id": "splits", "name": "splits", "dataType": "cr:Split"}
    return node | {"key": {"@id": "splits/name"}, "field": [name], "data": [{"splits/name": one} for one in splits]}


def _records(name: str, file: str, columns: Columns) -> Node:
    """Return the record set of a list or table."""
    fields = []
    for column, kind in columns.items():
        source = {"fileObject": {"@id": file}, "extract": {"column": column}}
        identifier = f"{name}/{quote(column, safe='')}"
        node: Node = {"@type": "cr:Field", "@id": identifier, "name": identifier}
        if isinstance(kind, str):
            node |= {"dataType": _TYPES[kind], "source": source}
        else:
            node |= {"repeated": True, "subField": [_part(identifier, source, *part) for part in kind.items()]}
        fields.append(node | ({"references": {"field": {"@id": "splits/name"}}} if column == "split" else {}))
    return {"@type": "cr:RecordSet", "@id": name, "name": name, "field": fields}


def _part(parent: str, source: Node, name: str, kind: str) -> Node:
    identifier, only = f"{parent}/{name}", {"transform": {"jsonPath": name}}
    return {
        "@type": "cr:Field",
        "@id": identifier,
        "name": identifier,
        "dataType": _TYPES[kind],
        "source": source | only,
    }


def _document(info: DatasetInfo, counts: Mapping[str, int], distribution: list[Node], records: list[Node]) -> bytes:
    rows, columns = info.sensor_shape
    shown = ", ".join(f"{split} {count}" for split, count in counts.items())
    return readable_json(
        {
            "@context": _CONTEXT,
            "@type": "sc:Dataset",
            "name": info.name,
            "description": (
                f"Simulated captures of a lensless camera ({rows} x {columns} pixels) with their scenes, made by flatlight "
                f"{info.versions.get('flatlight', '')}. Samples: {shown}. Fingerprint: {info.fingerprint}."
            ),
            "conformsTo": "http://mlcommons.org/croissant/1.0",
            "keywords": ["lensless imaging", "computational photography", "simulated"],
            "distribution": distribution,
            "recordSet": records,
        }
    )
