"""Clips whose every pixel is known."""

import numpy as np

from simulator.types import Clip


def known_clip(frames: int = 1, rows: int = 64, columns: int = 64, extras: bool = False) -> Clip:
    """Grey 0.25, a green block of radiance 2 that jumps 16 pixels to the right per frame; half is near, a corner unseen."""
    rgb = np.full((frames, rows, columns, 3), 0.25, np.float32)
    depth = np.full((frames, rows, columns), 0.2, np.float32)
    depth[:, : rows // 2] = 0.04
    valid = np.ones(depth.shape, bool)
    valid[:, -8:, -8:] = False
    for frame in range(frames):
        rgb[frame, :16, 16 * frame : 16 * frame + 16] = (0, 2.0, 0)
    more: dict[str, np.ndarray] = {}
    if extras:
        shape_id = np.where(valid, 0, -1).astype(np.int32)
        normal = np.where(valid[..., None], np.array([0, 0, -1], np.float32), np.float32(0))
        motion = np.zeros((frames, rows, columns, 3), np.float32)
        moves = np.zeros(depth.shape, bool)
        for frame in range(frames):
            shape_id[frame, :16, 16 * frame : 16 * frame + 16] = 1
            if frame + 1 < frames:
                motion[frame, :16, 16 * frame : 16 * frame + 16, 0] = 16
                moves[frame] = valid[frame]
        more = {
            "shape_id": shape_id,
            "normal": normal,
            "albedo": np.full(rgb.shape, 0.5, np.float32),
            "motion": motion,
            "motion_valid": moves,
            "hidden1_rgb": np.full(rgb.shape, 2.0, np.float32),
            "hidden1_depth_m": np.full(depth.shape, 0.2, np.float32),
            "hidden1_valid": ~valid,
        }
    return Clip(rgb, depth, valid, np.arange(frames + 1) / 1000, extras=more)
