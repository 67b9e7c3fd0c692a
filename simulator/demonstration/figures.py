"""The figures of a configuration, written into a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from simulator.demonstration.bench import Bench
from simulator.demonstration.depths import depth_figure
from simulator.demonstration.diagram import diagram_figure
from simulator.demonstration.flashes import across_figure, along_figure
from simulator.demonstration.paper import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[[Bench], "Figure"]


def figures_of(bench: Bench) -> dict[str, Draw]:
    """Return what draws each figure, by file name; a stack of one depth has no two depths to show."""
    figures: dict[str, Draw] = {
        "shutter_diagram.png": diagram_figure,
        "flashes_along_the_columns.png": along_figure,
        "flashes_along_the_rows.png": across_figure,
    }
    return figures if len(bench.ends.depths_m) == 1 else figures | {"points_at_two_depths.png": depth_figure}


def draw_figures(bench: Bench, folder: Path) -> list[Path]:
    """Draw all figures and return their paths; the folder is made where it is missing.

    Raises:
        StorageError: a picture cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return [save(draw(bench), folder / name) for name, draw in figures_of(bench).items()]
