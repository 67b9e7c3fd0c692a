"""Parquet: pyarrow finds samples by what is known of them, and the hashes are those of the files."""

import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pyarrow.dataset
import pyarrow.parquet
import pytest

from simulator.dataset.exports import export, parquet_index
from simulator.dataset.exports.parquet_index import scalars
from simulator.dataset.manifest import load_manifest
from simulator.errors import InputError
from simulator.io.files import sha256_file

FIRST = {"a": 1, "far_m": 0.5, "kind": "box", "lit": True, "deep": {"er": {"value": 2}}, "many": [1, 2], "mixed": 3}
OTHER = {"a": 2**53, "far_m": float("inf"), "kind": "inf", "lit": None, "deep": {"er": {"value": 2.5}}, "mixed": "x"}


@pytest.fixture
def table(samples: ModuleType, tmp_path: Path) -> Path:
    """The index of samples of which every second one has other metadata."""

    def make(index: int):
        metadata = OTHER if index % 2 else FIRST
        return samples.make_sample(index, metadata={**metadata, "far_m": "inf"} if index % 2 else metadata)

    root = samples.make_dataset(tmp_path / "set", make)
    export(root, "parquet-index", tmp_path / "out")
    return tmp_path / "out/samples.parquet"


def test_a_row_per_sample(dataset: Path, tmp_path: Path) -> None:
    export(dataset, "parquet-index", tmp_path / "out")
    rows = pyarrow.parquet.read_table(tmp_path / "out/samples.parquet").to_pylist()
    entries = load_manifest(dataset).entries
    assert [(row["split"], row["id"]) for row in rows] == list(entries)
    for row in rows:
        entry = entries[row["split"], row["id"]]
        for name in ("digest", "seed", "label", "seconds"):
            assert row[name] == getattr(entry, name)
        folder = dataset / row["folder"]
        assert {file["name"] for file in row["files"]} == {path.name for path in folder.iterdir()}
        for file in row["files"]:
            assert file["sha256"] == sha256_file(folder / file["name"])
            assert file["bytes"] == (folder / file["name"]).stat().st_size
        assert (row["metadata.clipped"], row["metadata.full_scale"]) == (0.001, 0.5)


def test_columns_are_as_wide_as_their_values(table: Path) -> None:
    schema = pyarrow.parquet.read_schema(table)
    types = {name: str(schema.field(f"metadata.{name}").type) for name in ("a", "far_m", "kind", "lit", "mixed")}
    assert types == {"a": "int64", "far_m": "double", "kind": "string", "lit": "bool", "mixed": "string"}
    assert str(schema.field("metadata.deep.er.value").type) == "double"
    assert "metadata.many" not in schema.names
    rows = {row["id"]: row for row in pyarrow.parquet.read_table(table).to_pylist() if row["split"] == "train"}
    assert [rows[f"s0000000{n}"]["metadata.far_m"] for n in range(3)] == [0.5, math.inf, 0.5]
    assert [rows[f"s0000000{n}"]["metadata.lit"] for n in range(3)] == [True, None, True]
    assert [rows[f"s0000000{n}"]["metadata.kind"] for n in range(3)] == ["box", "inf", "box"]
    assert [rows[f"s0000000{n}"]["metadata.mixed"] for n in range(3)] == ["3", "x", "3"]


def test_samples_are_found_by_what_is_known_of_them(table: Path) -> None:
    field = pyarrow.dataset.field
    filters = (field("split") == "train") & (field("metadata.far_m") > 1)
    found = pyarrow.parquet.read_table(table, columns=["id"], filters=filters)
    assert found.to_pydict() == {"id": ["s00000001"]}
    by_label = pyarrow.parquet.read_table(table, filters=[("label", "==", "class 2")])
    assert by_label["folder"].to_pylist() == ["train/0000/s00000002"]


def test_row_groups_are_bounded_and_the_table_is_the_same(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export(dataset, "parquet-index", tmp_path / "one")
    monkeypatch.setattr(parquet_index, "_GROUP_FILES", 6)
    export(dataset, "parquet-index", tmp_path / "two")
    tables = [pyarrow.parquet.ParquetFile(tmp_path / name / "samples.parquet") for name in ("one", "two")]
    assert [table.num_row_groups for table in tables] == [1, 2]
    assert tables[0].read().equals(tables[1].read())


def test_no_image_is_read(dataset: Path, tmp_path: Path) -> None:
    """So a damaged one is not noticed, but one that is gone; and a description that is not as it was made."""
    file = dataset / "train/0000/s00000001/measurement.exr"
    file.write_bytes(b"damaged")
    export(dataset, "parquet-index", tmp_path / "out")
    file.unlink()
    with pytest.raises(InputError, match=r"s00000001/measurement\.exr"):
        export(dataset, "parquet-index", tmp_path / "gone")
    description = dataset / "train/0000/s00000000/sample.json"
    description.write_text(description.read_text().replace("0.001", "0.002"))
    with pytest.raises(InputError, match="train/s00000000: its digest"):
        export(dataset, "parquet-index", tmp_path / "edited")


def test_metadata_that_make_no_columns(dataset: Path, tmp_path: Path, forge: Callable[..., Path]) -> None:
    forge(dataset, metadata={"a.b": 1, "a": {"b": 2}})
    with pytest.raises(InputError, match=r"s00000000: .*a\.b"):
        export(dataset, "parquet-index", tmp_path / "twice")
    forge(dataset, metadata={f"name {number}": number for number in range(1001)})
    with pytest.raises(InputError, match=r"s00000000: .*1000"):
        export(dataset, "parquet-index", tmp_path / "many")
    assert list(scalars({"n": 10**30})) == [("n", 10**30)]
    forge(dataset, metadata={"n": 10**30})
    export(dataset, "parquet-index", tmp_path / "large")
    rows = pyarrow.parquet.read_table(tmp_path / "large/samples.parquet").to_pylist()
    assert rows[0]["metadata.n"] == "1" + "0" * 30
