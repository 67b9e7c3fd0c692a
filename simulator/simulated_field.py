"""From a configuration to the field that is simulated: image, margin and stop, and the light that they leave out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.camera.field import (
    LIGHT_LEFT_OUT,
    Arrival,
    FieldOfView,
    automatic_margin,
    check_margin,
    margin_of_angle,
    read_angular_response,
    stop_tangents,
)
from simulator.camera.surroundings import WORDS
from simulator.config import Config
from simulator.io.images import filled, read_light
from simulator.optics.error_budget.budget import BudgetRow
from simulator.optics.stack import PsfStack
from simulator.types import View


@dataclass(frozen=True)
class SimulatedField:
    """What beside the image is simulated, how light from each direction counts, and what is left out.

    Attributes:
        config: the configuration.
        image_view: the view without a margin.
        nearest_light: gives where the light of the nearest depth falls, ``(rows, columns)``; asked for automatic margins.
    """

    config: Config
    image_view: View
    nearest_light: Callable[[], NDArray[np.floating]] = field(compare=False)

    @cached_property
    def of_view(self) -> FieldOfView:
        """How much of the light from each direction counts: vignetting, field stop and angular response."""
        camera = self.config.camera
        with self.config.refusals("camera", "camera.sensor"):
            response, stop = camera.sensor.angular_response, camera.field_stop_deg
            if isinstance(response, str):
                response = read_angular_response(self.config.resolve_path(response))
            edges = None if stop is None else stop_tangents(self.image_view, stop)
            return FieldOfView(self.config.forward.vignetting, edges, response)

    @cached_property
    def margin(self) -> tuple[int, int]:
        """Rows and columns beside each edge of the image from which light is simulated."""
        scene, view, seen = self.config.scene, self.image_view, self.of_view
        with self.config.refusals("scene"):
            if scene.margin_deg:
                return margin_of_angle(view, scene.margin_deg)
            if scene.margin != "auto":
                return check_margin(view, (scene.margin, scene.margin))
            bare = self._arrival(self.nearest_light()[None], replace(seen, stop=None))
            return automatic_margin(bare, view, seen.stop)

    def surroundings(self, view: View) -> str | NDArray[np.float32] | None:
        """Return what shines beside images that say nothing of it, for `simulator.camera.surroundings.surrounded`.

        Args:
            view: with the margin.
        """
        chosen = self.config.scene.surroundings
        if chosen is None or chosen in WORDS:
            return chosen
        return filled(read_light(self.config.resolve_path(chosen)), view.coarse_field[0].shape)

    def light_from_outside(self, stack: PsfStack, *, simulated: bool = True) -> float:
        """Return the share of a uniform half space's light on the sensor that comes from beside what is simulated.

        Args:
            stack: the camera's PSFs.
            simulated: False: from beside the image and through no stop, as if there were neither margin nor stop.
        """
        seen = self.of_view if simulated else replace(self.of_view, stop=None)
        ends = to_numpy(stack.values)[[0, -1]].sum(axis=1)
        return self._arrival(ends, seen).left_out(self.margin if simulated else (0, 0))

    def budget_row(self, stack: PsfStack) -> BudgetRow:
        """Return what the light that is neither simulated nor stopped adds to the error budget."""
        left_out = self.light_from_outside(stack)
        kind = "of a uniform half space's light, not simulated"
        wider = "a wider scene.margin" if self.margin != (0, 0) else "scene.margin: auto"
        change = f"{wider}, or camera.field_stop_deg" if left_out > 1e-3 else "nothing: all is simulated or stopped"
        return BudgetRow("light from outside", left_out, kind, change, left_out > 1.5 * LIGHT_LEFT_OUT)

    def record(self, stack: PsfStack) -> dict[str, Any]:
        """Return the field as a data set records it: responses by direction, margin, and what light is left out."""
        left_out = {"light_from_outside": self.light_from_outside(stack)}
        return self.of_view.record() | {"margin": list(self.margin)} | left_out

    def _arrival(self, light: NDArray[np.floating], seen: FieldOfView) -> Arrival:
        """Return from where a uniform half space's light arrives; it falls off as cos^4, whatever the simulation does."""
        whole = replace(seen, vignetting=True)
        return Arrival(light, self.config.camera.sensor.shape, self.image_view, whole)
