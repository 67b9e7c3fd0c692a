"""Scores of classifiers against definitions worked out by hand, and intervals against their coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from learning.recognition.scores import Predictions, chance, confusion_after_reversal, difference, majority

CLASSES = ("a", "b", "c")


def predictions(probabilities: object, truth: object, name: str = "one", **about: object) -> Predictions:
    return Predictions(name, CLASSES, np.array(truth), np.array(probabilities, float), **about)  # pyright: ignore


TWO_SEEDS = predictions(
    [
        [[0.7, 0.2, 0.1], [0.1, 0.3, 0.6], [0.2, 0.5, 0.3], [0.1, 0.1, 0.8]],
        [[0.4, 0.5, 0.1], [0.2, 0.7, 0.1], [0.1, 0.2, 0.7], [0.6, 0.3, 0.1]],
    ],
    [0, 1, 2, 2],
)


def test_accuracies_are_means_over_captures_and_seeds() -> None:
    assert TWO_SEEDS.guesses.tolist() == [[0, 2, 1, 2], [1, 1, 2, 0]]
    assert TWO_SEEDS.right().tolist() == [0.5, 0.5, 0.5, 0.5]
    assert TWO_SEEDS.right(2).tolist() == [1, 1, 1, 0.5]
    assert TWO_SEEDS.accuracy() == 0.5
    assert TWO_SEEDS.accuracy(2) == pytest.approx(7 / 8)
    assert TWO_SEEDS.accuracy(5) == 1
    assert TWO_SEEDS.over_seeds() == 0
    # Student's t of one degree of freedom, 12.706, times the standard error of 1 and 0.75, which is half their difference.
    assert TWO_SEEDS.over_seeds(2) == pytest.approx(12.7062 * 0.125, rel=1e-4)
    assert predictions(TWO_SEEDS.probabilities[:1], TWO_SEEDS.truth).over_seeds() is None


def test_equal_probabilities_are_no_right_guess() -> None:
    alike = predictions(np.full((1, 6, 3), 1 / 3), [0, 1, 2, 0, 1, 2])
    assert alike.accuracy() == alike.accuracy(2) == 0
    assert alike.accuracy(5) == 1


def test_confusion_has_what_is_done_in_rows() -> None:
    expected = np.array([[1, 1, 0], [0, 1, 1], [1, 1, 2]]) / [[2], [2], [4]]
    np.testing.assert_allclose(TWO_SEEDS.confusion(), expected)
    without_b = predictions(TWO_SEEDS.probabilities[:, [0, 2]], [0, 2]).confusion()
    assert np.isnan(without_b[1]).all()
    np.testing.assert_allclose(without_b[[0, 2]], [[0.5, 0.5, 0], [0, 0.5, 0.5]])


def test_log_loss_is_the_cross_entropy() -> None:
    own = [0.7, 0.3, 0.3, 0.8, 0.4, 0.7, 0.7, 0.1]
    assert TWO_SEEDS.log_loss() == pytest.approx(-np.log(own).mean())
    assert np.isfinite(predictions([[[0.0, 1.0, 0.0]]], [0]).log_loss())


def drawn(sharpen: float, count: int = 40_000) -> Predictions:
    """Truth that follows the probabilities exactly, which are then made sharper or flatter than they should be."""
    rng = np.random.default_rng(0)
    honest = rng.dirichlet([0.7, 0.7, 0.7], count)
    truth = (rng.random((count, 1)) > honest.cumsum(axis=1)).sum(axis=1)
    told = honest**sharpen
    return predictions([told / told.sum(axis=1, keepdims=True)], truth)


def test_calibration_is_measured() -> None:
    """Probabilities that the truth follows are calibrated; squared, they are too sure, and their roots too little."""
    honest, sure, unsure = (drawn(power) for power in (1, 2, 0.5))
    # Of 40 000 answers in about 7 bins, the mean of |error| is some 0.8 sqrt(p (1 - p) / n) = 0.5 %.
    assert honest.calibration_error() < 0.01
    assert honest.accuracy() == sure.accuracy() == unsure.accuracy()
    for one, sign in ((sure, 1), (unsure, -1)):
        confidence, right, counts = one.reliability()
        assert counts.sum() == 40_000
        gap = float((confidence - right)[counts > 0] @ counts[counts > 0]) / 40_000
        assert sign * gap == pytest.approx(one.calibration_error(), rel=0.15)
        expected = one.probabilities.max(axis=-1).mean() - one.accuracy()
        assert gap == pytest.approx(expected, abs=1e-9)
        assert sign * gap > 0.04


def test_calibration_errors_of_seeds_do_not_cancel() -> None:
    """Both are sure by 75 %; of one all answers are right, of the other half of them: each is wrong by 25 points."""
    sure = np.array([0.75, 0.2, 0.05])
    one = predictions([[sure] * 4, [sure] * 2 + [sure[::-1]] * 2], [0] * 4)
    assert one.calibration_error() == pytest.approx(0.25)
    confidence, right, counts = one.reliability()
    assert (confidence[7], right[7], counts[7]) == pytest.approx((0.75, 0.75, 8))


def test_all_right_is_not_certain() -> None:
    """Of 20 captures, all right: at least 83.9 % of all are, by Wilson's interval n / (n + z^2)."""
    one = predictions([np.tile([0.8, 0.1, 0.1], (20, 1))], np.zeros(20, int))
    assert one.intervals[1] == pytest.approx((20 / (20 + 1.95996**2), 1.0), rel=1e-5)


