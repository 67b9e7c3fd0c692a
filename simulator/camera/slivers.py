"""Slivers: a capture through a moving shutter, taken apart in time.

The frames that a shutter sees are put into N groups of equally many. The n-th sliver is the measurement times the mean of S
over its frames; the scene that belongs to it is the mean of its frames (the thesis: 60 frames are 10 slivers of 6). Means are
over time: where frames differ in length, each counts as long as it lasts. As S is the share of an interval, its mean over a
sliver's frames is S of the sliver's whole time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, like
from simulator.camera.shutter import ROUNDING, Shutter
from simulator.errors import InputError
from simulator.types import Clip


def frames_seen(frame_edges_s: NDArray[np.float64], shutter: Shutter, rows: int) -> slice:
    """Return which frames last while any of so many stored rows is open; the clip must cover the capture."""
    first, last = shutter.span_s(rows)
    start = int(np.count_nonzero(frame_edges_s[1:] <= first + ROUNDING * last))
    return slice(start, max(int(np.count_nonzero(frame_edges_s[:-1] < last * (1 - ROUNDING))), start + 1))


def exposed_part(clip: Clip, shutter: Shutter, rows: int) -> Clip:
    """Return the clip without frames during which none of so many stored rows is open; a still as it is.

    Raises:
        InputError: the clip does not cover the capture.
    """
    if len(clip.rgb) == 1:
        return clip
    shutter.check_covered(rows, clip.frame_edges_s)
    seen = frames_seen(clip.frame_edges_s, shutter, rows)
    if seen == slice(0, len(clip.rgb)):
        return clip
    return _frames_of(clip, seen, clip.frame_edges_s[seen.start : seen.stop + 1])


def sliver_length(frames: int, slivers: int) -> int:
    """Return how many frames a sliver holds.

    Raises:
        InputError: when the frames cannot be shared equally.
    """
    if not 1 <= slivers <= frames or frames % slivers:
        fitting = [number for number in range(1, frames + 1) if frames % number == 0]
        nearest = min(fitting, key=lambda number: abs(number - slivers))
        raise InputError(
            "slivers",
            f"got {slivers}, which does not divide the {frames} frames that the shutter sees; take {nearest}, or "
            "change the frames or the shutter's times",
        )
    return frames // slivers


def sliver_edges(frame_edges_s: NDArray[np.float64], slivers: int) -> NDArray[np.float64]:
    """Return when slivers begin and end, ``(N + 1,)`` seconds, from the edges ``(T + 1,)`` of the frames seen."""
    return frame_edges_s[:: sliver_length(len(frame_edges_s) - 1, slivers)]


def frame_shares(frame_edges_s: NDArray[np.float64], slivers: int) -> NDArray[np.float64]:
    """Return which share of its sliver's time each frame lasts, ``(N, T / N)``; rows add up to 1."""
    durations = np.diff(frame_edges_s).reshape(slivers, -1)
    return durations / durations.sum(axis=1, keepdims=True)


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
    """
    length = sliver_length(len(clip.rgb), slivers)
    if length == 1:
        return clip
    edges_s = sliver_edges(clip.frame_edges_s, slivers)
    shares = frame_shares(clip.frame_edges_s, slivers).astype(np.float32)

    def means(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.einsum("nt,nthwc->nhwc", shares, rgb.reshape(slivers, length, *rgb.shape[1:]))

    middle = _frames_of(clip, slice(length // 2, None, length), edges_s)
    if (around := middle.surroundings) is not None and clip.surroundings is not None and len(clip.surroundings.rgb) > 1:
        middle = replace(middle, surroundings=replace(around, rgb=means(clip.surroundings.rgb)))
    return replace(middle, rgb=means(clip.rgb))


def _frames_of(clip: Clip, frames: slice, frame_edges_s: NDArray[np.float64]) -> Clip:
    around = clip.surroundings
    return replace(
        clip,
        rgb=clip.rgb[frames],
        depth_m=clip.depth_m[frames],
        valid=clip.valid[frames],
        frame_edges_s=frame_edges_s,
        extras={name: values[frames] for name, values in clip.extras.items()},
        surroundings=None if around is None else around.frames(frames),
    )
