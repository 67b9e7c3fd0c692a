"""WebDataset's own package reads what we wrote: every sample in one piece, every file as it is on disk."""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
import webdataset

from simulator.dataset.exports import export
from simulator.dataset.reader import open_dataset
from simulator.io.exr import decode_exr


def read(*shards: Path) -> list[dict]:
    pipeline = webdataset.WebDataset([str(shard) for shard in shards], shardshuffle=False, empty_check=False)
    return list(pipeline)


def test_the_package_reads_stills(dataset: Path, tmp_path: Path) -> None:
    result = export(dataset, "webdataset", tmp_path / "out", splits=["train"])
    assert result.shards == {"train": 1}
    found, expected = read(tmp_path / "out/train-000000.tar"), open_dataset(dataset, "train")
    assert [sample["__key__"] for sample in found] == list(expected.ids)
    for sample, own in zip(found, expected, strict=True):
        files = {name for name in sample if not name.startswith("__")}
        assert files == {"measurement.exr", "ground_truth.exr", "sample.json"}
        planes, _ = decode_exr(sample["measurement.exr"], Path("measurement.exr"), require_checksums=True)
        np.testing.assert_array_equal(np.stack([planes[name] for name in "RGB"]), own.measurement)
        truth, _ = decode_exr(sample["ground_truth.exr"], Path("ground_truth.exr"))
        np.testing.assert_array_equal(truth["Z"], own.depth_m[0])
        assert json.loads(sample["sample.json"])["label"] == own.label


def test_the_package_keeps_the_frames_of_a_clip_together(clips: Path, tmp_path: Path) -> None:
    export(clips, "webdataset", tmp_path / "out")
    found, expected = read(tmp_path / "out/train-000000.tar"), open_dataset(clips, "train")
    assert [sample["__key__"] for sample in found] == list(expected.ids)
    for sample, own in zip(found, expected, strict=True):
        for frame in range(3):
            truth, _ = decode_exr(sample[f"frames.ground_truth.{frame:04d}.exr"], Path("x"))
            np.testing.assert_array_equal(truth["G"], own.rgb[frame, ..., 1])
            planes, _ = decode_exr(sample[f"frames.global.{frame:04d}.exr"], Path("x"))
            np.testing.assert_array_equal(planes["B"], own.global_measurements[frame, 2])


@pytest.mark.parametrize("shard_bytes", [10, 35_000, 64_000, 10**9])
def test_shards_keep_their_size_and_say_nothing_of_the_machine(dataset: Path, tmp_path: Path, shard_bytes: int) -> None:
    out = tmp_path / "out"
    result = export(dataset, "webdataset", out, splits=["train"], shard_bytes=shard_bytes)
    shards = sorted(out.glob("*.tar"))
    assert [shard.name for shard in shards] == [f"train-{number:06d}.tar" for number in range(len(shards))]
    assert result.shards == {"train": len(shards)}
    assert {10: 3, 35_000: 3, 64_000: 2, 10**9: 1}[shard_bytes] == len(shards)
    index = [json.loads(line) for line in (out / "index.jsonl").read_text().splitlines()]
    assert [(line["name"], line["bytes"]) for line in index] == [(path.name, path.stat().st_size) for path in shards]
    assert sum(line["samples"] for line in index) == 3
    for shard, line in zip(shards, index, strict=True):
        assert line["samples"] == 1 or shard.stat().st_size <= shard_bytes
        with tarfile.open(shard) as tar:
            members = tar.getmembers()
            assert [one.name for one in members] == sorted(one.name for one in members)
            for one in members:
                assert (one.uid, one.gid, one.uname, one.gname, one.mtime, one.mode) == (0, 0, "", "", 0, 0o644)
                key, _, name = one.name.partition(".")
                content = tar.extractfile(one)
                assert content is not None
                assert content.read() == (dataset / "train/0000" / key / name).read_bytes()
        assert shard.read_bytes()[257:265] == b"ustar\x0000"
