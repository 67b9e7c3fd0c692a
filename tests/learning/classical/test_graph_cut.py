"""Graph cuts against all labellings, dynamic programming and another max flow."""

from __future__ import annotations

import builtins
import sys
from itertools import product

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from learning.classical.graph_cut import build_network, cut_labels, labels_of_cut, source_side
from simulator.errors import InputError

ROUNDING = 1e-6  # costs of order one in 2^24 steps, some ten terms: 1e-6 is far below any difference of two labellings


def energy(unary: np.ndarray, labels: np.ndarray, pairwise: float) -> float:
    """Return E(x) of labels ``(h, w)`` for costs ``(K, h, w)``."""
    alone = np.take_along_axis(np.asarray(unary, np.float64), labels[None], axis=0).sum()
    steps = sum(int(np.abs(np.diff(labels, axis=axis)).sum()) for axis in (0, 1))
    return float(alone + pairwise * steps)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("pairwise", [0.0, 0.05, 0.3, 2.0])
def test_is_the_least_of_all_labellings(seed, pairwise):
    """2 x 3 pixels with 3 labels: 729 labellings, costs without any shape."""
    unary = np.random.default_rng(seed).normal(size=(3, 2, 3))
    everything = [energy(unary, np.reshape(labels, (2, 3)), pairwise) for labels in product(range(3), repeat=6)]
    assert energy(unary, cut_labels(unary, pairwise), pairwise) == pytest.approx(min(everything), abs=ROUNDING)


