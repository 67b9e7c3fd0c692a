"""Histograms: their counts are NumPy's, in the drawing and in the table, and every value is counted."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.plots.report.histograms import histogram, histogram_figure, round_edges

NUMBERS = st.floats(-1e9, 1e9).filter(lambda value: value == 0 or abs(value) > 1e-9)


@given(st.lists(NUMBERS, min_size=1, max_size=50))
def test_every_value_is_counted_once(values: list[float]) -> None:
    data = histogram("x", "m", values, "all")
    assert data.counts.sum() == len(values)
    assert 1 <= len(data.counts) <= 60
    steps = np.diff(data.edges)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-6)


def test_edges_are_round() -> None:
    np.testing.assert_allclose(round_edges(0.0312, 0.0988, 20), np.arange(0.03, 0.1001, 0.005))
    np.testing.assert_allclose(round_edges(0.3, 0.6, 3), [0.3, 0.4, 0.5, 0.6])  # 0.6 is just below 6 steps of 0.1
    assert round_edges(0, 0, 20).size == 2


def test_drawing_and_table_hold_numpy_s_counts() -> None:
    values = np.random.default_rng(5).gamma(2, 3, 800)
    data = histogram("Time & <tide>", "seconds", values, "all 800")
    expected = np.histogram(values, data.edges)[0]
    figure = histogram_figure(data)
    told = [int(count.replace(",", "")) for count in re.findall(r"</th><td>([\d,]+)</td>", figure)]
    assert told == expected.tolist()
    bars = re.findall(r'class="column" x="([\d.]+)" y="([\d.]+)" width="[\d.]+" height="([\d.]+)"', figure)
    heights = np.array([float(height) for *_, height in bars])
    np.testing.assert_allclose(heights / heights.max(), expected[expected > 0] / expected.max(), atol=1e-4)
    assert len({round(float(y) + float(height), 1) for _, y, height in bars}) == 1  # all stand on one line
    drawn = [int(count.replace(",", "")) for count in re.findall(r": ([\d,]+)</title>", figure)]
    assert drawn == expected[expected > 0].tolist()
    assert "Time &amp; &lt;tide&gt;" in figure
    assert "<tide>" not in figure


@pytest.mark.parametrize("count", [1, 7, 40, 999, 12_345])
def test_the_levels_of_the_axis_reach_up_to_the_bars(count: int) -> None:
    figure = histogram_figure(histogram("x", "m", np.zeros(count), "all"))
    lines = [float(y) for y in re.findall(r'class="grid" .*? y1="([\d.]+)"', figure)]
    (top,) = [float(y) for y in re.findall(r'class="column" x="[\d.]+" y="([\d.]+)"', figure)]
    assert 2 <= len(lines) <= 5
    assert min(lines) >= top
