"""What importers of films share: a video whose frames are read when they are wanted, and how clips are cut out of videos."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


class Video(Protocol):
    """A film, cheap to hold and to pickle: names and numbers only, frames are read when they are asked for.

    Attributes:
        packages: what decodes it, as pip knows it; its version counts in the data set's fingerprint.
    """

    packages: ClassVar[tuple[str, ...]]

    @property
    def name(self) -> str:
        """What it is called, in records and messages."""
        ...

    @property
    def frames_per_second(self) -> float | None:
        """Its own frame rate, or None where it has none; a plan must then say one."""
        ...

    @property
    def label(self) -> str | None:
        """Its class, or None."""
        ...

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that it is made of; they are hashed into the data set's fingerprint."""
        ...

    def __len__(self) -> int:
        """Return how many frames can be used."""
        ...

    def read(self, start: int, stop: int) -> Iterable[NDArray[np.float32]]:
        """Give frames one after the other as linear light ``(H, W, 3)``, all of one size, black where nothing is to be seen.

        An array ``(T, H, W, 3)`` will do; reading them one by one keeps large frames out of memory. Full scale is 1; pictures
        of linear light may hold more.

        Raises:
            InputError: naming the file that is broken.
        """
        ...

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return where these frames come from and what was done to them, JSON-serialisable."""
        ...


@dataclass(frozen=True)
class ClipPlan:
    """How clips are cut out of videos.

    Attributes:
        frames: of a clip, after raising.
        frames_per_second: rate at which a clip is taken to have been filmed; None is the video's own, raised. A shutter of
            some milliseconds sees motion in a film of 24 frames per second only if that is taken to run faster.
        raise_by: frames that one of the video's becomes, by interpolation; 1 leaves them.
        clips_per_video: how many clips a video gives, evenly spread over it; 1 begins anywhere, as the sample's random
            stream says.
        crop: where the view is cut out of the picture: in the ``centre`` or at a ``random`` place, the same for all frames.
    """

    frames: int
    frames_per_second: float | None = None
    raise_by: int = 1
    clips_per_video: int = 1
    crop: Literal["centre", "random"] = "centre"

    @property
    def needed(self) -> int:
        """The video's frames that a clip takes: r times as many frames between each two, and the last one."""
        return -(-(self.frames - 1) // self.raise_by) + 1

    def start(self, available: int, number: int, rng: np.random.Generator) -> int:
        """Return the first frame of a video's clip.

        Args:
            available: frames that the video has.
            number: which of the video's clips, from 0.
            rng: the sample's.

        Raises:
            InputError: the video is too short.
        """
        spare = available - self.needed
        if spare < 0:
            raise InputError(self.too_short(available))
        if self.clips_per_video == 1:
            return int(rng.integers(spare + 1))
        if self.clips_per_video > spare + 1:
            raise InputError(self.too_alike(available))
        return round(number * spare / (self.clips_per_video - 1))

    def fault(self, available: int) -> str | None:
        """Say why a video of so many frames cannot give its clips, or None where it can."""
        if available < self.needed:
            return self.too_short(available)
        if self.clips_per_video > available - self.needed + 1:
            return self.too_alike(available)
        return None

    def too_alike(self, available: int) -> str:
        """Say why a video of so many frames does not give so many clips."""
        fit = available - self.needed + 1
        return (
            f"has {available} frames, in which no more than {fit} different clips of {self.frames} begin, but "
            f"clips_per_video is {self.clips_per_video}: ask for fewer"
        )

    def too_short(self, available: int) -> str:
        """Say why a video of so many frames gives no clip."""
        raised = f", raised by {self.raise_by}" if self.raise_by > 1 else ""
        return (
            f"has {available} frames, but a clip of {self.frames}{raised} takes {self.needed}: ask for fewer, or raise "
            "them by more"
        )
