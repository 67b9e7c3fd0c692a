"""What a network for stills makes of clips: the same for all frames, its depth also beside other frames."""

from __future__ import annotations

from dataclasses import replace

import torch

from learning.camera import CaptureModel
from learning.method import Clock
from learning.models import build_network, learned_method
from learning.models.repeated import RepeatedStill


def test_all_frames_are_the_stills_and_images_may_be_anothers(
    moving_capture: CaptureModel, clip_capture: CaptureModel
) -> None:
    torch.manual_seed(0)
    camera = replace(moving_capture, timing=None)
    still = learned_method("flat", build_network(camera, "flatnet3d", "tiny"), camera)
    frames = learned_method("video", build_network(clip_capture, "videonet", "tiny", joint_iterations=2), clip_capture)
    measurement = torch.rand(2, 3, 48, 48)
    method, clock = RepeatedStill("both", still, moving_capture), Clock()
    alone = method.reconstruct(measurement)
    method.frames = frames
    both = method.to("cpu").reconstruct(measurement, clock)
    expected = still.reconstruct(measurement)
    for frame in range(4):
        torch.testing.assert_close(alone.image[:, frame], expected.image)
        torch.testing.assert_close(alone.disparity[:, frame], expected.disparity)
    torch.testing.assert_close(both.image, frames.reconstruct(measurement).image)
    torch.testing.assert_close(both.disparity, alone.disparity)
    assert list(clock.seconds) == ["inversion", "network", "joint"]
