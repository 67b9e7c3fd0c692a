"""Paired differences: the interval against Student's, and in whose favour it is."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from learning.evaluate.outcome import Outcome, outcome
from learning.evaluate.paired import compare, mean_interval


def _outcome(name: str, *seeds: list[float], score: str = "psnr") -> Outcome:
    def found(seed: list[float]) -> dict[str, list[Any]]:
        return {
            "scores": [{score: value} for value in seed],
            "over_time": [],
            "pixels": [1],
            "squares_cm2": [[1.0]],
            "counts": [[1]],
        }

    return outcome(name, "learned", [found(seed) for seed in seeds])


def test_the_interval_of_normal_values_is_students() -> None:
    values = np.random.default_rng(3).normal(0.4, 1.5, 200)
    interval = mean_interval(values, seed=0)
    assert interval is not None
    low, high = stats.t.interval(0.95, 199, loc=values.mean(), scale=stats.sem(values))
    # The percentiles of the bootstrap are 0.9 % narrower for 200 values; of 10 000 means they are right to 2 % of the half
    # width, one standard deviation.
    assert interval == pytest.approx((low, high), abs=0.06 * (high - low) / 2)
    assert mean_interval(values, seed=0) == interval != mean_interval(values, seed=1)


def test_the_interval_holds_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(0)
    intervals = [mean_interval(rng.exponential(size=60), seed=0) for _ in range(200)]
    held = sum(low <= 1 <= high for low, high in filter(None, intervals))
    # 95 % of 200 are 190, with a standard deviation of 3; skewed values lose one or two per cent (Efron, section 13.7).
    assert 179 <= held <= 197


def test_scenes_are_paired() -> None:
    # Scenes differ by tens of decibels, the methods by 0.5 on each.
    scenes = np.random.default_rng(0).uniform(10, 40, 30)
    better, worse = _outcome("A", (scenes + 0.5).tolist()), _outcome("B", scenes.tolist())
    (found,) = compare("A", [better, worse], 0)
    assert (found.reference, found.other, found.scenes) == ("A", "B", 30)
    assert found.mean == pytest.approx(0.5)
    assert found.interval == pytest.approx((0.5, 0.5))
    assert found.favours == "reference"
    (found,) = compare("B", [better, worse], 0)
    assert (found.mean, found.favours) == (pytest.approx(-0.5), "other")


@pytest.mark.parametrize(("score", "favours"), [("psnr", "reference"), ("flip", "other"), ("depth_rmse_cm", "other")])
def test_less_is_better_where_it_is_an_error(score: str, favours: str) -> None:
    pair = [_outcome("A", [3.0, 4.0, 3.5], score=score), _outcome("B", [1.0, 2.1, 1.4], score=score)]
    assert compare("A", pair, 0)[0].favours == favours


def test_an_interval_about_zero_favours_nobody() -> None:
    values = np.random.default_rng(1).normal(0, 1, 50)
    (found,) = compare("A", [_outcome("A", (values - values.mean()).tolist()), _outcome("B", [0.0] * 50)], 0)
    assert found.interval is not None
    assert found.interval[0] < 0 < found.interval[1]
    assert found.favours is None
    (single,) = compare("A", [_outcome("A", [2.0]), _outcome("B", [1.0])], 0)
    assert (single.mean, single.interval, single.favours) == (1.0, None, None)


def test_seeds_are_taken_together_and_singly() -> None:
    net = _outcome("Net", [10.0, 20.0], [14.0, 24.0])
    rival = _outcome("Rival", [9.0, 19.0], [7.0, 17.0])
    found = {(one.reference, one.other): one.mean for one in compare("Net", [net, rival], 0)}
    assert found == {
        ("Net", "Rival"): 4.0,  # 12, 22 against 8, 18
        ("Net, seed 1", "Rival"): 2.0,
        ("Net, seed 2", "Rival"): 6.0,
        ("Net", "Rival, seed 1"): 3.0,
        ("Net", "Rival, seed 2"): 5.0,
    }


def test_scenes_without_a_score_count_for_neither() -> None:
    pair = [_outcome("A", [1.0, np.nan, 3.0, 4.0]), _outcome("B", [0.0, 0.0, np.nan, 1.0])]
    (found,) = compare("A", pair, 0)
    assert (found.mean, found.scenes) == (2.0, 2)
    assert not compare("A", [_outcome("A", [np.inf]), _outcome("B", [np.inf])], 0)  # two perfect images
