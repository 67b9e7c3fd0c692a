"""Training a VideoNet3D on a data set's clips: as a VideoNet, with the depth of every frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.checkpoint import find_checkpoint, load_checkpoint
from learning.clip_examples import ClipExample, ClipExamples, open_clip_examples
from learning.clip_loss import ClipDepthLoss
from learning.config import Video3DTrainConfig
from learning.data import Example
from learning.method import Progress, Say, inference, linear_to_srgb
from learning.metrics import depth_scores
from learning.models.videonet3d import VideoNet3D
from learning.train import origin
from learning.train_video import VideoTraining
from learning.training_loop import Training, TrainResult, find_cache, run
from learning.transfer import transfer
from learning.validation import both_scores
from simulator.dataset.reader import Dataset
from simulator.errors import InputError


def train_video_3d(
    config: Video3DTrainConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None
) -> TrainResult:
    """Train a VideoNet3D, or go on with a training that was interrupted; see `learning.training_loop.run`."""
    return run(Video3DTraining, config, progress, say)


class Video3DTraining(VideoTraining):
    """From captures to frames and their depth."""

    _config: Video3DTrainConfig
    _network: VideoNet3D

    @classmethod
    def _build_loss(cls, config: Video3DTrainConfig, capture: CaptureModel) -> ClipDepthLoss:
        return ClipDepthLoss(config.loss, capture)

    @classmethod
    def _architecture_from_data(cls, config: Video3DTrainConfig, train: Dataset, validation: Dataset) -> dict[str, Any]:
        path = find_checkpoint(config.init_from, "init_from", config.resolve_path)
        known = load_checkpoint(path).architecture
        if known["network"] == "videonet3d":
            return {"still": known["still"]}
        if known["network"] == "flatnet3d":
            return {"still": dict(known)}
        wanted = "expected a flatnet3d to build on, or a videonet3d to go on from"
        raise InputError("init_from", f"got a checkpoint of {known['network']}, {path}, {wanted}")

    @classmethod
    def _take(cls, config: Video3DTrainConfig, network: VideoNet3D, path: Path) -> tuple[dict[str, Any], list[str]]:
        known = load_checkpoint(path)
        if known.architecture["network"] == "flatnet3d":
            return origin(known), transfer(network.joint.still, known)
        return origin(known), network.take(known.network, str(path))

    def _rate(self, module: nn.Module) -> float:
        # Inversions are the FlatNet3D's, which is not trained here; so are statistics, where it has some.
        return 1.0

    def _schedule(self) -> None:
        Training._schedule(self)

    def _open(self, dataset: Dataset) -> ClipExamples:
        network = self._plan.network
        assert isinstance(network, VideoNet3D)
        return open_clip_examples(
            dataset,
            self._config,
            self._capture,
            joint=network.joint,
            measured=False,
            cache=find_cache(dataset, self._config, self._say),
            on_gpu=self._group.on_cuda,
            depth=True,
        )

    def _losses(self, film: Any, example: ClipExample) -> dict[str, Tensor]:
        image = linear_to_srgb(example.radiance, self._capture.white)
        return self._loss(film, image, self._capture.disparity(example.depth_m), example.depth_m > 0)

    def _errors(self, film: Any, example: ClipExample) -> dict[str, Tensor]:
        seen = example.depth_m > 0
        truth = Example(
            example.measurement, example.radiance, example.depth_m.clamp_min(self._capture.near_m / 10), seen
        )
        depth = depth_scores(film, truth, self._capture, seen)
        return super()._errors(film, example) | {"depth_rmse_cm": depth.depth_rmse_cm}

    def _score(self, found: Mapping[str, float]) -> float:
        return both_scores(super()._score(found), found.get("depth_rmse_cm", 1.0))

    def _drawn(self, example: ClipExample) -> NDArray[np.uint8]:
        """Return an image: below true and estimated frames of each clip its true and estimated depths."""
        from simulator.plots.drawing import depth_colours

        with inference(self._network):
            film = self._film(self._network, example)
        found, capture = film.clamped(), self._capture
        truth = linear_to_srgb(example.radiance, capture.white)
        every, seen = torch.ones_like(example.depth_m, dtype=torch.bool), example.depth_m > 0
        rows = []
        for clip in range(len(truth)):
            for frames in (truth[clip], found.image[clip]):
                rows.append(
                    np.concatenate(list((frames * 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()), axis=1)
                )
            depths = ((example.depth_m.clamp_min(capture.near_m), seen), (found.depth_m(capture), every))
            for depth_m, valid in depths:
                metres, where = (each[clip, :, 0].cpu().numpy() for each in (depth_m, valid))
                rows.append(np.concatenate(list(depth_colours(metres, where, capture.near_m, capture.far_m)), axis=1))
        return np.concatenate(rows)
