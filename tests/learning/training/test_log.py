"""Numbers are written once, for programs and for TensorBoard, whatever died in between."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from learning.training.folder import METRICS, PREVIEW, TENSORBOARD
from learning.training.log import Log


def test_what_is_made_again_replaces_what_was_there(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log = Log(tmp_path, 0)
    for step in (1, 2, 3):
        log.write(step, "train", {"total": float(step)})
    log.close()
    with open(tmp_path / METRICS, "a") as file:
        file.write('{"step": 4, "ki')  # a process that died
    log = Log(tmp_path, 2)
    log.write(3, "train", {"total": 30.0})
    log.write(3, "validation", {"total": 5.0})
    log.close()
    found = [json.loads(line) for line in (tmp_path / METRICS).read_text().splitlines()]
    assert [(line["step"], line["kind"], line["total"]) for line in found] == [
        (1, "train", 1.0),
        (2, "train", 2.0),
        (3, "train", 30.0),
        (3, "validation", 5.0),
    ]
    board = EventAccumulator(str(tmp_path / TENSORBOARD))
    board.Reload()
    assert [(event.step, event.value) for event in board.Scalars("train/total")] == [(1, 1.0), (2, 2.0), (3, 30.0)]


def test_the_newest_picture_is_a_file(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (6, 9, 3), np.uint8)
    log = Log(tmp_path, 0)
    log.show(1, pixels[::-1].copy())
    log.show(2, pixels)
    log.close()
    assert np.array_equal(np.asarray(Image.open(tmp_path / PREVIEW)), pixels)
