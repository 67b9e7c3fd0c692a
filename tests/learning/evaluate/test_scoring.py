"""Scoring: the truth is perfect, bins are a brute-force sum, an estimate that is not a number is named."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel, capture_model
from learning.data import Example, ExampleSet
from learning.evaluate import scoring
from learning.evaluate.motion import SliverMotion
from learning.evaluate.outcome import outcome
from learning.evaluate.scoring import Criteria, baselines, score, take_times
from learning.method import Clock, Estimate, describe_device
from simulator.colour import linear_to_srgb
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
    # Images are equal; depth goes through disparity in float32, which costs less than a micrometre.
    assert one.scores["psnr"].mean > 100
    assert one.scores["ssim"].mean == pytest.approx(1, abs=1e-6)
    assert one.scores["flip"].mean == pytest.approx(0, abs=1e-6)
    for name in ("depth_rmse_cm", "disparity_rmse", "lit_depth_rmse_cm"):
        assert one.scores[name].mean == pytest.approx(0, abs=1e-4)
    assert one.pooled_depth_rmse_cm == pytest.approx(0, abs=1e-4)
    assert one.bins_cm == pytest.approx((0, 0, 0), abs=1e-4)


@pytest.mark.parametrize("batch", [1, 2])
def test_flicker_is_measured_along_each_clip_s_own_motion(
    clip_dataset: Path, batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the estimate and of the truth; the second clip moves twice as fast."""
    dataset = open_dataset(clip_dataset, "test")
    examples, capture = ExampleSet(dataset), capture_model(dataset, white=1.5)
    drawn = torch.rand(4, 3, 16, 16, generator=torch.Generator().manual_seed(2))

    def motion(stored: Any, slivers: int) -> SliverMotion:
        places = np.stack(np.meshgrid(np.arange(16.0), np.arange(16.0)), axis=-1)
        places[..., 0] += 1 + dataset.ids.index(stored.folder.name)
        assert slivers == 4
        return SliverMotion(np.stack([places] * 3), np.stack([places[..., 0] <= 15] * 3))

    class Drawn:
        name = "drawn"

        def __init__(self) -> None:
            self.capture = capture

        def reconstruct(self, measurement: torch.Tensor, clock: Clock | None = None) -> Estimate:
            image = drawn.expand(len(measurement), -1, -1, -1, -1)
            return Estimate(image, torch.zeros_like(image[:, :, :1]))

    monkeypatch.setattr(scoring, "sliver_motion", motion)
    found = score(Drawn(), examples, Criteria(EDGES_CM), device=CPU, batch=batch)["scores"]
    assert len(found) == len(dataset) > 1
    for at, scene in enumerate(found):
        truth = linear_to_srgb(examples[at].radiance.numpy() / 1.5)
        for name, film in (("warping_error", drawn.numpy()), ("true_warping_error", truth)):
            change = film[1:, ..., 1 + at :] - film[:-1, ..., : 15 - at]  # a point is 1 + at columns farther right
            assert scene[name] == pytest.approx(np.sqrt(np.mean(change.astype(np.float64) ** 2)), rel=1e-5)


def test_bins_are_sums_over_valid_pixels(examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any) -> None:
    half = oracle(tiny_camera, examples, lambda e: Estimate(e.image, e.disparity * 0.5))
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
    # What no bin holds counts all the same.
    part = score(half, examples, Criteria(EDGES_CM[:2]), device=CPU, batch=8)
    near = outcome("half", "learned", [part])
    assert near.bins_cm == one.bins_cm[:1]
    assert near.pooled_depth_rmse_cm == one.pooled_depth_rmse_cm


class Changed:
    """Examples of which each is changed before anybody sees it."""

    def __init__(self, examples: ExampleSet, change: Callable[[Example], Example]) -> None:
        self.dataset, self._examples, self._change = examples.dataset, examples, change
        self.timing = examples.timing

    def __len__(self) -> int:
        return len(self._examples)

    def __getitem__(self, position: int) -> Example:
        return self._change(self._examples[position])


def test_bins_hold_their_edges(examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any) -> None:
    def on_edges(example: Example) -> Example:
        depth_m = torch.full_like(example.depth_m, 0.03)
        depth_m[0, 1, :6] = torch.tensor([0.01, 0.02, 0.02, 0.05, 0.2, 0.2])
        return example._replace(depth_m=depth_m, valid=torch.ones_like(example.valid))

    edges: Any = Changed(examples, on_edges)
    found = score(oracle(tiny_camera, edges), edges, Criteria(EDGES_CM), device=CPU, batch=8)
    assert found["counts"][0] == [1, 2 + 16 * 16 - 6, 1 + 2]


