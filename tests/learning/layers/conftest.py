"""Cameras of random PSFs in any size, for tests that need no optics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from learning.camera import CaptureModel
from simulator.optics.stack import PsfStack


def random_capture(
    sensor: tuple[int, int],
    scene: tuple[int, int],
    psf: tuple[int, int],
    *,
    depths_m: tuple[float, ...] = (0.02, 0.03, 0.06),
    channels: tuple[str, ...] = ("R", "G", "B"),
    plain: bool = False,
    seed: int = 0,
) -> CaptureModel:
    """Return a camera of sparse random PSFs without any symmetry; a plain one neither scales nor shifts its numbers."""
    rng = np.random.default_rng(seed)
    values = rng.random((len(depths_m), len(channels), *psf)) ** 8
    stack = PsfStack(values, np.array(depths_m), 1e-5, channels, "random")
    irradiance = np.ones(scene) if plain else rng.uniform(0.5, 1, scene)
    return CaptureModel(
        stack=stack,
        sensor_shape=sensor,
        scene_shape=scene,
        gain=1.0 if plain else 0.02,
        offset=np.zeros(len(channels)) if plain else rng.uniform(0, 0.1, len(channels)),
        irradiance=irradiance.astype(np.float32),
        scene_to_camera=rng.random((len(channels), 3)) + np.eye(len(channels), 3),
        white=1.0 if plain else 0.7,
    )


@pytest.fixture
def camera() -> Callable[..., CaptureModel]:
    """Make a camera; see `random_capture`."""
    return random_capture
