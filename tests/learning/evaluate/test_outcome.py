"""Means and spreads against NumPy's and against numbers done by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from learning.evaluate.outcome import outcome, pooled_rms, summarise


def test_spreads_over_scenes_and_seeds_are_told_apart() -> None:
    # Scenes differ by 2, seeds by 10: neither may leak into the other.
    summary = summarise([[0.0, 2.0, 4.0], [10.0, 12.0, 14.0]])
    assert summary.mean == 7.0
    assert summary.over_scenes == pytest.approx(2.0, rel=1e-12)  # of 5, 7, 9
    assert summary.over_seeds == pytest.approx(math.sqrt(50), rel=1e-12)  # of 2, 12
    assert summary.seeds == (2.0, 12.0)


def test_random_scores_have_numpys_spreads() -> None:
    table = np.random.default_rng(0).normal(size=(3, 20))
    summary = summarise(table)
    assert summary.over_scenes == pytest.approx(np.std(table.mean(0), ddof=1), rel=1e-12)
    assert summary.over_seeds == pytest.approx(np.std(table.mean(1), ddof=1), rel=1e-12)


def test_one_seed_and_one_scene_have_no_spread() -> None:
    assert summarise([[1.0, 2.0]]).over_seeds is None
    assert summarise([[1.0], [2.0]]).over_scenes is None


def test_a_perfect_scene_leaves_no_spread_but_a_mean() -> None:
    summary = summarise([[math.inf, 20.0]])
    assert (summary.mean, summary.over_scenes) == (math.inf, None)


def test_scenes_without_a_score_are_left_out_for_every_seed() -> None:
    summary = summarise([[1.0, math.nan, 3.0], [2.0, 100.0, 4.0]])
    assert (summary.mean, summary.seeds, summary.left_out) == (2.5, (2.0, 3.0), 1)


def test_pooling_weighs_pixels_not_scenes() -> None:
    squares = [[[8.0, 1.0], [1.0, 0.0]]]
    counts = [[[2, 1], [1, 0]]]
    assert pooled_rms(squares, counts) == (math.sqrt(3), 1.0)


def test_each_seed_has_an_outcome_of_its_own() -> None:
    seeds = [
        {
            "scores": [{"depth_rmse_cm": cm} for cm in depths],
            "over_time": [{"depth_rmse_cm": [0.0, cm], "psnr": [1.0, 2.0]} for cm in depths],
            "pixels": [1, 3],
            "squares_cm2": [[cm * cm] for cm in depths],
            "counts": [[1]] * 2,
        }
        for depths in ([1.0, 3.0], [2.0, 4.0])
    ]
    both = outcome("Net", "learned", seeds, noise_db=20.0)
    assert [one.label for one in (both, *both.singly)] == ["Net", "Net, seed 1", "Net, seed 2"]
    assert [one.scores["depth_rmse_cm"].mean for one in (both, *both.singly)] == [2.5, 2.0, 3.0]
    assert [one.pooled_depth_rmse_cm for one in both.singly] == pytest.approx([math.sqrt(7), math.sqrt(13)])
    assert [one.bins_cm for one in both.singly] == [pytest.approx([math.sqrt(5)]), pytest.approx([math.sqrt(10)])]
    assert {one.noise_db for one in both.singly} == {20.0}
    assert [one["seed"] for one in both.plain()["singly"]] == [1, 2]
    assert outcome("Net", "learned", seeds[:1]).singly == ()
    assert both.over_time == {"depth_rmse_cm": (0.0, 2.5)}, "only what the scenes have, too"
    assert both.singly[1].over_time == {"depth_rmse_cm": (0.0, 3.0)}
