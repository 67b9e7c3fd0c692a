"""Videos as flat scenes: clips cut out of films and fitted to the view in linear light, on a plane that faces the camera."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.errors import InputError
from simulator.importers.frame_interpolation import FrameInterpolator
from simulator.importers.listing import first_lines
from simulator.importers.video_decoding import load_extra
from simulator.types import FARTHEST_M, Clip, View

Count: TypeAlias = Annotated[int, Field(ge=1)]
Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Crop: TypeAlias = Literal["centre", "random"]
InterpolateWith: TypeAlias = Literal["optical_flow", "superslomo"]


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

        Reading them one by one keeps large frames out of memory. Full scale is 1; images of linear light may hold more.

        Raises:
            InputError: naming the file that is broken.
        """
        ...

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return where these frames come from and what was done to them, JSON-serialisable."""
        ...


@dataclass(frozen=True)
class ClipPlan:
    """How clips are cut out of videos and shown.

    Attributes:
        frames: of a clip, after interpolation.
        frames_per_second: rate at which a clip is taken to have been filmed; None is the video's own times interpolate_by. A
            shutter of some milliseconds sees motion in a film of 24 frames per second only if that is taken to run faster.
        interpolate_by: frames that one of the video's becomes by temporal interpolation; 1 leaves them.
        clips_per_video: how many clips a video gives, evenly spread over it; 1 begins anywhere, as the sample's random
            stream says.
        crop: where the view is cut out of the image: in the ``centre`` or at a ``random`` place, the same for all frames.
        plane_m: depth of the plane on which clips are shown.
        interpolator: what interpolates frames; None where ``interpolate_by`` is 1.
    """

    frames: int
    frames_per_second: float | None = None
    interpolate_by: int = 1
    clips_per_video: int = 1
    crop: Crop = "centre"
    plane_m: float = FARTHEST_M
    interpolator: FrameInterpolator | None = None

    @classmethod
    def of(
        cls,
        view: View,
        frames: int,
        frames_per_second: float | None,
        clips_per_video: int,
        crop: Crop,
        plane_cm: float | None,
        interpolate_by: int,
        interpolate_with: InterpolateWith,
        superslomo_checkpoint: Path | None,
    ) -> ClipPlan:
        """Return the plan that a source's parameters make; the plane lies at the view's far depth unless it is said where.

        Raises:
            InputError: when the plane lies outside near..far, or as :func:`choose_interpolator`.
        """
        plane_m = min(view.far_m, FARTHEST_M) if plane_cm is None else plane_cm * 1e-2
        if plane_cm is not None and not view.near_m <= plane_m <= view.far_m:
            raise InputError(
                "plane_cm", f"got {plane_cm:g}, expected {view.near_m * 100:.4g} to {view.far_m * 100:.4g} cm"
            )
        interpolator = choose_interpolator(interpolate_by, interpolate_with, superslomo_checkpoint)
        return cls(frames, frames_per_second, interpolate_by, clips_per_video, crop, plane_m, interpolator)

    @property
    def needed(self) -> int:
        """The video's frames that a clip takes: each but the last becomes ``interpolate_by`` frames."""
        return -(-(self.frames - 1) // self.interpolate_by) + 1

    def start(self, available: int, number: int, rng: np.random.Generator) -> int:
        """Return the first frame of a video's clip.

        Raises:
            InputError: the video is too short.
        """
        if reason := self.fault(available):
            raise InputError("frames", reason)
        spare = available - self.needed
        if self.clips_per_video == 1:
            return int(rng.integers(spare + 1))
        return round(number * spare / (self.clips_per_video - 1))

    def fault(self, available: int) -> str | None:
        """Say why a video of so many frames cannot give its clips, or None where it can."""
        if available < self.needed:
            return (
                f"has {available} frames, but a clip of {self.frames}{self.interpolated} takes {self.needed}: ask for fewer, "
                "or a larger interpolate_by"
            )
        fit = available - self.needed + 1
        if self.clips_per_video > fit:
            return (
                f"has {available} frames, in which no more than {fit} different clips of {self.frames} begin, but "
                f"clips_per_video is {self.clips_per_video}: ask for fewer"
            )
        return None

    @property
    def interpolated(self) -> str:
        """How much is interpolated, for messages; empty where nothing is."""
        return f", interpolated by {self.interpolate_by}" if self.interpolate_by > 1 else ""


def choose_interpolator(
    interpolate_by: int, interpolate_with: InterpolateWith, checkpoint: Path | None
) -> FrameInterpolator | None:
    """Return what interpolates frames, or None where nothing is to be interpolated.

    ``checkpoint``: the weights of ``superslomo``: the public ``SuperSloMo.ckpt``, or the same tensors as ``.safetensors``.

    Raises:
        InputError: the checkpoint is missing, broken, or meaningless for what was asked; or a package is not installed.
    """
    if interpolate_by == 1:
        if checkpoint is not None:
            raise InputError("superslomo_checkpoint", f"got {checkpoint}, but interpolate_by is 1: leave it out")
        if interpolate_with != "optical_flow":
            raise InputError("interpolate_with", f"got {interpolate_with}, but interpolate_by is 1: leave it out")
        return None
    # OpenCV or torch, which nobody needs who interpolates nothing.
    if interpolate_with == "optical_flow":
        if checkpoint is not None:
            raise InputError("superslomo_checkpoint", f"got {checkpoint}, but optical_flow takes none: leave it out")
        from simulator.importers.optical_flow import OpticalFlow

        return OpticalFlow()
    if checkpoint is None:
        raise InputError(
            "superslomo_checkpoint",
            "missing: give the path of SuperSloMo.ckpt, not part of Flatlight",
        )
    load_extra("torch", "torch", "learn")
    from simulator.importers.superslomo import SuperSloMo

    return SuperSloMo.from_checkpoint(checkpoint)


@dataclass(frozen=True)
class FlatVideos:
    """A scene source of clips on a plane; picklable, it holds names and numbers only.

    Black light of a removed background lies on the same plane: it is known that no light comes from there, so ``valid`` is
    true everywhere.

    Attributes:
        importer: the name of what made it.
        view: the camera's view.
        videos: long enough for the plan.
        plan: how clips are cut out of them and shown.
        problems: lines ``"file: reason"`` about what cannot be used and was left out.
        other_inputs: files beside the videos' own that decide what a clip holds, such as label files.
    """

    importer: str
    view: View
    videos: tuple[Video, ...]
    plan: ClipPlan
    problems: tuple[str, ...] = ()
    other_inputs: tuple[Path, ...] = ()

    @classmethod
    def of(
        cls,
        importer: str,
        view: View,
        videos: Iterable[Video],
        plan: ClipPlan,
        problems: Iterable[str] = (),
        other_inputs: Iterable[Path] = (),
    ) -> FlatVideos:
        """Make a source of those videos that are long enough, and add the others to the problems that were found already.

        Videos stand in the order in which splits are filled.

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
            raise InputError("source", f"{importer} found no video that can be used{':' if found else ''}{listed}")
        return cls(importer, view, tuple(usable), plan, tuple(found), tuple(other_inputs))

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
        weights = () if self.plan.interpolator is None else self.plan.interpolator.inputs
        return [*(file for video in self.videos for file in video.files), *self.other_inputs, *weights]

    @property
    def packages(self) -> tuple[str, ...]:
        """Packages whose versions may change a clip: those that decode the videos, fit them and interpolate them."""
        interpolating = () if self.plan.interpolator is None else self.plan.interpolator.packages
        decoders = {package for video in self.videos for package in video.packages}
        return tuple(sorted({"opencv-python-headless", *decoders, *interpolating}))

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
            raise InputError(video.name, f"gave {len(rgb)} of the {plan.needed} frames from {start} on: fetch it again")
        interpolation: dict[str, Any] = {}
        if plan.interpolator is not None:
            rgb = plan.interpolator.interpolate(rgb, plan.interpolate_by)[: plan.frames]
            interpolation = {"interpolation": {"interpolate_by": plan.interpolate_by, **plan.interpolator.record()}}
        own_rate = video.frames_per_second
        rate = plan.frames_per_second or (None if own_rate is None else own_rate * plan.interpolate_by)
        if rate is None:
            raise InputError("frames_per_second", f"{video.name} has no frame rate; say one")
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
            **interpolation,
            "plane_m": plan.plane_m,
        }
        return Clip(
            rgb=rgb,
            depth_m=np.full(shape, plan.plane_m, np.float32),
            valid=np.ones(shape, bool),
            frame_edges_s=np.arange(len(rgb) + 1) / rate,
            label=video.label,
            source=source,
        )


@dataclass(frozen=True)
class Window:
    """A part of an image, in its pixels: the first row and column, and how many of each."""

    row: int
    column: int
    rows: int
    columns: int

    def record(self) -> dict[str, Any]:
        """Where it lies, for a sample's record."""
        return {"corner_px": [self.row, self.column], "size_px": [self.rows, self.columns]}


def largest_window(size: tuple[int, int], shape: tuple[int, int], crop: Crop, rng: np.random.Generator) -> Window:
    """Return the largest window with the view's proportions, to the nearest whole pixel.

    Args:
        size: rows and columns of the image.
        shape: rows and columns of the view.
        crop: in the ``centre`` or at a ``random`` place along the side on which something is cut off.
        rng: the sample's; drawn from only for ``random``.

    Example:
        >>> largest_window((240, 427), (160, 160), "centre", np.random.default_rng(0))
        Window(row=0, column=93, rows=240, columns=240)
    """
    scale = min(have / want for have, want in zip(size, shape, strict=True))
    rows, columns = (min(max(round(scale * want), 1), have) for have, want in zip(size, shape, strict=True))
    spare = size[0] - rows, size[1] - columns
    if crop == "centre":
        return Window(spare[0] // 2, spare[1] // 2, rows, columns)
    return Window(int(rng.integers(spare[0] + 1)), int(rng.integers(spare[1] + 1)), rows, columns)


def fit(image: NDArray[np.float32], window: Window, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Cut a window out of an image ``(H, W, 3)`` of linear light and resample it to a shape of rows and columns.

    Where the window is larger than the view, each new pixel is the mean over its area, so the mean light stays what it was;
    where it is smaller, values are interpolated bilinearly, so none is brighter or darker than its neighbours.

    Returns:
        float32 ``(*shape, 3)``, a copy.

    Raises:
        InputError: OpenCV is not installed.
    """
    cut = np.s_[window.row : window.row + window.rows, window.column : window.column + window.columns]
    part = np.ascontiguousarray(image[cut])
    if part.shape[:2] == shape:
        return part.copy() if np.shares_memory(part, image) else part
    cv2 = load_extra("cv2", "OpenCV")
    shrinks = part.shape[0] >= shape[0] and part.shape[1] >= shape[1]
    return cv2.resize(part, shape[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def fit_frames(
    frames: Iterable[NDArray[np.float32]], name: str, shape: tuple[int, int], crop: Crop, rng: np.random.Generator
) -> tuple[NDArray[np.float32], Window]:
    """Fit frames ``(H, W, 3)`` of linear light one after the other, all through the same window, see :func:`largest_window`.

    Only one frame at a time is held in its full size.

    Returns:
        ``(T, *shape, 3)`` float32, and the window.

    Raises:
        InputError: there are none, or they differ in size.
    """
    fitted: list[NDArray[np.float32]] = []
    window, size = Window(0, 0, 0, 0), (0, 0)
    for frame in frames:
        if not fitted:
            size = frame.shape[:2]
            window = largest_window(size, shape, crop, rng)
        elif frame.shape[:2] != size:
            raise InputError(name, f"changes its size from {size} to {frame.shape[:2]}: split it where that happens")
        fitted.append(fit(frame, window, shape))
    if not fitted:
        raise InputError(name, "gave no frames")
    return np.stack(fitted), window
