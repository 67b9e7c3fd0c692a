"""The classical methods: a volume by least squares or ADMM, also with a denoiser as prior; a graph cut and the image."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.checkpoint import find_denoiser, load_denoiser
from learning.classical.admm import Admm
from learning.classical.focus import COSTS, LIGHT, MEASURES, assemble, unary_cost
from learning.classical.graph_cut import cut_labels
from learning.classical.plug_and_play import PlugAndPlay
from learning.layers.inversion import RegularisedInversion, samples_at_once
from learning.layers.padding import as_pairs, from_pairs, scene_of
from learning.method import Clock, Estimate, Value, check_choices, linear_to_srgb
from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.validation import now_called


class ConstrainedLeastSquares(RegularisedInversion):
    """``argmin |Y - H(z) * S|^2 + lambda(z) |P * S|^2`` for each plane z: thesis 5.2 and 5.3, where P is the Laplacian.

    Gonzalez and Woods, Digital Image Processing, section 5.9. A Tikhonov term added to the Laplacian's middle is not in the
    thesis: without it wide masks, whose FH has zeros near frequency zero, give images of the wrong brightness. The layer of
    the networks with nothing learned, so that both have the same Fourier transforms, padding and units; the division is
    worked out once.
    """

    divided: Tensor

    def __init__(self, capture: CaptureModel, *, regularisation_lambda: float, tikhonov: float) -> None:
        """Prepare the division; the parameters are those of `RegularisedInversion`."""
        super().__init__(capture, regularisation_lambda=regularisation_lambda, tikhonov=tikhonov, learned=False)
        # Pairs, three axes: as the layer's own spectra they follow a module to another precision or memory format unharmed.
        divided = torch.cat(list(self.inverses()))
        self.register_buffer("divided", as_pairs(divided).flatten(0, 1), persistent=False)

    def volume(self, spectrum: Tensor, noise: Tensor | None = None) -> Tensor:
        """Return the volume of light; see `RegularisedInversion.volume`."""
        del noise
        inverses = from_pairs(self.divided).unflatten(0, self.log_lambda.shape)
        # One plane at a time: what lies between stays in the processor's cache, three times faster than all at once.
        return torch.stack([scene_of(spectrum * one, self.rows, self.columns) for one in inverses], dim=1) * self.scale

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, K, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``."""
        return super().forward(measurement)


VOLUME_PARAMETERS: dict[str, tuple[str, ...]] = {
    "cls": ("regularisation_lambda", "tikhonov"),
    "admm": ("tv", "sparsity", "iterations"),
    "pnp": ("denoiser", "prior", "noise_first", "noise_last", "iterations"),
}
"""Parameters of `ConstrainedLeastSquares`, `Admm` and `PlugAndPlay`; all others are of `ClassicalMethod`."""

