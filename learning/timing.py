"""When the rows of a sensor see the frames that a capture is taken apart into: what a rolling shutter adds to a camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.camera.shutter import Shutter, shutter_from_record, shutter_record
from simulator.camera.slivers import sliver_edges
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset
from simulator.dataset.sample import StoredSample, stored_folder
from simulator.errors import InputError
from simulator.text import show

_MOST_FRAMES = 2000  # a number that somebody else wrote decides how much memory a reader takes
_ALIKE = 1e-6  # of a capture's time: forgives times that were written with few digits


@dataclass(frozen=True, eq=False)
class Timing:
    """The frames that are told apart in a capture, and the shutter.

    Attributes:
        shutter: of the physical sensor.
        frame_edges_s: ``(N + 1,)`` seconds after the start of the capture: frame n, which a sliver of the capture saw, lasts
            from edge n to n + 1.
    """

    shutter: Shutter
    frame_edges_s: NDArray[np.float64]

    @property
    def frames(self) -> int:
        """N."""
        return len(self.frame_edges_s) - 1

    def sliver_weights(self, rows: int) -> NDArray[np.float64]:
        """Return the share of each frame's time in which each of so many rows of the stored image is open, ``(N, rows)``.

        A measurement times these is its slivers; see `simulator.camera.slivers`.
        """
        # Shutter rows are physical; the stored image is rotated by 180 degrees.
        return self.shutter.weights(rows, self.frame_edges_s)[:, ::-1].copy()

    def row_shares(self, rows: int) -> NDArray[np.float64]:
        """Return the share of each row's exposure that falls into each frame, ``(N, rows)``; over frames they add up to 1."""
        seconds = self.sliver_weights(rows) * np.diff(self.frame_edges_s)[:, None]
        return seconds / seconds.sum(axis=0)

    def record(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"shutter": shutter_record(self.shutter), "frame_edges_s": self.frame_edges_s.tolist()}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Timing:
        """Return the timing of a record; an InputError says what is wrong with it."""
        given = record if isinstance(record, Mapping) else {}
        try:
            edges_s = np.asarray(given.get("frame_edges_s"), np.float64)
        except (TypeError, ValueError):
            edges_s = np.empty(0)
        if edges_s.ndim != 1 or len(edges_s) < 2 or not (np.isfinite(edges_s).all() and (np.diff(edges_s) > 0).all()):
            got = show(given.get("frame_edges_s"))
            raise InputError("frame_edges_s", f"got {got}, expected at least two increasing times")
        if len(edges_s) > _MOST_FRAMES + 1:
            raise InputError("frame_edges_s", f"got {len(edges_s) - 1} frames, expected at most {_MOST_FRAMES}")
        return cls(shutter_from_record(given.get("shutter")), edges_s)

    def with_slivers_of(self, known: Timing) -> Timing:
        """Return the same capture taken apart as another one is that lasts as long; one of another length as it is."""
        ends_s = self.frame_edges_s[[0, -1]], known.frame_edges_s[[0, -1]]
        alike = np.allclose(*ends_s, rtol=0, atol=_ALIKE * known.frame_edges_s[-1])
        return replace(self, frame_edges_s=known.frame_edges_s) if alike else self

    def check_same(self, known: Timing, rows: int) -> None:
        """Refuse the timing of a capture, this one, for a method that knows another, of a sensor with so many rows.

        Raises:
            InputError: another number of slivers, other times, or another shutter.
        """
        if self.frames != known.frames:
            cure = "take a method for as many, or set dataset.slivers"
            raise InputError("slivers", f"got {self.frames}, the method was made for {known.frames}; {cure}")
        last_s = known.frame_edges_s[-1]
        if not np.allclose(self.frame_edges_s, known.frame_edges_s, rtol=0, atol=_ALIKE * last_s):
            apart = int(np.argmax(np.abs(self.frame_edges_s - known.frame_edges_s) > _ALIKE * last_s))
            here, there = (f"{1e3 * each.frame_edges_s[apart]:.6g} ms" for each in (self, known))
            got = f"got {here} for edge {apart} of 0 to {self.frames}, the method was made for {there}"
            raise InputError(
                "frame_edges_s", f"{got}; set scene.frames_per_second or dataset.slivers, or train and tune anew"
            )
        windows = [each.shutter.windows_s(rows) for each in (self, known)]
        if not (windows[0].shape == windows[1].shape and np.allclose(*windows, rtol=0, atol=_ALIKE * last_s)):
            here, there = (_described(each.shutter) for each in (self, known))
            raise InputError("shutter", f"got {here}, the method was made for {there}; train and tune anew")


def _described(shutter: Shutter) -> str:
    """Return a shutter's record in words, without long tables."""
    shown = {key: value for key, value in shutter_record(shutter).items() if not isinstance(value, list)}
    return " ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in shown.items()
    )


def recorded_timing(dataset: Dataset) -> Timing | None:
    """Return the timing of a data set's clips, which is that of any of its samples; None of stills.

    Clips are taken apart into their slivers, whether the ground truth holds these or all frames.

    Raises:
        InputError: no sample of any split, from which to tell; a damaged sample; no record of a shutter.
    """
    if len(dataset):
        return sample_timing(dataset, dataset.stored(0))
    for split, name in load_manifest(dataset.root).entries:
        return sample_timing(dataset, StoredSample(stored_folder(dataset.root, split, name)))
    if dataset.config["scene"].get("frames") in (None, 1):
        return None
    raise InputError(dataset.root, "has no sample from which to tell the times of its frames; generate some first")


def with_slivers(dataset: Dataset, slivers: int | None) -> Dataset:
    """Return a data set whose captures are taken apart into another number of slivers; None leaves them.

    Raises:
        InputError: stills, clips of which only the slivers' means are stored, or a number that does not divide the frames.
    """
    time = dataset.info.time
    if slivers is None or slivers == time.get("slivers"):
        return dataset
    if recorded_timing(dataset) is None:
        reason = "holds stills, which have no slivers; take clips (scene.frames)"
        raise InputError("slivers", f"got {slivers}, but {dataset.root} {reason}")
    if time.get("ground_truth") != "frames":
        reason = (
            "does not store all frames, from which other slivers could be made; generate it with ground_truth: frames"
        )
        raise InputError("slivers", f"got {slivers}, but {dataset.root} {reason}")
    other = Dataset(dataset.root, dataset.split, dataset.ids, replace(dataset.info, time=time | {"slivers": slivers}))
    recorded_timing(other)
    return other


def sample_timing(dataset: Dataset, stored: StoredSample) -> Timing | None:
    """Return the timing of one sample; None of a still."""
    if stored.frame_edges_s is None:
        return None
    if (shutter := dataset.shutter) is None:
        raise InputError(dataset.root, "records no shutter (time.shutter), which clips need; make it again")
    slivers = dataset.info.time.get("slivers")
    if slivers is not None and (type(slivers) is not int or slivers < 1):
        raise InputError(
            dataset.root, f"time.slivers: got {show(slivers)}, expected a number from 1; restore its record"
        )
    return Timing(shutter, sliver_edges(stored.frame_edges_s, slivers or stored.frames))
