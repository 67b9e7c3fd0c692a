"""Mixed precision: the U-Net in bfloat16 where it is wanted; what leaves it is float32 again."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from learning.estimate import Estimate
from simulator.errors import InputError


@dataclass(frozen=True)
class Precision:
    """How a network is evaluated.

    Attributes:
        kind: ``float32`` or ``bfloat16``.
        device: where.
    """

    kind: str
    device: torch.device

    @classmethod
    def choose(cls, wanted: str, device: torch.device) -> Precision:
        """Return the precision of a configuration.

        Args:
            wanted: ``auto`` (bfloat16 on a CUDA device that has it), ``float32`` or ``bfloat16``.
            device: where the network is.

        Raises:
            InputError: bfloat16 on a CUDA device without it.
        """
        fits = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
        if wanted == "bfloat16" and device.type == "cuda" and not fits:
            msg = f"precision: {torch.cuda.get_device_name(device)} has no bfloat16; take precision: float32, or auto"
            raise InputError(msg)
        kind = wanted if wanted != "auto" else "bfloat16" if fits else "float32"
        return cls(kind, device)

    def estimate(self, network: nn.Module, measurement: Tensor) -> Estimate:
        """Return a network's estimate, float32.

        Autocast takes convolutions and matrix products only; the inversion, Fourier transforms and complex products, stays
        float32, and batch statistics with it.
        """
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.kind == "bfloat16"):
            picture, disparity = network(measurement)
        return Estimate(picture.float(), disparity.float())
