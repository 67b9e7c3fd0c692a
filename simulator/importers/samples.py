"""Scenes of a data set that Flatlight made, seen by another camera: with another mask, sensor, shutter or noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simulator.assembly import Assembly
from simulator.config import config_from_dict
from simulator.dataset.dataset_info import FILE
from simulator.dataset.manifest import MANIFEST
from simulator.dataset.reader import Dataset, open_dataset
from simulator.dataset.sample import SPLITS
from simulator.errors import InputError
from simulator.types import Clip, View

_ALIKE = 1e-3  # relative: numbers that were written with few digits


def samples(view: View, *, path: Path, backwards: bool = False, still: bool = False) -> Samples:
    """Read the scenes of a data set: light and depth of its ground truth, and what shone beside the images.

    Splits stay apart: that of the same name is seen again, in its order; a split that the data set does not have takes from
    all scenes, and shares none with the others. The new camera must see the images under the same angles: pixel pitch and
    distance of the mask may change together. Its margin may reach as far as the samples know; ``scene.surroundings: own``
    takes what they know.

    Args:
        view: the new camera's view.
        path: folder of the data set.
        backwards: let time run backwards; labels stay what they were.
        still: show the middle frame throughout, so that nothing moves.

    Returns:
        A scene source; a scene's ``source`` says which sample it was, and what made that: a family or a source of its own.

    Raises:
        InputError: no data set, one without samples, images of another size or seen under other angles, a wider margin; both
            ``backwards`` and ``still``, or one of them where no frames of clips are stored.
    """
    if backwards and still:
        raise InputError("backwards", "got true with still: true, where frames have no order; leave one of them out")
    splits = tuple(dataset for split in SPLITS if len(dataset := open_dataset(path, split)))
    if not splits:
        raise InputError("path", f"{path} holds no finished sample; make some first")
    for name, changed in (("backwards", backwards), ("still", still)):
        if changed and splits[0].info.time.get("ground_truth") != "frames":
            reason = f"got true, but {path} stores no frames of clips, only stills or the means of slivers"
            raise InputError(name, f"{reason}; generate it with dataset.ground_truth: frames")
    shape, seen_by = splits[0].info.scene_shape, Assembly(config_from_dict(splits[0].config, path, check_plugins=False))
    tangent = seen_by.pixel_pitch_m / seen_by.mask_to_sensor_m
    own = view.pixel_pitch_m / view.distance_m
    if tuple(shape) != tuple(view.shape) or not np.isclose(tangent, own, rtol=_ALIKE, atol=0):
        seen, wanted = (
            f"{rows} x {columns} pixels of {np.degrees(np.arctan(each)):.4g} degrees"
            for (rows, columns), each in ((shape, tangent), (view.shape, own))
        )
        cure = "let scene.size, the pixels and camera.mask_to_sensor_mm give the same view"
        raise InputError("path", f"the images of {path} have {seen}, this camera's {wanted}; {cure}")
    if view.margin != (0, 0):
        around = splits[0].stored(0).surroundings()
        known = shape if around is None else tuple(around.coarseness * size for size in around.rgb.shape[1:3])
        if any(small > large for small, large in zip(view.field.shape, known, strict=True)):
            got = f"the samples of {path} know {known[0]} x {known[1]} pixels, image and margin"
            wanted = f"expected {' x '.join(map(str, view.field.shape))}: a narrower one, or camera.field_stop_deg"
            raise InputError("margin", f"{got}, {wanted}")
    return Samples(splits, backwards, still)


@dataclass(frozen=True)
class Samples:
    """All samples of a data set, split after split, as scenes."""

    parts: tuple[Dataset, ...]
    backwards: bool = False
    still: bool = False

    @property
    def splits(self) -> Mapping[str, range]:
        """The clips of each split of the data set."""
        ends = np.cumsum([0, *map(len, self.parts)]).tolist()
        return {each.split: range(*ends[at : at + 2]) for at, each in enumerate(self.parts)}

    @property
    def inputs(self) -> Sequence[Path]:
        """What the data set is; its samples' files carry digests of their own in the manifest."""
        root = Path(str(self.parts[0].root))
        return [root / FILE, root / MANIFEST]

    def __len__(self) -> int:
        """Return the number of samples."""
        return sum(map(len, self.parts))

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Return the scene of a sample; nothing is drawn from the generator."""
        del rng
        for dataset in self.parts:
            if index < len(dataset):
                sample, scene = dataset[index], dataset.config["scene"]
                clip = sample.clip()
                clip = clip.still(len(clip.rgb) // 2) if self.still else clip
                changes = {"backwards": self.backwards, "still": self.still}
                return replace(
                    _reversed(clip) if self.backwards else clip,
                    source={
                        "data set": dataset.fingerprint,
                        "sample": f"{dataset.split}/{dataset.ids[index]}",
                        "made by": {key: scene[key] for key in ("family", "source") if scene.get(key) is not None},
                        "scene": sample.metadata["scene"],
                        "seed": sample.seed,
                        **{name: True for name, changed in changes.items() if changed},
                    },
                )
            index -= len(dataset)
        raise IndexError(index)


def _reversed(clip: Clip) -> Clip:
    """Return a clip whose time runs backwards; extras, such as motion to the next frame, are left out."""
    around, end_s = clip.surroundings, clip.frame_edges_s[-1]
    return replace(
        clip,
        rgb=clip.rgb[::-1].copy(),
        depth_m=clip.depth_m[::-1].copy(),
        valid=clip.valid[::-1].copy(),
        frame_edges_s=end_s - clip.frame_edges_s[::-1],
        extras={},
        surroundings=around and replace(around, rgb=around.rgb[::-1].copy(), depth_m=around.depth_m[::-1].copy()),
    )
