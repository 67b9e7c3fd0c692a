"""Training a FlatNet on a data set, from the YAML file to checkpoints: its data, camera, network and loss."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm

from learning.camera import CaptureModel, capture_model, check_range, measure_reference_white
from learning.checkpoint import Checkpoint, find_checkpoint, load_checkpoint, save_checkpoint
from learning.config import ActivityTrainConfig, ClipDataConfig, TrainConfig, Video3DTrainConfig, VideoTrainConfig
from learning.data import Example, ExampleSet, Loader
from learning.distributed import Processes
from learning.layers.inversion import RegularisedInversion
from learning.losses import ReconstructionLoss
from learning.method import Progress, Say
from learning.models import Network, build_network, named
from learning.models.flatnet import FlatNet
from learning.timing import recorded_timing, with_slivers
from learning.training_loop import Item, Plan, RecordedLoss, Training, TrainResult, find_cache, open_splits, run
from learning.transfer import transfer
from learning.validation import draw, true_estimate, validate
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import sha256_file
from simulator.optics.stack_files import PSF_FOLDER, read_psf_stack

_SHOWN_NUMBERS = 12  # in a message
_CAMERA_NUMBERS = ("scene_shape", "sensor_shape", "gain", "offset", "irradiance", "scene_to_camera")
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


def train(config: TrainConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None) -> TrainResult:
    """Train a FlatNet, or go on with a training that was interrupted; see `learning.training_loop.run`."""
    return run(FlatNetTraining, config, progress, say)


def find_data(
    config: TrainConfig | VideoTrainConfig | Video3DTrainConfig | ActivityTrainConfig,
) -> tuple[Dataset, Dataset, CaptureModel]:
    """Open both splits of a training, look at some of their samples, and return them with the camera that the network knows.

    The validation split must come from the same camera: mask, sensor, exposure and range of depths. How finely its PSFs were
    computed may differ (``psf.model``, ``psf.depths``), so that what is learned from a fast model can be measured on an exact
    one; the data set's fingerprint tells.

    Raises:
        InputError: no such data set or stack, an empty split, data that nothing can be learned from, PSFs up to infinity, or
            a validation split of another camera: what differs is named.
    """
    train, validation = open_splits(config)
    if isinstance(config.data, ClipDataConfig):
        train, validation = (with_slivers(each, config.data.slivers) for each in (train, validation))
    capture = capture_model(train, config.resolve_stack(config.data.stack), white=measure_reference_white(train))
    check_range(capture)
    if validation.root != train.root:
        _check_same_camera(train, validation)
        _check_same_times(capture, validation)
    return train, validation, capture


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
            f"{where} {value.tolist() if np.size(value) <= _SHOWN_NUMBERS else 'another'}"
            for where, value in ((validation.root, np.asarray(two)), (f"data.train {train.root}", np.asarray(one)))
        )
        raise InputError("data.validation", f"{what} differs: {short}; validate on data of the same camera ({cure})")


def _check_same_times(capture: CaptureModel, validation: Dataset) -> None:
    """Refuse a validation split of stills for clips and the reverse, of another shutter, or of other slivers."""
    own, known = recorded_timing(validation), capture.timing
    if (own is None) != (known is None):
        kinds = {True: "stills", False: "clips"}
        got = f"{validation.root} holds {kinds[own is None]}, data.train {kinds[known is None]}"
        raise InputError("data.validation", f"{got}; validate on data of the same camera (scene.frames)")
    if own is not None and known is not None:
        try:
            own.check_same(known, capture.sensor_shape[0])
        except InputError as error:
            raise InputError("data.validation", f"{validation.root}: {error}") from error


def _camera(dataset: Dataset) -> dict[str, Any]:
    """Return what makes a data set's camera, by the names of `_CURES`."""
    capture = capture_model(dataset)
    stack = read_psf_stack(dataset.root / PSF_FOLDER)
    mask = stack.provenance.get("mask")
    at = stack.provenance.get("mask_to_sensor_m")
    optics = f"{mask['sha256']} at {at} m" if mask else f"PSFs {stack.fingerprint}"
    values = {name: getattr(capture, name) for name in _CAMERA_NUMBERS}
    depths = np.array([1 / capture.near_m, 1 / capture.far_m])
    return {**values, "channels": " ".join(stack.channels), "mask": optics, "range of depths, 1/m": depths}


def open_examples(dataset: Dataset, config: TrainConfig, say: Say) -> ExampleSet:
    """Return the examples of a split, with the noise and the cache of the configuration; ``say`` is told of the cache."""
    return ExampleSet(
        dataset,
        noise_db=config.data.noise_db,
        augment=config.data.augment if dataset.split == "train" else None,
        seed=config.seed,
        cache=find_cache(dataset, config, say),
    )


