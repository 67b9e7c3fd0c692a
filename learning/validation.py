"""Measuring a network on a validation split while it trains, and what is written down of it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.data import Example
from learning.distributed import Precision, Processes
from learning.method import Estimate, encode
from learning.metrics import depth_scores
from learning.resume import METRICS, PREVIEW, TENSORBOARD
from simulator.files import storage_errors, write_atomic

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter


def true_estimate(example: Example, capture: CaptureModel) -> Estimate:
    """Return picture and disparity of what was there, of a batch; what was not seen lies at the far depth."""
    disparity = torch.where(example.valid, capture.disparity(example.depth_m), 0)
    return Estimate(encode(example.radiance, capture.white), disparity)


def to_device(example: Example, device: torch.device) -> Example:
    """Return the example on a device; copies from pinned memory overlap with work there."""
    return Example(*(values.to(device, non_blocking=True) for values in example))


SHOWN = 4  # scenes in the picture
_GAP = 2  # pixels between tiles
_SMALLEST_ERROR = 1e-10  # 100 dB: what equals to the last bit has a finite PSNR


def validate(
    network: nn.Module,
    batches: Iterable[Example],
    loss: nn.Module,
    capture: CaptureModel,
    *,
    precision: Precision,
    group: Processes,
) -> dict[str, float]:
    """Return means over the scenes of a split: each term of the loss, ``psnr_db``, ``depth_rmse_cm``.

    PSNR is of sRGB codes, clamped. The depth's error is that of `learning.metrics.depth_scores` at valid pixels; a scene
    without any counts in the other numbers only. The processes share the scenes. The network is left in training mode.
    """
    network.eval()
    sums: dict[str, float] = {}
    counts: dict[str, int] = {}
    with torch.inference_mode():
        for batch in batches:
            example = to_device(batch, group.device)
            estimate = precision.estimate(network, example.measurement)
            truth = true_estimate(example, capture)
            count = len(example.measurement)
            values = {name: value.expand(count) for name, value in loss(estimate, *truth, example.valid).items()}
            values |= _errors(estimate.clamped(), truth, example, capture)
            for name, value in values.items():
                sums[name] = sums.get(name, 0.0) + float(value.double().sum())
                counts[name] = counts.get(name, 0) + len(value)
    network.train()
    both = torch.tensor([list(sums.values()), list(counts.values())], dtype=torch.float64, device=group.device)
    means = torch.div(*group.add(both)).tolist()
    return dict(zip(sums, means, strict=True))


def _errors(estimate: Estimate, truth: Estimate, example: Example, capture: CaptureModel) -> dict[str, Tensor]:
    """Return the errors of a batch's scenes."""
    squared = (estimate.picture - truth.picture).square().mean(dim=(1, 2, 3)).clamp_min(_SMALLEST_ERROR)
    depth = depth_scores(estimate, example, capture, example.valid).depth_rmse_cm
    return {"psnr_db": -10 * squared.log10(), "depth_rmse_cm": depth[example.valid.any(dim=(1, 2, 3))]}


def draw(network: nn.Module, example: Example, capture: CaptureModel, *, precision: Precision) -> NDArray[np.uint8]:
    """Return a picture ``(rows, columns, 3)``: a row per scene, with the truth and the estimate of picture and of depth.

    The network is left in training mode.
    """
    network.eval()
    with torch.inference_mode():
        estimate = precision.estimate(network, example.measurement).clamped()
    network.train()
    truth = true_estimate(example, capture)
    rows = []
    for scene in range(len(example.measurement)):
        codes = [_pixels(each.picture[scene]) for each in (truth, estimate)]
        depths = [_depths(each, scene, capture) for each in (truth, estimate)]
        rows.append(_joined([*codes, *depths], axis=1))
    return _joined(rows, axis=0)


def _pixels(codes: Tensor) -> NDArray[np.uint8]:
    return (codes.float() * 255).round().byte().permute(1, 2, 0).cpu().numpy()


def _depths(estimate: Estimate, scene: int, capture: CaptureModel) -> NDArray[np.uint8]:
    from simulator.preview.colours import depth_colours

    depth_m = estimate.depth_m(capture)[scene, 0].float().cpu().numpy()
    return depth_colours(depth_m, np.ones(depth_m.shape, bool), capture.near_m, capture.far_m)


def _joined(tiles: list[NDArray[Any]], axis: int) -> NDArray[np.uint8]:
    shape = list(tiles[0].shape)
    shape[axis] = _GAP
    gap = np.full(shape, 255, np.uint8)
    parts = [part for tile in tiles for part in (tile, gap)]
    return np.concatenate(parts[:-1], axis=axis)


class Log:
    """The log of a training, from some step on: what was written of later steps is taken away."""

    def __init__(self, folder: Path, step: int) -> None:
        """Open the log.

        Args:
            folder: the training's.
            step: steps done; the training goes on from there.

        Raises:
            StorageError: the folder cannot be written to.
        """
        from torch.utils.tensorboard.writer import SummaryWriter

        self._path, self._preview = folder / METRICS, folder / PREVIEW
        with storage_errors(self._path):
            kept = [line for line in self._lines() if line["step"] <= step]
            write_atomic(self._path, b"".join(_encoded(line) for line in kept))
            self._board: SummaryWriter = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)

    def write(self, step: int, kind: str, values: dict[str, float]) -> None:
        """Write numbers of a step.

        Args:
            step: steps done.
            kind: ``train`` or ``validation``.
            values: by name; finite.

        Raises:
            StorageError: the disk is full.
        """
        with storage_errors(self._path), open(self._path, "ab") as file:
            file.write(_encoded({"step": step, "kind": kind, **values}))
        for name, value in values.items():
            self._board.add_scalar(f"{kind}/{name}", value, step)

    def show(self, step: int, pixels: NDArray[np.uint8]) -> None:
        """Keep a picture ``(h, w, 3)`` of the validation scenes: in TensorBoard, and the newest as a file."""
        from PIL import Image

        from simulator.preview.drawing import png_bytes

        self._board.add_image("validation: truth, estimate, depths", pixels, step, dataformats="HWC")
        write_atomic(self._preview, png_bytes(Image.fromarray(pixels)))

    def close(self) -> None:
        """Finish the files."""
        self._board.close()

    def _lines(self) -> list[dict[str, Any]]:
        if not self._path.exists():
            return []
        found = []
        for text in self._path.read_text(encoding="utf-8").splitlines():
            try:
                found.append(json.loads(text))
            except ValueError:  # the last line of a process that died while it wrote
                continue
        return found


def _encoded(line: dict[str, Any]) -> bytes:
    return (json.dumps(line) + "\n").encode()
