"""The forward model of the lensless camera: light of a scene -> exposure of the sensor, with its adjoint.

y[c,r,x] = crop sum_t dt_t S[t,r] sum_k ( H[k,c] (*) V[t,k,c] )[r,x]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, like, namespace
from simulator.camera.colour import to_camera
from simulator.camera.convolution import StackConvolution
from simulator.camera.planes import clamped_share, split_planes
from simulator.camera.shutter import GlobalShutter
from simulator.errors import InputError
from simulator.optics.psf_stack import PsfStack
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
        shutter: GlobalShutter | None = None,
        boundary: str = "linear",
        *,
        irradiance: NDArray[np.float32] | None = None,
        scene_to_camera: NDArray[np.floating] | None = None,
        depth_rule: DepthRule | None = None,
    ) -> None:
        """Prepare the convolution.

        Args:
            stack: PSFs of K depths and C channels.
            sensor_shape: H, W of the (binned) sensor.
            scene_shape: h, w of the scene.
            shutter: None takes one frame with weight 1, so that y is an irradiance; with a shutter y is an exposure,
                irradiance x seconds.
            boundary: ``linear`` or ``circular``.
            irradiance: ``(h, w)`` from ``mask_irradiance``, used by ``forward_clip``; None means 1.
            scene_to_camera: ``(C, 3)`` from linear sRGB to the stack's channels, used by ``forward_clip``; None takes red,
                green and blue as they are.
            depth_rule: used by ``forward_clip``.

        Raises:
            InputError: when the shapes do not fit.
        """
        self.stack, self.shutter = stack, shutter
        self.sensor_shape, self.scene_shape = sensor_shape, scene_shape
        self._convolution = StackConvolution(stack.values, sensor_shape, scene_shape, boundary)
        self._irradiance = np.ones(scene_shape, np.float32) if irradiance is None else irradiance
        self.scene_to_camera = np.eye(3) if scene_to_camera is None else scene_to_camera
        self._rule = depth_rule or DepthRule()

    def forward(self, volume: Array, frame_edges_s: NDArray[np.float64] | None = None) -> Array:
        """Return the exposure ``(C, H, W)`` of a volume ``(T, K, C, h, w)`` of mask irradiance.

        Args:
            volume: light of each frame and plane.
            frame_edges_s: ``(T + 1,)`` seconds; not needed for one frame, which is taken to last long enough.

        Raises:
            InputError: for a wrong shape, or several frames without a shutter or edges.
        """
        expected = (*self.stack.values.shape[:2], *self.scene_shape)
        if volume.ndim != 5 or tuple(volume.shape[1:]) != tuple(expected):
            msg = f"volume must be (T, K, C, h, w) with (K, C, h, w) = {tuple(expected)}, got {tuple(volume.shape)}"
            raise InputError(msg)
        weights = self._row_weights(volume.shape[0], frame_edges_s)
        return sum(
            like(w[:, None], volume) * self._convolution.forward(v) for w, v in zip(weights, volume, strict=True)
        )

    def adjoint(self, image: Array, frame_edges_s: NDArray[np.float64] | None = None) -> Array:
        """Apply the transpose of ``forward`` to an image ``(C, H, W)``: the result is a volume ``(T, K, C, h, w)``."""
        expected = (self.stack.values.shape[1], *self.sensor_shape)
        if tuple(image.shape) != tuple(expected):
            msg = f"image must be (C, H, W) = {tuple(expected)}, got {tuple(image.shape)}"
            raise InputError(msg)
        frames = 1 if frame_edges_s is None else len(frame_edges_s) - 1
        weights = self._row_weights(frames, frame_edges_s)
        return namespace(image).stack([self._convolution.adjoint(like(w[:, None], image) * image) for w in weights])

    def forward_clip(self, clip: Clip) -> NDArray[np.float32]:
        """Return the exposure ``(C, H, W)`` of a clip; its planes are built one frame at a time.

        Raises:
            InputError: when the clip's size or channels do not fit, or more depths than allowed lie outside the planes.
        """
        frames, height, width, _ = clip.rgb.shape
        if (height, width) != tuple(self.scene_shape):
            msg = f"clip: its frames are {(height, width)}, but the model was made for scenes of {self.scene_shape}"
            raise InputError(msg)
        channels = self.stack.channels
        if len(self.scene_to_camera) != len(channels):
            msg = (
                f"scene_to_camera: got {len(self.scene_to_camera)} rows for the PSF stack's {len(channels)} channels "
                f"({', '.join(channels)}); give a row of three numbers per channel"
            )
            raise InputError(msg)
        depths_m = self.stack.depths_m
        share = clamped_share(clip.depth_m, clip.valid, depths_m)
        if share > self._rule.max_clamped:
            seen = clip.depth_m[clip.valid]
            msg = (
                f"clip: {share:.1%} of its pixels lie outside the PSF stack's depths, {depths_m[0]:g} to {depths_m[-1]:g} m "
                f"(the scene spans {seen.min():g} to {seen.max():g} m); widen psf.near_cm / psf.far_cm, or raise "
                "forward.max_clamped to clamp them"
            )
            raise InputError(msg)
        weights = self._row_weights(frames, clip.frame_edges_s if frames > 1 else None)
        total = np.zeros((self.stack.values.shape[1], *self.sensor_shape), np.float32)
        for rgb, depth_m, row_weight in zip(clip.rgb, clip.depth_m, weights, strict=True):
            light = to_camera(rgb, self.scene_to_camera) * self._irradiance
            planes = split_planes(light, depth_m, depths_m, self._rule.assignment)
            total += row_weight.astype(np.float32)[:, None] * self._convolution.forward(planes)
        return total

    def _row_weights(self, frames: int, frame_edges_s: NDArray[np.float64] | None) -> NDArray[np.float64]:
        """Return dt_t S[t, r] for the stored image's rows, ``(T, H)``."""
        rows = self.sensor_shape[0]
        if frames == 1 and frame_edges_s is None:
            return np.full((1, rows), 1.0 if self.shutter is None else self.shutter.exposure_s)
        if self.shutter is None or frame_edges_s is None:
            msg = f"volume: {frames} frames need a shutter and frame_edges_s; without them only one frame has a meaning"
            raise InputError(msg)
        # Shutter rows are physical; the stored image is turned by 180 degrees.
        shares = self.shutter.weights(rows, frame_edges_s)[:, ::-1]
        return np.diff(frame_edges_s)[:, None] * shares
