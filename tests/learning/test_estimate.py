"""Estimates within their ranges, and as depths."""

from __future__ import annotations

import pytest
import torch

from learning.capture import CaptureModel
from learning.estimate import Estimate


def test_clamping_changes_only_what_is_outside() -> None:
    picture = torch.tensor([-0.5, 0.0, 0.25, 1.0, 3.0]).expand(1, 3, 1, 5)
    disparity = torch.tensor([-2.0, 0.1, 0.9, 1.0, 1.5]).reshape(1, 1, 1, 5)
    clamped = Estimate(picture, disparity).clamped()
    assert clamped.picture[0, 1, 0].tolist() == [0, 0, 0.25, 1, 1]
    assert clamped.disparity.ravel().tolist() == pytest.approx([0, 0.1, 0.9, 1, 1])
    assert picture.min() == -0.5


def test_depths_stay_within_the_stacks_range(tiny_capture: CaptureModel) -> None:
    disparity = torch.tensor([-1.0, 0.0, 0.2, 1.0, 2.0]).reshape(1, 1, 1, 5)
    depth_m = Estimate(torch.zeros(1, 3, 1, 5), disparity).depth_m(tiny_capture)
    assert depth_m.shape == (1, 1, 1, 5)
    # 5 per metre, and a fifth of the 95 per metre to the nearest plane on top: 24 per metre.
    assert depth_m.ravel().tolist() == pytest.approx([0.2, 0.2, 1 / 24, 0.01, 0.01])
