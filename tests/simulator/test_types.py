"""A clip refuses what the light path could not use."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.types import Clip


def _fields(**changes):
    fields = {
        "rgb": np.ones((1, 4, 6, 3), np.float32),
        "depth_m": np.full((1, 4, 6), 0.1, np.float32),
        "valid": np.ones((1, 4, 6), bool),
        "frame_edges_s": np.array([0.0, 1.0]),
    }
    return fields | changes


def test_clip_accepts_infinite_depth():
    Clip(**_fields(depth_m=np.full((1, 4, 6), np.inf, np.float32)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rgb": np.ones((1, 4, 6, 3))}, r"^Clip\.rgb: "),
        ({"rgb": np.full((1, 4, 6, 3), np.nan, np.float32)}, r"^Clip\.rgb: "),
        ({"rgb": np.full((1, 4, 6, 3), -1e-3, np.float32)}, r"^Clip\.rgb: "),
        ({"depth_m": np.zeros((1, 4, 6), np.float32)}, r"^Clip\.depth_m: "),
        ({"depth_m": np.full((1, 4, 6), np.nan, np.float32)}, r"^Clip\.depth_m: "),
        ({"depth_m": np.ones((1, 6, 4), np.float32)}, r"^Clip\.depth_m: "),
        ({"valid": np.ones((1, 4, 6), np.uint8)}, r"^Clip\.valid: "),
        ({"frame_edges_s": np.array([1.0, 0.0])}, r"^Clip\.frame_edges_s: "),
    ],
)
def test_clip_refuses_bad_fields(changes, message):
    with pytest.raises(InputError, match=message):
        Clip(**_fields(**changes))
