"""The words that all rooms share: clips of scene light, their sources, the camera's geometry, spectral responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

FARTHEST_M = 1e6
"""Stands for infinity in depth maps on disk: its disparity is zero for any camera, its square still fits float32."""


@dataclass(frozen=True)
class View:
    """The pinhole view that a scene is drawn for: one scene pixel is one sensor pixel at every depth.

    Pixel ``j`` of ``W`` looks along ``tan(theta) = x_j / distance_m`` with ``x_j = (j - (W - 1) / 2) * pixel_pitch_m``.
    World axes: x right, y down, z into the scene, origin at the mask centre.

    Attributes:
        shape: rows and columns of the scene image.
        pixel_pitch_m: the sensor's binned pixel pitch, metres.
        distance_m: mask to sensor, metres.
        near_m: nearest depth (z from the mask plane) that the scene may use, metres.
        far_m: farthest depth, metres; may be ``inf``.
        margin: rows above and below and columns left and right of the image from which light is simulated, too; it is in the
            measurement, but not in the ground truth.
    """

    shape: tuple[int, int]
    pixel_pitch_m: float
    distance_m: float
    near_m: float
    far_m: float
    margin: tuple[int, int] = (0, 0)

    @property
    def field(self) -> View:
        """The view of all that is simulated, the image with its margin."""
        rows, columns = (size + 2 * margin for size, margin in zip(self.shape, self.margin, strict=True))
        return replace(self, shape=(rows, columns), margin=(0, 0))

    @property
    def coarse_field(self) -> tuple[View, int]:
        """The field's view in coarse pixels, and how many of the image's each of them covers along each axis.

        Four, or three where a size is odd, so that both grids have the same middle; the coarse one may reach a little beyond
        the margin.
        """
        whole = self.field.shape
        coarseness = 3 if any(size % 2 for size in whole) else 4
        sizes = [-(-size // coarseness) for size in whole]
        rows, columns = (size + (size * coarseness - wanted) % 2 for size, wanted in zip(sizes, whole, strict=True))
        return replace(self.field, shape=(rows, columns), pixel_pitch_m=coarseness * self.pixel_pitch_m), coarseness

    @property
    def tan_half_width(self) -> float:
        """Tangent of the angle from the axis to the middle of the image's left or right edge."""
        return 0.5 * self.shape[1] * self.pixel_pitch_m / self.distance_m

    @property
    def tan_half_height(self) -> float:
        """Tangent of the angle from the axis to the middle of the image's upper or lower edge."""
        return 0.5 * self.shape[0] * self.pixel_pitch_m / self.distance_m

    @property
    def tangents(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tangents of the angles that the rows' and the columns' middles look along, ``(h,)`` and ``(w,)``."""
        pixel = self.pixel_pitch_m / self.distance_m
        rows, columns = ((np.arange(size, dtype=np.float64) - (size - 1) / 2) * pixel for size in self.shape)
        return rows, columns


@dataclass(frozen=True)
class Surroundings:
    """What shines beside a clip's image: coarse, because only its light matters.

    Attributes:
        rgb: linear radiance, float32 ``(T, h, w, 3)``, finite and not negative; a single frame stands for all. It spans the
            image and the margin around it, with the same middle; what lies under the image is not used.
        depth_m: z from the mask plane, float32 metres ``(T, h, w)``.
        coarseness: pixels of the image that one of these covers along each axis.

    Raises:
        InputError: when shapes, types or values break these rules.
    """

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    coarseness: int

    def __post_init__(self) -> None:
        _check_light("Surroundings", self.rgb, self.depth_m)
        if self.coarseness < 1:
            raise InputError("Surroundings.coarseness", f"got {self.coarseness}, expected at least 1")

    def within(self, farthest_m: float) -> Surroundings:
        """Return the same with depths that end there: files hold no infinite ones."""
        return replace(self, depth_m=np.minimum(self.depth_m, np.float32(farthest_m)))

    def frames(self, chosen: slice) -> Surroundings:
        """Return those of some frames."""
        still = len(self.rgb) == 1
        return self if still else replace(self, rgb=self.rgb[chosen], depth_m=self.depth_m[chosen])


@dataclass(frozen=True)
class Clip:
    """What a scene sends to the camera: ``T`` frames of linear light with depth; a still is a clip of one frame.

    Attributes:
        rgb: linear radiance, float32 ``(T, H, W, 3)``, finite and not negative.
        depth_m: z from the mask plane, float32 metres ``(T, H, W)``, positive; where ``valid`` is false, the far depth.
        valid: bool ``(T, H, W)``, false where no surface was seen.
        frame_edges_s: float64 seconds ``(T + 1,)`` after the start of the capture, increasing: frame ``t`` lasts from edge
            ``t`` to ``t + 1``.
        label: the class name of an action, or None.
        source: where the clip came from, JSON-serialisable; it is stored with the sample.
        extras: more that is known of every pixel, by name: arrays of numbers ``(T, H, W)`` or ``(T, H, W, n)``, finite; see
            `simulator.render.frames` for those that rendering gives.
        surroundings: what shines beside the image, where the view has a margin and the source knows it.

    Raises:
        InputError: when shapes, types or values break these rules.
    """

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    valid: NDArray[np.bool_]
    frame_edges_s: NDArray[np.float64]
    label: str | None = None
    source: dict[str, Any] = field(default_factory=dict)
    extras: dict[str, NDArray[Any]] = field(default_factory=dict)
    surroundings: Surroundings | None = None

    def __post_init__(self) -> None:
        _check_light("Clip", self.rgb, self.depth_m)
        frames_shape = self.rgb.shape[:3]
        if self.valid.shape != frames_shape or self.valid.dtype != np.bool_:
            raise InputError(
                "Clip.valid", f"expected bool {frames_shape} like rgb, got {self.valid.dtype} {self.valid.shape}"
            )
        edges = self.frame_edges_s
        if edges.shape != (frames_shape[0] + 1,) or not (np.all(np.diff(edges) > 0) and np.all(np.isfinite(edges))):
            raise InputError(
                "Clip.frame_edges_s",
                f"must hold {frames_shape[0] + 1} finite, strictly increasing seconds, got {edges!r}",
            )
        if self.surroundings is not None and len(self.surroundings.rgb) not in (1, len(self.rgb)):
            raise InputError(
                "Clip.surroundings", f"got {len(self.surroundings.rgb)} frames, expected 1 or {len(self.rgb)} like rgb"
            )
        for name, values in self.extras.items():
            if values.ndim not in (3, 4) or values.shape[:3] != frames_shape or not np.all(np.isfinite(values)):
                raise InputError(
                    f"Clip.extras[{name!r}]",
                    f"expected finite {frames_shape} or {(*frames_shape, 'n')}, got {values.shape}",
                )

    def still(self, frame: int) -> Clip:
        """Return a clip that shows one frame all the time; extras, such as motion to the next one, are left out."""
        every, around = np.full(len(self.rgb), frame), self.surroundings
        if around is not None and len(around.rgb) > 1:
            around = replace(around, rgb=around.rgb[[frame]], depth_m=around.depth_m[[frame]])
        shown = {name: getattr(self, name)[every] for name in ("rgb", "depth_m", "valid")}
        return replace(self, **shown, extras={}, surroundings=around)


def _check_light(name: str, rgb: NDArray[Any], depth_m: NDArray[Any]) -> None:
    if rgb.ndim != 4 or rgb.shape[-1] != 3 or rgb.dtype != np.float32:
        raise InputError(f"{name}.rgb", f"expected float32 (T, H, W, 3), got {rgb.dtype} {rgb.shape}")
    if depth_m.shape != rgb.shape[:3] or depth_m.dtype != np.float32:
        raise InputError(
            f"{name}.depth_m", f"expected float32 {rgb.shape[:3]} like rgb, got {depth_m.dtype} {depth_m.shape}"
        )
    if not (rgb.min() >= 0 and rgb.max() < np.inf):  # also catches NaN, and needs no memory
        raise InputError(
            f"{name}.rgb", "expected finite and not negative: linear radiance has no NaN, inf or negative values"
        )
    if not np.all(depth_m > 0):  # also catches NaN
        raise InputError(
            f"{name}.depth_m", f"expected positive metres from the mask plane, got a minimum of {depth_m.min()}"
        )


@runtime_checkable
class SceneSource(Protocol):
    """Anything that yields clips: a rendered family, an imported data set, the user's own class.

    The same index and a generator in the same state give the same clip, in any process and order. A source of finitely
    many clips also has ``len(source)``, and may have

    - ``groups``: the number of the video (or sequence) that each clip comes from, ``len(source)`` whole numbers that never
      fall; no two splits of a data set share a video. Without it every clip is a video of its own.
    - ``splits``: by name (``train``, ``validation``, ``test``) the clips that only this split may show, in their order, where
      the source keeps them apart itself; a split that it does not name takes from all.
    - ``problems``: lines ``"file: reason"`` about what was found and cannot be used; a job refuses them unless it is asked to
      go on without.

    Any source may have ``packages``: names, as pip knows them, of packages beside `simulator.dataset.fingerprint.PACKAGES`
    whose versions change what ``clip`` returns (``av`` decodes films); they become part of the fingerprint.
    """

    @property
    def inputs(self) -> Sequence[Path]:
        """Files whose contents decide what ``clip`` returns; they are hashed into the data set's fingerprint."""
        ...

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Return the clip of this number, from 0; a source with a length is only asked for numbers below it."""
        ...


@dataclass(frozen=True)
class SpectralResponse:
    """Relative photon weights of the camera's channels under one light.

    Attributes:
        wavelengths_m: ``(N,)`` metres, increasing and evenly spaced.
        weights: ``(C, N)``, not negative: illuminant x quantum efficiency x colour filter x wavelength.
        channels: one name per row of ``weights``, for example ``("R", "G", "B")``.
        label: where the curves come from; ``nominal`` in it marks stand-ins.
    """

    wavelengths_m: NDArray[np.float64]
    weights: NDArray[np.float64]
    channels: tuple[str, ...]
    label: str


class Refractive(Protocol):
    """Anything with a refractive index, such as ``simulator.optics.materials.Material``."""

    @property
    def name(self) -> str:
        """What it is, for provenance."""
        ...

    def index(self, wavelength_m: float) -> float:
        """Return the refractive index at a vacuum wavelength in metres."""
        ...


@dataclass(frozen=True)
class Layer:
    """A plane-parallel layer that light crosses, such as a sensor's cover glass or the air above it.

    Attributes:
        thickness_m: metres.
        material: what it is made of.
    """

    thickness_m: float
    material: Refractive


@dataclass(frozen=True)
class CameraGeometry:
    """What the optics need to know of a camera.

    Attributes:
        mask_to_sensor_m: distance from the mask's modulating surface to the sensor, metres; with a layered gap the distance
            in air at which paraxial rays would arrive at the same place, sum of d / n.
        pixel_pitch_m: binned pixel pitch, metres.
        response: relative photon weights per channel.
        gap: the layers from the mask's modulating surface to the sensor, in that order; empty for air alone.
        window: the layers in front of the mask, such as its substrate when the modulating surface faces the sensor, in the
            order in which light crosses them; source depths are measured from the modulating surface and include them.
    """

    mask_to_sensor_m: float
    pixel_pitch_m: float
    response: SpectralResponse
    gap: tuple[Layer, ...] = ()
    window: tuple[Layer, ...] = ()
