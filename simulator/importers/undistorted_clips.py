"""Images with depth as clips of the view: every pixel of the view is looked up in the image and in its depth chart."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.camera_models import Lens, Pinhole
from simulator.importers.depth_codes import check_depths
from simulator.importers.depth_coding import DepthAlong
from simulator.importers.depth_sequences import DepthClips, Pair
from simulator.importers.undistortion import Circle, Field, Lookup, build_lookup
from simulator.types import Clip


@dataclass(frozen=True)
class UndistortedClips(DepthClips):
    """What sources of images with depth and any lens share; the first attributes are those of :class:`DepthClips`.

    Attributes:
        along: whether charts hold z along the optical axis or distances along rays.
        range_m: nearest and deepest valid depth, metres.
        field: ``fill`` or ``angles``, see `simulator.importers.undistortion.build_lookup`.
        circle: what the lens fills of the image, or None.
    """

    along: DepthAlong
    range_m: tuple[float, float]
    field: Field
    circle: Circle | None

    @abstractmethod
    def read(self, pair: Pair) -> tuple[NDArray[np.float32], NDArray[np.float64], Lens | None]:
        """Return linear light ``(H, W, 3)``, metres ``(H, W)``, infinite where unknown, and the lens, None if unknown.

        Raises:
            InputError: naming the file.
        """

    @abstractmethod
    def record(self, pairs: tuple[Pair, ...], lookup: Lookup) -> dict[str, Any]:
        """Return where a clip comes from and how it was read; ``lookup`` is that of its first frame."""

    @property
    @abstractmethod
    def limits(self) -> tuple[str, str]:
        """The parameter that limits depths, with its value; and which parameters to check where most lie beyond."""

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Return clip ``index`` (modulo their number); nothing is left to chance.

        Raises:
            InputError: naming the file, when it is broken; and when the clip has no valid depth.
        """
        del rng
        pairs = self.pairs_of(index)
        rgb = np.empty((self.length, *self.view.shape, 3), np.float32)
        depth = np.empty((self.length, *self.view.shape))
        lookups: list[Lookup] = []
        for t, pair in enumerate(pairs):
            light, metres, lens = self.read(pair)
            shape = (light.shape[0], light.shape[1])
            lookup = build_lookup(lens or any_pinhole(shape, self.circle), shape, self.view, self.field, self.circle)
            rgb[t] = lookup.colour(light)
            depth[t] = metres.reshape(-1)[lookup.nearest]
            if self.along == "ray":
                depth[t] *= lookup.cosine
            lookups.append(lookup)
        seen = np.stack([lookup.seen for lookup in lookups])
        none = np.isinf(depth) & seen
        beyond = seen & ~none & ((depth < self.range_m[0]) | (depth > self.range_m[1]))
        valid = seen & ~none & ~beyond
        check_depths(self.root, pairs[0].depth, depth[seen], beyond[seen], *self.limits)
        shares = {
            "unseen_share": 1 - float(seen.mean()),
            "without_depth_share": float(none.mean()),
            "beyond_max_share": float(beyond.mean()),
        }
        metres = np.where(valid, depth, self.view.far_m).astype(np.float32)
        source = self.record(pairs, lookups[0]) | shares
        return Clip(rgb, metres, valid, self.frame_edges_s, label=pairs[0].label, source=source)


def any_pinhole(shape: tuple[int, int], circle: Circle | None) -> Pinhole:
    """Return a lens for images ``(H, W)`` whose own is unknown: any focal length does, since ``fill`` finds it."""
    column, row = circle[:2] if circle else ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
    side = float(max(shape))
    return Pinhole(fx=side, fy=side, cx=column, cy=row)


def clip_files(pairs: tuple[Pair, ...]) -> dict[str, Any]:
    """A clip's files, for its record: those of its first and last frame."""
    ends = pairs[:1] + pairs[1:][-1:]
    return {
        "sequence": ends[0].sequence,
        "frames": len(pairs),
        "pictures": [pair.image.as_posix() for pair in ends],
        "depths": [pair.depth.as_posix() for pair in ends],
    }


def check_intrinsics(intrinsics: object, intrinsics_file: object, field: str, depth_along: str) -> None:
    """Refuse intrinsics that are given twice, or not at all where the directions of rays are needed."""
    if intrinsics is not None and intrinsics_file is not None:
        raise InputError("intrinsics, intrinsics_file", "both are given: leave one of them out")
    if intrinsics is None and intrinsics_file is None and (field == "angles" or depth_along == "ray"):
        what = "field: angles" if field == "angles" else "depth_along: ray"
        raise InputError(what, "needs the directions of the images' rays: give intrinsics or intrinsics_file")
