"""The bare sensor behind an amplitude mask as a Mitsuba sensor; of the LLVM variants only, which trace all rays at once."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.library import drjit, mitsuba


@dataclass(frozen=True)
class MaskedSensor:
    """A sensor and its mask, in Mitsuba's world units.

    Attributes:
        transmittance: ``(rows, columns)`` of the mask's cells, 0..1, in world axes (x right, y down).
        cell: pitch of the cells.
        distance: mask to sensor.
        pixel: pitch of the pixels.
        shape: rows and columns of the sensor.
    """

    transmittance: NDArray[np.float64]
    cell: float
    distance: float
    pixel: float
    shape: tuple[int, int]


def mitsuba_sensor(camera: MaskedSensor) -> Any:
    """Return the ``mitsuba.Sensor`` of a camera; needs an active LLVM variant."""
    mi = mitsuba()

    properties = mi.Properties()
    rows, columns = camera.shape
    film = {
        "type": "hdrfilm",
        "width": columns,
        "height": rows,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
        "component_format": "float32",
    }
    properties["film"] = mi.load_dict(film)
    properties["sampler"] = mi.load_dict({"type": "multijitter"})
    return _sensor_class()(properties, camera)


@functools.cache
def _sensor_class() -> Any:
    """Return the class of the sensor; ``mitsuba.Sensor`` is another class in each variant, and exists only in one."""
    dr = drjit()
    mi = mitsuba()

    class LenslessSensor(mi.Sensor):
        """Rays from a point in a pixel through a point in an opening, which is drawn with the transmittance's weight."""

        def __init__(self, properties: Any, camera: MaskedSensor) -> None:
            super().__init__(properties)
            openings = camera.transmittance > 0
            row, column = np.nonzero(openings)
            rows, columns = camera.transmittance.shape
            self._left = mi.Float((column - 0.5 * columns) * camera.cell)
            self._top = mi.Float((row - 0.5 * rows) * camera.cell)
            weights = camera.transmittance[openings]
            self._openings = mi.DiscreteDistribution(mi.Float(weights))
            self._open_area = mi.Float(float(weights.sum()) * camera.cell**2)
            self._cell, self._distance = mi.Float(camera.cell), mi.Float(camera.distance)
            height, width = camera.shape
            self._width, self._height = mi.Float(width * camera.pixel), mi.Float(height * camera.pixel)

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            del sample1  # of the wavelength
            # The picture is the physical sensor's turned by 180 degrees.
            x, y = (0.5 - sample2.x) * self._width, (0.5 - sample2.y) * self._height
            number, across = self._openings.sample_reuse(sample3.x, active)
            left, top = (dr.gather(mi.Float, part, number, active) for part in (self._left, self._top))
            opening = mi.Point3f(left + across * self._cell, top + sample3.y * self._cell, 0)
            along = opening - mi.Point3f(x, y, -self._distance)
            squared = dr.squared_norm(along)
            cosine_squared = self._distance * self._distance / squared
            weight = self._open_area * dr.square(cosine_squared / self._distance)
            ray = mi.Ray3f(opening, along * dr.rsqrt(squared), time, [])
            return ray, mi.Color3f(weight)

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[Any, Any]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def needs_aperture_sample(self) -> bool:
            return True

        def to_string(self) -> str:
            return "LenslessSensor[]"

    return LenslessSensor
