"""Scenes of a data set re-simulated: mirrored, recoloured, brighter, through the forward model that made the data set.

Rendering a scene takes twenty times as long as its measurement: new measurements of the scenes at hand cost little, and a
network that learns from them sees none of them twice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from learning.camera import capture_model, recorded_sensor
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.config import config_from_dict
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.settings import Range, Settings
from simulator.types import Clip


@dataclass(frozen=True)
class Augmentation(Settings):
    """How scenes are changed before they are re-simulated; {} takes the defaults.

    Attributes:
        flip: mirror rows and columns, each in half of the cases: the PSFs stay, so the measurement is no mirror image.
        reverse: let time run backwards in half of the cases; clips only.
        colour: standard deviation of the logarithm of what each of red, green and blue is multiplied by.
        exposure: all light is multiplied by 2^x, x evenly between minus and plus this.
        still: share of the clips that are frozen at one of their frames, which is drawn; clips only.
    """

    flip: bool = True
    reverse: bool = True
    colour: Annotated[float, Range(0, 2)] = 0.2
    exposure: Annotated[float, Range(0, 8, "stops")] = 0.5
    still: Annotated[float, Range(0, 1)] = 0.0

    def apply(self, clip: Clip, rng: np.random.Generator) -> Clip:
        """Return a clip changed by random numbers, alike in all frames and in what shines beside the image."""
        mirrored = rng.random(2) < 0.5 if self.flip else (False, False)
        gains = np.exp(self.colour * rng.standard_normal(3) + np.log(2) * rng.uniform(-self.exposure, self.exposure))
        backwards = self.reverse and len(clip.rgb) > 1 and rng.random() < 0.5
        if self.still and rng.random() < self.still:
            clip = clip.still(int(rng.integers(len(clip.rgb))))
        way = tuple(slice(None, None, -1 if each else 1) for each in (backwards, *mirrored))

        def changed(part: Any) -> dict[str, Any]:
            return {"rgb": part.rgb[way] * gains.astype(np.float32), "depth_m": part.depth_m[way]}

        around = clip.surroundings
        beside = None if around is None else replace(around, **changed(around))
        return replace(clip, **changed(clip), valid=clip.valid[way], extras={}, surroundings=beside)


class SceneCamera:
    """The camera of a data set, for scenes like those that it saw."""

    def __init__(self, dataset: Dataset) -> None:
        """Read the camera as the data set records it; no code that the data set names is run.

        Raises:
            InputError: what `learning.camera.capture_model` refuses.
        """
        self._capture = capture = capture_model(dataset)
        config = config_from_dict(dataset.config, dataset.root, check_plugins=False)
        self.sensor = recorded_sensor(dataset.info, config)
        self._model = ForwardModel(
            capture.stack,
            capture.sensor_shape,
            capture.field_shape,
            dataset.shutter,
            time=config.forward.time,
            irradiance=capture.irradiance,
            scene_to_camera=capture.scene_to_camera,
            depth_rule=DepthRule(config.forward.depth_assignment, max_clamped=1.0),  # refused when the data were made
        )

    def global_measurements(self, clip: Clip, slivers: int) -> NDArray[np.float32]:
        """Return what a global shutter would measure of each sliver of a clip, without noise, ``(N, C, H, W)``.

        Raises:
            InputError: see `exposure`.
        """
        self._check_surroundings(clip, "network.measnet")
        return np.stack([self.sensor.noiseless(seen) for seen in self._model.global_measurements(clip, slivers)])

    def exposure(self, clip: Clip) -> NDArray[np.float32]:
        """Return the noiseless exposure ``(C, H, W)`` of a clip, which `sensor` turns into a measurement.

        Raises:
            InputError: scenes without what shines beside the image, where the camera sees that, too.
        """
        self._check_surroundings(clip, "data.augment")
        return self._model.forward_clip(clip)

    def _check_surroundings(self, clip: Clip, key: str) -> None:
        if clip.surroundings is None and self._capture.field_shape != self._capture.scene_shape:
            reason = "its samples do not say what shone beside the image: made by an earlier version; make it again"
            raise InputError(key, reason)
