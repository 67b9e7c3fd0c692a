"""croissant.json: MLCommons' own package finds no fault, and reads what our reader and pyarrow read."""

import json
import shutil
from collections import Counter
from pathlib import Path
from types import ModuleType

import mlcroissant
import pyarrow.parquet
import pytest

from simulator.dataset.croissant import croissant
from simulator.dataset.exports import FORMATS, export
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import open_dataset
from simulator.io.files import sha256_file

# Of the package's own dependencies.
pytestmark = pytest.mark.filterwarnings(
    "ignore:ConjunctiveGraph is deprecated", "ignore:The inplace keyword in DataFrame.reset_index"
)


def opened(path: Path) -> mlcroissant.Dataset:
    """A description in which the package finds no error, and misses only what a data set does not know."""
    found = mlcroissant.Dataset(jsonld=str(path))
    assert not found.metadata.issues.errors
    missing = ("citeAs", "datePublished", "license", "version")
    assert all(any(f'/{name}"' in line for name in missing) for line in found.metadata.issues.warnings)
    assert "@context" not in found.metadata.issues.report()
    return found


def hashes_agree(path: Path) -> int:
    """Compare the hashes with the files; return how many there are."""
    nodes = [node for node in json.loads(path.read_text())["distribution"] if node["@type"] == "cr:FileObject"]
    for node in nodes:
        assert node["sha256"] == sha256_file(path.parent / node["contentUrl"])
        assert node["contentSize"] == f"{(path.parent / node['contentUrl']).stat().st_size} B"
    return len(nodes)


def described(root: Path) -> Path:
    path = root / "croissant.json"
    path.write_bytes(croissant(root))
    return path


def test_a_data_set(dataset: Path) -> None:
    path = described(dataset)
    assert croissant(dataset) == path.read_bytes()
    found = opened(path)
    rows = list(found.records("samples"))
    entries = list(load_manifest(dataset).entries.values())
    as_read = {
        (row["samples/split"].decode(), row["samples/id"].decode()): (
            row["samples/digest"].decode(),
            row["samples/seed"],
            row["samples/label"].decode(),
        )
        for row in rows
    }
    assert len(rows) == len(as_read) == 4
    assert as_read == {(one.split, one.id): (one.digest, one.seed, one.label) for one in entries}
    assert list(open_dataset(dataset).ids) == sorted(name for split, name in as_read if split == "train")
    assert [row["splits/name"] for row in found.records("splits")] == ["train", "validation", "test"]
    assert hashes_agree(path) == 3
    assert found.metadata.name == "small"


@pytest.mark.parametrize("kind", ["dataset", "clips"])
def test_sets_of_files_find_theirs(kind: str, request: pytest.FixtureRequest) -> None:
    """By the package's own matching: every file of every sample is in one set, and no other is."""
    from mlcroissant._src.operation_graph.operations.filter import match_path

    root: Path = request.getfixturevalue(kind)
    shutil.copytree(root / "psf", root / "psf_captured")
    sets = {
        node.id: node.includes for node in opened(described(root)).metadata.distribution if hasattr(node, "includes")
    }
    found: Counter[str] = Counter()
    for path in root.rglob("*"):
        name = path.relative_to(root)
        matching = [key for key, patterns in sets.items() if match_path(patterns, name)]
        assert len(matching) == (path.suffix == ".exr" or path.name == "sample.json"), name
        found.update(matching)
    assert found["measurements"] == found["descriptions"] == 4
    assert found["ground-truth"] == (4 if kind == "dataset" else 12)
    assert found["psf"] == found["psf_captured"] == 2
    assert sets.keys() == found.keys()  # none describes what is not there


@pytest.mark.parametrize("to", FORMATS)
def test_an_export(dataset: Path, tmp_path: Path, to: str) -> None:
    export(dataset, to, tmp_path / "out", splits=["train", "validation"])
    path = tmp_path / "out/croissant.json"
    found = opened(path)
    if to != "parquet-index":
        lines = [json.loads(line) for line in (tmp_path / "out/index.jsonl").read_text().splitlines()]
        rows = [{name.partition("/")[2]: value for name, value in row.items()} for row in found.records("index")]
        assert [(row["name"].decode(), row["sha256"].decode(), row["bytes"]) for row in rows] == [
            (line["name"], line["sha256"], line["bytes"]) for line in lines
        ]
    listed = {"webdataset": 2, "hdf5": 2, "npz": 0, "parquet-index": 1}[to]
    assert hashes_agree(path) == 2 + listed + (4 if to != "parquet-index" else 0)


def test_the_table_of_an_index(samples: ModuleType, tmp_path: Path) -> None:
    metadata = {"scene": {"shapes #1": 3, "lit": True}, "share": 0.25, "family": "b/c"}
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, metadata=metadata))
    export(root, "parquet-index", tmp_path / "out")
    found = opened(tmp_path / "out/croissant.json")
    table = pyarrow.parquet.read_table(tmp_path / "out/samples.parquet").to_pylist()
    rows = list(found.records("samples"))
    assert len(rows) == len(table) == 4
    for row, own in zip(rows, table, strict=True):
        assert row["samples/id"].decode() == own["id"]
        assert row["samples/metadata.share"] == 0.25
        assert row["samples/metadata.scene.shapes%20%231"] == 3
        assert row["samples/metadata.scene.lit"] is True
        assert row["samples/metadata.family"] == b"b/c"
        files = {
            file["samples/files/name"].decode(): file["samples/files/sha256"].decode() for file in row["samples/files"]
        }
        assert files == {file["name"]: file["sha256"] for file in own["files"]}


def test_a_name_of_any_text(samples: ModuleType, tmp_path: Path) -> None:
    text = 'A "set"\n</script> \u202e{@id}'
    root = samples.make_dataset(tmp_path / "set", name=text)
    assert opened(described(root)).metadata.name == text
