"""Labels of least energy: a cost per pixel and label, and a cost of the difference between neighbours' labels.

E(x) = sum_i E_i(x_i) + pairwise sum_ij |x_i - x_j| over 4-neighbours: thesis equation 5.5. The minimum is exact, because the
energy is that of a cut: Ishikawa, Exact Optimization for Markov Random Fields with Convex Priors, TPAMI 25 (2003).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

STEPS = 2**24
"""Capacities are integers: the largest cost has so many steps. Rounding lets the energy found lie above the minimum by at
most one step per pixel (of convex costs, half a step per label of it) and one per label of difference between neighbours."""


class Network(NamedTuple):
    """A flow network whose minimum cut is the labelling of least energy.

    Pixel i has a chain of K - 1 nodes from source to sink; the arc that is cut is its label. A node lies on the source's side
    where the label is larger than the node's place in the chain. ``nodes`` ``(K - 1, h, w)`` are their numbers, source and
    sink come after them; arcs lead from ``tails`` to ``heads`` ``(A,)`` with whole ``capacities``, not negative.
    """

    nodes: NDArray[np.int32]
    tails: NDArray[np.int32]
    heads: NDArray[np.int32]
    capacities: NDArray[np.int64]

    @property
    def source(self) -> int:
        """Number of the source."""
        return self.nodes.size

    @property
    def sink(self) -> int:
        """Number of the sink."""
        return self.nodes.size + 1


def cut_labels(unary: NDArray[np.floating], pairwise: float) -> NDArray[np.int64]:
    """Return the labels ``(h, w)`` of least energy, 0 to K - 1.

    Costs are rounded to 1 / `STEPS` of the largest; with that the result is exact. Where all are convex in the label, as
    `unary_cost`'s ``spread``, the smaller cuts of `cut_convex` find it, else one cut of `build_network`.

    Args:
        unary: ``(K, h, w)`` cost of each label at each pixel, any unit.
        pairwise: cost per label of difference between neighbours, not negative, in the same unit.

    Raises:
        InputError: non-finite costs, a negative ``pairwise``, fewer than two labels, or OR-tools is missing.
    """
    costs = _checked(unary, pairwise)
    step = _step(costs, pairwise)
    slopes = np.rint(np.diff(costs, axis=0) / step).astype(np.int64)
    if (np.diff(slopes, axis=0) >= 0).all():
        return cut_convex(slopes, round(pairwise / step))
    network = build_network(costs, pairwise)
    cut = source_side(network.tails, network.heads, network.capacities, network.source, network.sink)
    return labels_of_cut(network, cut)


def labels_of_cut(network: Network, source_side: NDArray[np.integer] | list[int]) -> NDArray[np.int64]:
    """Return the labels ``(h, w)`` of a cut, given by the numbers of the nodes on the source's side."""
    larger = np.zeros(network.nodes.size + 2, bool)
    larger[source_side] = True
    return larger[network.nodes].sum(axis=0)


def build_network(unary: NDArray[np.floating], pairwise: float) -> Network:
    """Return the network for costs ``(K, h, w)``; see `cut_labels`."""
    costs = _checked(unary, pairwise)
    step = _step(costs, pairwise)
    # A constant per pixel changes no labels, and costs that begin at 0 leave less to flow.
    whole = np.rint((costs - costs.min(axis=0)) / step).astype(np.int64)
    weight = round(pairwise / step)
    # |a - b| of two bits is 2 a (1 - b) + b - a: one arc of twice the weight instead of two, and a linear cost of either
    # pixel, which cancels everywhere but at the image's edges. Halves the time.
    linear = weight * np.arange(len(whole), dtype=np.int64)[:, None]
    for first, last in ((np.s_[:, 0], np.s_[:, -1]), (np.s_[:, :, 0], np.s_[:, :, -1])):
        whole[first] -= linear
        whole[last] += linear
    whole -= whole.min(axis=0)

    nodes = np.arange(whole[1:].size, dtype=np.int32).reshape(whole[1:].shape)
    source, sink = nodes.size, nodes.size + 1
    # Never worth cutting, so that a chain is cut once.
    uncut = int(whole.max(axis=0).sum()) + 1
    arcs = [
        (np.full_like(nodes[0], source), nodes[0], whole[0]),
        (nodes[:-1], nodes[1:], whole[1:-1]),
        (nodes[-1], np.full_like(nodes[-1], sink), whole[-1]),
        (nodes[1:], nodes[:-1], np.full(nodes[1:].shape, uncut)),
    ]
    for tails, heads in ((nodes[:, :-1], nodes[:, 1:]), (nodes[:, :, :-1], nodes[:, :, 1:])):
        arcs.append((tails, heads, np.full(tails.shape, 2 * weight)))
    tails, heads, capacities = (np.concatenate([arc[part].ravel() for arc in arcs]) for part in range(3))
    # Arcs without capacity stay: a sink that no arc names would not exist for the solver, which then cuts nothing.
    return Network(nodes, tails, heads, capacities)


def _step(costs: NDArray[np.float64], pairwise: float) -> float:
    """Return what the costs are rounded to."""
    return max(float(np.ptp(costs, axis=0).max()), pairwise) / STEPS or 1.0


def _checked(unary: NDArray[np.floating], pairwise: float) -> NDArray[np.float64]:
    if unary.ndim != 3 or unary.shape[0] < 2 or 0 in unary.shape:
        raise InputError("unary", f"got shape {unary.shape}, expected (K, h, w) with at least two labels")
    costs = np.asarray(unary, np.float64)
    if not np.isfinite(costs).all():
        share = 1 - np.isfinite(costs).mean()
        raise InputError("unary", f"{share:.2%} of its costs are NaN or infinite; check measurement and volume")
    if not (np.isfinite(pairwise) and pairwise >= 0):
        raise InputError("pairwise", f"got {pairwise!r}, expected 0 or more: only smooth labels may be rewarded")
    return costs


_PAIRS = (
    ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
)
"""Pixels and their neighbours below; pixels and their neighbours to the right."""


def cut_convex(slopes: NDArray[np.int64], weight: int) -> NDArray[np.int64]:
    """Return the labels ``(h, w)`` of least energy, 0 to K - 1.

    ``slopes`` ``(K - 1, h, w)``, never falling along K, are what each label costs more than the one before, ``weight`` what a
    difference of one label between neighbours costs.
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


def source_side(
    tails: NDArray[np.integer], heads: NDArray[np.integer], capacities: NDArray[np.int64], source: int, sink: int
) -> NDArray[np.int64]:
    """Return the numbers of the nodes on the source's side of a minimum cut, of the fewest where there are several.

    Arcs lead from ``tails`` to ``heads`` ``(A,)`` with whole ``capacities``, not negative; source and sink each need an arc,
    if only one of 0.
    """
    try:
        from ortools.graph.python.max_flow import SimpleMaxFlow
    except ImportError as error:
        cure = "pip install 'flatlight[learn]', or uv run --extra learn"
        raise InputError("graph cut", f"needs the package ortools ({error}): {cure}") from error
    solver: Any = SimpleMaxFlow()
    solver.add_arcs_with_capacity(tails, heads, capacities)
    status = solver.solve(source, sink)
    if status != solver.OPTIMAL:
        msg = f"graph cut: OR-tools' max flow ended with {status} for {len(tails)} arcs between {sink + 1} nodes"
        raise RuntimeError(msg)
    return np.asarray(solver.get_source_side_min_cut(), np.int64)
