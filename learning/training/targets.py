"""What a network should give for an example."""

from __future__ import annotations

import torch

from learning.capture import CaptureModel
from learning.data import Example
from learning.display import encode
from learning.estimate import Estimate


def true_estimate(example: Example, capture: CaptureModel) -> Estimate:
    """Return picture and disparity of what was there, of a batch; what was not seen lies at the far depth."""
    disparity = torch.where(example.valid, capture.disparity(example.depth_m), 0)
    return Estimate(encode(example.radiance, capture.white), disparity)


def to_device(example: Example, device: torch.device) -> Example:
    """Return the example on a device; copies from pinned memory overlap with work there."""
    return Example(*(values.to(device, non_blocking=True) for values in example))
