"""RGB + depth from anywhere: two folders, two patterns or a table of pairs, with units, unknown values and intrinsics.

Middlebury: Scharstein et al., High-resolution stereo datasets with subpixel-accurate ground truth, GCPR 2014: ``im0.png``
with ``disp0.pfm`` and ``calib.txt`` in a folder per scene, z = f B / (d + doffs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter

from simulator.errors import InputError
from simulator.importers.camera_models import Calibration, Intrinsics, Lens, nearest_file, read_calibration
from simulator.importers.depth_coding import DepthAlong, DepthCoding, DisparityDepth
from simulator.importers.depth_files import read_chart
from simulator.importers.depth_layouts import find_layouts, find_meaning
from simulator.importers.depth_sequences import Pair, check_rate, find_runs, read_pairs
from simulator.importers.file_pairs import pairs_of_folders, pairs_of_table
from simulator.importers.inspection import Likeness, Progress, Survey
from simulator.importers.listing import Fault, grouped
from simulator.importers.undistorted_clips import UndistortedClips, check_intrinsics, clip_files
from simulator.importers.undistortion import Lookup
from simulator.importers.videos import Count, Positive
from simulator.io.images import read_light
from simulator.types import View

FALLBACK = 1
"""A source that knows the layout by its name comes first."""

_ONE_VIDEO = (
    "all images are numbered on, so they are one video, for one split; independent: true if each is a scene of its own"
)

NotNegative = Annotated[float, Field(ge=0)]


def rgb_depth(
    view: View,
    *,
    path: Path,
    depth: DepthCoding,
    images: str | None = None,
    depths: str | None = None,
    masks: str | None = None,
    invalid: tuple[float, ...] | None = None,
    depth_along: DepthAlong = "axis",
    scale: Positive = 1.0,
    range_cm: tuple[NotNegative, NotNegative] = (0.0, float("inf")),
    frames: Count = 1,
    frames_per_second: Positive | None = None,
    independent: bool = False,
    intrinsics: Intrinsics | None = None,
    intrinsics_file: str | None = None,
    field: Literal["fill", "angles"] = "fill",
) -> RgbDepth:
    """Read stills or clips from images with depth charts of any kind.

    Images are PNG, JPEG, WebP, TIFF or EXR; charts are PNG or PGM of 8 or 16 bits, TIFF, EXR, PFM or npy. A chart may have
    fewer pixels than its image, in the same proportions. Clip ``index`` modulo the number of clips, in sorted order; clips of
    a sequence lie one after the other, share no frame and never cross a gap in the frames' numbers.

    Args:
        view: the camera's view: size, angles, far depth.
        path: the folder that images and depths start from; or a CSV table with the columns image and depth, and perhaps mask,
            clip, frame and label, whose paths start at its own folder.
        depth: what a chart's numbers mean. {type: metric, unit: mm} (m, cm; codes_per_unit: 5000 where they were multiplied);
            {type: disparity} with focal_px, baseline_mm, doffs_px where no calib.txt says them (codes_per_px); {type: linear,
            full_cm: 20} where depth is proportional to the code, zero_cm at code 0 and full_cm at full_code (65535, 255, 1.0
            by the file's type), {type: inverse, full_cm: 3} where one over depth is: bright is near.
        images: a folder of images, or a pattern such as "*/im0.png".
        depths: a folder of charts, or a pattern such as "*/disp0.pfm"; what stars stand for must be the same in both, in
            folders the names, with or without words such as rgb and depth, or the last numbers.
        masks: a folder or pattern of masks that are black where the depth is unknown.
        invalid: numbers of a chart that mean that the depth is unknown; null is 0, unless that is a depth by zero_cm or
            doffs_px. NaN and inf always do.
        depth_along: whether charts hold z along the optical axis or, as of many renderers, distances along each ray (needs
            intrinsics).
        scale: factor by which the scene shrinks about the camera: 0.05 puts what is 2 m away at 10 cm, under the same angles.
        range_cm: nearest and deepest depth, after scaling; beyond it the depth counts as unknown.
        frames: of a clip, with consecutive numbers; 1 gives stills.
        frames_per_second: rate at which a clip's frames were taken; clips need it.
        independent: every image is a scene of its own; otherwise images that are numbered on belong to one video, which no
            two splits share.
        intrinsics: the images' camera in pixels: type: pinhole (fx, fy, cx, cy, distortion [k1, k2, p1, p2, k3]),
            opencv_fisheye or scaramuzza, as for endoslam. Without it, and without a file, images are taken for undistorted
            and of unknown focal length.
        intrinsics_file: the name of the file that holds them, looked for beside each image and in the folders above, up to
            path: Middlebury's calib.txt, text with fx, fy, cx, cy or the matrix's nine numbers, YAML or JSON.
        field: fill takes the largest part of the image around its optical axis that fills the view, as if taken with another
            focal length; angles keeps each ray's direction (needs intrinsics), black where the image ends.

    Returns:
        A scene source. A still holds one frame of 1 s; where the depth is unknown, ``valid`` is false and the light comes
        from the view's far depth. Files without partner and sequences too short for a clip are its ``problems``; a sequence
        is a group.

    Raises:
        InputError: for missing folders or pairs, and when the parameters contradict one another.
    """
    check_rate(frames, frames_per_second)
    check_intrinsics(intrinsics, intrinsics_file, field, depth_along)
    if independent and frames > 1:
        raise InputError(
            "independent", f"got true, but clips of {frames} frames are no images by themselves: leave it out"
        )
    if not range_cm[0] < range_cm[1]:
        raise InputError("range_cm", f"got {list(range_cm)}, expected the nearest and a larger deepest depth")
    root, pairs, faults = _list(Path(path), images, depths, masks)
    if independent:
        pairs = tuple(replace(pair, sequence=pair.image.as_posix()) for pair in pairs)
    calibration = None if intrinsics is None else Calibration(intrinsics)
    folders = dict.fromkeys((root / pair.image).parent for pair in pairs)
    known = (
        {} if intrinsics_file is None else {each: _calibration_file(root, each, intrinsics_file) for each in folders}
    )
    starts, groups, short = find_runs(pairs, frames)
    source = RgbDepth(
        view=view,
        root=root,
        pairs=pairs,
        starts=starts,
        groups=groups,
        length=frames,
        frames_per_second=frames_per_second,
        problems=grouped(faults) + short,
        along=depth_along,
        range_m=(range_cm[0] * 1e-2, range_cm[1] * 1e-2),
        field=field,
        circle=None,
        coding=depth,
        invalid=_invalid(depth, invalid),
        scale=scale,
        calibration=calibration,
        calibration_files=known,
        other_inputs=(*dict.fromkeys(known.values()), *([] if images else [Path(path)])),
    )
    source.calibrated(pairs[0])  # what is missing is said at once
    return source


@dataclass(frozen=True)
class RgbDepth(UndistortedClips):
    """A scene source made by :func:`rgb_depth`; the first attributes are those of :class:`UndistortedClips`.

    Attributes:
        coding: what the charts' numbers mean.
        invalid: numbers that mean that the depth is unknown.
        scale: by which depths are multiplied.
        calibration: the camera of all images, or None.
        calibration_files: by folder of images, the file that holds their camera.
        other_inputs: files beside the images and charts that decide what a clip holds.
    """

    coding: DepthCoding
    invalid: tuple[float, ...]
    scale: float
    calibration: Calibration | None
    calibration_files: dict[Path, Path]
    other_inputs: tuple[Path, ...]

    @property
    def inputs(self) -> list[Path]:
        """All images, charts and masks, the table and the files with intrinsics."""
        return [*super().inputs, *self.other_inputs]

    def calibrated(self, pair: Pair) -> tuple[DepthCoding, Lens | None]:
        """Return what a chart's numbers mean, with its camera's numbers filled in, and the lens, None if unknown.

        Raises:
            InputError: disparities without focal length or baseline, or as `read_calibration`.
        """
        file = self.calibration_files.get((self.root / pair.image).parent)
        return _calibrated(self.coding, self.calibration if file is None else _calibration(file, pair))

    def read(self, pair: Pair) -> tuple[NDArray[np.float32], NDArray[np.float64], Lens | None]:
        """Read an image and its chart.

        Raises:
            InputError: naming the file, when it is broken, or sizes do not fit together.
        """
        coding, lens = self.calibrated(pair)
        light = read_light(self.root / pair.image)
        metres, _ = _read_depth(self.root, pair, coding, self.invalid)
        return light, _as_large(metres, light.shape[:2], self.root, pair) * self.scale, lens

    @property
    def limits(self) -> tuple[str, str]:
        """The parameter that limits depths, and those that decide them."""
        low, high = (limit * 100 for limit in self.range_m)
        return f"range_cm [{low:g}, {high:g}]", "check depth, invalid, scale and range_cm"

    def record(self, pairs: tuple[Pair, ...], lookup: Lookup) -> dict[str, Any]:
        """Return where a clip comes from and how it was read."""
        coding, lens = self.calibrated(pairs[0])
        return {
            "importer": "rgb_depth",
            **clip_files(pairs),
            **coding.record(),
            "depth_along": self.along,
            "invalid": list(self.invalid),
            "scale": self.scale,
            "range_cm": [limit * 100 if np.isfinite(limit) else None for limit in self.range_m],
            "intrinsics": None if lens is None else lens.model_dump(mode="json"),
            "field": self.field,
            "field_scale": None if lens is None else lookup.scale,
        }


def _list(
    path: Path, images: str | None, depths: str | None, masks: str | None
) -> tuple[Path, tuple[Pair, ...], tuple[Fault, ...]]:
    """Return the root, the pairs, and what cannot be used."""
    if path.suffix.lower() == ".csv":
        given = [
            name for name, value in (("images", images), ("depths", depths), ("masks", masks)) if value is not None
        ]
        if given:
            raise InputError(
                ", ".join(given), f"given, but {path.name} is a table, whose columns name the files: leave it out"
            )
        return path.parent, *pairs_of_table(path)
    if images is None or depths is None:
        missing = " and ".join(name for name, value in (("images", images), ("depths", depths)) if value is None)
        raise InputError(
            missing, "missing: name folders or patterns below path; `flatlight import --check` proposes them"
        )
    return path, *pairs_of_folders(path, images, depths, masks)


def _invalid(coding: DepthCoding, invalid: Sequence[float] | None) -> tuple[float, ...]:
    return (() if coding.zero_is_a_depth else (0.0,)) if invalid is None else tuple(invalid)


def _calibration_file(root: Path, folder: Path, name: str) -> Path:
    found = nearest_file(root, folder, (name,))  # an absolute one is the same from everywhere
    if found is None:
        raise InputError("intrinsics_file", f"there is no {name} in {folder} or above it, up to {root}")
    return found


def _calibration(file: Path, pair: Pair) -> Calibration:
    return read_calibration(file, second=pair.image.stem.startswith("im1"))


def _calibrated(coding: DepthCoding, calibration: Calibration | None) -> tuple[DepthCoding, Lens | None]:
    lens = None if calibration is None else calibration.lens
    if not isinstance(coding, DisparityDepth):
        return coding, lens
    focal = getattr(lens, "fx", None)
    if calibration is None:
        return coding.completed(focal, None, 0.0), lens
    return coding.completed(focal, calibration.baseline_mm, calibration.doffs_px), lens


def _read_depth(
    root: Path, pair: Pair, coding: DepthCoding, invalid: tuple[float, ...]
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Read a chart: metres, infinite where unknown, and its own numbers."""
    values = read_chart(root / pair.depth)
    metres = coding.depth_m(values)
    metres[np.isin(values, invalid)] = np.inf
    if pair.mask is not None:
        mask = read_chart(root / pair.mask)
        if mask.shape != values.shape:
            raise InputError(
                root / pair.mask, f"got {mask.shape}, but {pair.depth} is {values.shape}: fetch both again"
            )
        metres[mask == 0] = np.inf
    return metres, values


def _as_large(metres: NDArray[np.float64], shape: tuple[int, ...], root: Path, pair: Pair) -> NDArray[np.float64]:
    """Repeat a chart's pixels to the size of its image; depths are never mixed.

    Raises:
        InputError: naming the chart, when it has other proportions or more pixels.
    """
    if metres.shape == shape:
        return metres
    factors = [large / small for large, small in zip(shape, metres.shape, strict=False)]
    # Sizes are whole: a side may be half a pixel of the chart off.
    if min(factors) < 1 or abs(factors[0] / factors[1] - 1) > 0.5 / min(metres.shape):
        sizes = " x ".join(map(str, metres.shape)), " x ".join(map(str, shape[:2]))
        raise InputError(
            root / pair.depth,
            f"got {sizes[0]} pixels for the image {pair.image} of {sizes[1]}: expected as many, or fewer in its proportions",
        )
    rows, columns = (
        ((np.arange(large) + 0.5) * small / large).astype(int)
        for large, small in zip(shape, metres.shape, strict=False)
    )
    return metres[np.ix_(rows, columns)]


def recognises(path: Path) -> Likeness | None:
    """Whether there are images with depth at a path: a table of them, or files whose names and contents look like it."""
    if path.suffix.lower() == ".csv" and path.is_file():
        try:
            pairs, faults = pairs_of_table(path)
        except InputError:
            return None
        return Likeness(
            "sure", f"a table of {len(pairs)} pairs of image and depth{', some without their files' * bool(faults)}"
        )
    return next((layout.likeness for layout in find_layouts(path)), None)


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    depth: DepthCoding | None = None,
    images: str | None = None,
    depths: str | None = None,
    masks: str | None = None,
    invalid: tuple[float, ...] | None = None,
    intrinsics_file: str | None = None,
    scale: float = 1.0,
) -> Survey:
    """Read every pair once; parameters as for :func:`rgb_depth`; what is not given is proposed where the files tell.

    Raises:
        InputError: there are no pairs, or as the source.
    """
    layout = None if path.suffix.lower() == ".csv" or images or depths else next(iter(find_layouts(path)), None)
    found: dict[str, Any] = {}
    hints: dict[str, str] = {}
    if layout is not None:
        images, depths = layout.images, layout.depths
        found = {"images": images, "depths": depths}
    root, pairs, unpaired = _list(path, images, depths, masks)
    if depth is None:
        meaning = find_meaning(root, pairs[0])
        hints["depth"] = meaning.because
        if meaning.depth is not None:
            found["depth"], depth = meaning.depth, TypeAdapter(DepthCoding).validate_python(meaning.depth)
        if intrinsics_file is None and meaning.intrinsics_file is not None:
            found["intrinsics_file"] = intrinsics_file = meaning.intrinsics_file
    limits, unknown, codes = [np.inf, -np.inf], [0, 0], [np.inf, -np.inf]

    def read(pair: Pair) -> tuple[int, ...]:
        folder = (root / pair.image).parent
        calibration = (
            None if intrinsics_file is None else _calibration(_calibration_file(root, folder, intrinsics_file), pair)
        )
        values = read_chart(root / pair.depth)
        metres = values
        if depth is not None:
            coding, _ = _calibrated(depth, calibration)
            metres, values = _read_depth(root, pair, coding, _invalid(depth, invalid))
            metres = metres * scale
        light = read_light(root / pair.image)
        _as_large(metres, light.shape[:2], root, pair)
        known = metres[np.isfinite(metres)]
        if not known.size:
            raise InputError(
                root / pair.depth, "no depth is known in it: check depth and invalid, or leave this frame out"
            )
        numbers = values[np.isfinite(values)]
        limits[:] = min(limits[0], known.min()), max(limits[1], known.max())
        codes[:] = min(codes[0], numbers.min()), max(codes[1], numbers.max())
        unknown[:] = unknown[0] + metres.size - known.size, unknown[1] + metres.size
        return light.shape[:2]

    good, faults, facts, gaps = read_pairs(root, pairs, unpaired, read, progress)
    if good:
        facts["numbers of charts"] = f"{codes[0]:.6g} to {codes[1]:.6g}"
        if depth is not None:
            facts["depths"] = f"{limits[0] * 100:.4g} to {limits[1] * 100:.4g} cm"
        facts["unknown"] = f"{unknown[0] / unknown[1]:.1%} of pixels"
        facts["intrinsics"] = intrinsics_file or "none: the images' focal length is taken for unknown"
    notes = [*gaps, _ONE_VIDEO] if len(good) > 1 and len({pair.sequence for pair in good}) == 1 else gaps
    return Survey("rgb_depth", path, len(good), facts, grouped(faults), tuple(notes), (), found, hints)
