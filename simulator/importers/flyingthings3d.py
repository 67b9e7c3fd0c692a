"""FlyingThings3D, Monkaa and Driving (the SceneFlow data sets): pictures with disparity as stills or clips with depth.

Source: Mayer et al., A Large Dataset to Train Convolutional Networks for Disparity, Optical Flow, and Scene Flow
Estimation, CVPR 2016. A picture is taken as seen through the camera's own pinhole view; its disparity gives z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.colour import decode_srgb_picture
from simulator.errors import InputError
from simulator.importers.disparity import (
    AffineKind,
    DepthMap,
    FixedDepth,
    affine_map,
    check_fixed_depths,
    disparity_range,
    read_disparity,
)
from simulator.importers.listing import Fault, check_rate, fault_of, find_runs, grouped
from simulator.importers.sceneflow import FOCAL_PX, Eye, Frame, PicturePass, Subset, list_frames, recognises, survey
from simulator.pictures import read_picture
from simulator.types import Clip, View

__all__ = ["FlyingThings3D", "flyingthings3d", "recognises", "survey"]

BASELINE_UNITS = 1.0
"""Distance of the two cameras in the data set's units."""


def flyingthings3d(
    view: View,
    *,
    path: Path,
    frames: Annotated[int, Field(gt=0)] = 1,
    frames_per_second: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    picture_pass: PicturePass = "cleanpass",
    eye: Eye = "left",
    subset: Subset = "all",
    depth_scaling: Literal["affine_disparity", "affine_depth", "fixed"] = "affine_disparity",
    per: Literal["image", "set"] = "image",
    metres_per_unit: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None,
    crop: Literal["random", "centre"] = "random",
    downscale: Annotated[int, Field(gt=0)] | Literal["auto"] = "auto",
) -> FlyingThings3D:
    """Read stills or clips from a folder of FlyingThings3D (original or flattened layout), Monkaa or Driving.

    The files are listed at once and read when a clip is asked for; only ``per: set`` reads every disparity file at
    construction, to find the set's range. Clip ``index`` modulo the number of clips, in sorted order, is cut where the
    generator says, all its frames at the same place. Clips of a sequence lie one after the other, share no frame and never
    cross a gap in the frames' numbers.

    Args:
        view: the camera's view: size of the crop, near and far depth.
        path: the folder that holds ``frames_cleanpass`` (or ``RGB_cleanpass``) and ``disparity``.
        frames: of a clip, with consecutive numbers; 1 gives stills.
        frames_per_second: rate at which a clip's frames were taken; the data sets state none, so clips need it.
        picture_pass: the rendering without or with blur, fog and other effects.
        eye: which of the two cameras.
        subset: only the data set's own ``TRAIN`` or ``TEST`` part (FlyingThings3D's original layout).
        depth_scaling: ``affine_disparity`` maps disparity, ``affine_depth`` depth, affinely onto the view's near..far;
            ``fixed`` keeps the geometry (z = f B / disparity x ``metres_per_unit``) and clamps nothing; f is 1050 pixels,
            450 for Driving's 15 mm lens.
        per: the affine maps' range is that of the whole image (not of its crop), for a clip that of all its images
            together, so that depths do not pulse; or that of all images in the folder.
        metres_per_unit: metres per unit of the data set; needed by ``fixed`` and meaningless otherwise.
        crop: where the view is cut out.
        downscale: pixels per side that are averaged into one (colour, in linear light); depth takes the centre
            sample, so that fore- and background never mix. ``auto`` is the largest at which the picture fills the view.

    Returns:
        A scene source. A still holds one frame of 1 s; where the disparity is zero, ``valid`` is false and the depth
        far. Pictures without disparity, sequences too short for a clip and, with ``per: set``, broken disparities are its
        ``problems``; a sequence is a group.

    Raises:
        InputError: for missing folders, when nothing in them can be used, and when the parameters contradict one another.
    """
    check_rate(frames, frames_per_second)
    root, found, faults = list_frames(Path(path), picture_pass, eye, subset)
    if depth_scaling != "fixed" and metres_per_unit is not None:
        msg = (
            f"metres_per_unit is {metres_per_unit}, but depth_scaling: {depth_scaling} fills near..far: "
            "leave it out or use fixed"
        )
        raise InputError(msg)
    if depth_scaling == "affine_depth" and not np.isfinite(view.far_m):
        msg = "depth_scaling: affine_depth cannot reach far = inf: use affine_disparity, or give a finite far depth"
        raise InputError(msg)
    if depth_scaling == "fixed":
        if metres_per_unit is None:
            msg = "depth_scaling: fixed needs metres_per_unit (the metres that one unit of the data set stands for)"
            raise InputError(msg)
        depth: DepthMap | AffineKind = FixedDepth(FOCAL_PX, BASELINE_UNITS, metres_per_unit)
    elif per == "set":
        found, ranges, broken = _usable(root, found)
        faults += broken
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        depth = affine_map(depth_scaling, lowest, highest, view.near_m, view.far_m, f"path: {root}")
    else:
        depth = depth_scaling
    runs = find_runs([frame.sequence for frame in found], [frame.number for frame in found], frames)
    return FlyingThings3D(
        view,
        root,
        found,
        runs.starts,
        runs.groups,
        frames,
        frames_per_second,
        depth,
        crop,
        downscale,
        grouped(faults) + runs.problems,
    )