def check_normalisation(network: nn.Module, group: Processes) -> None:
    """Refuse batch normalisation in several processes on CPUs, where torch cannot share its statistics."""
    if group.world_size == 1 or group.on_cuda:
        return
    for name, each in network.named_modules():
        if isinstance(each, _BatchNorm) and any(own.requires_grad for own in each.parameters()):
            of_classes = name.startswith("classifier.")
            key, got, cure = ("classifier", "one", "") if of_classes else ("body", "unet", "take naf, or ")
            reason = f"got {got} with batch normalisation, which {group.world_size} processes share on GPUs only"
            raise InputError(f"network.{key}", f"{reason}; {cure}run one process")


def origin(known: Checkpoint) -> dict[str, Any]:
    """Return what a training that begins with a checkpoint records of it."""
    return {"architecture": known.architecture} | {
        key: known.record.get(key) for key in ("data sets", "scenes", "init_from")
    }


def freeze_statistics(network: nn.Module) -> None:
    """Freeze the running statistics of batch normalisation, as at inference; training otherwise uses each batch's own."""
    for module in network.modules():
        if isinstance(module, _BatchNorm):
            module.eval()


class NetworkTraining(Training[Item]):
    """From measurements to images, by a network of `learning.models`: what stills and clips share."""

    command = "train"
    _config: Any
    _network: Network

    @classmethod
    def plan(cls, config: Any, group: Processes) -> Plan:
        """Find the data, build loss and network, which is seeded, and give it the weights that it begins with."""
        train, validation, capture = find_data(config)
        loss = cls._build_loss(config, capture)
        torch.manual_seed(config.seed)
        architecture = {
            "network": config.network.name,
            **config.network.numbers,
            **cls._architecture_from_data(config, train, validation),
        }
        network = build_network(capture, **named(architecture))
        check_normalisation(network, group)
        init_from, taken = None, []
        if config.init_from is not None:
            path = cls._init_path(config)
            known, lines = cls._take(config, network, path)
            taken = [f"{path.name}: {line}" for line in lines]
            init_from = {"sha256": sha256_file(path), "file": path.name} | known
        camera: dict[str, Any] = {"stack": capture.stack.fingerprint, "white": capture.white}
        if capture.timing is not None:
            camera["timing"] = capture.timing.record()
        return Plan(config, group, train, validation, capture, camera, network, architecture, loss, init_from, taken)

    @classmethod
    def _architecture_from_data(cls, config: Any, train: Dataset, validation: Dataset) -> dict[str, Any]:
        """Return what the data add to the network's architecture."""
        return {}

    @classmethod
    def _init_path(cls, config: Any) -> Path:
        """Return the file that ``init_from`` means."""
        return find_checkpoint(config.init_from, "init_from", config.resolve_path)

    @classmethod
    @abstractmethod
    def _build_loss(cls, config: Any, capture: CaptureModel) -> RecordedLoss: ...

    @classmethod
    @abstractmethod
    def _take(cls, config: Any, network: Any, path: Path) -> tuple[dict[str, Any], list[str]]:
        """Put the weights of a file into the network; return what to record of it, and lines that say what was taken."""

    def _rate(self, module: nn.Module) -> float:
        return self._config.optimiser.inversion_rate if isinstance(module, RegularisedInversion) else 1.0

    def _schedule(self) -> None:
        super()._schedule()
        if self.progress.step >= self._config.optimiser.freeze_statistics * self._config.steps:
            freeze_statistics(self._network)

    def _save(self, path: Path, architecture: dict[str, Any], record: dict[str, Any]) -> None:
        save_checkpoint(path, self._network, architecture=architecture, capture=self._capture, record=record)


class FlatNetTraining(NetworkTraining[Example]):
    """From measurements to image and disparity."""

    _config: TrainConfig
    _network: FlatNet

    @classmethod
    def _build_loss(cls, config: TrainConfig, capture: CaptureModel) -> ReconstructionLoss:
        return ReconstructionLoss(config.loss, capture)

    @classmethod
    def _take(cls, config: TrainConfig, network: FlatNet, path: Path) -> tuple[dict[str, Any], list[str]]:
        known = load_checkpoint(path, network=config.network.name)
        return origin(known), transfer(network, known)

    def _open(self, dataset: Dataset) -> ExampleSet:
        return open_examples(dataset, self._config, self._say)

    def _terms(self, wrapped: nn.Module, example: Example) -> dict[str, Tensor]:
        estimate = self._plan.precision.estimate(wrapped, example.measurement)
        return self._loss(estimate, *true_estimate(example, self._capture), example.valid)

    def _metrics(self, batches: Loader[Example]) -> dict[str, float]:
        precision, group = self._plan.precision, self._group
        return validate(self._network, batches, self._loss, self._capture, precision=precision, group=group)

    def _drawn(self, example: Example) -> NDArray[np.uint8]:
        return draw(self._network, example, self._capture, precision=self._plan.precision)
