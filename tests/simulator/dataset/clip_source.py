"""A source of clips for the tests: in each of some videos a square moves to the right and towards the camera."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.errors import InputError
from simulator.types import Clip


@dataclass(frozen=True)
class Squares:
    view: object
    frames: int
    rate: float
    videos: int
    clips_per_video: int
    bad: tuple[int, ...]
    marker: Path | None
    problems: tuple[str, ...]
    inputs: tuple[Path, ...] = ()

    def __len__(self):
        return self.videos * self.clips_per_video

    @property
    def groups(self):
        return [place // self.clips_per_video for place in range(len(self))]

    def clip(self, index, rng):
        assert 0 <= index < len(self)
        if self.marker is not None:
            with open(f"{self.marker}.log", "a") as log:
                log.write(f"{index}\n")
        video = index // self.clips_per_video
        if video in self.bad:
            raise InputError(f"video_{video}.webm", "truncated")
        rows, columns = self.view.shape
        rgb = np.full((self.frames, rows, columns, 3), 0.05, np.float32)
        depth = np.full(rgb.shape[:3], self.view.far_m, np.float32)
        colour = rng.random(3)
        for frame in range(self.frames):
            window = np.s_[frame, 3 + video : 8 + video, frame % columns : frame % columns + 4]
            rgb[window] = colour
            depth[window] = self.view.far_m + (self.view.near_m - self.view.far_m) * (frame + 1) / self.frames
        valid = np.ones(depth.shape, bool)
        valid[np.arange(self.frames), 0, np.arange(self.frames) % columns] = False
        edges_s = np.arange(self.frames + 1) / self.rate
        return Clip(rgb, depth, valid, edges_s, f"class {video % 2}", {"video": f"video_{video}", "clip": index})


def squares(
    view,
    *,
    frames: int = 12,
    rate: float = 1000.0,
    videos: int = 6,
    clips_per_video: int = 2,
    bad: tuple[int, ...] = (),
    marker: Path | None = None,
    problems: tuple[str, ...] = (),
):
    """Squares that move."""
    return Squares(view, frames, rate, videos, clips_per_video, bad, marker, problems)
