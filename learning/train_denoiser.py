"""Training a denoiser on a data set's clean pictures: the usual loop with pictures in place of measurements."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import save_denoiser
from learning.config import DenoiserConfig
from learning.data import Loader
from learning.distributed import Processes
from learning.method import Progress, Say, inference, linear_to_srgb
from learning.models.denoiser import NOISE_RANGE, Denoiser, DenoisingLoss
from learning.pictures import NoisyPicture, Pictures
from learning.training_loop import Plan, Training, TrainResult, find_cache, open_splits, run
from learning.validation import to_device
from simulator.dataset.reader import Dataset
from simulator.errors import InputError


def train_denoiser(
    config: DenoiserConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None
) -> TrainResult:
    """Train a denoiser, or go on with a training that was interrupted; see `learning.training_loop.run`."""
    return run(DenoiserTraining, config, progress, say)


class DenoiserTraining(Training[NoisyPicture]):
    """From noisy pictures to clean ones."""

    command = "train-denoiser"
    _network: Denoiser

    @classmethod
    def plan(cls, config: DenoiserConfig, group: Processes) -> Plan:
        """Look at the data sets and build the network; of the camera only its colours, vignetting and white matter."""
        train, validation = open_splits(config)
        capture = capture_model(train, white=measure_reference_white(train))
        if len(capture.stack.channels) != 3:
            found = ", ".join(capture.stack.channels)
            raise InputError("data.train", f"got the channels {found}, expected pictures of three colours")
        size, wanted = (" x ".join(map(str, each.info.scene_shape)) for each in (validation, train))
        if size != wanted:
            cure = "validate on pictures of the same size (scene.size)"
            raise InputError("data.validation", f"got pictures of {size} pixels, data.train has {wanted}; {cure}")
        torch.manual_seed(config.seed)
        network, told = Denoiser(**config.network.numbers), {"network": config.network.name, **config.network.numbers}
        return Plan(config, group, train, validation, capture, {"white": capture.white}, network, told, DenoisingLoss())

    def _open(self, dataset: Dataset) -> Pictures:
        cache = find_cache(dataset, self._config, self._say)
        return Pictures(dataset, self._capture, NOISE_RANGE, self._config.seed, cache)

    def _denoised(self, network: nn.Module, example: NoisyPicture) -> Tensor:
        with self._plan.precision.autocast():
            return network(example.noisy, example.noise).float()

    def _terms(self, wrapped: nn.Module, example: NoisyPicture) -> dict[str, Tensor]:
        return self._loss(self._denoised(wrapped, example), example.clean, example.noise)

    def _metrics(self, batches: Loader[NoisyPicture]) -> dict[str, float]:
        """Return means over the validation pictures: the loss, PSNR of linear light before and after, and the score."""
        sums, count = torch.zeros(3, dtype=torch.float64, device=self._group.device), 0
        with inference(self._network):
            for batch in batches:
                example = to_device(batch, self._group.device)
                found = self._denoised(self._network, example)
                total = self._loss(found, example.clean, example.noise)["total"] * len(found)
                psnrs = [_psnr_db(each, example.clean).sum() for each in (found, example.noisy)]
                sums += torch.stack([total, *psnrs])
                count += len(found)
        sums = self._group.add(sums)
        every = float(self._group.add(sums.new_tensor(count)))
        total, psnr_db, noisy_db = (sums / every).tolist()
        # Chosen by the loss, a power: over levels of noise from faint to strong, PSNR says little.
        return {"total": total, "psnr_db": psnr_db, "noisy_psnr_db": noisy_db, "score": -10 * math.log10(total)}

    def _drawn(self, example: NoisyPicture) -> NDArray[np.uint8]:
        """Return an image: a row per picture, clean, noisy, denoised."""
        with torch.inference_mode():
            found = self._denoised(self._network, example)
        rows = torch.cat([example.clean, example.noisy, found], dim=3)
        codes = linear_to_srgb(torch.cat(list(rows), dim=1), 1.0)
        return (codes * 255).round().byte().permute(1, 2, 0).cpu().numpy()

    def _save(self, path: Path, architecture: dict[str, Any], record: dict[str, Any]) -> None:
        save_denoiser(path, self._network, architecture=architecture, record=record)


def _psnr_db(found: Tensor, clean: Tensor) -> Tensor:
    return -10 * (found - clean).square().mean(dim=(1, 2, 3)).clamp_min(1e-10).log10()
