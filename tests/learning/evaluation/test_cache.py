"""What is kept comes back, only under its own key; what is damaged counts as missing."""

import math
from pathlib import Path

import numpy as np
import pytest

from learning.evaluation.cache import ResultCache

KEY = {"method": {"checkpoint": "ab"}, "noise": {"db": 20.0, "seed": 0}}


def test_a_result_comes_back_under_its_key_alone(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path / "new" / "cache")
    result = {"scores": [{"psnr": math.inf, "ssim": 0.1 + 0.2}]}
    cache.save(KEY, result)
    assert ResultCache(cache.folder).load(KEY) == result
    assert cache.load(KEY | {"noise": {"db": 30.0, "seed": 0}}) is None


def test_arrays_come_back_exactly(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    picture = np.random.default_rng(0).random((3, 4, 5)).astype(np.float32)
    cache.save_arrays(KEY, {"picture": picture})
    found = cache.load_arrays(KEY)
    assert found is not None
    np.testing.assert_array_equal(found["picture"], picture)
    assert cache.load_arrays(KEY | {"scene": 1}) is None


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"key": 1}', b'{"key": {}, "result": {}}', b"PK\x03\x04broken"])
def test_damaged_files_count_as_missing(tmp_path: Path, damage: bytes) -> None:
    cache = ResultCache(tmp_path)
    cache.save(KEY, {"scores": []})
    cache.save_arrays(KEY, {"picture": np.zeros(3)})
    for path in tmp_path.iterdir():
        path.write_bytes(damage)
    assert cache.load(KEY) is None
    assert cache.load_arrays(KEY) is None
