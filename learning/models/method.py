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
        network: its weights, mode and device stay as they are, and may change between reconstructions.
        capture: the camera that it was built for.
    """

    def __init__(self, name: str, network: FlatNet, capture: CaptureModel) -> None:
        """Work out the inversion's W(z), as constrained least squares has it ready."""
        self.name, self.network, self.capture = name, network, capture
        self._inverse, self._made_from = self._work_out()

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``; stages ``inversion`` and ``network``.

        Raises:
            InputError: a measurement of another shape than the camera's.
        """
        clock = clock or Clock(measurement.device)
        if not _same(self._made_from, _sources(self.network)):
            self._inverse, self._made_from = self._work_out()
        training = self.network.training
        self.network.eval()  # batch normalisation by what training saw, not by this batch
        try:
            with torch.no_grad():
                with clock.stage("inversion"):
                    volume = self.network.inversion(measurement, self._inverse)
                with clock.stage("network"):
                    return self.network.enhance(volume)
        finally:
            self.network.train(training)

    def _work_out(self) -> tuple[Tensor, list[tuple[Tensor, int]]]:
        with torch.no_grad():
            return self.network.inversion.inverse(), _sources(self.network)


def _sources(network: FlatNet) -> list[tuple[Tensor, int]]:
    """Return what W follows from, with how often each was written to.

    The tensors share their memory with the network's. As long as they are kept, none else gets their addresses.
    """
    inversion = network.inversion
    return [
        (value.detach(), value._version) for value in (inversion.log_lambda, inversion.filters, inversion.numerator)
    ]


def _same(before: list[tuple[Tensor, int]], now: list[tuple[Tensor, int]]) -> bool:
    return all(
        version == other_version and value.data_ptr() == other.data_ptr() and value.dtype == other.dtype
        for (value, version), (other, other_version) in zip(before, now, strict=True)
    )
