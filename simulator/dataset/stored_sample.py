"""Reading a sample's folder, whole or only the part that is wanted."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.sample import Sample
from simulator.dataset.sample_layout import (
    DESCRIPTION,
    FRAMES,
    MEASUREMENT,
    NOISELESS,
    file_metadata,
    global_file,
    read_description,
    truth_file,
)
from simulator.errors import InputError
from simulator.io.clips import TRUTH, frame_extras, layout_channels
from simulator.io.exr import decode_exr


class SceneFrame(NamedTuple):
    """What was there in one frame: ``Sample``'s fields of the same names without their first axis."""

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    valid: NDArray[np.bool_]
    extras: dict[str, NDArray[Any]]


class StoredSample:
    """A sample on disk; every file is read, and checked against ``sample.json``, when it is asked for.

    Attributes:
        folder: the sample's folder.
        description: the content of ``sample.json``.
        channels: one name per measurement channel.
        label: class name, or None.
        frames: how many frames the ground truth has.
        frame_edges_s: see ``Sample``.
        has_global_measurements: whether there is one for each frame.
    """

    def __init__(
        self,
        folder: Path | str,
        description: dict[str, Any] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> None:
        """Read ``sample.json``.

        Args:
            folder: the sample's folder.
            description: what `read_description` gave, where it was read already.
            files: the content of the EXR files by name, where they were read already; ``folder`` only names them then.

        Raises:
            InputError: no sample, or a damaged ``sample.json``.
        """
        self.folder = Path(folder)
        self.description = read_description(self.folder)[0] if description is None else description
        self.channels: tuple[str, ...] = tuple(self.description["channels"])
        self.label: str | None = self.description["label"]
        self.frames: int = self.description.get("frames", 1)
        edges_s = self.description.get("frame_edges_s")
        self.frame_edges_s = None if edges_s is None else np.array(edges_s, np.float64)
        self.has_global_measurements: bool = self.description.get("global_measurements", False)
        self._files = files

    def measurement(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the measurement and the same before noise, ``(C, H, W)`` each.

        Raises:
            InputError: the file is missing, damaged, or belongs to another sample; it is named.
        """
        expected = [*self.channels, *(NOISELESS + name for name in self.channels)]
        planes = self._read(MEASUREMENT, None, expected)
        return self._stacked(planes), self._stacked(planes, NOISELESS)

    def frame(self, number: int) -> SceneFrame:
        """Return what was there in a frame, 0 to ``frames - 1``.

        Raises:
            InputError: the file is missing, damaged, or belongs elsewhere; it is named.
        """
        layout = self.description.get("extras", {})
        own = number if self.frames > 1 else None
        planes = self._read(truth_file(number, self.frames), own, [*TRUTH, *layout_channels(layout)])
        rgb = np.stack([planes[name] for name in "RGB"], axis=-1)
        return SceneFrame(rgb, planes["Z"], planes["valid"] != 0, frame_extras(planes, layout))

    def global_measurement(self, number: int) -> NDArray[np.float32]:
        """Return what a global shutter would have measured of a frame, ``(C, H, W)``.

        Raises:
            InputError: the sample has none, or the file is missing, damaged, or belongs elsewhere; it is named.
        """
        if not self.has_global_measurements:
            msg = f"{self.folder} has no global measurements; make the data set with dataset.global_measurements=true"
            raise InputError(msg)
        return self._stacked(self._read(global_file(number), number, list(self.channels)))

    def sample(self) -> Sample:
        """Return all of the sample.

        Raises:
            InputError: a file is missing, damaged, of no use, or belongs elsewhere; it is named.
        """
        self._check_no_more_frames()
        measurement, noiseless = self.measurement()
        frames = [self.frame(number) for number in range(self.frames)]
        measured = None
        if self.has_global_measurements:
            measured = np.stack([self.global_measurement(number) for number in range(self.frames)])
        return Sample(
            measurement=measurement,
            noiseless=noiseless,
            rgb=np.stack([frame.rgb for frame in frames]),
            depth_m=np.stack([frame.depth_m for frame in frames]),
            valid=np.stack([frame.valid for frame in frames]),
            seed=self.description["seed"],
            label=self.label,
            channels=self.channels,
            metadata=self.description["metadata"],
            extras={name: np.stack([frame.extras[name] for frame in frames]) for name in frames[0].extras},
            frame_edges_s=self.frame_edges_s,
            global_measurements=measured,
        )

    def _stacked(self, planes: dict[str, NDArray[np.float32]], prefix: str = "") -> NDArray[np.float32]:
        return np.stack([planes[prefix + name] for name in self.channels])

    def _read(self, name: str, frame: int | None, expected: list[str]) -> dict[str, NDArray[np.float32]]:
        path = self.folder / name
        try:
            data = path.read_bytes() if self._files is None else self._files[name]
        except OSError as error:
            msg = f"cannot read {path}: {error.strerror or error}"
            raise InputError(msg) from error
        planes, metadata = decode_exr(data, path, require_checksums=True)
        wanted = file_metadata(self.description, frame)
        if metadata != wanted:
            what = f"{path} does not belong to the {DESCRIPTION} beside it: their metadata differ"
            if metadata | {"frame": frame} == wanted:
                what = f"{path} is frame {metadata.get('frame')} of this sample, not frame {frame}"
            msg = f"{what} (mixed-up or edited files)"
            raise InputError(msg)
        if sorted(planes) != sorted(expected):
            msg = f"{path} must have the channels {sorted(expected)}, got {sorted(planes)}"
            raise InputError(msg)
        return planes

    def _check_no_more_frames(self) -> None:
        """Refuse frames beyond those described: whoever lists the folder would take them for this sample's."""
        folder = self.folder / FRAMES
        if self.frames == 1 or not folder.is_dir():
            return
        names = [path.name for path in folder.iterdir() if re.fullmatch(r"(ground_truth|global)\.\d+\.exr", path.name)]
        unknown = sorted(f"{FRAMES}/{name}" for name in names if f"{FRAMES}/{name}" not in self.description["files"])
        if unknown:
            msg = f"{self.folder / unknown[0]} is no file of this sample, which has {self.frames} frames; remove it"
            raise InputError(msg)


def read_sample(folder: Path | str) -> Sample:
    """Read a sample's folder.

    Raises:
        InputError: a file is missing, damaged, of no use, or belongs elsewhere; it is named.
    """
    return StoredSample(folder).sample()