@pytest.mark.parametrize("upright", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_chain_equals_dynamic_programming(seed, upright):
    """Viterbi's algorithm over 40 pixels with 9 labels, along either axis."""
    rng = np.random.default_rng(seed)
    costs, pairwise = rng.exponential(size=(9, 40)), rng.uniform(0.02, 0.5)
    steps = pairwise * np.abs(np.subtract.outer(np.arange(9), np.arange(9)))
    best = costs[:, 0]
    for column in costs.T[1:]:
        best = column + (best[:, None] + steps).min(axis=0)
    unary = costs[:, :, None] if upright else costs[:, None]
    assert energy(unary, cut_labels(unary, pairwise), pairwise) == pytest.approx(best.min(), abs=1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_equals_another_solver(seed):
    """SciPy's Dinic on the plain textbook network: two arcs per pair, nothing reparametrised, whole costs."""
    rng = np.random.default_rng(seed)
    unary, pairwise = rng.integers(0, 100, (5, 9, 11)).astype(np.float64), 13
    nodes = np.arange(4 * 99).reshape(4, 9, 11)
    arcs = {(396, int(node)): int(cost) for node, cost in zip(nodes[0].ravel(), unary[0].ravel(), strict=True)}
    arcs |= {(int(node), 397): int(cost) for node, cost in zip(nodes[-1].ravel(), unary[-1].ravel(), strict=True)}
    for level in range(3):
        for lower, upper, cost in zip(nodes[level].flat, nodes[level + 1].flat, unary[level + 1].flat, strict=True):
            arcs |= {(int(lower), int(upper)): int(cost), (int(upper), int(lower)): 10**6}
    for one, other in ((nodes[:, 1:], nodes[:, :-1]), (nodes[:, :, 1:], nodes[:, :, :-1])):
        for a, b in zip(one.flat, other.flat, strict=True):
            arcs |= {(int(a), int(b)): pairwise, (int(b), int(a)): pairwise}
    ends = np.array(list(arcs))
    graph = coo_array((np.array(list(arcs.values()), np.int32), (ends[:, 0], ends[:, 1])), shape=(398, 398)).tocsr()
    labels = cut_labels(unary, pairwise)
    assert energy(unary, labels, pairwise) == maximum_flow(graph, 396, 397).flow_value


def test_without_pairwise_each_pixel_chooses_alone_and_with_much_all_agree():
    unary = np.random.default_rng(2).uniform(size=(6, 5, 8))
    np.testing.assert_array_equal(cut_labels(unary, 0), unary.argmin(axis=0))
    np.testing.assert_array_equal(cut_labels(unary, 50), np.full((5, 8), unary.sum(axis=(1, 2)).argmin()))


def convex(rng, labels, shape):
    """Random costs whose slopes never fall; every fourth does not rise."""
    slopes = rng.normal(size=(1, *shape)) + np.cumsum(rng.exponential(size=(labels - 1, *shape)) / labels, axis=0)
    slopes[3::4] = slopes[2::4][: len(slopes[3::4])]
    return np.concatenate([np.zeros((1, *shape)), np.cumsum(slopes - slopes.mean(), axis=0)])


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("pairwise", [0.0, 0.1, 0.6, 3.0])
def test_convex_costs_are_the_least_of_all_labellings_too(seed, pairwise):
    unary = convex(np.random.default_rng(seed), 4, (2, 3))
    everything = [energy(unary, np.reshape(labels, (2, 3)), pairwise) for labels in product(range(4), repeat=6)]
    assert energy(unary, cut_labels(unary, pairwise), pairwise) == pytest.approx(min(everything), abs=ROUNDING)


@pytest.mark.parametrize(("labels", "pairwise"), [(2, 0.3), (5, 0.1), (8, 0.5), (29, 0.02), (29, 0.3)])
def test_convex_costs_take_small_cuts_to_what_the_large_one_finds(monkeypatch, labels, pairwise):
    rng = np.random.default_rng(labels)
    unary = convex(rng, labels, (17, 14))
    network = build_network(unary, pairwise)
    cut = source_side(network.tails, network.heads, network.capacities, network.source, network.sink)
    large = labels_of_cut(network, cut)
    monkeypatch.setattr("learning.classical.graph_cut.build_network", None)  # not called for these
    found = cut_labels(unary, pairwise)
    assert len(np.unique(found)) > 1
    least = energy(unary, large, pairwise)
    assert energy(unary, found, pairwise) == pytest.approx(least, abs=17 * 14 * labels * 2**-20)
    assert (found == large).mean() > 0.99


def test_two_labels_constant_costs_and_single_pixels():
    np.testing.assert_array_equal(cut_labels(np.array([[[1.0, 0.2]], [[0.0, 0.3]]]), 0.05), [[1, 0]])
    assert cut_labels(np.full((4, 1, 1), 7.0), 1.0).shape == (1, 1)
    assert energy(np.zeros((3, 4, 5)), cut_labels(np.zeros((3, 4, 5)), 1.0), 1.0) == 0


@pytest.mark.parametrize("label", range(4))
def test_a_label_that_costs_nothing_anywhere_is_chosen(label):
    """Its arcs have no capacity: neither source nor sink may get lost for it."""
    unary = np.ones((4, 3, 5))
    unary[label] = 0
    np.testing.assert_array_equal(cut_labels(unary, 0.0), np.full((3, 5), label))
    np.testing.assert_array_equal(cut_labels(unary, 0.1), np.full((3, 5), label))


def test_unit_and_offset_of_the_costs_do_not_matter():
    unary = np.random.default_rng(3).uniform(size=(5, 7, 6))
    labels = cut_labels(unary, 0.1)
    np.testing.assert_array_equal(cut_labels(unary * 1e-9, 1e-10), labels)
    np.testing.assert_array_equal(cut_labels(unary * 1e12 - 5e12, 1e11), labels)


@pytest.mark.parametrize(
    ("unary", "pairwise", "message"),
    [
        (np.zeros((1, 3, 3)), 0.1, "^unary: "),
        (np.zeros((3, 3)), 0.1, "^unary: "),
        (np.full((2, 2, 2), np.nan), 0.1, "^unary: "),
        (np.zeros((2, 2, 2)), -0.1, "^pairwise: "),
        (np.zeros((2, 2, 2)), np.nan, "^pairwise: "),
    ],
)
def test_refuses_what_has_no_minimum(unary, pairwise, message):
    with pytest.raises(InputError, match=message):
        cut_labels(unary, pairwise)


def test_missing_package_is_named_with_its_cure(monkeypatch):
    def refuse(name, *args, **kwargs):
        if name.startswith("ortools"):
            raise ImportError(name)
        return load(name, *args, **kwargs)

    load = builtins.__import__
    monkeypatch.setattr(builtins, "__import__", refuse)
    for name in [name for name in sys.modules if name.startswith("ortools")]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(InputError, match=r"^graph cut: "):
        cut_labels(np.zeros((2, 2, 2)), 0.1)
