"""Temporal consistency: what a film changes where nothing but motion should, by the true motion of the scene.

Lai et al., Learning Blind Video Temporal Consistency, ECCV 2018, equation 9 (warping error), with rendered motion in place of
estimated flow (`render: {outputs: [motion]}`, `dataset: {ground_truth: frames}`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from torch import Tensor

from simulator.dataset.sample import StoredSample


class SliverMotion(NamedTuple):
    """Where pixels of each frame are in the next one.

    Attributes:
        places: ``(N - 1, h, w, 2)`` float64, columns and rows.
        seen: ``(N - 1, h, w)`` bool, whether the point is seen all the way; where nothing is, it stands still.
    """

    places: NDArray[np.float64]
    seen: NDArray[np.bool_]


def sliver_motion(stored: StoredSample, slivers: int) -> SliverMotion | None:
    """Return the motion from the middle of each sliver to that of the next; None where the sample does not record it.

    Motion is recorded from frame to frame; over the frames between two middles it is followed at the nearest pixel.
    """
    if "motion" not in stored.description.get("extras", {}) or stored.frames % slivers:
        return None
    length = stored.frames // slivers
    if stored.description["metadata"].get("frames_seen") != stored.frames:
        return None  # of slivers, motion leads to the next frame only
    frames = [stored.frame(number) for number in range(stored.frames)]
    rows, columns = frames[0].valid.shape
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    places, seen = [], []
    for sliver in range(slivers - 1):
        # The middle of an even number of frames lies between two: half a step of the first, half a step of the last.
        even = length % 2 == 0
        first = sliver * length + length // 2 - even
        steps = [0.5, *[1.0] * (length - 1), 0.5] if even else [1.0] * length
        at_x, at_y, visible, empty = x.copy(), y.copy(), np.ones(x.shape, bool), ~frames[first].valid
        for frame, step in zip(frames[first : first + len(steps)], steps, strict=True):
            j, i = np.rint(at_x).astype(int), np.rint(at_y).astype(int)
            visible &= (j >= 0) & (j < columns) & (i >= 0) & (i < rows)
            near = np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)
            visible &= np.where(empty, ~frame.valid, frame.extras["motion_valid"][near])
            at_x += np.where(empty, 0, step * frame.extras["motion"][near][..., 0])
            at_y += np.where(empty, 0, step * frame.extras["motion"][near][..., 1])
        visible &= (at_x >= 0) & (at_x <= columns - 1) & (at_y >= 0) & (at_y <= rows - 1)
        places.append(np.stack([at_x, at_y], axis=-1))
        seen.append(visible)
    return SliverMotion(np.stack(places), np.stack(seen))


def warping_error(film: Tensor, motion: SliverMotion) -> float:
    """Return the root mean square difference of a film's ``(N, 3, h, w)`` codes along the motion; NaN where none is seen."""
    rows, columns = film.shape[-2:]
    places = torch.from_numpy(motion.places).to(film.device)
    # grid_sample counts from -1 at the first pixel's centre to 1 at the last one's.
    grid = 2 * places / places.new_tensor([columns - 1, rows - 1]) - 1
    carried = nnf.grid_sample(film[1:].double(), grid, mode="bilinear", align_corners=True)
    seen = torch.from_numpy(motion.seen).to(film.device)[:, None].expand_as(carried)
    squares = (carried - film[:-1].double()).square()[seen]
    return float(squares.mean().sqrt()) if squares.numel() else float("nan")
