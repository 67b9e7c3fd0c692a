"""Pictures from captures with the PSF of one depth: no depth is searched, so the volume is the picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from learning.baselines.admm import Admm
from learning.baselines.cls import ConstrainedLeastSquares
from learning.capture import CaptureModel
from learning.display import encode
from learning.estimate import Estimate
from learning.method import Clock
from simulator.errors import InputError

# Of ADMM, light from around the picture is let in: a real scene does not end where the picture does.
_DEFAULTS: dict[str, dict[str, Any]] = {
    "cls": {"strength": 1e-2, "floor": 0.0},
    "admm": {"tv": 0.1, "sparsity": 0.01, "iterations": 100, "light": "anywhere"},
}
_METHODS: dict[str, type[nn.Module]] = {"cls": ConstrainedLeastSquares, "admm": Admm}


class PlanarMethod:
    """CLS or ADMM at one plane; see `learning.method.Method`.

    Attributes:
        name: ``cls`` or ``admm``.
        capture: the camera; a stack of one plane.
        parameters: all of them.
    """

    def __init__(self, capture: CaptureModel, name: str, parameters: Mapping[str, Any]) -> None:
        """Prepare the method.

        Args:
            capture: the camera.
            name: ``cls`` or ``admm``.
            parameters: in the place of the defaults.

        Raises:
            InputError: a stack of several planes, an unknown name or parameter, or values that the method refuses.
        """
        if len(capture.stack.depths_m) != 1:
            msg = f"stack: got {len(capture.stack.depths_m)} planes, expected one: this is for pictures without depth"
            raise InputError(msg)
        if name not in _METHODS:
            msg = f"method: got {name!r}, expected one of {', '.join(_METHODS)}"
            raise InputError(msg)
        for parameter in parameters:
            if parameter not in _DEFAULTS[name]:
                known = ", ".join(_DEFAULTS[name])
                msg = f"--set: got {parameter!r}, expected a parameter of {name} for one plane: {known}"
                raise InputError(msg)
        self.name, self.capture = name, capture
        self.parameters = _DEFAULTS[name] | dict(parameters)
        self.stage = "inversion" if name == "cls" else "admm"
        self._inversion = _METHODS[name](capture, **self.parameters)

    def to(self, device: torch.device | str) -> PlanarMethod:
        """Move it to a device, in place."""
        self._inversion.to(device)
        return self

    def volume(self, measurement: Tensor) -> Tensor:
        """Return ``(B, 1, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``."""
        with torch.no_grad():
            return self._inversion(measurement)

    def radiance(self, volume: Tensor) -> Tensor:
        """Return linear sRGB ``(B, 3, h, w)``, 1 for white, not clipped."""
        return self.capture.to_srgb(volume[:, 0])

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return picture and a disparity of 0 everywhere, which is the one plane's."""
        clock = clock or Clock(measurement.device)
        with clock.stage(self.stage):
            picture = encode(self.radiance(self.volume(measurement)), 1.0)
        return Estimate(picture, torch.zeros_like(picture[:, :1]))
