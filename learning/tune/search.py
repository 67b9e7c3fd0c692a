"""Coordinate search: one parameter after the other, round by round, until nothing changes; a range has no edge to end at."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

from learning.method import Value
from simulator.errors import InputError

Parameters: TypeAlias = dict[str, Value]

_MOST_STEPS = 40  # along one parameter: a score that improves for ever without a limit is nobody's optimum
_LONE_RATIO = 2.0  # of a range with a single value


@dataclass(frozen=True)
class Axis:
    """The values that a parameter may take.

    Numbers go on geometrically beyond both ends of the list, with the ratio of its last two values, up to a limit; whole
    numbers stay whole, and odd where all of the list are. A list that begins with 0 ends there. Of words, there are no more.

    Raises:
        InputError: no candidates, numbers among words, numbers that do not increase, or that lie outside the limits.
    """

    values: tuple[Value, ...]
    low: float = 0.0
    high: float = math.inf

    def __post_init__(self) -> None:
        numbers = [value for value in self.values if not isinstance(value, str)]
        increasing = all(a < b for a, b in pairwise(numbers))
        if not self.values or len(numbers) not in (0, len(self.values)) or not increasing:
            raise InputError("values", f"got {list(self.values)}, expected words, or numbers in increasing order")
        if numbers and not (self.low <= numbers[0] and numbers[-1] <= self.high and numbers[0] >= 0):
            wanted = f"numbers from {self.low:g} to {self.high:g}, none negative"
            raise InputError("values", f"got {list(self.values)}, expected {wanted}")

    @property
    def is_number(self) -> bool:
        """Whether values have an order and go on beyond the list."""
        return not isinstance(self.values[0], str)

    def neighbour(self, value: Value, step: int) -> Value | None:
        """Return the next candidate above (``step`` 1) or below (-1) any value; None beyond a limit or for words.

        Example:
            >>> axis = Axis((1e-3, 1e-2), high=0.5)
            >>> axis.neighbour(1e-3, 1), axis.neighbour(1e-2, 1), axis.neighbour(0.1, 1), axis.neighbour(0.5, 1)
            (0.01, 0.1, 0.5, None)
            >>> Axis((3, 5, 7)).neighbour(7, 1), Axis((0, 1e-3)).neighbour(0, -1), Axis(("a", "b")).neighbour("a", 1)
            (9, None, None)
        """
        if isinstance(value, str):
            return None
        ladder = self._numbers
        while ladder[-1] <= value and (above := self._beyond(ladder[-1], 1)) is not None:
            ladder.append(above)
        while ladder[0] >= value and (below := self._beyond(ladder[0], -1)) is not None:
            ladder.insert(0, below)
        if step > 0:
            return min((rung for rung in ladder if rung > value), default=None)
        return max((rung for rung in ladder if rung < value), default=None)

    def _beyond(self, value: float, step: int) -> float | None:
        """Return what follows the last (``step`` 1) or first (-1) candidate, or what followed that."""
        limit = self.high if step > 0 else self.low
        if value in (limit, 0):
            return None
        further = self._rounded(value * self._ratio(step) ** step)
        if further == value:
            further = value + step * (2 if self._odd else 1)
        if step * (limit - further) < 0:
            further = self._rounded(limit)
        return further if step * (further - value) > 0 and step * (limit - further) >= 0 else None

    @property
    def _numbers(self) -> list[float]:
        return [value for value in self.values if not isinstance(value, str)]

    def _ratio(self, step: int) -> float:
        pair = self._numbers[-2:] if step > 0 else self._numbers[:2]
        return pair[1] / pair[0] if len(pair) == 2 and pair[0] > 0 else _LONE_RATIO

    @property
    def _whole(self) -> bool:
        return all(isinstance(value, int) for value in self.values)

    @property
    def _odd(self) -> bool:
        return self._whole and all(int(value) % 2 for value in self.values)

    def _rounded(self, value: float) -> float:
        """Return a whole number where the list holds such; others to 12 digits, so that a text gives the same number."""
        if not self._whole:
            return float(f"{value:.12g}")
        return 2 * round((value - 1) / 2) + 1 if self._odd else round(value)


@dataclass(frozen=True)
class Found:
    """Where a search ended: the best parameters, and how many rounds it took, the last, without a change, included.

    ``converged`` says whether nothing changed in the last; ``at_limit`` names those whose best value is a limit of its axis.
    """

    parameters: Parameters
    score: float
    rounds: int
    converged: bool
    at_limit: tuple[str, ...]


def coordinate_search(
    space: Mapping[str, Axis],
    starts: Sequence[Parameters],
    score: Callable[[Parameters], float],
    *,
    sweep: bool = True,
    least_gain: float = 1e-3,
    most_rounds: int = 10,
) -> Found:
    """Minimise a score over parameters, one at a time.

    Along numbers, the neighbours of the best value are tried upwards and downwards as long as they are better, beyond the
    list too: a best value always has a worse one on both sides, unless it is a limit. Words are all tried.

    Args:
        space: by parameter, in the order in which they are searched; parameters of the starts that it lacks stay.
        starts: the best of them is where the search begins.
        score: of parameters; NaN counts as infinite. Asked for some parameters again and again: the caller remembers.
        sweep: whether the first round tries all listed values, as insurance against a second minimum.
        least_gain: share of the score by which a value must be better to be taken; so a flat score ends the search.
        most_rounds: give up then.

    Raises:
        InputError: no start, or starts of which none has a finite score.
    """
    rated = [(_finite(score(dict(start))), start) for start in starts]
    best_score, best = min(rated, key=lambda pair: pair[0], default=(math.inf, {}))
    if math.isinf(best_score):
        raise InputError("starts", f"got {[dict(start) for start in starts]}, expected one with a finite score")
    best = dict(best)
    rounds, converged = 0, False
    while rounds < most_rounds and not converged:
        before = dict(best)
        for name, axis in space.items():

            def better(value: Value, name: str = name) -> bool:
                nonlocal best, best_score
                new = {**best, name: value}
                rating = _finite(score(new))
                if rating >= best_score - least_gain * abs(best_score):
                    return False
                best, best_score = new, rating
                return True

            if not axis.is_number or (sweep and rounds == 0):
                for value in axis.values:
                    better(value)
            for step in (1, -1):
                for _ in range(_MOST_STEPS):
                    value = axis.neighbour(best[name], step)
                    if value is None or not better(value):
                        break
        rounds += 1
        converged = best == before
    at_limit = tuple(name for name, axis in space.items() if axis.is_number and best[name] in (axis.low, axis.high))
    return Found(best, best_score, rounds, converged, at_limit)


def _finite(value: float) -> float:
    return math.inf if math.isnan(value) else value
