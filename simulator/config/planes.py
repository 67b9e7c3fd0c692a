"""Depth planes in a configuration: a range and a count, or a list; shared by computed and interpolated stacks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from simulator.config.base import Range, Section, refusal

_IN_FRONT = "depths are measured from the mask into the scene, so they are positive"
Depth = Annotated[float, Range(0.01, 1e7, "cm", infinite=True, below=_IN_FRONT)]
Depths = Annotated[tuple[Depth, ...], Field(min_length=1)]


class Planes(Section):
    """Depth planes as near, far and count, or as a list."""

    near_cm: Annotated[float, Range(0.01, 1e7, "cm", below=_IN_FRONT)] | None = Field(
        default=None, description="nearest plane, centimetres from the mask"
    )
    far_cm: Depth | None = Field(default=None, description="farthest plane, centimetres from the mask, or inf")
    depths: Annotated[int, Range(1, 1000, below="a stack has at least one plane")] | None = Field(
        default=None, description="number of planes"
    )
    spacing: Literal["disparity", "log", "linear"] = Field(
        default="disparity", description="planes at even steps of 1/z (disparity), log z or z"
    )
    depths_cm: Depths | None = Field(
        default=None, description="the planes themselves, in place of near, far and depths"
    )

    @model_validator(mode="after")
    def _sensible_depths(self) -> Self:
        if self.depths_cm is not None:
            for key, unset in (("near_cm", None), ("far_cm", None), ("depths", None), ("spacing", "disparity")):
                if getattr(self, key) != unset:
                    text = f"got {getattr(self, key)!r} beside depths_cm, which already lists the planes; keep one"
                    raise refusal(text, key)
            check_increasing(self.depths_cm)
            return self
        near, far = self.near_cm, self.far_cm
        if near is None or far is None or self.depths is None:
            text = "the planes are not given: needs near_cm, far_cm and depths, or depths_cm: [...]"
            raise refusal(text)
        if near > far or (near == far and self.depths > 1):
            text = f"got {near:g}, which is not nearer than far_cm = {far:g}; swap them?"
            raise refusal(text, "near_cm")
        if self.depths == 1 and near < far:
            text = "got 1 plane for a range; one plane is written depths_cm: [z] without near_cm, far_cm and depths"
            raise refusal(text, "depths")
        if math.isinf(far) and self.spacing != "disparity":
            text = f"got {self.spacing!r}, whose even steps never reach far_cm = inf; use disparity"
            raise refusal(text, "spacing")
        return self

    @property
    def nearest_cm(self) -> float:
        """The nearest plane, centimetres."""
        return self.depths_cm[0] if self.depths_cm is not None else self.near_cm  # pyright: ignore[reportReturnType]


class InterpolatedPlanes(Planes):
    """Planes that a measured stack is interpolated to, by magnification and disparity."""

    extrapolate: bool = Field(
        default=False, description="whether planes outside the measured range are allowed: the outermost one, rescaled"
    )


def check_increasing(depths_cm: Sequence[float]) -> None:
    """Raise pydantic's error at the first depth that is not beyond the one before it."""
    for index, (before, depth) in enumerate(pairwise(depths_cm), start=1):
        if not depth > before:
            text = f"got {depth:g} after {before:g}; depths must increase strictly, nearest first"
            raise refusal(text, "depths_cm", index)
