"""Captures without a data set: a measurement of a real camera and its measured PSFs are all that is known."""

from __future__ import annotations

import numpy as np

from learning.capture import CaptureModel
from simulator.arrays import Array, to_numpy
from simulator.errors import InputError
from simulator.optics.stack import PsfStack


def plain_capture(
    stack: PsfStack,
    sensor_shape: tuple[int, int],
    scene_shape: tuple[int, int] | None = None,
    *,
    background: float | Array = 0.0,
    white: float = 1.0,
) -> CaptureModel:
    """Return a camera of which only the PSFs are known: gain 1, no vignetting, camera colours shown as they are.

    Radiance then has the unit of measurement / PSF, with an unknown factor where the PSF's exposure was another one.

    Args:
        stack: the PSFs; one channel (grey) or three (red, green, blue).
        sensor_shape: H, W of the measurement.
        scene_shape: h, w of the picture around the centre; None takes the sensor's, the picture that a pinhole in the
            mask's place would give.
        background: what the measurement shows without light, one number or one per channel.
        white: the radiance that pictures show as 1; see `typical_white`.

    Raises:
        InputError: a stack of other than one or three channels, or shapes and numbers that `CaptureModel` refuses.
    """
    channels = len(stack.channels)
    if channels not in (1, 3):
        msg = f"stack: got {channels} channels ({', '.join(stack.channels)}), expected 1 (grey) or 3 (red, green, blue)"
        raise InputError(msg)
    scene = sensor_shape if scene_shape is None else scene_shape
    return CaptureModel(
        stack=stack,
        sensor_shape=sensor_shape,
        scene_shape=scene,
        gain=1.0,
        offset=np.broadcast_to(np.asarray(background, np.float64), channels).copy(),
        irradiance=np.ones(scene, np.float32),
        # A third of each: its pseudo-inverse gives the grey value to red, green and blue alike.
        scene_to_camera=np.eye(3) if channels == 3 else np.full((1, 3), 1 / 3),
        white=white,
    )


def typical_white(capture: CaptureModel, measurement: Array) -> float:
    """Return a radiance to be shown as 1: twice the mean of a scene that sends as much light as was measured.

    For a capture whose unit is unknown; of data sets it is measured once for all, see `learning.display.measure_white`.

    Args:
        capture: the camera, its ``white`` unused.
        measurement: ``(..., C, H, W)``.

    Raises:
        InputError: a measurement without light above the background.
    """
    light = to_numpy(measurement).astype(np.float64) - capture.offset[:, None, None]
    # A pixel of radiance 1 gives gain x irradiance x the PSF's sum, were the sensor large enough to hold it.
    response = capture.gain * np.mean(np.sum(to_numpy(capture.stack.values), axis=(-2, -1), dtype=np.float64), axis=0)
    per_scene = np.sum(light, axis=(-2, -1)) / (response * np.sum(capture.irradiance, dtype=np.float64))
    mean = float(np.mean(per_scene))
    if not mean > 0:
        msg = (
            f"measurement: got a mean radiance of {mean:.3g} above the background, expected light; check the background"
        )
        raise InputError(msg)
    return 2 * mean
