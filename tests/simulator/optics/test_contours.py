"""Lines drawn along edges: of the width asked for, the same by either way of drawing, in a time that width does not grow."""

import time

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from simulator.design.patterns import contours


@pytest.mark.parametrize("line", [6.0, 17.9, 18.0, 18.5, 33.0])
def test_wide_and_narrow_lines_are_discs_along_the_edges(line: float) -> None:
    """Against the plain definition, bit for bit: the distance from an edge is the root of a whole number."""
    edges = contours(300, 60, 1, 1) > 0  # a line narrower than two samples is the edge itself
    y, x = np.ogrid[-20:21, -20:21]
    expected = binary_dilation(edges, x**2 + y**2 <= (line / 2) ** 2)
    np.testing.assert_array_equal(contours(300, 60, line, 1), expected)


def test_the_widest_line_costs_little() -> None:
    """Discs of 196000 samples at every edge exhaust the memory; distances take a fraction of a second."""
    began = time.process_time()
    pattern = contours(600, 240, 500, 1)
    assert time.process_time() - began < 10
    assert pattern.mean() > 0.5
