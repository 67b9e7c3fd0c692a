"""What the figures show: Gaussian PSFs of known width, and clips whose every pixel is known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import RendererAgg

from simulator.optics.stack import PsfStack
from simulator.plots.comparison import Candidate, judge
from simulator.types import Clip

AREA_M2 = 2e-6


@pytest.fixture(scope="session")
def gaussian_candidate() -> Callable[..., Candidate]:
    """Return a function that makes a candidate whose PSF has a standard deviation per depth, in pixels of 10 um."""

    def make(name: str = "gaussian", sigmas: tuple[float, ...] = (3.0, 4.0), camera: str = "a camera") -> Candidate:
        at = np.arange(81) - 40
        planes = [np.exp(-(at[:, None] ** 2 + at[None, :] ** 2) / (2 * sigma**2)) for sigma in sigmas]
        values = np.stack([plane / plane.sum() * AREA_M2 / 1e-10 for plane in planes])[:, None].repeat(3, 1)
        provenance = {
            "mask": {"name": name, "transmitted_area_m2": AREA_M2, "shape": [100, 100], "pitch_m": 2e-6},
            "sampling": {"error": 0.0123},
            "errors": {"spectrum": {"channels": {"R": 0.12, "G": 0.34, "B": 0.23}, "lines": 9}},
        }
        depths = np.linspace(0.04, 0.2, len(sigmas))
        stack = PsfStack(values, depths, 1e-5, ("R", "G", "B"), "test", provenance)
        off_sensor = np.tile(np.linspace(0.25, 0.5, len(sigmas))[:, None], (1, 3))
        return judge(name, stack, camera, [("model", "a <drawn> Gaussian")], off_sensor)

    return make


def draw_clip(frames: int = 1, rows: int = 64, columns: int = 64, extras: bool = False) -> Clip:
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


@pytest.fixture(scope="session")
def known_clip() -> Callable[..., Clip]:
    """The function draw_clip."""
    return draw_clip


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> dict[Any, Any]:
    """What is written into figures while they are drawn: {text artist: its box}, ticks outside the axes left out."""
    boxes = {}
    draw_text = RendererAgg.draw_text

    def record(self, gc, x, y, s, prop, angle, ismath=False, mtext=None):
        if mtext is not None and s.strip():
            boxes[mtext] = mtext.get_window_extent(self)
        return draw_text(self, gc, x, y, s, prop, angle, ismath, mtext)

    monkeypatch.setattr(RendererAgg, "draw_text", record)
    return boxes
