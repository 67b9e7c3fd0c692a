"""FlyingThings3D stereo frames as scenes: one picture with its disparity gives one still with depth.

Source: Mayer et al., A Large Dataset to Train Convolutional Networks for Disparity, Optical Flow, and Scene Flow
Estimation, CVPR 2016. A picture is taken as seen through the camera's own pinhole view; its disparity gives z.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.colour import decode_srgb_picture
from simulator.errors import InputError
from simulator.importers._depth_scaling import AffineKind, DepthMap, FixedDepth, affine_map
from simulator.importers._pfm import read_pfm
from simulator.importers._sceneflow import Eye, Frame, PicturePass, Subset, list_frames
from simulator.pictures import read_picture
from simulator.types import Clip, View

FOCAL_PX = 1050.0
"""35 mm lens on a 32 mm wide film of 960 pixels (the data set's documentation)."""
BASELINE_UNITS = 1.0
"""Distance of the two cameras in the data set's units."""


def flyingthings3d(
    view: View,
    *,
    path: Path,
    picture_pass: PicturePass = "cleanpass",
    eye: Eye = "left",
    subset: Subset = "all",
    depth_scaling: Literal["affine_disparity", "affine_depth", "fixed"] = "affine_disparity",
    per: Literal["image", "set"] = "image",
    metres_per_unit: Annotated[float, Field(gt=0)] | None = None,
    crop: Literal["random", "centre"] = "random",
    downscale: Annotated[int, Field(gt=0)] | Literal["auto"] = "auto",
) -> FlyingThings3D:
    """Read stills from a FlyingThings3D folder, in the original or the flattened layout.

    The files are listed at once and read when a clip is asked for; only ``per: set`` reads every disparity file at
    construction, to find the set's range. Frame ``index`` modulo the number of frames, in sorted order, is cut where
    the generator says.

    Args:
        view: the camera's view: size of the crop, near and far depth.
        path: the folder that holds ``frames_cleanpass`` (or ``RGB_cleanpass``) and ``disparity``.
        picture_pass: the rendering without or with blur, fog and other effects.
        eye: which of the two cameras.
        subset: only the data set's own ``TRAIN`` or ``TEST`` part (original layout).
        depth_scaling: ``affine_disparity`` maps disparity, ``affine_depth`` depth, affinely onto the view's near..far;
            ``fixed`` keeps the geometry (z = f B / disparity x ``metres_per_unit``) and clamps nothing.
        per: the affine maps' range is that of the whole image (not of its crop) or that of all images in the folder.
        metres_per_unit: metres per unit of the data set; needed by ``fixed`` and meaningless otherwise.
        crop: where the view is cut out.
        downscale: pixels per side that are averaged into one (colour, in linear light); depth takes the centre
            sample, so that fore- and background never mix. ``auto`` is the largest at which the picture fills the view.

    Returns:
        A scene source. A clip holds one frame of 1 s; where the disparity is zero, ``valid`` is false and the depth
        far.

    Raises:
        InputError: for missing folders or pairs, and when the parameters contradict one another.
    """
    root, frames = list_frames(Path(path), picture_pass, eye, subset)
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
        ranges = [_disparity_range(_read_disparity(root / frame.disparity), frame) for frame in frames]
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        depth = affine_map(depth_scaling, lowest, highest, view.near_m, view.far_m, f"path: {root}")
    else:
        depth = depth_scaling
    return FlyingThings3D(view, root, frames, depth, crop, downscale)


@dataclass(frozen=True)
class FlyingThings3D:
    """A scene source made by :func:`flyingthings3d`; picklable, it holds names and numbers only.

    Attributes:
        view: the camera's view.
        root: the data set's folder.
        frames: the pairs of files, relative to ``root``.
        depth: how disparity becomes metres: one map for all frames, or the kind of map that each image gets.
        crop: where the view is cut out.
        downscale: pixels per side that become one, or ``auto``.
    """

    view: View
    root: Path
    frames: tuple[Frame, ...]
    depth: DepthMap | AffineKind
    crop: Literal["random", "centre"]
    downscale: int | Literal["auto"]

    def __len__(self) -> int:
        """Return how many different frames there are."""
        return len(self.frames)

    @property
    def inputs(self) -> list[Path]:
        """All pictures and disparity maps: which of them a data set uses depends on its size only."""
        return [self.root / file for frame in self.frames for file in (frame.picture, frame.disparity)]

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Cut one still out of frame ``index`` (modulo their number).

        Raises:
            InputError: naming the file, when it is broken, when picture and disparity differ in size, or when the view
                is larger than the picture.
        """
        frame = self.frames[index % len(self.frames)]
        picture = read_picture(self.root / frame.picture)
        disparity = _read_disparity(self.root / frame.disparity)
        if picture.shape != (*disparity.shape, 3):
            msg = (
                f"{self.root / frame.picture} is {' x '.join(map(str, picture.shape))} and its disparity "
                f"{frame.disparity} is {' x '.join(map(str, disparity.shape))}: expected an RGB picture of the same "
                "size, fetch both again"
            )
            raise InputError(msg)
        depth_map = self._depth_map(disparity, frame)

        factor = self._factor(disparity.shape, frame)
        rows, columns = (size * factor for size in self.view.shape)
        row, column = self._corner(disparity.shape[0] - rows, disparity.shape[1] - columns, rng)
        window = np.s_[row : row + rows, column : column + columns]
        rgb = _box_mean(decode_srgb_picture(picture[window]), factor)
        centres = np.s_[factor // 2 :: factor, factor // 2 :: factor]
        cut = disparity[window][centres].astype(np.float64)
        valid = cut > 0
        depth = np.full(cut.shape, self.view.far_m)
        depth[valid] = depth_map.depth_m(cut[valid])
        source: dict[str, Any] = {
            "importer": "flyingthings3d",
            "picture": frame.picture.as_posix(),
            "disparity": frame.disparity.as_posix(),
            "corner_px": [row, column],
            "downscale": factor,
            "per": "image" if isinstance(self.depth, str) else "set",
            **depth_map.record(),
        }
        edges_s = np.array([0.0, 1.0])
        return Clip(rgb[None], depth.astype(np.float32)[None], valid[None], edges_s, source=source)

    def _depth_map(self, disparity: NDArray[np.float32], frame: Frame) -> DepthMap:
        if not isinstance(self.depth, str):
            return self.depth
        lowest, highest = _disparity_range(disparity, frame)
        name = str(self.root / frame.disparity)
        return affine_map(self.depth, lowest, highest, self.view.near_m, self.view.far_m, name)

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


def _read_disparity(path: Path) -> NDArray[np.float32]:
    """Disparity without its sign, ``(H, W)``; releases of the data set differ in the sign, but never within a file."""
    disparity = read_pfm(path)
    if disparity.ndim != 2:
        msg = f"{path} has three channels ('PF'); expected a disparity map with one ('Pf')"
        raise InputError(msg)
    if disparity.min() < 0 < disparity.max():
        msg = f"{path} mixes disparities of both signs ({disparity.min():g}..{disparity.max():g} px): expected one sign"
        raise InputError(msg)
    return np.abs(disparity)


def _disparity_range(disparity: NDArray[np.float32], frame: Frame) -> tuple[float, float]:
    """Smallest and largest disparity that is not zero (zero means infinitely far: no surface)."""
    seen = disparity[disparity > 0]
    if seen.size == 0:
        msg = f"{frame.disparity} is zero everywhere, so it says nothing about depth: leave this frame out"
        raise InputError(msg)
    return float(seen.min()), float(seen.max())


def _box_mean(linear: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over blocks of ``factor x factor`` pixels; ``(H, W, 3)`` -> ``(H / factor, W / factor, 3)``."""
    rows, columns, channels = linear.shape
    blocks = linear.reshape(rows // factor, factor, columns // factor, factor, channels)
    return blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
