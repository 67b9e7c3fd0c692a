"""A data set as learning and evaluation see it: tensors, with the stored noise or any other, the same in every process."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset as TorchDataset

from learning.batches import Batches, Draw
from learning.camera_numbers import recorded_sensor
from learning.sample_cache import Arrays, SampleCache
from simulator.camera.noise import GaussianNoise
from simulator.camera.sensor import Sensor
from simulator.config import config_from_dict
from simulator.config.camera import GaussianNoise as GaussianConfig
from simulator.config.camera import PhysicalNoise as PhysicalConfig
from simulator.dataset.reader import Dataset
from simulator.dataset.sample import SPLITS, sample_index
from simulator.errors import InputError

__all__ = ["Batches", "Draw", "Example", "ExampleSet", "check_dataset"]

_STREAM = 6  # apart from the simulator's streams of the same seed, whose keys are shorter
_CHECKED = 16


class Example(NamedTuple):
    """A measurement and what was there; ``default_collate`` makes batches of the same kind with a leading B.

    Attributes:
        measurement: ``(C, H, W)`` float32, DN / 2^bits.
        radiance: ``(3, h, w)`` float32, linear sRGB.
        depth_m: ``(1, h, w)`` float32, metres.
        valid: ``(1, h, w)`` bool, False where nothing was seen, which lies at the far depth.
    """

    measurement: Tensor
    radiance: Tensor
    depth_m: Tensor
    valid: Tensor


class ExampleSet(TorchDataset[Example]):
    """One split of a data set of stills; picklable, for workers that are forked or spawned.

    Attributes:
        dataset: the split.
    """

    def __init__(
        self,
        dataset: Dataset,
        *,
        noise_db: tuple[float, float] | None = None,
        seed: int = 0,
        cache: Path | None = None,
    ) -> None:
        """Look at the data set; samples are read when they are asked for, or now, where there is a cache to be filled.

        Args:
            dataset: the split.
            noise_db: None gives the measurements as stored. A range redraws white Gaussian noise on the noiseless ones: the
                PSNR is uniform in the range, in decibels; its peak is the sample's greatest noiseless value, black level
                included; the result is clipped and quantised as the data set's own noise is (physical noise always is).
            seed: decides, with the split, the sample's id and the draw's number, level and noise.
            cache: folder for decoded samples, shared by processes and runs; see `SampleCache`.

        Raises:
            InputError: an empty split, mosaics, or levels that make no sense.
        """
        _check_not_empty(dataset)
        if noise_db is not None and not 0 < noise_db[0] <= noise_db[1] <= 120:
            msg = f"noise_db: got {noise_db}, expected a range of PSNRs such as (20, 50), in 0 to 120 dB"
            raise InputError(msg)
        self.dataset, self._noise_db, self._seed = dataset, noise_db, seed
        self._sensor, self._clip, self._quantise = _converter(dataset)
        self._cache = None
        if cache is not None:
            kind = "measurement" if noise_db is None else "noiseless"
            self._cache = SampleCache.filled(cache, dataset, kind, self._read)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.dataset)

    def __getitem__(self, draw: Draw | int) -> Example:
        """Return a sample; a plain position is draw number 0.

        Raises:
            InputError: a damaged sample, or a clip; the file is named.
        """
        position, number = draw if isinstance(draw, tuple) else (draw, 0)
        arrays = self._read(position) if self._cache is None else self._cache.read(position)
        measurement = arrays.measurement
        if self._noise_db is not None:
            measurement = self._noisy(measurement, position, number)
        return Example(*(torch.from_numpy(values) for values in (measurement, *arrays[1:])))

    def _read(self, position: int) -> Arrays:
        stored = self.dataset.stored(position)
        if stored.frame_edges_s is not None:
            msg = f"{stored.folder} is a clip of {stored.frames} frames; this reconstruction is of stills: use a set of those"
            raise InputError(msg)
        measurement, noiseless = stored.measurement()
        frame = stored.frame(0)
        if frame.depth_m.min() <= 0:
            msg = f"{stored.folder}: a depth of {frame.depth_m.min():g} m; expected z from the mask plane, above 0"
            raise InputError(msg)
        radiance = np.ascontiguousarray(np.moveaxis(frame.rgb, -1, 0))
        return Arrays(
            measurement if self._noise_db is None else noiseless, radiance, frame.depth_m[None], frame.valid[None]
        )

    def _noisy(self, noiseless: NDArray[np.float32], position: int, number: int) -> NDArray[np.float32]:
        assert self._noise_db is not None
        split, index = SPLITS.index(self.dataset.split), sample_index(self.dataset.ids[position])
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(_STREAM, split, index, number)))
        noise = GaussianNoise(psnr_db=rng.uniform(*self._noise_db), clip=self._clip, quantise=self._quantise)
        return noise.apply(noiseless, self._sensor, rng)


def check_dataset(dataset: Dataset) -> None:
    """Refuse a data set that says nothing about intensity and depth of stills; a few samples are read.

    Raises:
        InputError: an empty split, clips, mosaics, one depth everywhere, or a sample with NaN, inf or other damage.
    """
    examples = ExampleSet(dataset)
    near, far = np.inf, 0.0
    for position in np.unique(np.linspace(0, len(dataset) - 1, _CHECKED).astype(int)).tolist():
        example = examples[position]
        seen = example.depth_m[example.valid]
        if len(seen):
            near, far = min(near, float(seen.min())), max(far, float(seen.max()))
    if near >= far:
        what = f"all scenes are at {far:g} m" if far > 0 else "no pixel of its scenes is valid"
        msg = f"{dataset.root}, split {dataset.split!r} says nothing about depth: {what}; use scenes or a source with depth"
        raise InputError(msg)


def _check_not_empty(dataset: Dataset) -> None:
    if len(dataset) == 0:
        msg = (
            f"{dataset.root}: split {dataset.split!r} is empty; set dataset.{dataset.split} in its configuration and run "
            "`flatlight generate` again, or give another data set"
        )
        raise InputError(msg)


def _converter(dataset: Dataset) -> tuple[Sensor, bool, bool]:
    """Return the sensor, and whether measurements are clipped and quantised."""
    config = config_from_dict(dataset.config, dataset.root, check_plugins=False)
    if (readout := config.camera.sensor.readout) != "binned_rgb":
        msg = f"{dataset.root}: camera.sensor.readout is {readout}; reconstruction needs all colours in a pixel (binned_rgb)"
        raise InputError(msg)
    sensor = recorded_sensor(dataset.info, config)
    noise = config.camera.noise
    if isinstance(noise, GaussianConfig):
        return sensor, noise.clip, noise.quantise
    physical = isinstance(noise, PhysicalConfig)  # whose converter always does both
    return sensor, physical, physical
