"""Clean pictures of a data set with noise on them: whole ones, and single planes of volumes, as a denoiser learns from."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset as TorchDataset

from learning.camera import CaptureModel
from learning.data import Draw, SampleCache, read_scene
from simulator.camera.planes import split_planes
from simulator.dataset.reader import Dataset
from simulator.dataset.sample import SPLITS, sample_index

_STREAM = 7  # apart from those of `learning.data`
_WHOLE, _ANY_PLANE = 0.3, 0.2  # shares of whole pictures, and of planes whether or not something is in them
_PLANES = (4, 32)  # of a stack: the least number, and one more than the greatest
_BRIGHTNESS = (0.4, 1.6)


class NoisyPicture(NamedTuple):
    """A picture and its noisy version ``(3, h, w)`` float32, 1 for white, with the noise's standard deviation ``()``."""

    clean: Tensor
    noisy: Tensor
    noise: Tensor


class Pictures(TorchDataset[NoisyPicture]):
    """The scenes of one split of a data set as ADMM's volumes hold them: linear light over white, vignetting included.

    Some are whole, some one plane of a random stack: surfaces on black. Flipped, turned, brighter or darker, colours
    exchanged. All of it is decided by the seed, the sample and the number of the draw.
    """

    def __init__(
        self, dataset: Dataset, capture: CaptureModel, noise: tuple[float, float], seed: int, cache: Path | None = None
    ) -> None:
        """Take pictures of scenes, with noise whose standard deviation lies log-uniformly between two numbers.

        ``cache`` is a folder for decoded scenes, the same as those of `learning.data.ExampleSet` with ``augment``.
        """
        self.dataset, self._noise, self._seed = dataset, noise, seed
        self._read = partial(read_scene, dataset)
        if cache is not None:
            self._read = SampleCache.filled(cache, dataset, "scene", self._read).read
        field = capture.scene_irradiance / capture.scene_irradiance.max() / capture.white
        self._colours = (capture.scene_to_camera[:, :, None, None] * field).astype(np.float32)
        self._disparities = (1 / capture.near_m, 1 / capture.far_m)

    def __len__(self) -> int:
        """Return the number of scenes."""
        return len(self.dataset)

    def __getitem__(self, draw: Draw | int) -> NoisyPicture:
        """Return a picture of a scene; a plain position is draw number 0."""
        position, number = draw if isinstance(draw, tuple) else (draw, 0)
        scene = self._read(position)
        split, index = SPLITS.index(self.dataset.split), sample_index(self.dataset.ids[position])
        rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(_STREAM, split, index, number)))
        light = np.einsum("cahw,ahw->chw", self._colours, scene["radiance"])
        if rng.random() > _WHOLE:
            light = self._plane(light, scene["depth_m"][0], rng)
        picture = torch.from_numpy(np.ascontiguousarray(_varied(light, rng), np.float32))
        noise = float(np.exp(rng.uniform(*np.log(self._noise))))
        noisy = picture + noise * torch.from_numpy(rng.standard_normal(picture.shape, np.float32))
        return NoisyPicture(picture, noisy, torch.tensor(noise))

    def _plane(
        self, light: NDArray[np.float32], depth_m: NDArray[np.float32], rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return one plane: of a stack even in disparity, as stacks are, with ends that are those of the camera or nearer."""
        near, far = self._disparities
        if rng.random() < 0.5:
            far, near = np.sort(rng.uniform(far, near, 2))
        volume = split_planes(light, depth_m, 1 / np.linspace(near, far, int(rng.integers(*_PLANES))))
        if rng.random() < _ANY_PLANE:
            return volume[rng.integers(len(volume))]
        row, column = (rng.integers(size) for size in depth_m.shape)
        return volume[volume[:, :, row, column].sum(axis=1).argmax()]


def _varied(light: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return a picture ``(3, h, w)`` otherwise: turned or flipped, its colours exchanged, brighter or darker."""
    if rng.random() < 0.5:
        light = light[..., ::-1]
    turns = int(rng.integers(4)) if light.shape[1] == light.shape[2] else 2 * int(rng.integers(2))
    return np.rot90(light, turns, (1, 2))[rng.permutation(len(light))] * np.float32(rng.uniform(*_BRIGHTNESS))
