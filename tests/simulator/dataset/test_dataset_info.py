"""dataset.json: comes back as it was written; damage is named by its key."""

import json
from pathlib import Path
from types import ModuleType

import pytest

from simulator.dataset.dataset_info import read_info, write_info
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
    "damage",
    [
        *(b"", b"{", b"\xff\xfe", b"[" * 100_000),
        *({"format": "other"}, {"format_version": 2}, {"fingerprint": "abc"}, {"name": 3}, {"exposure": None}),
        *({"counts": counts} for counts in (None, {"train": -1}, {"pilot": 1}, {"train": True})),
        *({"scene_shape": [1, 2, 3]}, {"sensor_shape": [0, 2]}, {"channels": []}, {"channels": "RGB"}, "no exposure"),
    ],
)
def test_damaged_info_is_named(dataset: Path, damage: bytes | dict | str) -> None:
    path = dataset / "dataset.json"
    content = json.loads(path.read_text())
    if isinstance(damage, dict):
        content |= damage
    else:
        del content["exposure"]
    path.write_bytes(damage if isinstance(damage, bytes) else json.dumps(content).encode())
    with pytest.raises(InputError, match=r"dataset\.json: "):
        read_info(dataset)


def test_info_checks_what_it_is_given(samples: ModuleType) -> None:
    with pytest.raises(InputError, match=r"^scene_shape: "):
        samples.make_info(scene_shape=[10, 12])