def test_intervals_cover_the_accuracy() -> None:
    """Of 600 captures at 60 %, the bootstrap's interval is that of the binomial distribution, within its own noise."""
    rng = np.random.default_rng(1)
    right = rng.random(600) < 0.6
    chances = np.where(right[:, None], [0.6, 0.3, 0.1], [0.3, 0.6, 0.1])
    one = predictions([chances], np.zeros(600, int))
    ends = one.intervals[1]
    assert ends is not None
    half = 1.96 * np.sqrt(right.mean() * (1 - right.mean()) / 600)
    assert ends[0] == pytest.approx(right.mean() - half, abs=0.004)
    assert ends[1] == pytest.approx(right.mean() + half, abs=0.004)


def test_a_lead_is_paired_where_the_captures_are_the_same() -> None:
    """Of two that are right on nearly the same captures the difference is known far better than either accuracy."""
    rng = np.random.default_rng(2)
    truth = rng.integers(0, 3, 600)
    right = rng.random(600) < 0.6
    wrong_more = right & (rng.random(600) > 0.05)
    first, second = (
        predictions([np.eye(3)[np.where(which, truth, (truth + 1) % 3)]], truth, name)
        for name, which in (("first", right), ("second", wrong_more))
    )
    paired = difference(first, second)
    assert paired.paired
    assert paired.mean == pytest.approx(right.mean() - wrong_more.mean())
    lost = right & ~wrong_more
    test = stats.binomtest(int(lost.sum()), 600).proportion_ci(0.95, "wilson")
    assert paired.interval is not None
    assert paired.interval[0] == pytest.approx(test.low, abs=0.006)
    assert paired.interval[1] == pytest.approx(test.high, abs=0.006)
    other = predictions(second.probabilities, truth, "second", clips=("another", "data set"))
    apart = difference(first, other)
    assert not apart.paired
    assert apart.mean == pytest.approx(paired.mean)
    assert apart.interval is not None
    spread = np.sqrt(sum(each.mean() * (1 - each.mean()) / 600 for each in (right, wrong_more)))
    assert (apart.interval[1] - apart.interval[0]) / 2 == pytest.approx(1.96 * spread, rel=0.05)


def test_a_lead_of_all_against_none_is_not_certain() -> None:
    """Of 20 captures each: Newcombe (1998), method 10, from Wilson's 83.9 % .. 100 % and 0 % .. 16.1 %; and at most 100 %."""
    truth = np.zeros(20, int)
    right, wrong = (predictions([np.tile(each, (20, 1))], truth) for each in ([0.8, 0.1, 0.1], [0.1, 0.8, 0.1]))
    low = 1 - 20 / (20 + 1.95996**2)
    for clips in ((), ("another", "data set")):
        other = predictions(wrong.probabilities, truth, "second", clips=clips)
        found = difference(right, other)
        assert found.paired == (clips == ())
        assert found.interval == pytest.approx((1 - np.hypot(low, low), 1), rel=1e-5)
        assert difference(right, predictions(right.probabilities, truth, clips=clips)).interval == pytest.approx(
            (-low, low), rel=1e-5
        )


def test_what_looks_at_nothing() -> None:
    assert chance(CLASSES) == pytest.approx(1 / 3)
    assert chance(CLASSES, 5) == 1
    truth = np.array([0, 1, 1, 2, 1, 0])
    assert majority(truth) == 0.5
    assert majority(truth, 2) == pytest.approx(5 / 6)


def test_what_right_answers_become_backwards() -> None:
    forwards = predictions([np.eye(3)[[0, 0, 1, 1, 2]]], [0, 0, 1, 2, 2])
    backwards = predictions([np.eye(3)[[1, 0, 1, 0, 2]]], [0, 0, 1, 2, 2])
    np.testing.assert_allclose(confusion_after_reversal(forwards, backwards), [[0.5, 0.5, 0], [0, 1, 0], [0, 0, 1]])
    never = predictions([np.eye(3)[[1, 1, 1, 1, 1]]], [0, 0, 1, 2, 2])
    assert np.isnan(confusion_after_reversal(never, backwards)[0]).all()
