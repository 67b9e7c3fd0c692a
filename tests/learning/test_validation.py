"""Errors that are known beforehand come out, however the scenes are shared out."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import nn

from learning.camera import CaptureModel
from learning.config import LossConfig
from learning.data import Example
from learning.distributed import Precision, Processes
from learning.losses import ReconstructionLoss
from learning.method import Estimate, srgb_to_linear
from learning.validation import METRICS, PREVIEW, TENSORBOARD, Log, draw, true_estimate, validate

CPU = torch.device("cpu")
HERE = {"precision": Precision("float32", CPU), "group": Processes(CPU)}


class Known(nn.Module):
    """Gives what its measurement holds: codes and disparity; clipped nowhere."""

    def forward(self, measurement: torch.Tensor) -> Estimate:
        assert not self.training
        return Estimate(measurement[:, :3], measurement[:, 3:])


def scenes(capture: CaptureModel, count: int) -> tuple[Example, torch.Tensor]:
    """Return scenes of mid-grey at half of the disparities, and what would be measured of them without an error."""
    codes = torch.full((count, 3, 16, 16), 0.5)
    disparity = torch.full((count, 1, 16, 16), 0.5)
    radiance = srgb_to_linear(codes, capture.white)
    truth = Example(torch.cat([codes, disparity], 1), radiance, capture.depth_m(disparity), disparity > 0)
    return truth, truth.measurement.clone()


def test_known_errors(tiny_capture: CaptureModel) -> None:
    truth, estimate = scenes(tiny_capture, 3)
    estimate[0, :3] += 0.1  # 20 dB
    estimate[1, :3] -= 0.01  # 40 dB
    estimate[2, :3] += 7  # clipped to 1: 6.02 dB
    estimate[:2, 3] = 1.5  # clipped to 1, the near depth
    example = truth._replace(measurement=estimate)
    network = Known().train()
    loss = ReconstructionLoss(LossConfig(), tiny_capture)
    middle_cm = 100 * float(tiny_capture.depth_m(np.float64(0.5)))
    results = []
    for parts in ([slice(0, 3)], [slice(0, 2), slice(2, 3)]):
        batches = [Example(*(values[part] for values in example)) for part in parts]
        results.append(validate(network, batches, loss, tiny_capture, **HERE))
        assert network.training
    for result in results:
        # Codes pass through float32 and the sRGB curve and back: 1e-6 of 0.01 in the 40 dB scene is 1e-3 dB.
        assert result["psnr_db"] == pytest.approx((20 + 40 + 20 * np.log10(2)) / 3, abs=1e-3)
        assert result["depth_rmse_cm"] == pytest.approx(2 / 3 * (middle_cm - 100 * tiny_capture.near_m), rel=1e-5)
        assert result["intensity"] == pytest.approx((0.1 + 0.01 + 7) / 3, rel=1e-5)
        assert result["depth"] == pytest.approx(2 / 3, rel=1e-5)  # the loss sees what is not clipped
        depth_db = 20 * np.log10(2 / 3 * (middle_cm - 100 * tiny_capture.near_m))
        assert result["score"] == pytest.approx((20 + 40 + 20 * np.log10(2)) / 3 - depth_db, abs=1e-3)


def test_what_has_no_error_has_a_finite_score(tiny_capture: CaptureModel) -> None:
    truth, _ = scenes(tiny_capture, 2)
    truth = truth._replace(depth_m=tiny_capture.depth_m(truth.measurement[:, 3:]))
    result = validate(Known(), [truth], ReconstructionLoss(LossConfig(), tiny_capture), tiny_capture, **HERE)
    assert result["depth_rmse_cm"] < 1e-4
    assert np.isfinite(result["score"])
    assert result["score"] > result["psnr_db"] + 80


def test_depth_is_judged_as_in_the_evaluation(tiny_capture: CaptureModel) -> None:
    """Where there is one, against the true depth: one beyond the range is not moved to its end."""
    truth, estimate = scenes(tiny_capture, 3)
    estimate[:, 3, :, :8] = 0.9  # wrong where nothing was seen
    truth.valid[..., :8] = False
    truth.valid[2] = False  # a scene without any depth counts in the image only
    near_m = tiny_capture.near_m
    truth.depth_m[1] = near_m / 2
    estimate[1, 3] = 1
    batches = [Example(*(values[part] for values in truth._replace(measurement=estimate))) for part in ([0, 1], [2])]
    result = validate(Known(), batches, ReconstructionLoss(LossConfig(), tiny_capture), tiny_capture, **HERE)
    assert result["depth_rmse_cm"] == pytest.approx((0 + 100 * near_m / 2) / 2, rel=1e-5)
    assert result["psnr_db"] > 60


def test_what_was_not_seen_is_far(tiny_capture: CaptureModel) -> None:
    truth, _ = scenes(tiny_capture, 1)
    truth.valid[..., :4] = False
    disparity = true_estimate(truth, tiny_capture).disparity
    assert float(disparity[..., :4].max()) == 0
    assert torch.allclose(disparity[..., 4:], torch.tensor(0.5), atol=1e-6)


def test_image(tiny_capture: CaptureModel) -> None:
    """Truth and estimate stand side by side, and equal ones look equal."""
    truth, estimate = scenes(tiny_capture, 2)
    estimate[1, 0] = 1.0
    pixels = draw(Known(), truth._replace(measurement=estimate), tiny_capture, **{"precision": HERE["precision"]})
    assert pixels.shape == (2 * 16 + 2, 4 * 16 + 3 * 2, 3)
    codes, guesses, depths, guessed = (pixels[:, 18 * n : 18 * n + 16] for n in range(4))
    assert np.array_equal(codes[:16], guesses[:16])
    assert np.abs(codes[:16].astype(int) - 128).max() <= 1
    assert tuple(guesses[20, 5]) == (255, 128, 128)
    assert np.array_equal(depths, guessed)
    assert tuple(depths[5, 5]) == (33, 145, 140)  # the middle of `simulator.plots.drawing`


def test_what_is_made_again_replaces_what_was_there(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    log = Log(tmp_path, 0)
    for step in (1, 2, 3):
        log.write(step, "train", {"total": float(step)})
    log.close()
    with open(tmp_path / METRICS, "a") as file:
        file.write('{"step": 4, "ki')  # a process that died
    time.sleep(1)  # TensorBoard names files by the second and a count within a process, and reads 10 before 9
    log = Log(tmp_path, 2)
    log.write(3, "train", {"total": 30.0})
    log.write(3, "validation", {"total": 5.0})
    log.close()
    found = [json.loads(line) for line in (tmp_path / METRICS).read_text().splitlines()]
    kept = [(1, "train", 1.0), (2, "train", 2.0), (3, "train", 30.0), (3, "validation", 5.0)]
    assert [(line["step"], line["kind"], line["total"]) for line in found] == kept
    board = EventAccumulator(str(tmp_path / TENSORBOARD))
    board.Reload()
    assert [(event.step, event.value) for event in board.Scalars("train/total")] == [(1, 1.0), (2, 2.0), (3, 30.0)]


def test_the_newest_image_is_a_file(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (6, 9, 3), np.uint8)
    log = Log(tmp_path, 0)
    log.show(1, pixels[::-1].copy())
    log.show(2, pixels)
    log.close()
    assert np.array_equal(np.asarray(Image.open(tmp_path / PREVIEW)), pixels)
