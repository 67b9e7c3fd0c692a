"""Measuring a network on a validation split while it trains, and what is written down of it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.data import Example, Item
from learning.distributed import Precision, Processes
from learning.method import Estimate, inference, linear_to_srgb
from learning.metrics import depth_scores
from simulator.io.files import storage_errors, write_atomic

METRICS = "metrics.jsonl"
"""One line per log entry and per validation."""
TENSORBOARD = "tensorboard"
PREVIEW = "validation.png"
SHOWN = 4  # scenes in the preview
_GAP = 2  # pixels between tiles
_SMALLEST_ERROR = 1e-10  # 100 dB: what equals to the last bit has a finite PSNR


def true_estimate(example: Example, capture: CaptureModel) -> Estimate:
    """Return image and disparity of what was there, of a batch; what was not seen lies at the far depth."""
    disparity = torch.where(example.valid, capture.disparity(example.depth_m), 0)
    return Estimate(linear_to_srgb(example.radiance, capture.white), disparity)


def errors_in_words(metrics: Mapping[str, float]) -> str:
    """Return what a validation found, for people: of all scores those that there are."""
    words = {
        "psnr_db": "PSNR {:.2f} dB",
        "noisy_psnr_db": "of the input {:.2f} dB",
        "depth_rmse_cm": "depth RMSE {:.2f} cm",
        "moving_psnr_db": "of moving pixels {:.2f} dB",
        "top_1": "top-1 {:.1%}",
        "top_2": "top-2 {:.1%}",
    }
    return ", ".join(text.format(metrics[name]) for name, text in words.items() if name in metrics)


def to_device(example: Item, device: torch.device) -> Item:
    """Return a named tuple such as an example on a device; copies from pinned memory overlap with work there."""
    return type(example)(*(values.to(device, non_blocking=True) for values in example))


def validate(
    network: nn.Module,
    batches: Iterable[Example],
    loss: Callable[..., dict[str, Tensor]],
    capture: CaptureModel,
    *,
    precision: Precision,
    group: Processes,
) -> dict[str, float]:
    """Return means over the scenes of a split: each term of the loss, ``psnr_db``, ``depth_rmse_cm``; and ``score``.

    The score, by which the best checkpoint is chosen, is made of what is reported: PSNR minus the depth error's decibels, so
    that halving either error is worth as much. PSNR is of sRGB codes, clamped. The depth's error is that of
    `learning.metrics.depth_scores` at valid pixels; a scene without any counts in the other numbers only. The processes
    share the scenes.
    """
    sums: dict[str, float] = {}
    counts: dict[str, int] = {}
    with inference(network):
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
    both = torch.tensor([list(sums.values()), list(counts.values())], dtype=torch.float64, device=group.device)
    means = torch.div(*group.add(both)).tolist()
    found = dict(zip(sums, means, strict=True))
    return found | {"score": both_scores(found["psnr_db"], found["depth_rmse_cm"])}


def both_scores(psnr_db: float, depth_rmse_cm: float) -> float:
    """Return one number for image and depth, dB: the PSNR less that of the depth's error, whose peak is 1 cm."""
    return psnr_db - 20 * math.log10(max(depth_rmse_cm, _SMALLEST_ERROR))


def _errors(estimate: Estimate, truth: Estimate, example: Example, capture: CaptureModel) -> dict[str, Tensor]:
    """Return the errors of a batch's scenes."""
    squared = (estimate.image - truth.image).square().mean(dim=(1, 2, 3)).clamp_min(_SMALLEST_ERROR)
    depth = depth_scores(estimate, example, capture, example.valid).depth_rmse_cm
    return {"psnr_db": -10 * squared.log10(), "depth_rmse_cm": depth[example.valid.any(dim=(1, 2, 3))]}


def draw(network: nn.Module, example: Example, capture: CaptureModel, *, precision: Precision) -> NDArray[np.uint8]:
    """Return an image ``(rows, columns, 3)``: a row per scene, with the truth and the estimate of image and of depth."""
    from simulator.plots.drawing import depth_colours

    with inference(network):
        estimate = precision.estimate(network, example.measurement).clamped()
    both = (true_estimate(example, capture), estimate)
    rows = []
    for scene in range(len(example.measurement)):
        codes = [(each.image[scene].float() * 255).round().byte().permute(1, 2, 0).cpu().numpy() for each in both]
        depths_m = [each.depth_m(capture)[scene, 0].float().cpu().numpy() for each in both]
        seen = np.ones(depths_m[0].shape, bool)
        depths = [depth_colours(depth_m, seen, capture.near_m, capture.far_m) for depth_m in depths_m]
        rows.append(_joined([*codes, *depths], axis=1))
    return _joined(rows, axis=0)


def _joined(tiles: list[NDArray[Any]], axis: int) -> NDArray[np.uint8]:
    shape = list(tiles[0].shape)
    shape[axis] = _GAP
    gap = np.full(shape, 255, np.uint8)
    return np.concatenate([part for tile in tiles for part in (tile, gap)][:-1], axis=axis)


def read_metrics(folder: Path) -> list[dict[str, Any]]:
    """Return the lines of a training's metrics.jsonl, see `Log`; none where there is no such file."""
    path, found = folder / METRICS, []
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            line = json.loads(text)
        except ValueError:  # the last line of a process that died while it wrote
            continue
        if isinstance(line, dict) and {"step", "kind"} <= set(line):  # else another program's
            found.append(line)
    return found


class Log:
    """metrics.jsonl for programs, TensorBoard for people, from some step on: what was written of later steps is removed.

    Only rank 0 has one.
    """

    def __init__(self, folder: Path, step: int) -> None:
        """Open the log of a training that goes on after ``step`` steps."""
        from torch.utils.tensorboard.writer import SummaryWriter

        self._path, self._preview = folder / METRICS, folder / PREVIEW
        with storage_errors(self._path):
            kept = [line for line in read_metrics(folder) if line["step"] <= step]
            write_atomic(self._path, b"".join(_encoded(line) for line in kept))
            self._board = SummaryWriter(str(folder / TENSORBOARD), purge_step=step + 1)

    def write(self, step: int, kind: str, values: dict[str, float]) -> None:
        """Write finite numbers of a step, of the kind ``train`` or ``validation``."""
        with storage_errors(self._path), open(self._path, "ab") as file:
            file.write(_encoded({"step": step, "kind": kind, **values}))
        for name, value in values.items():
            self._board.add_scalar(f"{kind}/{name}", value, step)

    def show(self, step: int, pixels: NDArray[np.uint8]) -> None:
        """Keep an image ``(h, w, 3)`` of the validation scenes: in TensorBoard, and the newest as a file."""
        from PIL import Image

        from simulator.plots.drawing import png_bytes

        self._board.add_image("validation", pixels, step, dataformats="HWC")
        write_atomic(self._preview, png_bytes(Image.fromarray(pixels)))

    def close(self) -> None:
        """Finish the files."""
        self._board.close()


def _encoded(line: dict[str, Any]) -> bytes:
    return (json.dumps(line) + "\n").encode()
