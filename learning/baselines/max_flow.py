"""Minimum cuts by OR-tools' push-relabel maximum flow."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


def source_side(
    tails: NDArray[np.integer], heads: NDArray[np.integer], capacities: NDArray[np.int64], source: int, sink: int
) -> NDArray[np.int64]:
    """Return the numbers of the nodes on the source's side of a minimum cut, of the fewest where there are several.

    Args:
        tails: ``(A,)`` node where each arc begins.
        heads: ``(A,)`` node where it ends.
        capacities: ``(A,)`` whole numbers, not negative; source and sink each need an arc, if only one of 0.
        source: its number.
        sink: its number.

    Raises:
        InputError: OR-tools is missing.
    """
    solver = _load_solver()
    solver.add_arcs_with_capacity(tails, heads, capacities)
    status = solver.solve(source, sink)
    if status != solver.OPTIMAL:
        msg = f"graph cut: OR-tools' max flow ended with {status} for {len(tails)} arcs between {sink + 1} nodes"
        raise RuntimeError(msg)
    return np.asarray(solver.get_source_side_min_cut(), np.int64)


def _load_solver() -> Any:
    try:
        from ortools.graph.python.max_flow import SimpleMaxFlow
    except ImportError as error:
        msg = f"graph cut: needs the package ortools ({error}): pip install 'flatlight[learn]', or uv run --extra learn"
        raise InputError(msg) from error
    return SimpleMaxFlow()
