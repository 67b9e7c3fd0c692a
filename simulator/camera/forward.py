"""The forward model of the lensless camera: light of a scene over time -> exposure of the sensor, with its adjoint.

y[c,r,x] = crop sum_t dt_t S[t,r] sum_k ( H[k,c] (*) V[t,k,c] )[r,x]

2D is K = 1, a still T = 1, a global shutter a S that is the same for all rows: one call for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array
from simulator.camera.colour import to_camera
from simulator.camera.convolution import StackConvolution
from simulator.camera.planes import clamped_share, outside_planes, split_planes
from simulator.camera.shutter import Shutter
from simulator.camera.slivers import exposed_part, frame_shares, sliver_edges, sliver_length
from simulator.camera.surroundings import whole_frames
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.types import Clip


@dataclass(frozen=True)
class DepthRule:
    """How ``forward_clip`` puts depths on planes.

    Attributes:
        assignment: ``linear`` in disparity, or ``nearest``.
        max_clamped: largest share of valid pixels whose depth may lie outside the planes.
    """

    assignment: str = "linear"
    max_clamped: float = 0.01


class ForwardModel:
    """From scene light to radiant exposure per unit mask irradiance; linear, with ``adjoint`` as its transpose.

    Arrays may be NumPy or torch, like the stack's values; float32 or float64.
    """

    def __init__(
        self,
        stack: PsfStack,
        sensor_shape: tuple[int, int],
        scene_shape: tuple[int, int],
        shutter: Shutter | None = None,
        boundary: str = "linear",
        *,
        time: Literal["integral", "mean"] = "integral",
        irradiance: NDArray[np.float32] | None = None,
        scene_to_camera: NDArray[np.floating] | None = None,
        depth_rule: DepthRule | None = None,
    ) -> None:
        """Prepare the convolution.

        Args:
            stack: PSFs of K depths and C channels.
            sensor_shape: H, W of the (binned) sensor.
            scene_shape: h, w of the scene; of clips with surroundings, of the field that both make.
            shutter: None takes one frame with weight 1, so that y is an irradiance; with a shutter y is an exposure,
                irradiance x seconds.
            boundary: ``linear`` or ``circular``.
            time: ``integral`` gives exposures, ``mean`` divides them by each row's exposure time: the mean irradiance while
                the row was open, on the scale of a single frame.
            irradiance: ``(h, w)`` from `simulator.camera.field.FieldOfView`, used by ``forward_clip``; None means 1.
            scene_to_camera: ``(C, 3)`` from linear sRGB to the stack's channels, used by ``forward_clip``; None takes red,
                green and blue as they are.
            depth_rule: used by ``forward_clip``.
        """
        if time not in ("integral", "mean"):
            raise InputError("time", f"got {time!r}, expected 'integral' or 'mean'")
        self.stack, self.shutter, self.time = stack, shutter, time
        self.sensor_shape, self.scene_shape = sensor_shape, scene_shape
        self._convolution = StackConvolution(stack.values, sensor_shape, scene_shape, boundary)
        self._irradiance = np.ones(scene_shape, np.float32) if irradiance is None else irradiance
        self.scene_to_camera = np.eye(3) if scene_to_camera is None else scene_to_camera
        self._rule = depth_rule or DepthRule()

    def with_values(self, values: Array) -> ForwardModel:
        """Return the same camera with other values ``(K, C, H, W)`` of its PSFs, such as a tensor of them on a device."""
        other, convolution = copy(self), self._convolution
        other.stack = replace(self.stack, values=values)
        other._convolution = StackConvolution(values, self.sensor_shape, self.scene_shape, convolution.boundary)
        return other

    def forward(self, volume: Array, frame_edges_s: NDArray[np.float64] | None = None) -> Array:
        """Return the exposure ``(..., C, H, W)`` of a volume ``(T, K, ..., C, h, w)`` of mask irradiance.

        Args:
            volume: light of each frame and plane; ``...`` is a batch, or nothing.
            frame_edges_s: ``(T + 1,)`` seconds; not needed for one frame, which is taken to last long enough.

        Raises:
            InputError: for a wrong shape, or several frames without a shutter or edges.
        """
        expected = (*self.stack.values.shape[:2], *self.scene_shape)
        if volume.ndim < 5 or (*volume.shape[1:2], *volume.shape[-3:]) != expected:
            wanted = f"(T, K, ..., C, h, w) with (K, C, h, w) = {expected}"
            raise InputError("volume", f"expected {wanted}, got {tuple(volume.shape)}")
        return self._convolution.forward_rows(volume, self.row_weights(volume.shape[0], frame_edges_s))

    def adjoint(self, image: Array, frame_edges_s: NDArray[np.float64] | None = None) -> Array:
        """Return the volume ``(T, K, ..., C, h, w)`` of an image ``(..., C, H, W)``: the transpose of ``forward``."""
        expected = (self.stack.values.shape[1], *self.sensor_shape)
        if tuple(image.shape[-3:]) != tuple(expected):
            raise InputError("image", f"expected (..., C, H, W) with (C, H, W) = {expected}, got {tuple(image.shape)}")
        frames = 1 if frame_edges_s is None else len(frame_edges_s) - 1
        return self._convolution.adjoint_rows(image, self.row_weights(frames, frame_edges_s))

    def forward_clip(self, clip: Clip) -> NDArray[np.float32]:
        """Return the exposure ``(C, H, W)`` of a clip.

        Its planes are built one frame at a time: memory does not grow with the number of frames. A clip of one frame is a
        scene that stands still for as long as the shutter is open.

        Raises:
            InputError: when the clip's size or channels do not fit, it is shorter than the shutter, or more depths than
                allowed lie outside the planes.
        """
        clip = self._checked(clip)
        frames = len(clip.rgb)
        weights = self.row_weights(frames, clip.frame_edges_s if frames > 1 else None)
        return self._convolution.forward_rows(self._planes(clip), weights)

    def global_measurements(self, clip: Clip, slivers: int) -> Iterator[NDArray[np.float32]]:
        """Return, one by one, what a global shutter would give of each sliver, N times ``(C, H, W)``: MeasNet's targets.

        The mean over the sliver's time, seen by every row for the row's exposure time, so that they are on the scale of
        ``forward_clip``. See `simulator.camera.slivers`.

        Raises:
            InputError: as ``forward_clip``, and when the frames that the shutter sees cannot be shared equally.
        """
        clip = self._checked(clip)
        sliver_length(len(clip.rgb), slivers)
        planes, exposures = self._planes(clip), self._exposures().astype(np.float32)[:, None]

        def exposed(shares: NDArray[np.float64]) -> NDArray[np.float32]:
            alike = np.repeat(shares[:, None], self.sensor_shape[0], axis=1)
            return self._convolution.forward_rows((next(planes) for _ in shares), alike) * exposures

        return map(exposed, frame_shares(clip.frame_edges_s, slivers))

    def row_weights(self, frames: int = 1, frame_edges_s: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return the weight of each frame in each row of the stored image, ``(T, H)``: dt S, or dt S / T_exp.

        Args:
            frames: how many.
            frame_edges_s: ``(T + 1,)`` seconds; not needed for one frame, which is taken to last long enough.

        Raises:
            InputError: several frames without a shutter or edges, or edges that do not cover the shutter.
        """
        if frames == 1 and frame_edges_s is None:
            return self._exposures()[None]
        if self.shutter is None or frame_edges_s is None:
            raise InputError("volume", f"has {frames} frames; give a shutter and frame_edges_s, or one frame")
        # Shutter rows are physical; the stored image is rotated by 180 degrees.
        seconds = np.diff(frame_edges_s)[:, None] * self.shutter.weights(self.sensor_shape[0], frame_edges_s)[:, ::-1]
        return seconds if self.time == "integral" else seconds / self._open_s()

    def sliver_weights(self, frame_edges_s: NDArray[np.float64], slivers: int) -> NDArray[np.float64]:
        """Return the mean of S over each sliver's frames, for the stored image's rows: ``(N, H)``.

        Args:
            frame_edges_s: ``(T + 1,)`` seconds of the frames that the shutter sees.
            slivers: N, which divides T.

        Raises:
            InputError: no shutter, edges that do not cover it, or frames that cannot be shared equally.
        """
        if self.shutter is None:
            raise InputError("shutter", "got None; a capture has slivers only under a shutter: give the model one")
        return self.shutter.weights(self.sensor_shape[0], sliver_edges(frame_edges_s, slivers))[:, ::-1]

    def _open_s(self) -> NDArray[np.float64]:
        """Return the exposure times of the stored image's rows, ``(H,)`` seconds; ones without a shutter."""
        rows = self.sensor_shape[0]
        return np.ones(rows) if self.shutter is None else self.shutter.exposures_s(rows)[::-1]

    def clamped_light(self, clip: Clip) -> float:
        """Return the share of a clip's light, image and surroundings, that ``forward_clip`` moves onto an outermost plane."""
        whole = clamped = 0.0
        for rgb, depth_m in whole_frames(clip, self.scene_shape):
            light = rgb.sum(axis=-1) * self._irradiance
            whole += float(light.sum())
            clamped += float(light[outside_planes(depth_m, self.stack.depths_m)].sum())
        return clamped / whole if whole else 0.0

    def _exposures(self) -> NDArray[np.float64]:
        """Return what an irradiance of 1 that lasts gives in the stored image's rows, ``(H,)``."""
        return self._open_s() if self.time == "integral" else np.ones(self.sensor_shape[0])

    def _checked(self, clip: Clip) -> Clip:
        """Return the part of a clip that the shutter sees, after all checks."""
        channels = self.stack.channels
        if len(self.scene_to_camera) != len(channels):
            raise InputError(
                "scene_to_camera",
                f"got {len(self.scene_to_camera)} rows, expected one per channel of the PSF stack ({', '.join(channels)})",
            )
        if self.shutter is not None:
            clip = exposed_part(clip, self.shutter, self.sensor_shape[0])
        depths_m = self.stack.depths_m
        share = clamped_share(clip.depth_m, clip.valid, depths_m)
        if share > self._rule.max_clamped:
            seen = clip.depth_m[clip.valid]
            raise InputError(
                "clip",
                f"{share:.1%} of its pixels ({seen.min():g} to {seen.max():g} m) lie outside the PSF stack's "
                f"{depths_m[0]:g} to {depths_m[-1]:g} m; widen psf.near_cm / psf.far_cm, or raise forward.max_clamped "
                "to clamp them",
            )
        return clip

    def _planes(self, clip: Clip) -> Iterator[NDArray[np.float32]]:
        """Yield the irradiance at the mask of each frame on the depth planes, ``(K, C, h, w)``."""
        for rgb, depth_m in whole_frames(clip, self.scene_shape):
            light = to_camera(rgb, self.scene_to_camera) * self._irradiance
            yield split_planes(light, depth_m, self.stack.depths_m, self._rule.assignment)
