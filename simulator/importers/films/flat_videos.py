"""Videos as flat scenes: clips cut out of films, each on a plane that faces the camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from simulator.errors import InputError
from simulator.importers.films.fit import fit_frames
from simulator.importers.films.video import ClipPlan, Video
from simulator.importers.survey import first_lines
from simulator.types import FARTHEST_M, Clip, View

if TYPE_CHECKING:
    from simulator.importers.raising import Raiser


def plane_depth(view: View, plane_cm: float | None) -> float:
    """Return the plane's depth in metres: as given, else the view's far depth.

    Raises:
        InputError: when it lies outside near..far.
    """
    if plane_cm is None:
        return min(view.far_m, FARTHEST_M)
    if not view.near_m <= plane_cm * 1e-2 <= view.far_m:
        msg = (
            f"plane_cm: got {plane_cm:g}, which is outside near..far = {view.near_m * 100:.4g}..{view.far_m * 100:.4g} "
            "cm; choose a depth inside, or set scene.near_cm and scene.far_cm"
        )
        raise InputError(msg)
    return plane_cm * 1e-2


def choose_raiser(
    raise_by: int, raise_with: Literal["optical_flow", "superslomo"], checkpoint: Path | None
) -> Raiser | None:
    """Return what interpolates frames, or None where none are wanted.

    Raises:
        InputError: the checkpoint is missing, broken, or meaningless for what was asked.
    """
    if raise_by == 1:
        if checkpoint is not None:
            msg = (
                f"superslomo_checkpoint is {checkpoint}, but raise_by: 1 leaves the frames: leave it out or raise more"
            )
            raise InputError(msg)
        if raise_with != "optical_flow":
            msg = f"raise_with: got {raise_with}, but raise_by: 1 leaves the frames: leave it out or raise more"
            raise InputError(msg)
        return None
    # OpenCV or torch, which nobody needs who raises nothing.
    from simulator.importers.raising import build_raiser

    return build_raiser(raise_with, checkpoint)


def flat_videos(
    importer: str,
    view: View,
    videos: Iterable[Video],
    *,
    plan: ClipPlan,
    plane_m: float,
    raiser: Raiser | None = None,
    problems: Iterable[str] = (),
    other_inputs: Iterable[Path] = (),
) -> FlatVideos:
    """Make a source of those videos that are long enough, and list the others among its problems.

    Args:
        importer: its name, for the samples' records.
        view: the camera's view.
        videos: in the order in which splits are filled.
        plan: how clips are cut out of them.
        plane_m: depth of the plane.
        raiser: what interpolates frames; needed when ``plan.raise_by`` is more than 1.
        problems: lines ``"file: reason"`` that were found already.
        other_inputs: files beside the videos' own that decide what a clip holds, such as label files.

    Raises:
        InputError: no video can be used.
    """
    usable: list[Video] = []
    found = list(problems)
    for video in videos:
        if fault := plan.fault(len(video)):
            found.append(f"{video.name}: {fault}")
        else:
            usable.append(video)
    if not usable:
        listed = "".join(f"\n  {line}" for line in first_lines(found, 10))
        msg = f"source: {importer} found no video that can be used{':' if found else ''}{listed}"
        raise InputError(msg)
    return FlatVideos(importer, view, tuple(usable), plan, plane_m, raiser, tuple(found), tuple(other_inputs))


@dataclass(frozen=True)
class FlatVideos:
    """A scene source of clips on a plane; picklable, it holds names and numbers only.

    Black light of a removed background lies on the same plane: it is known that no light comes from there, so ``valid`` is
    true everywhere.

    Attributes:
        importer: the name of what made it.
        view: the camera's view.
        videos: long enough for the plan.
        plan: how clips are cut out of them.
        plane_m: depth of the plane.
        raiser: what interpolates frames, or None.
        problems: lines ``"file: reason"`` about what cannot be used and was left out.
        other_inputs: files beside the videos' own that decide what a clip holds.
    """

    importer: str
    view: View
    videos: tuple[Video, ...]
    plan: ClipPlan
    plane_m: float
    raiser: Raiser | None = None
    problems: tuple[str, ...] = ()
    other_inputs: tuple[Path, ...] = ()

    def __len__(self) -> int:
        """Return the number of clips: videos times clips per video."""
        return len(self.videos) * self.plan.clips_per_video

    @property
    def groups(self) -> tuple[int, ...]:
        """The number of each clip's video."""
        return tuple(index // self.plan.clips_per_video for index in range(len(self)))

    @property
    def inputs(self) -> list[Path]:
        """All files: which of them a data set uses depends on its size only."""
        raisers = () if self.raiser is None else self.raiser.inputs
        return [*(file for video in self.videos for file in video.files), *self.other_inputs, *raisers]

    @property
    def packages(self) -> tuple[str, ...]:
        """Packages whose versions may change a clip: those that decode the videos, fit them and raise them."""
        raisers = () if self.raiser is None else self.raiser.packages
        decoders = {package for video in self.videos for package in video.packages}
        return tuple(sorted({"opencv-python-headless", *decoders, *raisers}))

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Cut one clip out of its video; the index is taken modulo their number.

        Raises:
            InputError: naming the file, when it is broken or its frames differ in size.
        """
        which, number = divmod(index % len(self), self.plan.clips_per_video)
        video, plan = self.videos[which], self.plan
        start = plan.start(len(video), number, rng)
        stop = start + plan.needed
        rgb, window = fit_frames(video.read(start, stop), video.name, self.view.shape, plan.crop, rng)
        if len(rgb) != plan.needed:
            msg = f"{video.name} gave {len(rgb)} of the {plan.needed} frames from {start} on: fetch it again"
            raise InputError(msg)
        raising: dict[str, Any] = {}
        if self.raiser is not None:
            rgb = self.raiser.raise_frames(rgb, plan.raise_by)[: plan.frames]
            raising = {"raising": {"raise_by": plan.raise_by, **self.raiser.record()}}
        own_rate = video.frames_per_second
        rate = plan.frames_per_second or (None if own_rate is None else own_rate * plan.raise_by)
        if rate is None:
            msg = f"frames_per_second: {video.name} has no rate of its own; say at which a clip is taken to have been filmed"
            raise InputError(msg)
        shape = rgb.shape[:3]
        source = {
            "importer": self.importer,
            "video": video.name,
            **video.record(start, stop),
            "first_frame": start,
            "frames_read": plan.needed,
            **({} if own_rate is None else {"own_frames_per_second": own_rate}),
            "frames_per_second": rate,
            "crop": {"place": plan.crop, **window.record()},
            **raising,
            "plane_m": self.plane_m,
        }
        return Clip(
            rgb=rgb,
            depth_m=np.full(shape, self.plane_m, np.float32),
            valid=np.ones(shape, bool),
            frame_edges_s=np.arange(len(rgb) + 1) / rate,
            label=video.label,
            source=source,
        )
