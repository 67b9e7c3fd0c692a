"""The camera's field: how much of the light from each direction counts, and how far beside the image light is simulated.

A bare sensor sees the whole half space before its mask: of a uniform one, more light arrives from beside a usual image than
from the image itself. So scenes get a margin that is simulated with the image, or the camera a stop that ends its field;
what neither covers is stated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.camera.convolution import StackConvolution
from simulator.errors import InputError
from simulator.io.tables import read_number_table
from simulator.settings import Range, Settings
from simulator.types import View

LIGHT_LEFT_OUT = 0.02
"""Share of a uniform half space's light that an automatic margin leaves out at most."""
STEEPEST_DEG = 80.0
"""Angle to the axis beyond which no margin reaches: there a flat image of the field has more than 30 times the pixels per
degree that it has on the axis."""
_STEP = 4  # pixels by which an automatic margin grows


@dataclass(frozen=True)
class CosinePower(Settings):
    """A pixel's response to oblique light as a power of the cosine of its angle.

    Attributes:
        cosine_power: the power; 0 responds to all directions alike
    """

    cosine_power: Annotated[float, Range(0, 50)]

    def response(self, angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the response at angles to the axis."""
        return np.cos(angle_rad) ** self.cosine_power


@dataclass(frozen=True)
class AngularTable:
    """A pixel's response to oblique light, as measured; linear between the angles.

    Attributes:
        angles_deg: to the axis, increasing from 0 to 90.
        values: response at each, not negative; it is not normalised.

    Raises:
        InputError: angles or values that break these rules.
    """

    angles_deg: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        angles, values = np.array(self.angles_deg, np.float64), np.array(self.values, np.float64)
        if angles.ndim != 1 or angles.shape != values.shape or len(angles) < 2 or not np.all(np.diff(angles) > 0):
            raise InputError("angular response", f"got angles {show_numbers(angles)}, expected them to increase")
        if angles[0] != 0 or angles[-1] != 90:
            raise InputError(
                "angular response",
                f"goes from {angles[0]:g} to {angles[-1]:g} degrees, expected 0 to 90; the steepest light counts, too",
            )
        if not (np.all(values >= 0) and values[0] > 0 and np.all(np.isfinite(values))):
            raise InputError(
                "angular response", f"got {show_numbers(values)}, expected finite, not negative, and light at 0 degrees"
            )

    def response(self, angle_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the response at angles to the axis."""
        return np.interp(np.degrees(angle_rad), self.angles_deg, self.values)


def show_numbers(values: NDArray[np.float64]) -> str:
    """Return the first few numbers as text."""
    return ", ".join(f"{value:g}" for value in values.ravel()[:4]) + (", ..." if values.size > 4 else "")


def read_angular_response(path: Path) -> AngularTable:
    """Read a CSV file with an angle to the axis in degrees and the response to it in each row.

    Raises:
        InputError: as `simulator.io.tables.read_number_table` and `AngularTable`, naming the file.
    """
    angles, values = read_number_table(path, "an angle in degrees and the response", columns=2).values.T
    try:
        return AngularTable(tuple(angles.tolist()), tuple(values.tolist()))
    except InputError as error:
        raise InputError(path, error.reason) from error


AngularResponse = CosinePower | AngularTable


@dataclass(frozen=True)
class FieldOfView:
    """How much of the light from each direction counts.

    Attributes:
        vignetting: the cos^4 fall-off of a flat mask before a flat scene.
        stop: tangents of the angles to the axis at which an ideal stop ends the field, above and below and to both sides;
            None for a bare camera. Ideal: far before the mask and of its shape for each of its points.
        angular_response: of the sensor's pixels, None for one that is alike from everywhere.
    """

    vignetting: bool = True
    stop: tuple[float, float] | None = None
    angular_response: AngularResponse | None = None

    def irradiance(self, view: View) -> NDArray[np.float32]:
        """Return the irradiance at the mask that counts, per unit radiance of each scene pixel: ``(h, w)`` steradian.

        V = L (p / d)^2 cos^4(theta): the pixel's solid angle is (p / d)^2 cos^3, the mask's tilt gives one more cosine; no
        1/z^2, because a farther surface shows more of itself. Source: Horn, Robot Vision, section 10.3. Pixels that the
        stop's edge cuts count by the part inside it.
        """
        y, x = view.tangents
        cosine_squared = 1 / (1 + y[:, None] ** 2 + x[None, :] ** 2)
        pixel = view.pixel_pitch_m / view.distance_m
        light = pixel**2 * (cosine_squared**2 if self.vignetting else np.ones(view.shape))
        if self.angular_response is not None:
            light = light * self.angular_response.response(np.arccos(np.sqrt(cosine_squared)))
        if self.stop is not None:
            rows, columns = (
                np.clip((edge - np.abs(tangents)) / pixel + 0.5, 0, 1)
                for edge, tangents in zip(self.stop, (y, x), strict=True)
            )
            light = light * rows[:, None] * columns
        return np.asarray(light, np.float32)

    def record(self) -> dict[str, Any]:
        """Return it as a data set records it; see `field_from_record`."""
        response = self.angular_response
        return {
            "vignetting": self.vignetting,
            "stop_tangents": None if self.stop is None else list(self.stop),
            "angular_response": None if response is None else dict(vars(response)),
        }


def stop_tangents(view: View, stop_deg: Literal["image"] | float | tuple[float, float]) -> tuple[float, float]:
    """Return where a stop ends the field, tangents of the angles to the axis above and below and to both sides.

    Args:
        view: the image's.
        stop_deg: full angle that passes, or the vertical and the horizontal one, degrees; ``image``: right around the image.

    Raises:
        InputError: a stop that would cut the image.
    """
    edges = (view.tan_half_height, view.tan_half_width)
    if stop_deg == "image":
        return edges
    passing = stop_deg if isinstance(stop_deg, tuple) else (stop_deg, stop_deg)
    rows, columns = (math.tan(math.radians(angle / 2)) for angle in passing)
    if rows < edges[0] or columns < edges[1]:
        seen = " x ".join(f"{math.ceil(200 * math.degrees(math.atan(edge))) / 100:g}" for edge in edges)
        got = " x ".join(f"{angle:g}" for angle in dict.fromkeys(passing))
        raise InputError(
            "field_stop_deg",
            f"got {got}, narrower than the image, which spans {seen} degrees; expected at least that, or image for a stop "
            "right around it",
        )
    return rows, columns


def field_from_record(record: Mapping[str, Any]) -> FieldOfView:
    """Return the field of a record that somebody else may have written.

    Raises:
        InputError: missing or senseless values.
    """
    try:
        response, stop = record["angular_response"], record["stop_tangents"]
        if response is not None:
            table = "angles_deg" in response
            response = (
                AngularTable(tuple(map(float, response["angles_deg"])), tuple(map(float, response["values"])))
                if table
                else CosinePower(float(response["cosine_power"]))
            )
            if isinstance(response, CosinePower) and not 0 <= response.cosine_power <= 50:
                raise ValueError(f"cosine_power {response.cosine_power}")
        edges = None if stop is None else (float(stop[0]), float(stop[1]))
        if edges is not None and not all(0 < edge < math.inf for edge in edges):
            raise ValueError(f"stop_tangents {stop}")
        if not isinstance(record["vignetting"], bool):
            raise TypeError(f"vignetting {record['vignetting']!r}")
        return FieldOfView(record["vignetting"], edges, response)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError("field", f"damaged record ({type(error).__name__}: {error})") from error


# ---- how far light is simulated


class Arrival:
    """How much of a uniform half space's light arrives at the sensor from each direction.

    A direction's PSF lies beside the sensor where the direction is steep: only what lands on it counts. That is H^T 1, the
    adjoint of a sensor that weighs alike, times what `FieldOfView.irradiance` lets through.
    """

    def __init__(
        self, psfs: NDArray[np.floating], sensor_shape: tuple[int, int], view: View, field: FieldOfView
    ) -> None:
        """Compute it on the view's pixels.

        Args:
            psfs: ``(N, rows, columns)``, each alike in weight; only where their light lies counts, so that channels may be
                added up.
            sensor_shape: H, W.
            view: the image's; its margin does not count.
            field: of the camera.
        """
        self._shape = view.shape
        reach = [size // 2 + 1 for size in psfs.shape[-2:]]
        rows, columns = (sensor + 2 * half for sensor, half in zip(sensor_shape, reach, strict=True))
        wide = replace(view, shape=(rows, columns), margin=(0, 0))
        weights = field.irradiance(wide).astype(np.float64)
        light = np.asarray(psfs, np.float32)[:, None]
        light = light / light.sum(axis=(-2, -1), keepdims=True)
        landing = StackConvolution(light, sensor_shape, wide.shape).adjoint(np.ones((1, *sensor_shape), np.float32))
        self._light = np.maximum(landing[:, 0], 0) * weights

    def left_out(self, margin: tuple[int, int]) -> float:
        """Return the share that arrives from beyond the image with such a margin, of the worst PSF."""
        inside = []
        for size, image, more in zip(self._light.shape[1:], self._shape, margin, strict=True):
            half = max((size - image) // 2 - more, 0)
            inside.append(slice(half, size - half))
        total = self._light.sum(axis=(-2, -1))
        within = self._light[:, inside[0], inside[1]].sum(axis=(-2, -1))
        return float(np.max(np.clip(1 - within / total, 0, 1)))

    def margin(self, share: float = LIGHT_LEFT_OUT) -> tuple[int, int]:
        """Return the margin, rows and columns, that leaves out no more than such a share.

        It grows on the side that gains more for each pixel that is simulated.
        """
        rows, columns = 0, 0
        left = self.left_out((0, 0))
        while left > share:
            taller, wider = self.left_out((rows + _STEP, columns)), self.left_out((rows, columns + _STEP))
            height, width = (size + 2 * more for size, more in zip(self._shape, (rows, columns), strict=True))
            if (left - taller) / width >= (left - wider) / height:
                rows, left = rows + _STEP, taller
            else:
                columns, left = columns + _STEP, wider
        return rows, columns


def automatic_margin(bare: Arrival, view: View, stop: tuple[float, float] | None) -> tuple[int, int]:
    """Return the margin, rows and columns, that leaves out little light, or reaches up to the stop if that is nearer.

    Args:
        bare: where light arrives from without the stop.
        view: the image's.
        stop: see `FieldOfView.stop`.
    """
    steepest = math.tan(math.radians(STEEPEST_DEG))
    rows, columns = map(min, bare.margin(), _reaching(view, stop or (steepest, steepest)))
    return rows, columns


def margin_of_angle(view: View, margin_deg: float) -> tuple[int, int]:
    """Return the margin, rows and columns, that reaches so many degrees beyond the image's edges.

    Raises:
        InputError: a margin that reaches beyond `STEEPEST_DEG`.
    """
    edges_deg = [math.degrees(math.atan(edge)) for edge in (view.tan_half_height, view.tan_half_width)]
    if max(edges_deg) + margin_deg > STEEPEST_DEG:
        raise InputError("margin_deg", _too_steep(view, f"{margin_deg:g}", f"{STEEPEST_DEG - max(edges_deg):.3g}"))
    rows, columns = (math.tan(math.radians(edge + margin_deg)) for edge in edges_deg)
    return _reaching(view, (rows, columns))


def check_margin(view: View, margin: tuple[int, int]) -> tuple[int, int]:
    """Return a margin, rows and columns.

    Raises:
        InputError: it reaches beyond `STEEPEST_DEG`.
    """
    steepest = math.tan(math.radians(STEEPEST_DEG))
    most = [max(0, size - 1) for size in _reaching(view, (steepest, steepest))]
    if any(wanted > limit for wanted, limit in zip(margin, most, strict=True)):
        raise InputError("margin", _too_steep(view, f"{max(margin)}", f"{min(most)}"))
    return margin


def _reaching(view: View, tangents: tuple[float, float]) -> tuple[int, int]:
    """Return how many rows and columns beside the image reach as far as these angles' tangents."""
    pixel = view.pixel_pitch_m / view.distance_m
    edges = (view.tan_half_height, view.tan_half_width)
    rows, columns = (
        max(0, math.ceil((tangent - edge) / pixel - 1e-6)) for tangent, edge in zip(tangents, edges, strict=True)
    )
    return rows, columns


def _too_steep(view: View, got: str, most: str) -> str:
    edge_deg = math.degrees(math.atan(max(view.tan_half_height, view.tan_half_width)))
    if edge_deg >= STEEPEST_DEG:
        return (
            f"got {got}, but the image itself reaches to {edge_deg:.4g} degrees to the axis, and no margin reaches beyond "
            f"{STEEPEST_DEG:g}; expected none, a smaller image, or margin: auto, which adds what there is room for"
        )
    return f"got {got}, which reaches beyond {STEEPEST_DEG:g} degrees to the axis; expected at most {most}, or margin: auto"
