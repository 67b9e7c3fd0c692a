"""The upper surface of a staircase of mask pixels, exact and of few triangles: equal neighbours are one level region.

Seen from above the surface is a map of level regions, and of the walls between them as narrow bands. It has vertices only
where a region has a corner, and where a region is cut into rectangles. Every rectangle, and every straight band, then lies
between two chains of vertices, and one rule divides all of them into triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Convex corners lie inside their pixel by this share of it, so that walls lean. Upright ones would make two pixels that
# touch at a corner share an edge four times, which is not a solid; leaning ones keep the surface single-valued.
LEAN = 1 / 512
# Round a corner of the pixel grid lie four quadrants: 0 upper left, 1 upper right, 2 lower left, 3 lower right. So the
# quadrant beside k is k ^ 1, the one above or below it k ^ 2, the opposite one k ^ 3.
_BESIDE, _BEYOND, _OPPOSITE = [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Surface:
    """A surface z(x, y) over a rectangle.

    Attributes:
        points: ``(N, 3)``.
        faces: ``(M, 3)`` triangles of points, counter-clockwise seen from above.
        rim: the points on the rectangle's sides, counter-clockwise seen from above.
    """

    points: NDArray[np.float64]
    faces: Indices
    rim: Indices


def corner_count(height: NDArray[np.float64]) -> int:
    """Return how many corners the level regions of pixels ``(H, W)`` have: at most half the triangles of its surface."""
    return sum(int(np.count_nonzero(corners)) for corners in _corners(_around(height)))


def staircase(height: NDArray[np.float64]) -> Surface:
    """Return the surface of level pixels ``(H, W)`` of side 1, centred, row 0 at the top; z has the unit of the heights."""
    rows, columns = height.shape
    around = _around(height)
    beside, beyond = around == around[_BESIDE], around == around[_BEYOND]
    convex, reflex = _corners(around)
    block_of, ends = _blocks(around)
    kept = convex | reflex
    kept[ends.quadrant, ends.row, ends.column] = True
    number = np.cumsum(kept).reshape(kept.shape) - 1
    quadrant, row, column = np.nonzero(kept)
    pushed = np.stack([convex[kept], ~reflex[kept]])  # along y, x; a cut ends on a straight wall, which leans in x
    pushed &= np.stack([(row > 0) & (row < rows), (column > 0) & (column < columns)])
    y = row + LEAN * pushed[0] * np.where(quadrant >= 2, 1, -1)
    x = column + LEAN * pushed[1] * np.where(quadrant % 2, 1, -1)
    pixel = row - (quadrant < 2), column - (quadrant % 2 == 0)

    # Rectangles: their ends, and the corners of L between them; the chains are top and bottom, from left to right.
    middle = reflex[kept]
    at_end = number[ends.quadrant, ends.row, ends.column]
    blocks = _Chains(
        np.concatenate([ends.block, block_of[pixel][middle]]),
        np.concatenate([ends.second, quadrant[middle] < 2]),
        np.concatenate([x[at_end], x[middle]]),
        np.concatenate([at_end, np.flatnonzero(middle)]),
    )
    # Level bands of walls, from left to right, which run through crossings; upright ones, downwards, which end there.
    corner = (convex | reflex)[kept] & (row > 0) & (row < rows)
    level_bands = _numbered(~beyond[1], np.zeros(beyond[1].shape, bool))
    level_walls = _Chains(level_bands[row, column][corner], quadrant[corner] >= 2, x[corner], np.flatnonzero(corner))
    crossing = np.logical_and.reduce(convex)
    upright_bands = _numbered(~beside[2].T, crossing.T).T
    off_rim = (column > 0) & (column < columns)
    band = upright_bands[row, column] - (crossing[row, column] & (quadrant < 2))
    upright_walls = _Chains(band[off_rim], quadrant[off_rim] % 2 == 0, y[off_rim], np.flatnonzero(off_rim))

    place = np.select(
        [column == 0, row == rows, column == columns], [y, rows + x, 2 * rows + columns - y], 2 * (rows + columns) - x
    )
    on_rim = np.flatnonzero((row % rows == 0) | (column % columns == 0))
    return Surface(
        np.stack([x - columns / 2, rows / 2 - y, height[pixel]], 1),
        np.concatenate([chains.triangles() for chains in (blocks, level_walls, upright_walls)]),
        on_rim[np.argsort(place[on_rim], kind="stable")],
    )


def _around(height: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the level, by number, of the four quadrants round each corner ``(4, H + 1, W + 1)``; -1 outside."""
    level = np.unique(height, return_inverse=True)[1].reshape(height.shape).astype(np.int32)
    level = np.pad(level, 1, constant_values=-1)
    return np.stack([level[:-1, :-1], level[:-1, 1:], level[1:, :-1], level[1:, 1:]])


