"""Scoring: the truth is perfect, bins are a brute-force sum, an estimate that is no number is named."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.capture import CaptureModel
from learning.data import ExampleSet
from learning.estimate import Estimate
from learning.evaluation.outcome import outcome
from learning.evaluation.scoring import Criteria, score
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError

EDGES_CM = (1.0, 2.0, 5.0, 20.0)
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def examples(tiny_dataset: Path) -> ExampleSet:
    return ExampleSet(open_dataset(tiny_dataset, "test"))


def test_the_truth_is_perfect(examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any) -> None:
    method = oracle(tiny_camera, examples)
    found = score(method, examples, Criteria(EDGES_CM, 0.05), device=CPU, batch=3)
    assert method.batches == [3, 3, 2]
    one = outcome("oracle", "learned", [found])
    # Pictures are equal; depth goes through disparity in float32, which costs less than a micrometre.
    assert one.scores["psnr"].mean > 100
    assert one.scores["ssim"].mean == pytest.approx(1, abs=1e-6)
    assert one.scores["flip"].mean == pytest.approx(0, abs=1e-6)
    for name in ("depth_rmse_cm", "disparity_rmse", "lit_depth_rmse_cm"):
        assert one.scores[name].mean == pytest.approx(0, abs=1e-4)
    assert one.pooled_depth_rmse_cm == pytest.approx(0, abs=1e-4)
    assert one.bins_cm == pytest.approx((0, 0, 0), abs=1e-4)


def test_bins_are_sums_over_valid_pixels(examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any) -> None:
    half = oracle(tiny_camera, examples, lambda e: Estimate(e.picture, e.disparity * 0.5))
    found = score(half, examples, Criteria(EDGES_CM), device=CPU, batch=8)
    squares, counts = np.zeros(3), np.zeros(3)
    near, far = tiny_camera.near_m, tiny_camera.far_m
    for position in range(len(examples)):
        example = examples[position]
        true_m = example.depth_m[example.valid].numpy().astype(np.float64)
        disparity = (1 / true_m - 1 / far) / (1 / near - 1 / far)
        wrong_m = 1 / (1 / far + disparity / 2 * (1 / near - 1 / far))
        for bin_, (low, high) in enumerate(pairwise(EDGES_CM)):
            inside = (true_m * 100 >= low * (1 - 1e-6)) & (true_m * 100 < high * (1 + (bin_ == 2) * 1e-6))
            squares[bin_] += np.sum((100 * (wrong_m - true_m)[inside]) ** 2)
            counts[bin_] += inside.sum()
    assert np.sum(found["counts"], axis=0).tolist() == counts.tolist()
    assert counts.sum() == 8 * (16 * 16 - 1)  # one pixel of each scene shows nothing
    np.testing.assert_allclose(np.sum(found["squares_cm2"], axis=0), squares, rtol=1e-4)  # float32 depths
    one = outcome("half", "learned", [found])
    assert one.bins_cm == pytest.approx(np.sqrt(squares / counts).tolist(), rel=1e-4)
    assert one.pooled_depth_rmse_cm == pytest.approx(np.sqrt(squares.sum() / counts.sum()), rel=1e-4)


def test_dark_pixels_are_left_out_on_request(examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any) -> None:
    far = oracle(tiny_camera, examples, lambda e: Estimate(e.picture, e.disparity * 0))
    found = score(far, examples, Criteria(EDGES_CM, 0.3), device=CPU, batch=8)
    plain = score(far, examples, Criteria(EDGES_CM), device=CPU, batch=8)
    assert "lit_depth_rmse_cm" not in plain["scores"][0]
    assert any(one["lit_depth_rmse_cm"] != one["depth_rmse_cm"] for one in found["scores"])


@pytest.mark.parametrize(("field", "value"), [("picture", float("nan")), ("disparity", float("inf"))])
def test_an_estimate_that_is_no_number_is_named(
    examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any, field: str, value: float
) -> None:
    def spoil(estimate: Estimate) -> Estimate:
        values = getattr(estimate, field).clone()
        values[-1, 0, 3, 3] = value
        return estimate._replace(**{field: values})

    with pytest.raises(InputError, match=rf"oracle: its {field} of sample {examples.dataset.ids[3]} is NaN"):
        score(oracle(tiny_camera, examples, spoil), examples, Criteria(EDGES_CM), device=CPU, batch=4)