def test_dark_and_invalid_pixels_do_not_count(examples: ExampleSet, tiny_camera: CaptureModel, oracle: Any) -> None:
    """What nothing was seen of is bright here, and far like the estimate: counted, it would lower the error."""

    def bright(example: Example) -> Example:
        return example._replace(radiance=torch.where(example.valid, example.radiance, 2 * tiny_camera.white))

    lit: Any = Changed(examples, bright)
    far = oracle(tiny_camera, lit, lambda e: Estimate(e.image, e.disparity * 0))
    found = score(far, lit, Criteria(EDGES_CM, 0.3), device=CPU, batch=8)
    assert "lit_depth_rmse_cm" not in score(far, lit, Criteria(EDGES_CM), device=CPU, batch=8)["scores"][0]
    for position, one in enumerate(found["scores"]):
        example = lit[position]
        luminance = np.tensordot((0.2126, 0.7152, 0.0722), example.radiance.numpy().astype(np.float64), axes=1)
        counted = example.valid[0].numpy() & (luminance >= 0.3 * tiny_camera.white)
        error_cm = 100 * (example.depth_m[0].numpy().astype(np.float64) - tiny_camera.far_m)[counted]
        assert one["lit_depth_rmse_cm"] == pytest.approx(np.sqrt(np.mean(error_cm**2)), rel=1e-5)
    assert any(one["lit_depth_rmse_cm"] != pytest.approx(one["depth_rmse_cm"], rel=1e-3) for one in found["scores"])


@pytest.mark.parametrize(("field", "value"), [("image", float("nan")), ("disparity", float("inf"))])
def test_a_non_finite_estimate_is_named(
    examples: ExampleSet, tiny_camera: Any, oracle: Any, field: str, value: float
) -> None:
    def spoil(estimate: Estimate) -> Estimate:
        values = getattr(estimate, field).clone()
        values[-1, 0, 3, 3] = value
        return estimate._replace(**{field: values})

    with pytest.raises(InputError, match=r"^oracle: "):
        score(oracle(tiny_camera, examples, spoil), examples, Criteria(EDGES_CM), device=CPU, batch=4)


def test_naive_baselines_are_what_hand_computation_gives(tiny_dataset: Path, tiny_camera: CaptureModel) -> None:
    test = open_dataset(tiny_dataset, "test")
    examples = ExampleSet(test)
    criteria = Criteria((1.0, 20.0))
    naive = baselines(examples, tiny_camera, 3)
    found = [score(one, examples, criteria, device=CPU, batch=5) for one in naive]
    rows = [outcome(one.name, one.kind, [each], only=one.scores) for one, each in zip(naive, found, strict=True)]
    frames = [test.stored(position).frame(0) for position in range(len(test))]
    depth_cm = np.stack([100 * frame.depth_m.astype(np.float64) for frame in frames])
    valid = np.stack([frame.valid for frame in frames])
    codes = np.stack([linear_to_srgb(np.clip(frame.rgb / tiny_camera.white, 0, 1)) for frame in frames]).astype(float)
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
    for row, image in ((mean, codes.mean(0)), (black, 0 * codes[0])):
        errors = np.mean((codes - image) ** 2, axis=(1, 2, 3))
        assert row.scores["psnr"].mean == pytest.approx(np.mean(-10 * np.log10(errors)), rel=1e-5)
        assert "depth_rmse_cm" not in row.scores
        assert row.pooled_depth_rmse_cm is None


class Sleeper:
    """A method that takes known seconds, and says when it was called, on which scene."""

    def __init__(self, name: str, seconds: Callable[[int], float], log: list[tuple[str, float]]) -> None:
        self.name, self.capture, self._seconds, self._log, self._turn = name, None, seconds, log, 0

    def reconstruct(self, measurement: torch.Tensor, clock: Clock | None = None) -> None:
        assert clock is not None
        assert measurement.shape == (1, 1, 2, 2)
        self._log.append((self.name, measurement[0, 0, 0, 0].item()))
        for share, stage in ((1, "inversion"), (2, "network")):
            with clock.stage(stage):
                time.sleep(share * self._seconds(self._turn))
        self._turn += 1


def test_the_median_by_stage_of_turns_after_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    log: list[tuple[str, float]] = []
    done: list[tuple[int, int]] = []
    fast = Sleeper("fast", lambda turn: [100.0, 1.0, 9.0, 2.0][turn], log)
    slow = Sleeper("slow", lambda turn: 10.0, log)
    scenes = torch.arange(2.0)[:, None, None, None].expand(2, 1, 2, 2)
    times = take_times([fast, slow], scenes, 3, lambda *counts: done.append(counts))  # pyright: ignore[reportArgumentType]
    assert log == [(name, scene) for scene in (0, 1, 0, 1) for name in ("fast", "slow")]
    assert times[0].stages == {"inversion": 2.0, "network": 4.0}
    assert (times[0].total, times[0].fastest) == (6.0, 3.0)
    assert times[1].total == pytest.approx(30.0)
    assert done == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_the_device_names_its_threads() -> None:
    assert f"{torch.get_num_threads()} of " in describe_device(torch.device("cpu"))