@dataclass(frozen=True)
class FlyingThings3D:
    """A scene source made by :func:`flyingthings3d`; picklable, it holds names and numbers only.

    Attributes:
        view: the camera's view.
        root: the data set's folder.
        frames: the pairs of files, relative to ``root``, sequence after sequence.
        starts: index of each clip's first frame.
        groups: number of the sequence that each clip comes from.
        length: frames of a clip.
        frames_per_second: of clips; None for stills.
        depth: how disparity becomes metres: one map for all frames, or the kind of map that each clip gets.
        crop: where the view is cut out.
        downscale: pixels per side that become one, or ``auto``.
        problems: what was found and cannot be used.
    """

    view: View
    root: Path
    frames: tuple[Frame, ...]
    starts: tuple[int, ...]
    groups: tuple[int, ...]
    length: int
    frames_per_second: float | None
    depth: DepthMap | AffineKind
    crop: Literal["random", "centre"]
    downscale: int | Literal["auto"]
    problems: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return how many different clips there are."""
        return len(self.starts)

    @property
    def inputs(self) -> list[Path]:
        """All pictures and disparity maps: which of them a data set uses depends on its size only."""
        return [self.root / file for frame in self.frames for file in (frame.picture, frame.disparity)]

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Cut clip ``index`` (modulo their number) out of its frames.

        Raises:
            InputError: naming the file, when it is broken, when pictures and disparities differ in size, or when the view
                is larger than the picture.
        """
        start = self.starts[index % len(self.starts)]
        frames = self.frames[start : start + self.length]
        disparities = [read_disparity(self.root / frame.disparity) for frame in frames]
        depth_map = self._depth_map(disparities, frames)
        shape = disparities[0].shape
        factor = self._factor(shape, frames[0])
        rows, columns = (size * factor for size in self.view.shape)
        row, column = self._corner(shape[0] - rows, shape[1] - columns, rng)
        window = np.s_[row : row + rows, column : column + columns]
        centres = np.s_[factor // 2 :: factor, factor // 2 :: factor]
        rgb = np.empty((self.length, *self.view.shape, 3), np.float32)
        for t, frame in enumerate(frames):
            picture = self._read_picture(frame, disparities[t].shape, shape)
            rgb[t] = _box_mean(decode_srgb_picture(picture[window]), factor)
        cut = np.stack([disparity[window][centres] for disparity in disparities]).astype(np.float64)
        valid = cut > 0
        depth = np.full(cut.shape, self.view.far_m)
        depth[valid] = depth_map.depth_m(cut[valid])
        if isinstance(depth_map, FixedDepth):
            for t, frame in enumerate(frames):
                check_fixed_depths(depth[t][valid[t]], cut[t][valid[t]], self.root / frame.disparity)
        source = {
            "importer": "flyingthings3d",
            **_names(frames),
            "corner_px": [row, column],
            "downscale": factor,
            "per": "image" if isinstance(self.depth, str) else "set",
            **depth_map.record(),
        }
        edges_s = np.arange(self.length + 1) / (self.frames_per_second or 1.0)
        return Clip(rgb, depth.astype(np.float32), valid, edges_s, source=source)

    def _read_picture(
        self, frame: Frame, shape: tuple[int, ...], first: tuple[int, ...]
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        picture = read_picture(self.root / frame.picture)
        if picture.shape != (*shape, 3):
            msg = (
                f"{self.root / frame.picture} is {' x '.join(map(str, picture.shape))} and its disparity "
                f"{frame.disparity} is {' x '.join(map(str, shape))}: expected an RGB picture of the same "
                "size, fetch both again"
            )
            raise InputError(msg)
        if shape != first:
            msg = (
                f"{self.root / frame.picture} is {shape[0]} x {shape[1]}, but the clip's first frame is "
                f"{first[0]} x {first[1]}: expected one size in a sequence, fetch it again"
            )
            raise InputError(msg)
        return picture

    def _depth_map(self, disparities: list[NDArray[np.float32]], frames: tuple[Frame, ...]) -> DepthMap:
        if isinstance(self.depth, FixedDepth):
            return replace(self.depth, focal_px=frames[0].focal_px)
        if not isinstance(self.depth, str):
            return self.depth
        names = [self.root / frame.disparity for frame in frames]
        ranges = [disparity_range(disparity, name) for disparity, name in zip(disparities, names, strict=True)]
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        return affine_map(self.depth, lowest, highest, self.view.near_m, self.view.far_m, str(names[0]))

    def _factor(self, shape: tuple[int, ...], frame: Frame) -> int:
        largest = min(shape[0] // self.view.shape[0], shape[1] // self.view.shape[1])
        factor = max(largest, 1) if self.downscale == "auto" else self.downscale
        if factor > largest:
            cure = f"downscale at most {largest}" if largest else f"a scene of at most {shape[0]} x {shape[1]}"
            msg = (
                f"the scene's {self.view.shape[0]} x {self.view.shape[1]} pixels at downscale {factor} are more than "
                f"{frame.picture} has ({shape[0]} x {shape[1]}): use {cure}"
            )
            raise InputError(msg)
        return factor

    def _corner(self, spare_rows: int, spare_columns: int, rng: np.random.Generator) -> tuple[int, int]:
        if self.crop == "centre":
            return spare_rows // 2, spare_columns // 2
        return int(rng.integers(spare_rows + 1)), int(rng.integers(spare_columns + 1))


def _usable(
    root: Path, frames: tuple[Frame, ...]
) -> tuple[tuple[Frame, ...], list[tuple[float, float]], tuple[Fault, ...]]:
    """The frames whose disparity can be read, the range of each, and what is wrong with the others."""
    usable, ranges, faults = [], [], []
    for frame in frames:
        name = root / frame.disparity
        try:
            ranges.append(disparity_range(read_disparity(name), name))
        except InputError as error:
            if len(frames) == 1:
                raise
            faults.append(fault_of(error, name))
        else:
            usable.append(frame)
    if not usable:
        msg = f"none of the {len(frames)} disparities in {root} can be used; the first: {': '.join(faults[0])}"
        raise InputError(msg)
    return tuple(usable), ranges, tuple(faults)


def _names(frames: tuple[Frame, ...]) -> dict[str, Any]:
    """A clip's files: those of a still, or the first and the last of consecutive ones."""
    if len(frames) == 1:
        return {"picture": frames[0].picture.as_posix(), "disparity": frames[0].disparity.as_posix()}
    return {
        "sequence": frames[0].sequence,
        "frames": len(frames),
        "pictures": [frame.picture.as_posix() for frame in (frames[0], frames[-1])],
        "disparities": [frame.disparity.as_posix() for frame in (frames[0], frames[-1])],
    }


def _box_mean(linear: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over blocks of ``factor x factor`` pixels; ``(H, W, 3)`` -> ``(H / factor, W / factor, 3)``."""
    rows, columns, channels = linear.shape
    blocks = linear.reshape(rows // factor, factor, columns // factor, factor, channels)
    return blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
