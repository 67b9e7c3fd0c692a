"""Frames and depth without learning: two walls at known depths, one of which moves; and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel
from learning.classical.by_name import ALL_DEFAULTS, build_method
from learning.classical.clip_depth import OF_VOLUME, ClipDepth
from learning.classical.method import ClassicalMethod
from learning.config import TuneConfig
from learning.layers.space_time import JOINT, JointLeastSquares
from learning.method import Clock
from learning.tune.job import classical
from simulator.errors import InputError


@pytest.fixture(scope="module")
def wide_camera(moving_capture: CaptureModel) -> CaptureModel:
    """The camera with dots over the whole sensor, as a mask that suits a rolling shutter has them; nearer, they lie wider."""
    rng = np.random.default_rng(5)
    values = np.zeros((3, 3, 81, 81), np.float32)
    for place in rng.uniform(-26, 26, (90, 2)):
        power = rng.uniform(0.5, 1, 3)
        for plane, magnification in enumerate((1.5, 1.25, 1.0)):
            row, column = np.round(place * magnification).astype(int) + 40
            values[plane, :, row, column] += power
    return moving_capture.with_stack(replace(moving_capture.stack, values=values))


def test_depths_of_what_moves_are_found(wide_camera: CaptureModel) -> None:
    """A textured square at the nearest plane jumps to the other side, before a textured wall at the farthest.

    Without noise, by the camera's own operator. In every frame the square is nearer by more than half of the range.
    """
    rng = np.random.default_rng(2)
    places = [np.s_[4:12, 1:7]] * 2 + [np.s_[4:12, 9:15]] * 2
    volume, near = np.zeros((4, 3, 3, 16, 16)), np.zeros((4, 16, 16), bool)
    wall, square = rng.uniform(0.05, 0.6, (3, 16, 16)), rng.uniform(0.2, 1, (3, 8, 6))
    for frame, place in enumerate(places):
        near[(frame, *place)] = True
        volume[frame, 2] = wall * ~near[frame]
        volume[(frame, 0, slice(None), *place)] = square
    seen = wide_camera.space_time(np.zeros(1)).forward(volume * wide_camera.irradiance * wide_camera.white)
    given = torch.from_numpy(wide_camera.gain * seen + wide_camera.offset[:, None, None])[None].float()
    of_depth = {"contrast": 2.0, "pairwise": 0.2}
    method = build_method(wide_camera, "joint3d", {"planes": 3, "iterations": 40, **of_depth})
    clock = Clock()
    estimate = method.reconstruct(given, clock)
    assert list(clock.seconds) == ["joint", "graph cut", "assembly"]
    assert estimate.image.shape == (1, 4, 3, 16, 16)
    for frame, disparity in enumerate(estimate.disparity[0, :, 0].numpy()):
        assert disparity[near[frame]].mean() > disparity[~near[frame]].mean() + 0.5, frame


def test_volumes_are_the_least_squares_of_its_planes(moving_capture: CaptureModel) -> None:
    """And what is estimated of them is, frame by frame, what a graph cut gives of the volume of a still."""
    measurement = torch.rand(1, 3, 48, 48, generator=torch.Generator().manual_seed(1))
    method = build_method(moving_capture, "joint3d", {"planes": 2, "iterations": 3})
    assert isinstance(method, ClipDepth)
    numbers: dict[str, Any] = dict(JOINT) | {"iterations": 3}
    expected = JointLeastSquares(moving_capture.with_planes(2), **numbers).volumes(measurement)
    volume = method.volume(measurement)
    torch.testing.assert_close(volume, expected)
    assert set(OF_VOLUME) == {*JOINT, "planes"}
    whole = method.estimate(volume)
    still = replace(moving_capture.with_planes(2), timing=None)
    of_depth: Any = {key: value for key, value in ALL_DEFAULTS["joint3d"].items() if key not in OF_VOLUME}
    cut = ClassicalMethod("cut", still, torch.nn.Identity(), stage="none", **of_depth)
    for frame in range(4):
        one = cut.estimate(volume[:, frame])
        torch.testing.assert_close(whole.image[:, frame], one.image)
        torch.testing.assert_close(whole.disparity[:, frame], one.disparity)


def test_a_search_asks_for_no_single_plane(moving_capture: CaptureModel, tmp_path: Path) -> None:
    config = TuneConfig.model_validate(
        {"output": tmp_path / "tuned.json", "data": {"validation": tmp_path}, "methods": ["joint3d"]}
    )
    tunable = classical(moving_capture, "joint3d", config, torch.device("cpu"))
    assert tunable.space["planes"].neighbour(2, -1) is None
    for name, axis in tunable.space.items():
        for value in axis.values:
            tunable.build(dict(tunable.defaults) | {name: value})
    assert ALL_DEFAULTS["joint3d"].keys() >= tunable.space.keys()
    assert tunable.volume_parameters == set(OF_VOLUME)


def test_stills_and_one_plane_are_refused(tiny_capture: CaptureModel, clip_capture: CaptureModel) -> None:
    with pytest.raises(InputError, match=r"^joint3d: got the camera of stills"):
        build_method(tiny_capture, "joint3d")
    with pytest.raises(InputError, match=r"^stack: got one plane, but joint3d"):
        build_method(clip_capture, "joint3d")
