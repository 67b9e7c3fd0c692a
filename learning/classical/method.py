"""The classical methods: a volume by least squares or ADMM, depth from it by a graph cut, and the all-in-focus picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.classical.admm import Admm
from learning.classical.cls import ConstrainedLeastSquares
from learning.classical.focus import COSTS, LIGHT, MEASURES, assemble, unary_cost
from learning.classical.graph_cut import cut_labels
from learning.method import Clock, Estimate, encode
from simulator.arrays import to_numpy
from simulator.errors import InputError

Value = float | int | str

VOLUME_PARAMETERS: dict[str, tuple[str, ...]] = {"cls": ("strength", "floor"), "admm": ("tv", "sparsity", "iterations")}
"""Parameters of `ConstrainedLeastSquares` and `Admm`; all others are of `ClassicalMethod`."""

DEFAULTS: dict[str, dict[str, Value]] = {
    "cls": {
        "strength": 0.1,
        "floor": 1.0,
        "cost": "spread",
        "measure": "laplacian",
        "contrast": 8.0,
        "window_px": 2.0,
        "pairwise": 0.2,
        "steps_between_planes": 4,
        "light": "label",
    },
    "admm": {
        "tv": 0.02,
        "sparsity": 0.01,
        "iterations": 60,
        "cost": "spread",
        "measure": "light",
        "contrast": 0.75,
        "window_px": 1.0,
        "pairwise": 0.2,
        "steps_between_planes": 4,
        "light": "sum",
    },
}
"""All parameters, as found on validation scenes of 64 x 64 pixels with eight planes at 40 dB: where tuning begins."""

SEARCH: dict[str, dict[str, tuple[Value, ...]]] = {
    "cls": {
        "strength": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
        "floor": (0.03, 0.1, 0.3, 1.0),
        "cost": COSTS,
        "measure": MEASURES,
        "contrast": (0.3, 1.0, 2.0, 4.0, 8.0, 16.0),
        "window_px": (0.5, 1.0, 2.0, 4.0),
        "pairwise": (0.1, 0.2, 0.5, 2.0, 8.0),
        "steps_between_planes": (1, 4),
        "light": LIGHT,
    },
    "admm": {
        "tv": (0.005, 0.01, 0.02, 0.05, 0.1),
        "sparsity": (1e-3, 3e-3, 0.01, 0.03, 0.1),
        "iterations": (30, 60, 120),
        "cost": COSTS,
        "measure": MEASURES,
        "contrast": (0.25, 0.5, 0.75, 1.0, 2.0),
        "window_px": (0.5, 1.0, 2.0, 4.0),
        "pairwise": (0.1, 0.2, 0.5, 2.0, 8.0),
        "steps_between_planes": (1, 4),
        "light": LIGHT,
    },
}
"""Candidates for tuning, coarse; numbers increase."""

_VOLUMES: dict[str, tuple[Callable[..., nn.Module], str, str]] = {
    "cls": (ConstrainedLeastSquares, "CLS + graph cut", "inversion"),
    "admm": (Admm, "ADMM + graph cut", "admm"),
}
_KINDS: dict[type, tuple[str, tuple[type, ...]]] = {
    str: ("a word", (str,)),
    int: ("a whole number", (int,)),
    float: ("a number", (int, float)),
}


class ClassicalMethod:
    """CLS + graph cut and ADMM + graph cut of the thesis, section 5.2.3: a `learning.method.Method`.

    Attributes:
        name: in tables and figures.
        capture: the camera that it believes in.
    """

    def __init__(
        self,
        name: str,
        capture: CaptureModel,
        volume_method: nn.Module,
        *,
        stage: str,
        cost: str,
        measure: str,
        contrast: float,
        window_px: float,
        pairwise: float,
        steps_between_planes: int,
        light: str,
    ) -> None:
        """Put the method together.

        Args:
            name: in tables and figures.
            capture: the camera, whose stack has at least two planes.
            volume_method: from measurements ``(B, C, H, W)`` to volumes ``(B, K, C, h, w)`` of all planes.
            stage: what its time is booked under.
            cost: the unary cost; this and the next three see `learning.classical.focus.unary_cost`.
            measure: of sharpness.
            contrast: of the planes.
            window_px: standard deviation of the window.
            pairwise: cost of a step between neighbours from the first label to the last, as a multiple of what separates a
                pixel's best label from its worst, in the scene's mean: one number serves all costs, contrasts and labels.
            steps_between_planes: labels of depth from one plane to the next, for the costs that have some between.
            light: of the picture; see `learning.classical.focus.assemble`.

        Raises:
            InputError: a single plane, a negative ``pairwise``, or other names for ``cost``, ``measure`` or ``light``.
        """
        planes = len(capture.stack.depths_m)
        if planes < 2:
            msg = f"capture: its stack has {planes} plane, expected at least two: depth is found by comparing planes"
            raise InputError(msg)
        if not (np.isfinite(pairwise) and pairwise >= 0):
            msg = f"pairwise: got {pairwise!r}, expected 0 or more"
            raise InputError(msg)
        for what, value, known in (("cost", cost, COSTS), ("measure", measure, MEASURES), ("light", light, LIGHT)):
            if value not in known:
                msg = f"{what}: got {value!r}, expected one of {', '.join(known)}"
                raise InputError(msg)
        self.name, self.capture = name, capture
        self._method, self._stage, self._light, self._pairwise = volume_method, stage, light, float(pairwise)
        self._unary: dict[str, Any] = {"cost": cost, "measure": measure, "contrast": contrast, "window_px": window_px}
        self._unary["steps_between_planes"] = steps_between_planes
        # A wrong contrast or window is told now, not after minutes of ADMM.
        unary_cost(torch.zeros(1, 2, 1, 1, 1), **self._unary)

    def to(self, device: torch.device | str) -> Self:
        """Move what makes volumes to a device, and return this; graph cuts stay on the CPU."""
        self._method.to(device)
        return self

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits, on their device; without gradients.

        Args:
            measurement: what the camera stored.
            clock: times the stages: that of the volume, ``graph cut`` (with its costs) and ``assembly``.

        Raises:
            InputError: measurements that do not fit the camera, or are no numbers.
        """
        clock = clock or Clock(measurement.device)
        with clock.stage(self._stage):
            volume = self.volume(measurement)
        return self.estimate(volume, clock)

    @torch.no_grad()
    def volume(self, measurement: Tensor) -> Tensor:
        """Return the volume ``(B, K, C, h, w)`` of measurements ``(B, C, H, W)``.

        Raises:
            InputError: measurements that do not fit the camera.
        """
        shape = (len(self.capture.stack.channels), *self.capture.sensor_shape)
        if measurement.ndim != 4 or tuple(measurement.shape[1:]) != shape:
            wanted = ", ".join(str(n) for n in shape)
            msg = f"measurement: got shape {tuple(measurement.shape)}, expected (B, {wanted}) for this camera"
            raise InputError(msg)
        return self._method(measurement)

    @torch.no_grad()
    def estimate(self, volume: Tensor, clock: Clock | None = None) -> Estimate:
        """Return picture and depth of a volume ``(B, K, C, h, w)``.

        Args:
            volume: in the camera's channels, 1 for white, free of the irradiance map.
            clock: times the stages.

        Raises:
            InputError: a volume of another shape, or one with NaN or infinite values.
        """
        clock = clock or Clock(volume.device)
        with clock.stage("graph cut"):
            places = self.places(volume)
        with clock.stage("assembly"):
            return assemble(volume, places, self.capture, self._light)

    @torch.no_grad()
    def places(self, volume: Tensor) -> Tensor:
        """Return each pixel's place among the planes, ``(B, h, w)``, 0 to K - 1, on the volume's device.

        One graph cut per scene, on the CPU.

        Raises:
            InputError: a volume with NaN or infinite values.
        """
        costs = to_numpy(unary_cost(volume, **self._unary)).astype(np.float64)
        steps = costs.shape[1] - 1
        labels = [cut_labels(cost, self._pairwise * float(np.ptp(cost, axis=0).mean()) / steps) for cost in costs]
        # Divided, not multiplied: a label at a plane then has exactly the plane's number.
        return torch.from_numpy(np.stack(labels) / (steps // (volume.shape[1] - 1))).to(volume)


def build_classical(capture: CaptureModel, name: str, parameters: Mapping[str, Value] | None = None) -> ClassicalMethod:
    """Return a classical method for a camera.

    Args:
        capture: the camera.
        name: ``cls`` or ``admm``.
        parameters: by name, any of `DEFAULTS`; the others are taken from there.

    Raises:
        InputError: another name, a parameter that the method does not have, or a value that it refuses.
    """
    if name not in _VOLUMES:
        msg = f"name: got {name!r}, expected one of {', '.join(_VOLUMES)}"
        raise InputError(msg)
    given = dict(parameters or {})
    known = DEFAULTS[name]
    for parameter, value in given.items():
        if parameter not in known:
            msg = f"parameters: got {parameter!r}, which {name} does not have; expected some of {', '.join(known)}"
            raise InputError(msg)
        kind, kinds = _KINDS[type(known[parameter])]
        if not isinstance(value, kinds) or isinstance(value, bool):
            msg = f"parameters: {name}'s {parameter} is {value!r}, expected {kind} such as {known[parameter]!r}"
            raise InputError(msg)
    merged = known | given
    build, label, stage = _VOLUMES[name]
    of_volume: dict[str, Any] = {key: merged[key] for key in VOLUME_PARAMETERS[name]}
    of_depth: dict[str, Any] = {key: value for key, value in merged.items() if key not in of_volume}
    return ClassicalMethod(label, capture, build(capture, **of_volume), stage=stage, **of_depth)


# Of ADMM, light from around the picture is let in: a real scene does not end where the picture does.
_PLANAR_DEFAULTS: dict[str, dict[str, Any]] = {
    "cls": {"strength": 1e-2, "floor": 0.0},
    "admm": {"tv": 0.1, "sparsity": 0.01, "iterations": 100, "light": "anywhere"},
}
_PLANAR_METHODS: dict[str, type[nn.Module]] = {"cls": ConstrainedLeastSquares, "admm": Admm}


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
        if name not in _PLANAR_METHODS:
            msg = f"method: got {name!r}, expected one of {', '.join(_PLANAR_METHODS)}"
            raise InputError(msg)
        for parameter in parameters:
            if parameter not in _PLANAR_DEFAULTS[name]:
                known = ", ".join(_PLANAR_DEFAULTS[name])
                msg = f"--set: got {parameter!r}, expected a parameter of {name} for one plane: {known}"
                raise InputError(msg)
        self.name, self.capture = name, capture
        self.parameters = _PLANAR_DEFAULTS[name] | dict(parameters)
        self.stage = "inversion" if name == "cls" else "admm"
        self._inversion = _PLANAR_METHODS[name](capture, **self.parameters)

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
