"""A trained network as a reconstruction method."""

from __future__ import annotations

import torch
from torch import Tensor

from learning.capture import CaptureModel
from learning.estimate import Estimate
from learning.method import Clock
from learning.models.flatnet import FlatNet


class LearnedMethod:
    """A network that stands beside the classical methods; see `learning.method.Method`.

    Attributes:
        name: in tables and figures.
        network: its weights, mode and device stay as they are.
        capture: the camera that it was built for.
    """

    def __init__(self, name: str, network: FlatNet, capture: CaptureModel) -> None:
        self.name, self.network, self.capture = name, network, capture

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``; stages ``inversion`` and ``network``.

        Raises:
            InputError: a measurement of another shape than the camera's.
        """
        clock = clock or Clock(measurement.device)
        training = self.network.training
        self.network.eval()  # batch normalisation by what training saw, not by this batch
        try:
            with torch.no_grad():
                with clock.stage("inversion"):
                    volume = self.network.inversion(measurement)
                with clock.stage("network"):
                    return self.network.enhance(volume)
        finally:
            self.network.train(training)
