"""Damaged and hostile files: each refused at once, by one line that names the file and the key."""

from __future__ import annotations

import copy
import json
import math
import shutil
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from learning.checkpoint import load_checkpoint, shipped_checkpoints
from learning.reconstruct.choice import Request, choose_method
from learning.reconstruct.inputs import load_measurement
from simulator.errors import InputError

GONE = object()
HUGE, LONG = 10**9, "x" * 9999
NUMBERS = [
    GONE,
    None,
    math.nan,
    math.inf,
    -1,
    0,
    1e308,
    10**40,
    "x",
    LONG,
    True,
    [],
    {},
]  # where one positive number belongs
SHAPES = [GONE, None, 7, [16], [16, 0], [16, -16], [HUGE, HUGE], [16, HUGE], [10**30, 16], [1e9, 16], ["x", 16], LONG]
MATRICES = [
    GONE,
    None,
    1,
    LONG,
    {},
    [],
    [[1, 0, 0]],
    [[1, 0, 0]] * 4,
    [[1, 0], [0, 1], [1, 1]],
    [[1, 0, 0], [0, 1], [1]],
]
MATRICES += [[[1, 0, 0], [0, 1, 0], [0, 0, bad]] for bad in (math.nan, math.inf, "x", None, 10**999)]

DATASET: list[tuple[str, list[Any]]] = [
    ("scene_shape", SHAPES),
    ("sensor_shape", SHAPES),
    ("scene_to_camera.matrix", MATRICES),
    ("exposure.full_scale", [each for each in NUMBERS if each is not True]),
    ("exposure", [GONE, None, 1, [], {}]),
    ("channels", [GONE, None, [], [1, 2, 3], ["R"], ["R", "G", LONG], LONG, ["R"] * 99]),
    ("config", [GONE, None, [], {}, {"camera": {}}]),
    ("config.camera", [GONE, None, 1, [], {}, {LONG: 1}]),
    ("config.camera.sensor.binning", [None, math.nan, -1, 0, 1e308, "x", [], {}]),
    ("config.psf.near_cm", [math.nan, -1, 0, 1e308, "x", [], {}]),
    ("config.camera.sensor.shape", [None, 7, [16], [16, 0], [16, -16], ["x", 16]]),
]
PSF: list[tuple[str, list[Any]]] = [
    ("pixel_pitch_m", NUMBERS),
    ("depths_m", [GONE, None, 1, [], [3, 2, 1], [math.nan] * 3, [0, 1, 2], [-1, 1, 2], ["x"] * 3]),
    ("channels", [GONE, None, [], [1, 2, 3], ["R", "R", "G"], LONG, [[], [], []]]),
    ("frame", [GONE, None, "physical", LONG]),
    ("files", [GONE, None, [], {}, {"x": "y"}, 1]),
]
SAMPLE: list[tuple[str, list[Any]]] = [
    ("frames", [None, 0, -1, HUGE, 10**30, math.nan, "x", [], True]),
    ("channels", [GONE, None, [1, 2, 3], [], LONG]),
    ("extras", [1, [], {"Q": 1}, {"Q": {"kind": "float", "size": HUGE}}]),
]
CHECKPOINT: list[tuple[str, list[Any]]] = [
    ("camera.sensor_shape", [*SHAPES, [16, 2**20], [2**20, 2**20]]),
    ("camera.scene_shape", SHAPES),
    ("camera.gain", NUMBERS),
    ("camera.white", NUMBERS),
    ("camera.pixel_pitch_m", NUMBERS),
    ("camera.channels", [GONE, None, [], ["R"], 1]),
    ("camera", [GONE, None, [], 1]),
    ("architecture", [GONE, None, [], 1]),
    ("architecture.network", [GONE, None, 1, "x", LONG, []]),
    ("architecture.filters", [None, 0, -1, 5, HUGE, 10**30, math.nan, math.inf, "x", [], 2**12]),
    ("architecture.levels", [None, 0, -1, 5, HUGE, 10**30, math.nan, math.inf, "x", []]),
    ("architecture.stem", [None, 0, -1, 5, HUGE, 10**30, math.nan, math.inf, "x", []]),
]


def changed(content: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """Return a copy in which one key, dotted, has another value, or is gone."""
    changed = copy.deepcopy(content)
    *way, last = key.split(".")
    at = changed
    for step in way:
        at = at[step]
    if value is GONE:
        del at[last]
    else:
        at[last] = value
    return changed


def check_refusals(table: list[tuple[str, list[Any]]], file: str, read: Callable[[str, Any], None]) -> None:
    """Every change of the table is refused within 5 s by one short line that names the file and the key."""
    for key, values in table:
        for value in values:
            start = time.monotonic()
            with pytest.raises(InputError) as caught:
                read(key, value)
            message = str(caught.value)
            shown = f"{key} = {str(value)[:60]}: {message[:500]}"
            assert time.monotonic() - start < 5, shown
            assert f"{file}: " in message, shown
            assert "\n" not in message, shown
            assert len(message) < 1200, shown
            first, *inner = key.split(".")
            assert any(part in message for part in inner or [first]) or "by the architecture" in message, shown


@pytest.mark.parametrize(
    ("file", "table"), [("dataset.json", DATASET), ("psf/psf.json", PSF), ("test/0000/s00000000/sample.json", SAMPLE)]
)
def test_a_damaged_data_set(tiny_dataset: Path, tmp_path: Path, file: str, table: list[tuple[str, list[Any]]]) -> None:
    root = tmp_path / "set"
    shutil.copytree(tiny_dataset, root, ignore=shutil.ignore_patterns("train", "validation"))
    content = json.loads((root / file).read_text(encoding="utf-8"))
    sample = root / "test/0000/s00000000"
    parameters = {"steps_between_planes": 1}

    def read(key: str, value: Any) -> None:
        (root / file).write_text(json.dumps(changed(content, key, value)), encoding="utf-8")
        choose_method(load_measurement(sample), Request(method="cls", stack="nominal", parameters=parameters))

    check_refusals(table, Path(file).name, read)


def test_a_damaged_checkpoint(checkpoints: list[Path], tmp_path: Path) -> None:
    data, path = checkpoints[0].read_bytes(), tmp_path / "network.safetensors"
    (size,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + size])
    content = json.loads(header["__metadata__"]["flatlight"])

    def read(key: str, value: Any) -> None:
        header["__metadata__"] = {"flatlight": json.dumps(changed(content, key, value))}
        text = json.dumps(header).encode()
        path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + size :])
        load_checkpoint(path)

    check_refusals(CHECKPOINT, path.name, read)


def test_a_checkpoint_whose_psfs_lie_in_one_row_is_refused(tmp_path: Path) -> None:
    """The same bytes under another shape: the period of the FFT would have hundreds of times as many pixels as the file."""
    data = next(iter(shipped_checkpoints().values())).read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + size])
    planes, channels, rows, columns = header["camera.psf"]["shape"]
    header["camera.psf"]["shape"] = [planes, channels, 1, rows * columns]
    text = json.dumps(header).encode()
    (tmp_path / "row.safetensors").write_bytes(struct.pack("<Q", len(text)) + text + data[8 + size :])
    with pytest.raises(InputError, match=r"row\.safetensors: .*sensor_shape: "):
        load_checkpoint(tmp_path / "row.safetensors")
