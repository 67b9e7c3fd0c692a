"""EndoSLAM, SimCol3D and folders like theirs: images with depth charts give stills or clips, undistorted to the view.

Sources: Ozyoruk et al., EndoSLAM dataset and an unsupervised monocular visual odometry and depth estimation approach for
endoscopic videos, Medical Image Analysis 2021; Rau et al., SimCol3D: 3D reconstruction during colonoscopy challenge,
Medical Image Analysis 2024. Neither files nor folders say what a depth code means, so the user must.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.colour import decode_srgb_image
from simulator.errors import InputError
from simulator.importers.camera_models import Intrinsics, Lens, nearest_file, read_intrinsics
from simulator.importers.depth_codes import DepthCounts, read_codes
from simulator.importers.depth_coding import DepthAlong, DepthCode, RangeDepth
from simulator.importers.depth_pairs import list_pairs, recognises
from simulator.importers.depth_sequences import Pair, check_rate, find_runs, read_pairs
from simulator.importers.inspection import Progress, Survey
from simulator.importers.listing import grouped
from simulator.importers.undistorted_clips import UndistortedClips, check_intrinsics, clip_files
from simulator.importers.undistortion import Circle, Lookup, find_circle
from simulator.importers.videos import Count, Positive
from simulator.io.images import image_shape, read_image
from simulator.types import View

__all__ = ["EndoSlam", "endoslam", "recognises", "survey"]

_LOOKED_AT = 8
_OFF_CENTRE = 0.05
_SIMCOL = {"depth_scale_cm": 20, "depth_code": "linear", "depth_full_code": 65280}


def endoslam(
    view: View,
    *,
    path: Path,
    depth_scale_cm: Positive,
    depth_code: DepthCode,
    depth_at_zero_cm: Positive | None = None,
    depth_full_code: Annotated[int, Field(gt=0, le=65535)] | None = None,
    depth_along: DepthAlong = "axis",
    max_cm: Annotated[float, Field(gt=0)] = 10.0,
    frames: Count = 1,
    frames_per_second: Positive | None = None,
    intrinsics: Intrinsics | None = None,
    intrinsics_file: Path | None = None,
    field: Literal["fill", "angles"] = "fill",
    border: Literal["auto", "none"] | tuple[float, float, Positive] = "auto",
) -> EndoSlam:
    """Read stills or clips from images with depth charts, paired by their numbers.

    Clip ``index`` modulo the number of clips, in sorted order; clips of a sequence lie one after the other, share no frame
    and never cross a gap in the frames' numbers. Files are listed at once and read when a clip is asked for; only
    ``border: auto`` opens up to eight images at construction.

    EndoSLAM's UnityCam charts are bright where near, in 8 bits, and no formula was published: ``depth_code: inverse``, with
    a ``depth_scale_cm`` of your choice. SimCol3D's images and charts are PNG of four channels of 16 bits; its own code reads
    charts as code / 65280 x 20 cm: ``depth_scale_cm: 20``, ``depth_code: linear``, ``depth_full_code: 65280``.

    Args:
        view: the camera's view: size, angles, far depth.
        path: a folder with images and depth charts somewhere below it, such as ``Frames`` beside ``Pixelwise Depths``,
            ``train_frame`` beside ``train_depth``, or ``FrameBuffer_0000.png`` and ``Depth_0000.png`` in one folder.
        depth_scale_cm: depth at the full code: the farthest of a ``linear`` chart, the nearest of an ``inverse`` one.
        depth_code: ``linear``: depth is proportional to the code; ``inverse``: one over depth is (bright is near).
        depth_at_zero_cm: depth at code zero, if that is a depth: null takes it for none (0 or infinity). A reversed depth
            buffer has its near plane as ``depth_scale_cm`` and its far plane here.
        depth_full_code: the full code; null is the file's largest number, 255 or 65535.
        depth_along: whether the chart holds z along the optical axis or distances along each ray (needs intrinsics).
        max_cm: where the chart says more, ``valid`` is false and the light comes from the view's far depth; a clip that lies
            beyond it everywhere is refused.
        frames: of a clip, with consecutive numbers; 1 gives stills.
        frames_per_second: rate at which a clip's frames were taken; clips need it (UnityCam's was 30).
        intrinsics: the images' camera in pixels: ``type: pinhole`` (fx, fy, cx, cy, distortion [k1, k2, p1, p2, k3]),
            ``opencv_fisheye`` (fx, fy, cx, cy, distortion [k1, k2, k3, k4]) or ``scaramuzza`` (mapping [a0, a2, a3, a4], cx,
            cy, stretch), with ``first_pixel: 1`` for MATLAB's numbers. Without it, and without a file, the images are
            taken for undistorted and of unknown focal length.
        intrinsics_file: the same as YAML or JSON, or a text file with the camera matrix's nine numbers, row by row.
        field: ``fill`` takes the largest part of the image around its optical axis that fills the view, at most 70
            degrees to its corners, as if taken with another focal length; ``angles`` keeps each ray's direction (needs
            intrinsics), black where the image ends.
        border: the circle that the lens fills; outside it the image is black and ``valid`` false. ``auto`` finds it in
            eight images, ``none`` uses the whole image; or column, row and radius in pixels, the first pixel being 0.

    Returns:
        A scene source. A still holds one frame of 1 s. Files without partner and sequences too short for a clip are its
        ``problems``; a sequence is a group.

    Raises:
        InputError: for missing folders or pairs, and when the parameters contradict one another.
    """
    check_rate(frames, frames_per_second)
    check_intrinsics(intrinsics, intrinsics_file, field, depth_along)
    known = intrinsics or (read_intrinsics(intrinsics_file) if intrinsics_file is not None else None)
    if depth_at_zero_cm == depth_scale_cm:
        raise InputError("depth_at_zero_cm, depth_scale_cm", f"both are {depth_scale_cm:g}: they must differ")
    root = Path(path)
    pairs, faults = list_pairs(root)
    starts, groups, short = find_runs(pairs, frames)
    shape = _first_shape(root, pairs)
    circle = _find_border(root, pairs, shape) if border == "auto" else None if border == "none" else border
    return EndoSlam(
        view=view,
        root=root,
        pairs=pairs,
        starts=starts,
        groups=groups,
        length=frames,
        frames_per_second=frames_per_second,
        problems=grouped(faults) + short,
        decoding=RangeDepth(
            type=depth_code, full_cm=depth_scale_cm, zero_cm=depth_at_zero_cm, full_code=depth_full_code
        ),
        along=depth_along,
        range_m=(0.0, max_cm * 1e-2),
        lens=known,
        shape=shape,
        field=field,
        circle=circle,
        intrinsics_file=intrinsics_file,
    )


@dataclass(frozen=True)
class EndoSlam(UndistortedClips):
    """A scene source made by :func:`endoslam`; the first attributes are those of :class:`UndistortedClips`.

    Attributes:
        decoding: what the codes mean.
        lens: the images' camera, or None.
        shape: rows and columns of all images.
        intrinsics_file: where the camera came from, or None.
    """

    decoding: RangeDepth
    lens: Lens | None
    shape: tuple[int, int]
    intrinsics_file: Path | None

    @property
    def inputs(self) -> list[Path]:
        """All images and depth charts, and the file with intrinsics."""
        return [*super().inputs, *([] if self.intrinsics_file is None else [self.intrinsics_file])]

    def read(self, pair: Pair) -> tuple[NDArray[np.float32], NDArray[np.float64], Lens | None]:
        """Read an image and its depth chart.

        Raises:
            InputError: naming the file, when it is broken or of another size than the others.
        """
        light = decode_srgb_image(self._read(pair.image, read_image, 3))
        return light, self.decoding.depth_m(self._read(pair.depth, read_codes, 2)), self.lens

    @property
    def limits(self) -> tuple[str, str]:
        """The parameter that limits depths, and those that decide them."""
        cure = (
            f"check depth_scale_cm ({self.decoding.full_cm:g}) and depth_code ({self.decoding.type}), or raise max_cm"
        )
        return f"max_cm {self.range_m[1] * 100:g}", cure

    def record(self, pairs: tuple[Pair, ...], lookup: Lookup) -> dict[str, Any]:
        """Return where a clip comes from and how it was read."""
        return {
            "importer": "endoslam",
            **clip_files(pairs),
            **self.decoding.record(),
            "depth_along": self.along,
            "max_cm": self.range_m[1] * 100,
            "intrinsics": None if self.lens is None else self.lens.model_dump(mode="json"),
            "field": self.field,
            "field_scale": None if self.lens is None else lookup.scale,
            "image_circle_px": None if self.circle is None else list(self.circle),
        }

    def _read(self, name: Path, reader: Any, dimensions: int) -> NDArray[Any]:
        image = reader(self.root / name)
        if image.shape[:2] != self.shape or image.ndim != dimensions:
            what = " x ".join(map(str, image.shape))
            kind = "RGB image" if dimensions == 3 else "depth chart"
            raise InputError(
                self.root / name,
                f"got {what}; expected a {kind} of {self.shape[0]} x {self.shape[1]}, like {self.pairs[0].image}",
            )
        return image


def _first_shape(root: Path, pairs: tuple[Pair, ...]) -> tuple[int, int]:
    """Rows and columns of the first image that is one; those that are broken fail when their clip is asked for."""
    first: InputError | None = None
    for pair in pairs:
        try:
            return image_shape(root / pair.image)
        except InputError as error:
            first = first or error
    assert first is not None
    raise first


def _find_border(root: Path, pairs: tuple[Pair, ...], shape: tuple[int, int]) -> Circle | None:
    """The image circle, from images spread over all sequences."""
    chosen = np.unique(np.linspace(0, len(pairs) - 1, _LOOKED_AT).round().astype(int))
    images = []
    for k in chosen:
        with suppress(InputError):
            images.append(read_image(root / pairs[k].image))
    alike = [image for image in images if image.shape == (*shape, 3)]
    return find_circle(alike, str(root)) if alike else None


def survey(
    path: Path,
    progress: Progress | None = None,
    *,
    depth_scale_cm: float | None = None,
    depth_code: DepthCode | None = None,
    depth_at_zero_cm: float | None = None,
    depth_full_code: int | None = None,
    depth_along: DepthAlong = "axis",
    max_cm: float = 10.0,
) -> Survey:
    """Read every pair once; parameters as for :func:`endoslam`.

    With ``depth_scale_cm`` and ``depth_code``, codes are told in centimetres too, and a chart that lies beyond ``max_cm``
    everywhere is a problem.

    Raises:
        InputError: when there is no such folder or no pair in it, or only one of ``depth_scale_cm`` and ``depth_code`` is
            given.
    """
    decoding = None
    if any(value is not None for value in (depth_scale_cm, depth_code, depth_at_zero_cm, depth_full_code)):
        if depth_scale_cm is None or depth_code is None:
            missing = "depth_scale_cm" if depth_scale_cm is None else "depth_code"
            raise InputError(missing, "missing: give both depth_scale_cm and depth_code, or neither")
        decoding = RangeDepth(
            type=depth_code, full_cm=depth_scale_cm, zero_cm=depth_at_zero_cm, full_code=depth_full_code
        )
    root = Path(path)
    pairs, unpaired = list_pairs(root)
    counts = DepthCounts(decoding, max_cm * 1e-2, depth_along)
    images: list[NDArray[Any]] = []

    def read(pair: Pair) -> tuple[int, ...]:
        image, codes = read_image(root / pair.image), read_codes(root / pair.depth)
        if image.shape != (*codes.shape, 3):
            texts = (" x ".join(map(str, array.shape)) for array in (image, codes))
            raise InputError(root / pair.image, f"got {', but its depth chart is '.join(texts)}: fetch both again")
        if not counts.add(codes):
            raise InputError(root / pair.depth, counts.all_beyond)
        if len(images) < _LOOKED_AT:
            images.append(image)
        return codes.shape

    good, faults, facts, gaps = read_pairs(root, pairs, unpaired, read, progress)
    facts |= counts.facts()
    notes, found, hints = [*counts.notes(), *gaps], dict[str, Any](), dict[str, str]()
    if images:
        alike = [image for image in images if image.shape == images[0].shape]
        facts["image circle"], note = _circle(alike, root)
        notes += note
        facts["intrinsics"], note = _intrinsics(root, good[0], images[0].shape)
        notes += note
        if good[0].image.name.startswith("FrameBuffer"):
            found, hints = _SIMCOL, {"depth_code": "as SimCol3D's own code reads it, code / 65280 x 20 cm"}
    return Survey("endoslam", root, len(good), facts, grouped(faults), tuple(notes), found=found, hints=hints)


def _circle(images: list[NDArray[Any]], root: Path) -> tuple[str, list[str]]:
    try:
        circle = find_circle(images, str(root))
    except InputError as error:
        return "none found", [str(error)]
    if circle is None:
        return "the whole image", []
    return f"column {circle[0]:.1f}, row {circle[1]:.1f}, radius {circle[2]:.1f} px", []


def _intrinsics(root: Path, pair: Pair, shape: tuple[int, ...]) -> tuple[str, list[str]]:
    file = nearest_file(root, (root / pair.image).parent)
    if file is None:
        return "no file", []
    try:
        column, row = read_intrinsics(file).centre
    except InputError as error:
        return str(file), [str(error)]
    off = max(abs(column - (shape[1] - 1) / 2) / shape[1], abs(row - (shape[0] - 1) / 2) / shape[0])
    if off <= _OFF_CENTRE:
        return str(file), []
    return str(file), [
        f"{file} puts the optical axis at column {column:g}, row {row:g} of {shape[0]} x {shape[1]} pixels: check that it "
        "belongs to images of this size"
    ]
