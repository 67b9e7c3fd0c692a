"""What a training learns from: the splits of data sets, the camera they know, the examples."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.capture import CaptureModel, capture_model
from learning.config.train import DataConfig, TrainConfig
from learning.data import ExampleSet, check_dataset
from learning.display import measure_white
from simulator.dataset import open_dataset
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.optics.cache import cache_folder

_MOST_WORKERS = 8


@dataclass(frozen=True)
class Material:
    """What a training learns from.

    Attributes:
        train: the split that is learned from.
        validation: the split that is measured.
        capture: the camera, with the PSFs that the inversion knows and the white of the pictures.
    """

    train: Dataset
    validation: Dataset
    capture: CaptureModel

    def describe(self) -> dict[str, Any]:
        """Return what decides a training's numbers, plain."""
        splits = {
            split.split: {"name": split.info.name, "fingerprint": split.fingerprint, "samples": len(split)}
            for split in (self.train, self.validation)
        }
        return {**splits, "stack": self.capture.stack.fingerprint, "white": self.capture.white}


def find_material(config: TrainConfig) -> Material:
    """Open the data sets of a training and look at some of their samples.

    Raises:
        InputError: no such data set or stack, an empty split, data that nothing can be learned from, or a validation split of
            another camera.
    """
    root = config.resolve_path(config.data.train)
    other = root if config.data.validation is None else config.resolve_path(config.data.validation)
    train, validation = open_dataset(root, "train"), open_dataset(other, "validation")
    for dataset in (train, validation):
        check_dataset(dataset)
    stack = config.data.stack
    known = stack if stack in ("nominal", "captured") else config.resolve_path(stack)
    capture = capture_model(train, known, white=measure_white(train))
    seen = capture if other == root else capture_model(validation, capture.stack, white=capture.white)
    for what in ("scene_shape", "sensor_shape", "gain"):
        first, second = getattr(capture, what), getattr(seen, what)
        if first != second:
            msg = (
                f"data.validation: {other} has {what} {second}, data.train {first}; validate on data of the same camera and "
                "exposure (camera.exposure.full_scale)"
            )
            raise InputError(msg)
    return Material(train, validation, capture)


def open_examples(dataset: Dataset, config: DataConfig, seed: int, say: Callable[[str], None]) -> ExampleSet:
    """Return the examples of a split, with the noise and the cache of the configuration.

    Args:
        dataset: the split.
        config: the data section.
        seed: of the noise.
        say: told where samples are kept.
    """
    cache = None
    if config.cache:
        cache = cache_folder() / "samples" if config.cache is True else Path(config.cache).expanduser()
        say(f"{dataset.split}: {len(dataset)} samples, kept decoded in {cache}")
    return ExampleSet(dataset, noise_db=config.noise_db, seed=seed, cache=cache)


def count_workers(config: DataConfig, processes: int) -> int:
    """Return how many workers each process has for reading: at most one less than there are cores for it."""
    if config.workers != "auto":
        return config.workers
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(max(cores // processes - 1, 0), _MOST_WORKERS)
