"""dataset.json: comes back as it was written; damage is named by its key."""

import json
from pathlib import Path
from types import ModuleType

import pytest

from simulator.dataset.dataset_info import DatasetInfo, read_info, write_info
from simulator.errors import InputError


def test_info_round_trip(tmp_path: Path, samples: ModuleType) -> None:
    info = samples.make_info()
    write_info(tmp_path, info)
    back = read_info(tmp_path)
    assert back.config["psf"] == {"far_cm": "inf"}
    assert {**vars(back), "config": None} == {**vars(info), "config": None}
    content = json.loads((tmp_path / "dataset.json").read_text())
    assert (content["format"], content["format_version"]) == ("flatlight-dataset", 1)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("format", "other", "format must be"),
        ("format_version", 2, "format version 2, this package reads 1"),
        ("counts", None, "counts"),
        ("counts", {"train": -1}, "counts"),
        ("counts", {"pilot": 1}, "counts"),
        ("counts", {"train": True}, "counts"),
        ("fingerprint", "abc", "64 hexadecimal digits"),
        ("scene_shape", [1, 2, 3], "two sizes"),
        ("sensor_shape", [0, 2], "two sizes"),
        ("channels", [], "tuple of names"),
        ("channels", "RGB", "tuple of names"),
        ("name", 3, "name"),
        ("exposure", "missing", "lacks exposure"),
    ],
)
def test_damaged_info_is_named(dataset: Path, key: str, value: object, words: str) -> None:
    path = dataset / "dataset.json"
    content = json.loads(path.read_text())
    content[key] = value
    if value == "missing":
        del content[key]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"dataset\.json.*{words}"):
        read_info(dataset)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_unreadable_info(dataset: Path, content: bytes) -> None:
    (dataset / "dataset.json").write_bytes(content)
    with pytest.raises(InputError, match=r"\.json"):
        read_info(dataset)


def test_info_checks_what_it_is_given(samples: ModuleType) -> None:
    assert isinstance(samples.make_info(), DatasetInfo)
    with pytest.raises(InputError, match="scene_shape"):
        samples.make_info(scene_shape=[10, 12])
