"""Figures that show what a camera's shutter and PSFs do to a few flashes of light, computed by its own forward model.

After figures 2.3 to 2.6 of the thesis: the shutter's diagram, flashes along and across the rows, two points at two depths.
"""

from simulator.demonstration.bench import Bench
from simulator.demonstration.facts import shutter_facts
from simulator.demonstration.figures import draw_figures

__all__ = ["Bench", "draw_figures", "shutter_facts"]
