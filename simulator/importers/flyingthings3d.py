"""FlyingThings3D, Monkaa and Driving (the SceneFlow data sets): images with disparity as stills or clips with depth.

Source: Mayer et al., A Large Dataset to Train Convolutional Networks for Disparity, Optical Flow, and Scene Flow
Estimation, CVPR 2016. An image is taken as seen through the camera's own pinhole view; its disparity gives z.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_image
from simulator.errors import InputError
from simulator.importers.depth_sequences import DepthClips, Pair, check_rate, find_runs, read_pairs
from simulator.importers.disparity import (
    AffineKind,
    AffineMap,
    DepthMap,
    FixedDepth,
    check_fixed_depths,
    disparity_range,
    read_disparity,
)
from simulator.importers.inspection import Likeness, Progress, Survey
from simulator.importers.listing import Fault, fault_of, grouped
from simulator.importers.sceneflow import PASSES, Eye, PicturePass, Subset, find_root, focal_px, list_frames
from simulator.importers.videos import Count, Crop, Positive
from simulator.io.images import read_image
from simulator.types import Clip, View

BASELINE_UNITS = 1.0
"""Distance of the two cameras in the data set's units."""


def flyingthings3d(
    view: View,
    *,
    path: Path,
    frames: Count = 1,
    frames_per_second: Positive | None = None,
    picture_pass: PicturePass = "cleanpass",
    eye: Eye = "left",
    subset: Subset = "all",
    depth_scaling: Literal["affine_disparity", "affine_depth", "fixed"] = "affine_disparity",
    per: Literal["image", "set"] = "image",
    metres_per_unit: Positive | None = None,
    crop: Crop = "random",
    downscale: Count | Literal["auto"] = "auto",
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
            sample, so that fore- and background never mix. ``auto`` is the largest at which the image fills the view.

    Returns:
        A scene source. A still holds one frame of 1 s; where the disparity is zero, ``valid`` is false and the depth
        far. Images without disparity, sequences too short for a clip and, with ``per: set``, broken disparities are its
        ``problems``; a sequence is a group.

    Raises:
        InputError: for missing folders, when nothing in them can be used, and when the parameters contradict one another.
    """
    check_rate(frames, frames_per_second)
    root, pairs, faults = list_frames(Path(path), picture_pass, eye, subset)
    if depth_scaling != "fixed" and metres_per_unit is not None:
        raise InputError(
            "metres_per_unit", f"got {metres_per_unit}, but depth_scaling is {depth_scaling}: leave it out"
        )
    if depth_scaling == "affine_depth" and not np.isfinite(view.far_m):
        raise InputError("depth_scaling", "affine_depth cannot reach far = inf: use affine_disparity or a finite depth")
    depth: float | AffineMap | AffineKind
    if depth_scaling == "fixed":
        if metres_per_unit is None:
            raise InputError("depth_scaling", "fixed needs metres_per_unit: the metres of one unit of the data set")
        depth = metres_per_unit
    elif per == "set":
        pairs, ranges, broken = _usable(root, pairs)
        faults += broken
        depth = AffineMap.over(depth_scaling, ranges, view.near_m, view.far_m, f"path: {root}")
    else:
        depth = depth_scaling
    starts, groups, short = find_runs(pairs, frames)
    problems = grouped(faults) + short
    return FlyingThings3D(
        view, root, pairs, starts, groups, frames, frames_per_second, problems, depth, crop, downscale
    )


def recognises(path: Path) -> Likeness | None:
    """Whether a folder looks like a SceneFlow data set, by the names in it alone."""
    try:
        root, images = find_root(path, PASSES)
    except (InputError, OSError):
        return None
    return Likeness("sure", f"has {images.name} beside disparity") if (root / "disparity").is_dir() else None


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    picture_pass: PicturePass | None = None,
    eye: Eye = "left",
    subset: Subset = "all",
) -> Survey:
    """Read every pair of one eye once; parameters and errors as for :func:`flyingthings3d`.

    Without ``picture_pass`` it is the first rendering that is there.
    """
    root, images = find_root(path, (picture_pass,) if picture_pass else PASSES)
    used: PicturePass = "finalpass" if "finalpass" in images.name else "cleanpass"
    _, pairs, unpaired = list_frames(path, used, eye, subset)
    ranges: list[tuple[float, float]] = []
    holes = 0

    def read(pair: Pair) -> tuple[int, ...]:
        nonlocal holes
        disparity = read_disparity(root / pair.depth)
        ranges.append(disparity_range(disparity, root / pair.depth))
        _read_image(root, pair, disparity.shape)
        holes += int((disparity == 0).sum())
        return disparity.shape

    good, faults, sequences, notes = read_pairs(root, pairs, unpaired, read, progress)
    facts = {"images": f"{images.name}, {eye} eye", **sequences}
    if ranges:
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        facts["disparity"] = f"{lowest:.4g} to {highest:.4g} px"
    if holes:
        facts["without disparity"] = f"{holes} pixels (valid is false there)"
    if len({focal_px(pair) for pair in good}) > 1:
        facts["focal lengths"] = "450 and 1050 px (15 and 35 mm)"
    return Survey("flyingthings3d", path, len(good), facts, grouped(faults), tuple(notes))


@dataclass(frozen=True)
class FlyingThings3D(DepthClips):
    """A scene source made by :func:`flyingthings3d`; the first attributes are those of :class:`DepthClips`.

    Attributes:
        depth: how disparity becomes metres: the metres that one unit stands for, one map for all images, or the kind of map
            that each clip gets.
        crop: where the view is cut out.
        downscale: pixels per side that become one, or ``auto``.
    """

    depth: float | AffineMap | AffineKind
    crop: Crop
    downscale: int | Literal["auto"]

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Cut clip ``index`` (modulo their number) out of its frames.

        Raises:
            InputError: naming the file, when it is broken, when images and disparities differ in size, or when the view
                is larger than the image.
        """
        pairs = self.pairs_of(index)
        disparities = [read_disparity(self.root / pair.depth) for pair in pairs]
        depth_map = self._depth_map(disparities, pairs)
        shape = disparities[0].shape
        factor = self._factor(shape, pairs[0])
        rows, columns = (size * factor for size in self.view.shape)
        row, column = (shape[0] - rows) // 2, (shape[1] - columns) // 2
        if self.crop == "random":
            row, column = int(rng.integers(shape[0] - rows + 1)), int(rng.integers(shape[1] - columns + 1))
        window = np.s_[row : row + rows, column : column + columns]
        centres = np.s_[factor // 2 :: factor, factor // 2 :: factor]
        rgb = np.empty((self.length, *self.view.shape, 3), np.float32)
        for t, (pair, disparity) in enumerate(zip(pairs, disparities, strict=True)):
            image = _read_image(self.root, pair, disparity.shape)
            if disparity.shape != shape:
                raise InputError(
                    self.root / pair.image,
                    f"got {disparity.shape}, but the first frame is {shape}: fetch it again",
                )
            rgb[t] = _box_mean(decode_srgb_image(image[window]), factor)
        cut = np.stack([disparity[window][centres] for disparity in disparities]).astype(np.float64)
        valid = cut > 0
        depth = np.full(cut.shape, self.view.far_m)
        depth[valid] = depth_map.depth_m(cut[valid])
        if isinstance(depth_map, FixedDepth):
            for t, pair in enumerate(pairs):
                check_fixed_depths(depth[t][valid[t]], cut[t][valid[t]], self.root / pair.depth)
        source = {
            "importer": "flyingthings3d",
            **_names(pairs),
            "corner_px": [row, column],
            "downscale": factor,
            "per": "image" if isinstance(self.depth, str) else "set",
            **depth_map.record(),
        }
        return Clip(rgb, depth.astype(np.float32), valid, self.frame_edges_s, source=source)

    def _depth_map(self, disparities: list[NDArray[np.float32]], pairs: tuple[Pair, ...]) -> DepthMap:
        if isinstance(self.depth, AffineMap):
            return self.depth
        if not isinstance(self.depth, str):
            return FixedDepth(focal_px(pairs[0]), BASELINE_UNITS, self.depth)
        names = [self.root / pair.depth for pair in pairs]
        ranges = [disparity_range(disparity, name) for disparity, name in zip(disparities, names, strict=True)]
        return AffineMap.over(self.depth, ranges, self.view.near_m, self.view.far_m, str(names[0]))

    def _factor(self, shape: tuple[int, ...], pair: Pair) -> int:
        largest = min(shape[0] // self.view.shape[0], shape[1] // self.view.shape[1])
        factor = max(largest, 1) if self.downscale == "auto" else self.downscale
        if factor > largest:
            cure = f"downscale at most {largest}" if largest else f"a scene of at most {shape[0]} x {shape[1]}"
            raise InputError(
                "downscale",
                f"{factor} x {self.view.shape} is more than {pair.image} has ({shape[0]} x {shape[1]}): use {cure}",
            )
        return factor


def _read_image(root: Path, pair: Pair, shape: tuple[int, ...]) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read the image of a disparity map of this size."""
    image = read_image(root / pair.image)
    if image.shape != (*shape, 3):
        raise InputError(
            root / pair.image,
            f"got {image.shape}, but its disparity {pair.depth} is {shape}: fetch both again",
        )
    return image


def _usable(
    root: Path, pairs: tuple[Pair, ...]
) -> tuple[tuple[Pair, ...], list[tuple[float, float]], tuple[Fault, ...]]:
    """The pairs whose disparity can be read, the range of each, and what is wrong with the others."""
    usable, ranges, faults = [], [], []
    for pair in pairs:
        name = root / pair.depth
        try:
            ranges.append(disparity_range(read_disparity(name), name))
        except InputError as error:
            if len(pairs) == 1:
                raise
            faults.append(fault_of(error, name))
        else:
            usable.append(pair)
    if not usable:
        raise InputError("path", f"{root} has no disparity that can be used; the first: {': '.join(faults[0])}")
    return tuple(usable), ranges, tuple(faults)


def _names(pairs: tuple[Pair, ...]) -> dict[str, Any]:
    """A clip's files: those of a still, or the first and the last of consecutive ones."""
    if len(pairs) == 1:
        return {"picture": pairs[0].image.as_posix(), "disparity": pairs[0].depth.as_posix()}
    return {
        "sequence": pairs[0].sequence,
        "frames": len(pairs),
        "pictures": [pair.image.as_posix() for pair in (pairs[0], pairs[-1])],
        "disparities": [pair.depth.as_posix() for pair in (pairs[0], pairs[-1])],
    }


def _box_mean(linear: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """Mean over blocks of ``factor x factor`` pixels; ``(H, W, 3)`` -> ``(H / factor, W / factor, 3)``."""
    rows, columns, channels = linear.shape
    blocks = linear.reshape(rows // factor, factor, columns // factor, factor, channels)
    return blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