def _corners(around: NDArray[np.int32]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which quadrants are a convex corner of their region, and which the middle of an L of three."""
    beside, beyond = around == around[_BESIDE], around == around[_BEYOND]
    inside = around >= 0
    return inside & ~beside & ~beyond, inside & beside & beyond & (around != around[_OPPOSITE])


@dataclass(frozen=True)
class _Ends:
    """The four corners of each rectangle, as vertices ``(quadrant, row, column)`` of its top (False) or bottom chain."""

    block: Indices
    second: NDArray[np.bool_]
    quadrant: Indices
    row: Indices
    column: Indices


def _blocks(around: NDArray[np.int32]) -> tuple[Indices, _Ends]:
    """Cut all level regions along rows into rectangles; return whose each pixel is, and the rectangles' ends."""
    wall = (around[2] != around[3])[:-1]
    row, left = np.nonzero(wall[:, :-1])
    right = np.nonzero(wall[:, 1:])[1] + 1
    value = around[3, row, left]
    # Runs of equal pixels that lie exactly below each other are one rectangle.
    order = np.lexsort((row, value, right, left))
    same = [np.diff(of[order]) == 0 for of in (left, right, value)] + [np.diff(row[order]) == 1]
    first = np.concatenate([[True], ~np.logical_and.reduce(same)])
    run_block = np.empty_like(order)
    run_block[order] = np.cumsum(first) - 1
    block_of = np.repeat(run_block, right - left).reshape(len(wall), -1)
    top, low = order[first], order[np.roll(first, -1)]
    sides = []
    for runs, down in ((top, 0), (low, 1)):
        for edge, own in ((left, 3 - 2 * down), (right, 2 - 2 * down)):
            i, j = row[runs] + down, edge[runs]
            here, beyond, opposite = (around[k, i, j] for k in (own, own ^ 2, own ^ 3))
            # A corner of the region; or the corner of an L; or a cut that ends on a straight wall, kept by the upper side.
            quadrant = np.where(here != beyond, own, np.where(here == opposite, own ^ 2, min(own, own ^ 2)))
            sides.append((np.arange(len(runs)), np.full(len(runs), bool(down)), quadrant, i, j))
    return block_of, _Ends(*(np.concatenate(part) for part in zip(*sides, strict=True)))


def _numbered(wall: NDArray[np.bool_], broken: NDArray[np.bool_]) -> Indices:
    """Number the bands of walls, row by row; ``wall[i, j]`` goes from corner j to j + 1, ``broken`` where a band must end."""
    before = np.pad(wall, ((0, 0), (1, 0)))[:, :-1]
    return np.cumsum(wall & (~before | broken), dtype=np.int64).reshape(wall.shape)


@dataclass(frozen=True)
class _Chains:
    """Pairs of chains of vertices: which pair, first (left of the way) or second chain, place along the way, vertex."""

    pair: Indices
    second: NDArray[np.bool_]
    along: NDArray[np.float64]
    vertex: Indices

    def triangles(self) -> Indices:
        """Divide what lies between the chains: each vertex joins the one before it to the latest of the other chain."""
        order = np.lexsort((self.along, self.pair))
        pair, second, vertex = self.pair[order], self.second[order], self.vertex[order]
        at = np.arange(len(order))
        begins = np.diff(pair, prepend=-1) != 0
        start = np.maximum.accumulate(np.where(begins, at, 0))
        faces: list[Any] = []
        latest = [np.maximum.accumulate(np.where(second == side, at, -1)) for side in (False, True)]
        group = np.cumsum(begins) - 1
        for side in (0, 1):
            own, other = latest[side], latest[1 - side]
            before = np.concatenate([[-1], own[:-1]])
            mine = second == bool(side)
            first_other = at[(second != bool(side)) & (np.concatenate([[-1], other[:-1]]) < start)]
            joins = mine & (before >= start)
            v, previous, facing = at[joins], before[joins], np.maximum(other, first_other[group])[joins]
            faces.append(vertex[np.stack([previous, v, facing] if side else [previous, facing, v], 1)])
        return np.concatenate(faces)
