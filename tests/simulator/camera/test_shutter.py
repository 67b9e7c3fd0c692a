"""Shutters against a fine grid of time, each other, and a search through all sets of rows."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, RowShutter
from simulator.errors import InputError

_SECONDS = st.floats(1e-5, 0.1)
_BINNING = st.integers(1, 3)
_ROWS = 6  # stored


@st.composite
def _tables(draw, binning):
    opening = draw(st.lists(st.floats(0, 0.1), min_size=_ROWS * binning, max_size=_ROWS * binning))
    length = draw(st.lists(_SECONDS, min_size=_ROWS * binning, max_size=_ROWS * binning))
    return RowShutter(np.stack([opening, np.add(opening, length)], axis=1), binning)


_SHUTTERS = st.one_of(
    st.builds(GlobalShutter, _SECONDS, _BINNING),
    st.builds(RollingShutter, _SECONDS, st.floats(1e-6, 0.01), st.sampled_from(["down", "up"]), _BINNING),
    st.builds(
        DualRollingShutter, _SECONDS, st.floats(1e-6, 0.01), st.sampled_from(["outside_in", "centre_out"]), _BINNING
    ),
    _BINNING.flatmap(_tables),
)


@st.composite
def _edges(draw, shutter):
    """Frames of any lengths that together last at least as long as the shutter."""
    lengths = np.array(draw(st.lists(st.floats(0.01, 1), min_size=1, max_size=20)))
    lasts = shutter.duration_s(_ROWS) * draw(st.floats(1, 3))
    return np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum() * lasts])


_CASES = _SHUTTERS.flatmap(lambda shutter: st.tuples(st.just(shutter), _edges(shutter)))


@settings(max_examples=200, deadline=None)
@given(_CASES)
def test_the_shares_of_all_frames_add_up_to_the_exposure_time(case):
    shutter, edges = case
    weights = shutter.weights(_ROWS, edges)
    assert weights.shape == (len(edges) - 1, _ROWS)
    assert weights.min() >= 0
    assert weights.max() <= 1
    total = np.diff(edges) @ weights
    # Rounding of times, the greatest of which is the clip's end.
    np.testing.assert_allclose(total, shutter.exposures_s(_ROWS), rtol=1e-12, atol=1e-15 * len(edges) * edges[-1])


@settings(max_examples=60, deadline=None)
@given(_CASES)
def test_weights_equal_a_fine_grid_of_time(case):
    shutter, edges = case
    instants = 4001  # per frame, each in the middle of its part
    windows = shutter.windows_s(_ROWS)
    counted = []
    for start, stop in pairwise(edges):
        times = start + (np.arange(instants) + 0.5) / instants * (stop - start)
        inside = (times >= windows[..., :1]) & (times < windows[..., 1:])
        counted.append(inside.mean(axis=(1, 2)))
    # A window cuts a frame at two places, each off by half a part at most.
    np.testing.assert_allclose(shutter.weights(_ROWS, edges), counted, atol=1.01 / instants)


@settings(max_examples=60, deadline=None)
@given(_BINNING.flatmap(_tables), st.floats(1e-3, 10), st.data())
def test_only_differences_of_times_count(shutter, later_s, data):
    edges = data.draw(_edges(shutter))
    moved = RowShutter(shutter.table_s + later_s, shutter.binning)
    # Moved times are rounded to 1 part in 2^53 of up to 10 s; a share divides them by the shortest frame.
    atol = 8 * np.finfo(float).eps * (later_s + edges[-1]) / np.diff(edges).min()
    np.testing.assert_allclose(moved.weights(_ROWS, edges + later_s), shutter.weights(_ROWS, edges), atol=atol)


@pytest.mark.parametrize("rows", [8, 10])
@pytest.mark.parametrize(("order", "top", "bottom"), [("outside_in", "down", "up"), ("centre_out", "up", "down")])
def test_dual_rolling_is_two_rolling_halves(rows, order, top, bottom):
    dual = DualRollingShutter(0.002, 1e-4, order).physical_windows_s(rows)
    halves = [RollingShutter(0.002, 1e-4, way).physical_windows_s(rows // 2) for way in (top, bottom)]
    assert np.array_equal(dual, np.concatenate(halves))


def test_the_middle_row_of_an_odd_number_comes_once():
    opening = DualRollingShutter(0.002, 1e-4).physical_windows_s(5)[:, 0] / 1e-4
    assert opening == pytest.approx([0, 1, 2, 1, 0])
    opening = DualRollingShutter(0.002, 1e-4, "centre_out").physical_windows_s(5)[:, 0] / 1e-4
    assert opening == pytest.approx([2, 1, 0, 1, 2])


def test_rows_open_one_line_time_after_another():
    windows = RollingShutter(0.003, 2e-4).physical_windows_s(4)
    assert windows[:, 0] == pytest.approx([0, 2e-4, 4e-4, 6e-4])
    assert windows[:, 1] == pytest.approx([3e-3, 3.2e-3, 3.4e-3, 3.6e-3])


@pytest.mark.parametrize("kind", [RollingShutter, DualRollingShutter])
def test_a_binned_row_is_the_mean_of_its_physical_rows(kind):
    edges = np.linspace(0, 0.02, 13)
    single = kind(0.003, 2e-4, binning=1).weights(24, edges)
    binned = kind(0.003, 2e-4, binning=4).weights(6, edges)
    np.testing.assert_allclose(binned, single.reshape(12, 6, 4).mean(axis=2), atol=1e-15)
    assert kind(0.003, 2e-4, binning=4).duration_s(6) == kind(0.003, 2e-4).duration_s(24)


@pytest.mark.parametrize(
    ("edges", "words"),
    [
        ([0, 0.005, 0.0099], "lasts from 0 to 0.0099 s, but the shutter is open from 0 to 0.01 s"),
        ([0.001, 0.02], "lasts from 0.001 to 0.02 s"),
        ([0, 0.02, 0.01], "^frame_edges_s: "),
        ([0, 0.02, np.nan], "^frame_edges_s: "),
        ([0.0], "^frame_edges_s: "),
    ],
)
def test_a_clip_that_is_shorter_than_the_capture_is_refused(edges, words):
    with pytest.raises(InputError, match=words):
        RollingShutter(0.008, 1e-3).weights(3, np.array(edges))


def _most_apart(spans):
    """The greatest number of rows of which no two are open at once: every set of rows is tried."""
    for size in range(len(spans), 1, -1):
        for some in combinations(spans, size):
            if all(a[1] <= b[0] or b[1] <= a[0] for a, b in combinations(some, 2)):
                return size
    return 1


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 12), st.integers(1, 6)), min_size=1, max_size=8))
def test_separable_frames_is_the_largest_set_of_rows_that_are_never_open_together(rows):
    table = np.array([(opening, opening + length) for opening, length in rows], float)
    assert RowShutter(table).separable_frames(len(table)) == _most_apart(table)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 12), st.integers(1, 6)), min_size=4, max_size=12).filter(lambda r: not len(r) % 2)
)
def test_physical_rows_that_are_binned_come_no_more_apart(rows):
    table = np.array([(opening, opening + length) for opening, length in rows], float)
    spans = [(min(a[0], b[0]), max(a[1], b[1])) for a, b in zip(table[::2], table[1::2], strict=True)]
    assert RowShutter(table, 2).separable_frames(len(spans)) == _most_apart(spans)


def _rows(windows, binning=1):
    return RowShutter(np.array(windows, float), binning)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: GlobalShutter(0), "^exposure_s: "),
        (lambda: GlobalShutter(np.inf), "^exposure_s: "),
        (lambda: GlobalShutter(0.01, 0), "^binning: "),
        (lambda: RollingShutter(0.01, np.nan), "^line_time_s: "),
        (lambda: RollingShutter(0.01, 1e-5, "left"), "^direction: "),
        (lambda: DualRollingShutter(0.01, 1e-5, "down"), "^order: "),
        (lambda: RowShutter(np.zeros((3, 3))), "^table_s: "),
        (lambda: RowShutter(np.zeros((0, 2))), "^table_s: "),
        (lambda: _rows([(0, 1), (0, np.nan)]), "^table_s: "),
        (lambda: _rows([(0, 1), (np.nan, 1)]), "^table_s: "),
        (lambda: _rows([(0, np.inf)]), "^table_s: "),
        (lambda: _rows([(0, 1), (-1, 1)]), "^table_s: "),
        (lambda: _rows([(0, 1), (1, 1)]), "^table_s: "),
        (lambda: _rows([(0, 1)] * 5, 2).weights(3, np.array([0, 1])), "^table_s: "),
    ],
)
def test_senseless_shutters_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_the_dual_shutter_is_the_published_indicator_averaged_in_pairs() -> None:
    """Antipa et al., Video from Stills, ICCP 2019, section 3: whether a row is open at a time, sampled finely.

    Rows are read from both edges to the middle, and binned in pairs. A sample of 0.1 us may be on the wrong side of a
    window's edge: of a frame of 220 us, at most 4 in 2200.
    """
    line_us, exposure_us, rows = 27.52, 1320.0, 40
    edges_us = np.linspace(0, 19 * line_us + exposure_us, 9)
    shutter = DualRollingShutter(exposure_us * 1e-6, line_us * 1e-6, binning=2)
    times_us = np.arange(0.05, edges_us[-1], 0.1)
    expected = np.zeros((8, rows // 2))
    for row in range(rows):
        begins = line_us * min(row, rows - 1 - row)
        indicator = (times_us >= begins) & (times_us < begins + exposure_us)
        for frame in range(8):
            inside = (times_us >= edges_us[frame]) & (times_us < edges_us[frame + 1])
            expected[frame, row // 2] += indicator[inside].mean() / 2
    np.testing.assert_allclose(shutter.weights(rows // 2, edges_us * 1e-6), expected, atol=4 / 2200)
