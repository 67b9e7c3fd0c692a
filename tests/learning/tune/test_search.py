"""The search against functions whose minimum is known; axes against values written out by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from learning.tune.search import Axis, Parameters, coordinate_search
from simulator.errors import InputError


def walk(axis: Axis, value: float | str, step: int, most: int = 6) -> list[float | int | str]:
    """Return what follows a value, until the axis ends."""
    found: list[float | int | str] = []
    while len(found) < most and (following := axis.neighbour(value, step)) is not None:
        found.append(following)
        value = following
    return found


@pytest.mark.parametrize(
    ("axis", "value", "step", "expected"),
    [
        (Axis((1e-3, 1e-2, 1e-1)), 1e-3, 1, [1e-2, 1e-1, 1.0, 10.0, 100.0, 1000.0]),
        (Axis((1e-3, 1e-2, 1e-1), low=2e-5), 1e-2, -1, [1e-3, 1e-4, 2e-5]),
        (Axis((1.0, 3.0), high=20), 3.0, 1, [9.0, 20.0]),
        (Axis((25, 50, 100), low=1, high=300), 100, 1, [200, 300]),
        (Axis((25, 50, 100), low=1), 25, -1, [12, 6, 3, 2, 1]),
        (Axis((3, 5, 7)), 7, 1, [9, 13, 19, 27, 37, 51]),  # odd stays odd
        (Axis((1, 2, 3), low=1), 1, -1, []),
        (Axis((5, 7), high=10), 7, 1, [9]),  # the limit itself is even
        (Axis((0, 1e-3, 1e-2)), 1e-3, -1, [0]),  # nothing lies below nothing
        (Axis((0.0,)), 0.0, 1, []),
        (Axis((2.0,)), 2.0, 1, [4.0, 8.0, 16.0, 32.0, 64.0, 128.0]),
        (Axis(("linear", "huber")), "linear", 1, []),
        (Axis((1 / 3, 2 / 3)), 1 / 3, 1, [2 / 3 * 2**n for n in range(6)]),
    ],
)
def test_neighbours_are_listed_or_follow_by_the_same_ratio(axis: Axis, value: Any, step: int, expected: Any) -> None:
    found = walk(axis, value, step)
    assert found == pytest.approx(expected, rel=1e-11)
    assert [type(one) for one in found] == [type(one) for one in expected]


@pytest.mark.parametrize("values", [(), (2.0, 1.0), (1.0, 1.0), (1.0, "much"), (-1.0, 1.0), (1.0, 300.0)])
def test_senseless_candidates_are_refused(values: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match=r"^values: "):
        Axis(values, high=100)


def distance(optimum: dict[str, float], words: dict[str, float] | None = None) -> Callable[[Parameters], float]:
    """Return a score with its minimum at ``optimum``: squared distances in log, coupled, plus a number for a word."""

    def score(parameters: Parameters) -> float:
        steps = [math.log10(float(parameters[name]) / best) for name, best in optimum.items()]
        coupled = 0.2 * sum(steps) ** 2 + sum(step**2 for step in steps)
        return 1 + coupled + (words[str(parameters["word"])] if words else 0.0)

    return score


def test_an_optimum_inside_of_the_lists_is_found_from_any_corner() -> None:
    space = {"a": Axis((1e-3, 1e-2, 1e-1, 1.0)), "b": Axis((1, 10, 100)), "word": Axis(("x", "y", "z"))}
    score = distance({"a": 1e-1, "b": 10}, {"x": 1.0, "y": 0.0, "z": 2.0})
    for start in ({"a": 1e-3, "b": 100, "word": "x"}, {"a": 1.0, "b": 1, "word": "z"}):
        found = coordinate_search(space, [start], score)
        assert found.parameters == {"a": 1e-1, "b": 10, "word": "y"}
        assert (found.score, found.converged, found.at_limit) == (1.0, True, ())


def test_an_optimum_beyond_the_list_is_reached_and_has_a_worse_neighbour_on_both_sides() -> None:
    tried: set[float] = set()

    def score(parameters: Parameters) -> float:
        tried.add(float(parameters["a"]))
        return distance({"a": 1e3})(parameters)

    found = coordinate_search({"a": Axis((1e-1, 1.0))}, [{"a": 1.0}], score)
    assert found.parameters["a"] == 1e3
    assert {1e2, 1e4} < tried
    assert found.at_limit == ()


def test_a_limit_stops_the_search_and_is_said() -> None:
    found = coordinate_search({"n": Axis((10, 20), low=1, high=70)}, [{"n": 10}], distance({"n": 1e6}))
    assert (found.parameters, found.at_limit, found.converged) == ({"n": 70}, ("n",), True)


def test_a_flat_score_ends_and_changes_nothing() -> None:
    tried: list[Parameters] = []

    def score(parameters: Parameters) -> float:
        tried.append(parameters)
        return 1 - 1e-9 * float(parameters["a"])

    found = coordinate_search({"a": Axis((1.0, 10.0))}, [{"a": 1.0}], score)
    assert found.parameters == {"a": 1.0}
    assert len(tried) < 10


def test_a_score_that_improves_for_ever_ends() -> None:
    found = coordinate_search({"a": Axis((1.0, 2.0))}, [{"a": 1.0}], lambda p: 1 / float(p["a"]), most_rounds=2)
    assert not found.converged


def test_only_the_sweep_sees_a_second_minimum() -> None:
    values = {1.0: 5.0, 2.0: 6.0, 4.0: 6.0, 8.0: 1.0}

    def score(parameters: Parameters) -> float:
        return values.get(float(parameters["a"]), 9.0)

    space = {"a": Axis(tuple(values))}
    assert coordinate_search(space, [{"a": 1.0}], score).parameters["a"] == 8.0
    assert coordinate_search(space, [{"a": 1.0}], score, sweep=False).parameters["a"] == 1.0


def test_the_search_begins_at_the_better_start_also_off_the_grid_and_avoids_nan() -> None:
    def score(parameters: Parameters) -> float:
        a = float(parameters["a"])
        return math.nan if a > 5 else distance({"a": 3.0})(parameters)

    found = coordinate_search({"a": Axis((1e-2, 1e-1))}, [{"a": 10.0}, {"a": 3.0}], score)
    assert found.parameters == {"a": 3.0}
    with pytest.raises(InputError, match=r"^starts: "):
        coordinate_search({"a": Axis((1.0,))}, [{"a": 10.0}], score)


def test_parameters_out_of_the_space_stay() -> None:
    found = coordinate_search({"a": Axis((1.0, 10.0))}, [{"a": 1.0, "fixed": "word"}], distance({"a": 10.0}))
    assert found.parameters == {"a": 10.0, "fixed": "word"}


@pytest.mark.parametrize(
    ("value", "below", "above"),
    [(0.05, 1e-2, 1e-1), (0.5, 1e-1, 1.0), (50.0, 10.0, 100.0), (5e-5, 1e-5, 1e-4), (2e3, 500.0, None)],
)
def test_a_value_off_the_list_has_the_neighbours_of_its_place(value: float, below: float, above: float | None) -> None:
    axis = Axis((1e-3, 1e-2, 1e-1), high=500)
    assert (axis.neighbour(value, -1), axis.neighbour(value, 1)) == (below, above)
