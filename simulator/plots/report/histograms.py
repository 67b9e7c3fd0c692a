"""Histograms of a page: counted by NumPy, drawn as SVG, and told as a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.plots.report.markup import Html, folded, shown, table
from simulator.text import share

_FEWEST, _MOST, _MARKS = 5, 24, 5  # bins, and numbers below them, about
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BELOW = 360.0, 190.0, 46.0, 12.0, 10.0, 40.0


@dataclass(frozen=True)
class Histogram:
    """Values in bins.

    Attributes:
        title: of what.
        unit: the axis's label.
        edges: ``(N + 1,)`` increasing.
        counts: ``(N,)``.
        of: what was counted, with how many.
        mark: an edge's value as text.
    """

    title: str
    unit: str
    edges: NDArray[np.float64]
    counts: NDArray[np.int64]
    of: str
    mark: Callable[[float], str] = "{:.4g}".format


def histogram(
    title: str, unit: str, values: ArrayLike, of: str, mark: Callable[[float], str] = "{:.4g}".format
) -> Histogram:
    """Count values, finite and at least one, in bins with round edges; the rest is as in `Histogram`."""
    numbers = np.asarray(values, np.float64)
    bins = min(max(round(2 * numbers.size ** (1 / 3)), _FEWEST), _MOST)  # Rice's rule
    edges = round_edges(float(numbers.min()), float(numbers.max()), bins)
    inside = np.clip(numbers, edges[0], edges[-1])  # of a value on an edge, rounding may take it outside
    return Histogram(title, unit, edges, np.histogram(inside, edges)[0], of, mark)


def round_edges(low: float, high: float, bins: int) -> NDArray[np.float64]:
    """Return edges that hold both numbers, steps of 1, 2 or 5 times a power of ten; about ``bins`` of them.

    Example:
        >>> round_edges(13, 88, 8).tolist()
        [10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0]
    """
    step = _round_step((high - low) / bins or abs(high) / bins or 1.0)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return np.arange(first, max(last, first + 1) + 1, dtype=np.float64) * step


def _round_step(least: float) -> float:
    power = 10.0 ** math.floor(math.log10(least))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least * (1 - 1e-9))


def histogram_figure(data: Histogram) -> Html:
    """Return the drawing with its title, and its numbers as a table behind it."""
    highest = max(int(data.counts.max()), 1)
    described = f"Histogram of {data.title}, {data.of}: {_in_words(data)}"
    rows = [
        (f"{data.mark(low)} to {data.mark(high)}", f"{count:,}", share(count / max(int(data.counts.sum()), 1)))
        for low, high, count in zip(data.edges[:-1], data.edges[1:], data.counts.tolist(), strict=True)
    ]
    return Html(
        f'<figure class="histogram"><figcaption><h3>{shown(data.title)}</h3>{shown(data.of)}</figcaption>'
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{shown(described)}">'
        f"{_axes(data, highest)}{_bars(data, highest)}</svg>"
        f"{folded('Numbers', table(data.title, (data.unit, 'count', 'share'), rows))}</figure>"
    )


def _in_words(data: Histogram) -> str:
    most = int(data.counts.argmax())
    ends = f"{data.mark(data.edges[0])} to {data.mark(data.edges[-1])}"
    peak = f"{data.mark(data.edges[most])} to {data.mark(data.edges[most + 1])}"
    return f"{ends}, most between {peak}; {data.unit}"


def _axes(data: Histogram, highest: int) -> str:
    bottom, right = _HEIGHT - _BELOW, _WIDTH - _RIGHT
    parts = []
    for level in _levels(highest):
        y = bottom - (bottom - _TOP) * level / highest
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{_short(level)}</text>')
    for at in range(0, len(data.edges), -(-len(data.counts) // _MARKS)):
        x = _LEFT + (right - _LEFT) * at / (len(data.edges) - 1)
        parts.append(f'<line class="axis" x1="{x:.1f}" x2="{x:.1f}" y1="{bottom}" y2="{bottom + 4}"/>')
        label = shown(data.mark(float(data.edges[at])))
        parts.append(
            f'<text x="{x:.1f}" y="{bottom + 17}" text-anchor="{"middle" if x < right else "end"}">{label}</text>'
        )
    middle = (_LEFT + right) / 2
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{right}" y1="{bottom}" y2="{bottom}"/>')
    parts.append(f'<text class="unit" x="{middle}" y="{_HEIGHT - 6}" text-anchor="middle">{shown(data.unit)}</text>')
    return "".join(parts)


def _bars(data: Histogram, highest: int) -> str:
    bottom = _HEIGHT - _BELOW
    width = (_WIDTH - _RIGHT - _LEFT) / len(data.counts)
    return "".join(
        f'<rect class="column" x="{_LEFT + number * width + 0.5:.2f}" y="{bottom - high:.2f}" '
        f'width="{max(width - 1, 0.5):.2f}" height="{high:.2f}"><title>'
        f"{shown(data.mark(data.edges[number]))} to {shown(data.mark(data.edges[number + 1]))}: {count:,}</title></rect>"
        for number, count in enumerate(data.counts.tolist())
        if (high := (bottom - _TOP) * count / highest)
    )


def _levels(highest: int) -> Sequence[int]:
    step = max(1, int(_round_step(highest / 3)))
    return range(0, highest + 1, step)


def _short(count: int) -> str:
    """Return a count in few letters.

    Example:
        >>> _short(800), _short(25_000), _short(3_000_000)
        ('800', '25 k', '3 M')
    """
    for size, unit in ((1_000_000, " M"), (1_000, " k")):
        if count >= 10 * size or (count >= size and count % size == 0):
            return f"{count / size:g}{unit}"
    return str(count)
