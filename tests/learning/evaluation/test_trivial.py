"""The trivial rows against the same numbers done by hand from the samples' files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from learning.capture import CaptureModel
from learning.data import ExampleSet
from learning.evaluation.outcome import outcome
from learning.evaluation.scoring import Criteria, score
from learning.evaluation.trivial import trivial_methods
from simulator.colour import linear_to_srgb
from simulator.dataset.reader import open_dataset


def test_trivial_rows_are_what_hand_computation_gives(tiny_dataset: Path, tiny_camera: CaptureModel) -> None:
    test = open_dataset(tiny_dataset, "test")
    examples = ExampleSet(test)
    criteria = Criteria((1.0, 20.0))
    rows = [
        outcome(
            one.name, "trivial", [score(one, examples, criteria, device=torch.device("cpu"), batch=5)], only=one.scores
        )
        for one in trivial_methods(examples, tiny_camera, 3)
    ]
    frames = [test.stored(position).frame(0) for position in range(len(test))]
    depth_cm = np.stack([100 * frame.depth_m.astype(np.float64) for frame in frames])
    valid = np.stack([frame.valid for frame in frames])
    codes = np.stack([linear_to_srgb(np.clip(frame.rgb / tiny_camera.white, 0, 1)) for frame in frames]).astype(
        np.float64
    )
    mean_cm = depth_cm[valid].mean()
    constant, disparity, mean, black = rows
    assert constant.method == f"constant depth ({mean_cm:.2f} cm)"
    by_scene = [np.sqrt(np.mean((d[v] - mean_cm) ** 2)) for d, v in zip(depth_cm, valid, strict=True)]
    # Depths are float32, and pass through disparity.
    assert constant.scores["depth_rmse_cm"].mean == pytest.approx(np.mean(by_scene), rel=1e-5)
    assert constant.scores["depth_rmse_cm"].over_scenes == pytest.approx(np.std(by_scene, ddof=1), rel=1e-4)
    assert constant.pooled_depth_rmse_cm == pytest.approx(depth_cm[valid].std(), rel=1e-5)
    assert constant.bins_cm == pytest.approx([depth_cm[valid].std()], rel=1e-5)
    assert "psnr" not in constant.scores
    # Of disparity another constant is best: the mean of 1 / z, which beats the mean depth there.
    per_m = 100 / depth_cm
    mean_per_m = per_m[valid].mean()
    assert disparity.method == f"constant disparity ({100 / mean_per_m:.2f} cm)"
    by_scene = [np.sqrt(np.mean((d[v] - mean_per_m) ** 2)) for d, v in zip(per_m, valid, strict=True)]
    assert disparity.scores["disparity_rmse_per_m"].mean == pytest.approx(np.mean(by_scene), rel=1e-5)
    of_mean_depth = [np.sqrt(np.mean((d[v] - 100 / mean_cm) ** 2)) for d, v in zip(per_m, valid, strict=True)]
    assert disparity.scores["disparity_rmse_per_m"].mean < np.mean(of_mean_depth)
    assert set(disparity.scores) == {"disparity_rmse", "disparity_rmse_per_m"}
    assert set(constant.scores) == {"depth_rmse_cm"}
    for row, picture in ((mean, codes.mean(0)), (black, 0 * codes[0])):
        errors = np.mean((codes - picture) ** 2, axis=(1, 2, 3))
        assert row.scores["psnr"].mean == pytest.approx(np.mean(-10 * np.log10(errors)), rel=1e-5)
        assert "depth_rmse_cm" not in row.scores
        assert row.pooled_depth_rmse_cm is None
