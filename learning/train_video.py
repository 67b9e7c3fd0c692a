"""Training a VideoNet on a data set's clips: the usual loop with clips in place of stills."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.checkpoint import load_checkpoint
from learning.clip_examples import ClipExample, ClipExamples, open_clip_examples
from learning.clip_loss import ClipLoss
from learning.config import VideoTrainConfig
from learning.data import Loader
from learning.method import Progress, Say, inference, linear_to_srgb
from learning.metrics import moving_pixels, psnr, psnr_at
from learning.models.videonet import VideoNet
from learning.models.videonet3d import VideoNet3D
from learning.train import origin
from learning.train_clips import ClipTraining
from learning.training_loop import TrainResult, find_cache, run
from learning.validation import to_device
from simulator.dataset.reader import Dataset


def train_video(
    config: VideoTrainConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None
) -> TrainResult:
    """Train a VideoNet, or go on with a training that was interrupted; see `learning.training_loop.run`."""
    return run(VideoTraining, config, progress, say)


class VideoTraining(ClipTraining):
    """From captures to frames."""

    _network: VideoNet | VideoNet3D

    @classmethod
    def _build_loss(cls, config: VideoTrainConfig, capture: CaptureModel) -> ClipLoss:
        return ClipLoss(config.loss)

    @classmethod
    def _take(cls, config: VideoTrainConfig, network: VideoNet, path: Path) -> tuple[dict[str, Any], list[str]]:
        known = load_checkpoint(path)
        return origin(known), network.take(known.network, str(path))

    def _open(self, dataset: Dataset) -> ClipExamples:
        config, network = self._config, self._plan.network
        assert isinstance(network, VideoNet)
        return open_clip_examples(
            dataset,
            config,
            self._capture,
            joint=network.joint,
            measured=network.measnet is not None,
            cache=find_cache(dataset, config, self._say),
            on_gpu=self._group.on_cuda,
        )

    def _film(self, network: nn.Module, example: ClipExample) -> Any:
        with self._plan.precision.autocast():
            film = network(example.measurement, example.start if example.start.numel() else None)
        return type(film)(*(values.float() for values in film))

    def _losses(self, film: Any, example: ClipExample) -> dict[str, Tensor]:
        measured = example.measured  # as if all rows had the same exposure, like MeasNet's
        if measured.numel():
            assert isinstance(self._network, VideoNet)
            measured = self._network.inversion.light(measured)
        return self._loss(film, linear_to_srgb(example.radiance, self._capture.white), measured)

    def _errors(self, film: Any, example: ClipExample) -> dict[str, Tensor]:
        """Return the errors of each clip, NaN where it has none: where nothing moves, or nothing was seen."""
        truth = linear_to_srgb(example.radiance, self._capture.white)
        found = film.image.clamp(0, 1)
        errors = {"psnr_db": psnr(found, truth), "moving_psnr_db": psnr_at(found, truth, moving_pixels(truth))}
        return {name: values.clamp_max(100) for name, values in errors.items()}  # of what is equal, too

    def _terms(self, wrapped: nn.Module, example: ClipExample) -> dict[str, Tensor]:
        return self._losses(self._film(wrapped, example), example)

    def _metrics(self, batches: Loader[ClipExample]) -> dict[str, float]:
        """Return means over the validation clips: the loss's terms, ``psnr_db``, ``moving_psnr_db``; and ``score``.

        The score is the mean of both PSNRs: what stands still is most of a clip, and easy. Where nothing moves in any clip,
        it is the first alone.
        """
        sums: dict[str, float] = {}
        counts: dict[str, int] = {}
        with inference(self._network):
            for batch in batches:
                example = to_device(batch, self._group.device)
                film = self._film(self._network, example)
                count = len(example.measurement)
                values = {name: value.expand(count) for name, value in self._losses(film, example).items()}
                errors = self._errors(film, example)
                for name, value in (values | errors).items():
                    known = value[~value.isnan()] if name in errors else value
                    sums[name] = sums.get(name, 0.0) + float(known.double().sum())
                    counts[name] = counts.get(name, 0) + len(known)
        both = torch.tensor([list(sums.values()), list(counts.values())], dtype=torch.float64)
        summed = self._group.add(both.to(self._group.device))
        found = {name: float(total / of) for name, (total, of) in zip(sums, summed.T, strict=True) if of}
        return found | {"score": self._score(found)}

    def _score(self, found: Mapping[str, float]) -> float:
        return (found["psnr_db"] + found.get("moving_psnr_db", found["psnr_db"])) / 2

    def _drawn(self, example: ClipExample) -> NDArray[np.uint8]:
        """Return an image: of each clip a row of its true frames, and below it one of the estimated."""
        with inference(self._network):
            film = self._film(self._network, example)
        truth = linear_to_srgb(example.radiance, self._capture.white)
        rows = [row for pair in zip(truth, film.image.clamp(0, 1), strict=True) for row in pair]
        sheet = torch.cat([torch.cat(list(row), dim=-1) for row in rows], dim=-2)
        return (sheet * 255).round().byte().permute(1, 2, 0).cpu().numpy()
