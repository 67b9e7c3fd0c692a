"""What a training learns from: the splits of data sets, the camera they know, the examples."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from learning.capture import CaptureModel, capture_model
from learning.config.train import TrainConfig
from learning.data import ExampleSet, check_dataset
from learning.display import measure_white
from simulator.dataset import open_dataset
from simulator.dataset.dataset_info import PSF_FOLDER
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.cache import cache_folder
from simulator.optics.stack_files import read_psf_stack

_MOST_WORKERS = 8
_SHOWN = 12  # numbers in a message
_NUMBERS = ("scene_shape", "sensor_shape", "gain", "offset", "irradiance", "scene_to_camera")
_CURES = {
    "scene_shape": "scene.size",
    "sensor_shape": "camera.sensor.shape",
    "channels": "camera.sensor.readout",
    "range of depths, 1/m": "psf.near_cm, psf.far_cm",
    "mask": "camera.mask, camera.mask_to_sensor_mm",
    "scene_to_camera": "camera.scene_to_camera",
    "irradiance": "forward.vignetting",
    "offset": "camera.noise.type, camera.sensor.black_level_dn",
    "gain": "camera.exposure.full_scale",
}
"""What makes a camera, and what of the data set's configuration decides it; from coarse to fine."""


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

    The validation split must come from the same camera: mask, sensor, exposure and range of depths. How finely its PSFs were
    computed may differ (``psf.model``, ``psf.depths``), so that what is learned from a fast model can be measured on an exact
    one; the data set's fingerprint tells.

    Raises:
        InputError: no such data set or stack, an empty split, data that nothing can be learned from, or a validation split of
            another camera: what differs is named.
    """
    root = config.resolve_path(config.data.train)
    other = root if config.data.validation is None else config.resolve_path(config.data.validation)
    train, validation = open_dataset(root, "train"), open_dataset(other, "validation")
    for dataset in (train, validation):
        check_dataset(dataset)
    stack = config.data.stack
    known = stack if stack in ("nominal", "captured") else config.resolve_path(stack)
    capture = capture_model(train, known, white=measure_white(train))
    if other != root:
        _check_same_camera(train, validation)
    return Material(train, validation, capture)


def _check_same_camera(train: Dataset, validation: Dataset) -> None:
    """Refuse a validation split that was measured otherwise than what is learned from."""
    first, second = _camera(train), _camera(validation)
    for what, cure in _CURES.items():
        one, two = first[what], second[what]
        if np.shape(one) == np.shape(two) and (
            one == two if isinstance(one, str) else np.allclose(one, two, rtol=1e-5)
        ):
            continue
        short = " and ".join(
            f"{where} {value.tolist() if np.size(value) <= _SHOWN else 'another'}"
            for where, value in ((validation.root, np.asarray(two)), (f"data.train {train.root}", np.asarray(one)))
        )
        msg = f"data.validation: {what} differs: {short}; validate on data of the same camera ({cure})"
        raise InputError(msg)


def _camera(dataset: Dataset) -> dict[str, Any]:
    """Return what makes a data set's camera, by the names of `_CURES`."""
    capture = capture_model(dataset)
    stack = read_psf_stack(dataset.root / PSF_FOLDER)
    made = stack.provenance
    mask = made.get("mask")
    optics = f"{mask['sha256']} at {made.get('mask_to_sensor_m')} m" if mask else f"PSFs {stack.fingerprint}"
    values = {name: getattr(capture, name) for name in _NUMBERS}
    depths = np.array([1 / capture.near_m, 1 / capture.far_m])
    return {**values, "channels": " ".join(stack.channels), "mask": optics, "range of depths, 1/m": depths}


def open_examples(dataset: Dataset, config: TrainConfig, say: Callable[[str], None]) -> ExampleSet:
    """Return the examples of a split, with the noise and the cache of the configuration.

    Args:
        dataset: the split.
        config: the training.
        say: told where samples are kept.
    """
    cache = None
    place = config.data.cache
    if place:
        cache = cache_folder() / "samples" if place is True else config.resolve_path(place)
        say(f"{dataset.split}: {len(dataset)} samples, kept decoded in {cache}")
    return ExampleSet(dataset, noise_db=config.data.noise_db, seed=config.seed, cache=cache)


def count_workers(config: TrainConfig, processes: int) -> int:
    """Return how many workers each process has for reading: at most one less than there are cores for it."""
    if config.data.workers != "auto":
        return config.data.workers
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(max(cores // processes - 1, 0), _MOST_WORKERS)
