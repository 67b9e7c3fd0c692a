"""``export`` as users meet it: what it prints, and how it ends."""

from pathlib import Path

import pytest

from simulator.dataset.exports import FORMATS


@pytest.mark.parametrize("to", FORMATS)
def test_it_says_what_it_wrote(flatlight, dataset: Path, tmp_path: Path, to: str) -> None:
    out = tmp_path / "out"
    code, text, err = flatlight("export", dataset, "--to", to, "--output", out)
    assert code == 0, err
    assert f": {out}\n" in text
    assert text.startswith("4 samples in ")
    assert "samples exported: 4 of 4" in err
    assert ("train has 1, validation has 1" in text) == ("workers" in text) == (to == "webdataset")
    files = {"webdataset": 2, "hdf5": 2, "npz": 4, "parquet-index": 1}[to]
    assert f"4 samples in {files} file(s)" in text
    _, text, _ = flatlight("export", dataset, "--to", to, "--output", out)
    assert f"{files} of them were there before" in text


def test_a_choice_of_splits(flatlight, one_error, dataset: Path, tmp_path: Path) -> None:
    asked = ("export", dataset, "--to", "hdf5", "--output", tmp_path / "out", "--shard-mb", 1)
    assert flatlight(*asked, "--split", "train", "--split", "validation")[1].startswith("4 samples")
    one_error(flatlight(*asked, "--split", "train"), "--output", "another export")
    one_error(flatlight(*asked, "--split", "all"), "--split", "'all'")
    (tmp_path / "file").touch()
    one_error(
        flatlight("export", dataset, "--to", "npz", "--output", tmp_path / "file" / "out"), "--output", "is a file"
    )


def test_what_is_missing_is_named(flatlight, one_error, dataset: Path, tmp_path: Path, monkeypatch) -> None:
    asked = ("export", dataset, "--output", tmp_path / "out", "--to")
    one_error(flatlight(*asked, "zip"), "--to", "'zip'")
    monkeypatch.setattr("simulator.dataset.exports.find_spec", lambda name: None)
    for to in ("hdf5", "parquet-index"):
        one_error(flatlight(*asked, to), "--to", "flatlight[export]")
    assert flatlight(*asked, "webdataset")[0] == 0
