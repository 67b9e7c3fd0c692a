"""Slivers: a capture through a moving shutter, taken apart in time.

The frames that a shutter sees are put into N groups of equally many. The n-th sliver is the measurement times the mean of S
over its frames; the scene that belongs to it is the mean of its frames (the thesis: 60 frames are 10 slivers of 6).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, like
from simulator.camera.shutter import Shutter
from simulator.errors import InputError
from simulator.types import Clip


def exposed_part(clip: Clip, shutter: Shutter, rows: int) -> Clip:
    """Return the clip without the frames that begin after the last of so many stored rows has closed; a still as it is."""
    if len(clip.rgb) == 1:
        return clip
    end = shutter.duration_s(rows)
    seen = max(int(np.count_nonzero(clip.frame_edges_s[:-1] < end * (1 - 1e-9))), 1)
    return clip if seen == len(clip.rgb) else _frames_of(clip, slice(0, seen), clip.frame_edges_s[: seen + 1])


def sliver_length(frames: int, slivers: int) -> int:
    """Return how many frames a sliver holds.

    Raises:
        InputError: when the frames cannot be shared equally.
    """
    if not 1 <= slivers <= frames or frames % slivers:
        fitting = [number for number in range(1, frames + 1) if frames % number == 0]
        nearest = min(fitting, key=lambda number: abs(number - slivers))
        msg = (
            f"slivers: got {slivers} for a capture that sees {frames} frames, which do not come out even; take {nearest} "
            "slivers, or change the number of frames or the shutter's times"
        )
        raise InputError(msg)
    return frames // slivers


def sliver_weights(weights: NDArray[np.float64], slivers: int) -> NDArray[np.float64]:
    """Return the mean of S over the frames of each sliver, ``(N, rows)``, from S ``(T, rows)`` of the frames seen."""
    length = sliver_length(len(weights), slivers)
    return weights.reshape(slivers, length, -1).mean(axis=1)


def split_measurement(measurement: Array, weights: NDArray[np.float64]) -> Array:
    """Return the slivers ``(N, C, H, W)`` of a measurement ``(C, H, W)``.

    Args:
        measurement: NumPy or torch, in the stored orientation.
        weights: ``(N, H)``, in the stored orientation, as `ForwardModel.sliver_weights` gives them.
    """
    return like(weights[:, None, :, None], measurement) * measurement[None]


def sliver_means(clip: Clip, slivers: int) -> Clip:
    """Return a clip of N frames, the slivers': mean radiance; depth, validity and extras of the frame in the middle.

    Depths are not averaged: a mean of fore- and background is neither.

    Raises:
        InputError: when the frames cannot be shared equally.
    """
    frames = len(clip.rgb)
    length = sliver_length(frames, slivers)
    if length == 1:
        return clip
    means = clip.rgb.reshape(slivers, length, *clip.rgb.shape[1:]).mean(axis=1, dtype=np.float32)
    return replace(_frames_of(clip, slice(length // 2, None, length), clip.frame_edges_s[::length]), rgb=means)


def _frames_of(clip: Clip, frames: slice, frame_edges_s: NDArray[np.float64]) -> Clip:
    return replace(
        clip,
        rgb=clip.rgb[frames],
        depth_m=clip.depth_m[frames],
        valid=clip.valid[frames],
        frame_edges_s=frame_edges_s,
        extras={name: values[frames] for name, values in clip.extras.items()},
    )