DEFAULTS: dict[str, dict[str, Value]] = {
    "cls": {
        "regularisation_lambda": 0.1,
        "tikhonov": 1.0,
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
    "pnp": {
        "denoiser": "denoiser",
        "prior": 0.1,
        "noise_first": 2.5,
        "noise_last": 0.06,
        "iterations": 12,
        "cost": "spread",
        "measure": "light",
        "contrast": 0.75,
        "window_px": 1.0,
        "pairwise": 0.1,
        "steps_between_planes": 4,
        "light": "sum",
    },
}
"""All parameters, as found on validation scenes of 64 x 64 pixels with eight planes at 40 dB: where tuning begins."""

_SEARCH_OF_DEPTH: dict[str, tuple[Value, ...]] = {
    "window_px": (0.5, 1.0, 2.0, 4.0),
    "pairwise": (0.1, 0.2, 0.5, 2.0, 8.0),
    "steps_between_planes": (1, 4),
    "light": LIGHT,
}
SEARCH: dict[str, dict[str, tuple[Value, ...]]] = {
    "cls": {
        "regularisation_lambda": (0.003, 0.01, 0.03, 0.1, 0.3, 1.0),
        "tikhonov": (0.03, 0.1, 0.3, 1.0),
        "cost": COSTS,
        "measure": MEASURES,
        "contrast": (0.3, 1.0, 2.0, 4.0, 8.0, 16.0),
        **_SEARCH_OF_DEPTH,
    },
    "admm": {
        "tv": (0.005, 0.01, 0.02, 0.05, 0.1),
        "sparsity": (1e-3, 3e-3, 0.01, 0.03, 0.1),
        "iterations": (30, 60, 120),
        "cost": COSTS,
        "measure": MEASURES,
        "contrast": (0.25, 0.5, 0.75, 1.0, 2.0),
        **_SEARCH_OF_DEPTH,
    },
    "pnp": {
        "iterations": (12, 24, 48),
        "prior": (0.03, 0.1, 0.3),
        "noise_first": (1.2, 2.5, 5.0),
        "noise_last": (0.03, 0.06, 0.12),
        "cost": COSTS,
        "measure": MEASURES,
        "contrast": (0.25, 0.5, 0.75, 1.0, 2.0),
        **_SEARCH_OF_DEPTH,
    },
}
"""Candidates for tuning, coarse, in the order of the search; numbers increase."""

PLANAR_DEFAULTS: dict[str, dict[str, Value]] = {
    "cls": {"regularisation_lambda": 1e-2, "tikhonov": 0.0},
    "admm": {"tv": 0.1, "sparsity": 0.01, "iterations": 60, "light": "anywhere"},
    "pnp": {
        "denoiser": "denoiser",
        "prior": 0.1,
        "noise_first": 2.5,
        "noise_last": 0.06,
        "iterations": 24,
        "light": "anywhere",
    },
}
"""Of one plane. ADMM lets light from around the image in: a real scene does not end where the image does."""

_VOLUMES: dict[str, tuple[Callable[..., nn.Module], str, str]] = {
    "cls": (ConstrainedLeastSquares, "CLS + graph cut", "inversion"),
    "admm": (Admm, "ADMM + graph cut", "admm"),
    "pnp": (PlugAndPlay, "plug-and-play ADMM + graph cut", "pnp"),
}


def _volume_method(capture: CaptureModel, name: str, parameters: Mapping[str, Any]) -> nn.Module:
    """Return what makes volumes; a denoiser is named by its file, or as the shipped one."""
    ready = dict(parameters)
    if "denoiser" in ready:
        ready["denoiser"], _ = load_denoiser(find_denoiser(ready["denoiser"]))
    return _VOLUMES[name][0](capture, **ready)


def check_parameters(
    given: Mapping[str, Any], known: Mapping[str, Value], of: str, argument: str = "parameters"
) -> None:
    """Refuse parameters that a method does not have, and values of another kind than its own.

    ``known`` are the method's with their defaults; its name ``of`` and the ``argument`` they were given by are for messages.
    """
    for name, value in given.items():
        if name not in known:
            hint = now_called(name, known)
            raise InputError(argument, f"got {name!r}, expected a parameter of {of}: {', '.join(known)}{hint}")
        own = known[name]
        wanted = {str: ((str,), "a word"), int: ((int,), "a whole number"), float: ((int, float), "a number")}
        kinds, words = wanted[type(own)]
        if not isinstance(value, kinds) or isinstance(value, bool):
            raise InputError(argument, f"{name} of {of} is {value!r}, expected {words} such as {own!r}")


class ClassicalMethod:
    """CLS + graph cut and ADMM + graph cut of the thesis, section 5.2.3: a `learning.method.Method`.

    Attributes:
        name: in tables and figures.
        capture: the camera with its assumed PSFs.
        stage: of the clock, for the volume.
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
            stage: of the clock, for the volume.
            cost: the unary cost; this and the next three see `learning.classical.focus.unary_cost`.
            measure: of sharpness.
            contrast: of the planes.
            window_px: standard deviation of the window.
            pairwise: cost of a step between neighbours from the first label to the last, as a multiple of what separates a
                pixel's best label from its worst, in the scene's mean: one number serves all costs, contrasts and labels.
            steps_between_planes: labels of depth from one plane to the next, for the costs that have some between.
            light: of the image; see `learning.classical.focus.assemble`.

        Raises:
            InputError: a single plane, a negative ``pairwise``, or other names for ``cost``, ``measure`` or ``light``.
        """
        planes = len(capture.stack.depths_m)
        if planes < 2:
            raise InputError("capture", f"got a stack of {planes} plane, expected two or more to find depth among")
        if not (np.isfinite(pairwise) and pairwise >= 0):
            raise InputError("pairwise", f"got {pairwise!r}, expected 0 or more")
        check_choices(("cost", cost, COSTS), ("measure", measure, MEASURES), ("light", light, LIGHT))
        self.name, self.capture = name, capture
        self.stage = stage
        self._method, self._light, self._pairwise = volume_method, light, float(pairwise)
        self._unary: dict[str, Any] = {"cost": cost, "measure": measure, "contrast": contrast, "window_px": window_px}
        self._unary["steps_between_planes"] = steps_between_planes
        # A wrong contrast or window is told now, not after minutes of ADMM.
        unary_cost(torch.zeros(1, 2, 1, 1, 1), **self._unary)

    def to(self, device: torch.device | str) -> Self:
        """Move what makes volumes to a device, and return this; graph cuts stay on the CPU."""
        self._method.to(device)
        return self

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate; the clock's stages: that of the volume, ``graph cut`` (with its costs) and ``assembly``."""
        clock = clock or Clock(measurement.device)
        with clock.stage(self.stage):
            volume = self.volume(measurement)
        return self.estimate(volume, clock)

    @torch.no_grad()
    def volume(self, measurement: Tensor) -> Tensor:
        """Return the volume ``(B, K, C, h, w)`` of measurements ``(B, C, H, W)``."""
        # Of eight at once, ADMM takes twice the time on a CPU: its arrays are so large that malloc maps each anew.
        return torch.cat([self._method(part) for part in measurement.split(samples_at_once(measurement))])

    @torch.no_grad()
    def estimate(self, volume: Tensor, clock: Clock | None = None) -> Estimate:
        """Return image and depth of a volume ``(B, K, C, h, w)`` in the camera's channels, 1 for white."""
        clock = clock or Clock(volume.device)
        with clock.stage("graph cut"):
            places = self.places(volume)
        with clock.stage("assembly"):
            return assemble(volume, places, self.capture, self._light)

    @torch.no_grad()
    def places(self, volume: Tensor) -> Tensor:
        """Return each pixel's place among the planes, ``(B, h, w)``, 0 to K - 1: one graph cut per scene, on the CPU."""
        costs = to_numpy(unary_cost(volume, **self._unary)).astype(np.float64)
        steps = costs.shape[1] - 1
        labels = [cut_labels(cost, self._pairwise * float(np.ptp(cost, axis=0).mean()) / steps) for cost in costs]
        # Divided, not multiplied: a label at a plane then has exactly the plane's number.
        return torch.from_numpy(np.stack(labels) / (steps // (volume.shape[1] - 1))).to(volume)


def build_classical(capture: CaptureModel, name: str, parameters: Mapping[str, Value] | None = None) -> ClassicalMethod:
    """Return ``cls``, ``admm`` or ``pnp`` for a camera, with `DEFAULTS` for the parameters that are not given.

    Raises:
        InputError: another name, a parameter that the method does not have, or a value that it refuses.
    """
    check_choices(("name", name, _VOLUMES))
    check_parameters(parameters or {}, DEFAULTS[name], name)
    merged = DEFAULTS[name] | dict(parameters or {})
    _, label, stage = _VOLUMES[name]
    of_volume = {key: merged.pop(key) for key in VOLUME_PARAMETERS[name]}
    of_depth: dict[str, Any] = merged
    return ClassicalMethod(label, capture, _volume_method(capture, name, of_volume), stage=stage, **of_depth)


class PlanarMethod:
    """CLS or ADMM of either kind for one depth: nothing to search, the volume is the image: a `learning.method.Method`."""

    def __init__(self, capture: CaptureModel, name: str, parameters: Mapping[str, Any]) -> None:
        """Prepare the method; ``parameters`` take the place of `PLANAR_DEFAULTS`.

        Raises:
            InputError: a stack of several planes, an unknown name or parameter, or values that the method refuses.
        """
        if len(capture.stack.depths_m) != 1:
            raise InputError("stack", f"got {len(capture.stack.depths_m)} planes, expected one")
        check_choices(("method", name, _VOLUMES))
        check_parameters(parameters, PLANAR_DEFAULTS[name], f"{name} for one plane")
        self.name, self.capture = name, capture
        self.parameters = PLANAR_DEFAULTS[name] | dict(parameters)
        _, _, self.stage = _VOLUMES[name]
        self._inversion = _volume_method(capture, name, self.parameters)

    def to(self, device: torch.device | str) -> Self:
        """Move what makes images to a device, and return this."""
        self._inversion.to(device)
        return self

    @torch.no_grad()
    def volume(self, measurement: Tensor) -> Tensor:
        """Return ``(B, 1, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``."""
        return self._inversion(measurement)

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return image and a disparity of 0 everywhere, which is the one plane's."""
        with (clock or Clock(measurement.device)).stage(self.stage):
            return self.estimate(self.volume(measurement))

    def estimate(self, volume: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of a volume ``(B, 1, C, h, w)`` in the camera's channels; no further stage is timed."""
        del clock
        image = linear_to_srgb(self.capture.to_srgb(volume[:, 0]), 1.0, clip=False)
        return Estimate(image, torch.zeros_like(image[:, :1]))
