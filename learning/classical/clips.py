"""Classical methods for clips by name, with their parameters: from one capture to the frames that it saw.

The two linear ones that know nothing of motion are here; `learning.layers.space_time` has the joint least squares,
`learning.classical.fista` total variation, `learning.classical.clip_prior` a denoiser of frames. Two fit a network to each
capture, which takes minutes to hours: `learning.classical.untrained`, `learning.classical.neural_space_time`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel, check_one_plane
from learning.checkpoint import DENOISER, find_checkpoint, find_denoiser, load_checkpoint, load_denoiser
from learning.classical.clip_prior import ClipPlugAndPlay
from learning.classical.fista import FistaTv
from learning.classical.fitting import FilmFitting
from learning.classical.neural_space_time import NeuralSpaceTime
from learning.classical.untrained import UntrainedNetwork
from learning.layers.inversion import RegularisedInversion
from learning.layers.padding import check_measurement
from learning.layers.space_time import JOINT, ClipProblem, FirstLight, JointLeastSquares
from learning.method import Clock, Estimate, Value, linear_to_srgb, srgb_to_linear, threads_for
from learning.models.refinement import MOST_RADIANCE
from simulator.errors import InputError
from simulator.io.files import expanded


def _defaults(method: type) -> dict[str, Value]:
    """Return the defaults of a method's settings."""
    given = inspect.signature(method).parameters.values()
    return {each.name: each.default for each in given if each.default is not each.empty}


INITIAL_ESTIMATES = {"fista": ("joint", "dark"), "pnp_clips": ("joint",)}
"""What ``initial_estimate`` may be, by method, beside the file of a network."""
_STATIC: dict[str, Value] = {"regularisation_lambda": 1.0, "tikhonov": 1.0}
CLIP_DEFAULTS: dict[str, dict[str, Value]] = {
    "static": _STATIC,
    "slivers": {"regularisation_lambda": 10.0, "tikhonov": 10.0},
    "joint": JOINT,
    "fista": {
        "tv": 0.01,
        "tv_over_time": 1.0,
        "iterations": 200,
        "prox": "exact",
        "inner": 4,
        "initial_estimate": "joint",
    },
    "pnp_clips": {
        "denoiser": DENOISER,
        "initial_estimate": "joint",
        "prior": 1.0,
        "level_first": 0.2,
        "level_last": 0.01,
        "over_time": 1.0,
        "iterations": 24,
        "inner": 16,
    },
    "udn": {"iterations": 2000, **_defaults(UntrainedNetwork)},
    "nstm": {"iterations": 2000, **_defaults(NeuralSpaceTime)},
}
CLIP_SEARCH: dict[str, dict[str, tuple[Value, ...]]] = {
    "static": {"regularisation_lambda": (0.1, 0.3, 1.0, 3.0), "tikhonov": (0.3, 1.0, 3.0, 10.0)},
    "slivers": {"regularisation_lambda": (1.0, 10.0, 100.0), "tikhonov": (1.0, 10.0, 100.0)},
    "joint": {
        "static": (0.03, 0.1, 0.3),
        "moving": (0.05, 0.1, 0.2, 0.4),
        "memory": (2.0, 5.0, 10.0, 20.0),
        "sharpest": (0.025, 0.05, 0.1),
        "decay": (1.5, 2.0, 3.0),
        "correlation": (0.0, 0.5, 0.9),
        "noise": (1.0, 3.0, 10.0),
        "iterations": (10, 20, 40),
    },
    "fista": {
        "tv": (0.003, 0.01, 0.03),
        "tv_over_time": (0.3, 1.0, 3.0),
        "iterations": (50, 100, 200),
    },
    "pnp_clips": {
        "prior": (0.5, 1.0, 2.0, 4.0),
        "level_first": (0.1, 0.2, 0.4),
        "level_last": (0.01, 0.02, 0.04),
        "over_time": (0.5, 1.0, 2.0),
    },
    "udn": {"learning_rate": (3e-4, 1e-3, 3e-3)},
    "nstm": {"scene_cells": (0.3, 0.6, 1.2), "scene_rate": (3e-3, 1e-2, 3e-2), "motion_rate": (1e-4, 1e-3, 1e-2)},
}
_LABELS = {
    "static": "static inversion, repeated",
    "slivers": "zero-filled slivers, inverted",
    "joint": "joint least squares",
    "fista": "FISTA-TV",
    "pnp_clips": "plug-and-play over frames",
    "udn": "untrained network (UDN)",
    "nstm": "neural space-time model",
}


class StaticInversion(nn.Module):
    """One inversion of the whole capture as if nothing had moved, repeated for all frames: a baseline for all others."""

    def __init__(self, capture: CaptureModel, *, regularisation_lambda: float, tikhonov: float) -> None:
        """See `RegularisedInversion`; of one plane."""
        super().__init__()
        options: dict[str, Any] = {"regularisation_lambda": regularisation_lambda, "tikhonov": tikhonov}
        self.inversion = RegularisedInversion(capture, learned=False, **options)
        self._frames = capture.frames

    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, N, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``."""
        return self.inversion(measurement).expand(-1, self._frames, -1, -1, -1)


class SliverInversion(StaticInversion):
    """Each sliver inverted by itself, closed rows left dark, as bright as if all had been open: the thesis's start."""

    weights: Tensor

    def __init__(self, capture: CaptureModel, *, regularisation_lambda: float, tikhonov: float) -> None:
        """See `StaticInversion`."""
        super().__init__(capture, regularisation_lambda=regularisation_lambda, tikhonov=tikhonov)
        shares = capture.row_shares  # of light as if all rows had the same exposure
        shares = shares / shares.mean(axis=1, keepdims=True)
        self.register_buffer("weights", torch.from_numpy(shares).to(torch.get_default_dtype()), persistent=False)

    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, N, C, h, w)`` as `StaticInversion` does."""
        inversion = self.inversion
        check_measurement(measurement, inversion.offset, inversion.rows, inversion.columns)
        slivers = inversion.light(measurement)[:, None] * self.weights[:, None, :, None]
        found = inversion.volume(inversion.spectrum(slivers.flatten(0, 1)))
        return found[:, 0].unflatten(0, slivers.shape[:2])


class NetworkEstimate(nn.Module):
    """The light of the frames that a trained VideoNet finds, for methods that begin with it.

    The network assumes the PSFs and the white that it was trained with, as it does where it is the method itself.
    """

    to_camera: Tensor

    def __init__(self, capture: CaptureModel, checkpoint: Path) -> None:
        """Read the network; an InputError refuses another kind, and a camera with other sizes, times, pixels or channels."""
        super().__init__()
        known = load_checkpoint(checkpoint, network="videonet").capture
        try:
            own = capture.with_assumed(known)
        except InputError as error:
            raise InputError(checkpoint, f"is for another camera: {error}") from error
        self.network = load_checkpoint(checkpoint, capture=own).network
        self.problem = ClipProblem(capture)
        to_camera = np.asarray(capture.scene_to_camera) * own.white / capture.white
        self.register_buffer("to_camera", torch.from_numpy(to_camera).to(torch.get_default_dtype()), persistent=False)

    def light(self, measurement: Tensor) -> Tensor:
        """Return x ``(N, K, B, C, rows, columns)`` of measurements ``(B, C, H, W)``; see `ClipProblem`."""
        radiance = srgb_to_linear(self.network(measurement).image, 1.0, clip=False).clamp(0, MOST_RADIANCE)
        return self.problem.light(torch.einsum("ca,bnahw->bnchw", self.to_camera, radiance)[:, :, None])


def find_initial_estimate(
    method: str, text: str, key: str = "initial_estimate", resolve: Callable[[str], Path] = expanded
) -> Path | None:
    """Return the file of the network that a method is to begin with, None for a word of `INITIAL_ESTIMATES`.

    ``key`` and ``resolve`` as of `find_checkpoint`; an InputError says that it is neither a word nor a file.
    """
    words = INITIAL_ESTIMATES[method]
    if text in words:
        return None
    try:
        return find_checkpoint(text, key, resolve)
    except InputError as error:
        raise InputError(key, f"{error.reason}; or take {' or '.join(words)} as initial_estimate") from error


def _initial_estimate(capture: CaptureModel, method: str, text: str) -> FirstLight:
    if (path := find_initial_estimate(method, text)) is not None:
        return NetworkEstimate(capture, path)
    numbers: dict[str, Any] = dict(JOINT)
    return JointLeastSquares(capture, **numbers)


def _fista(capture: CaptureModel, *, initial_estimate: str, **parameters: Any) -> FistaTv:
    start = None if initial_estimate == "dark" else _initial_estimate(capture, "fista", initial_estimate)
    return FistaTv(capture, start=start, **parameters)


def _plug_and_play(
    capture: CaptureModel, *, denoiser: str, initial_estimate: str, **parameters: Any
) -> ClipPlugAndPlay:
    prior, _ = load_denoiser(find_denoiser(denoiser))
    start = _initial_estimate(capture, "pnp_clips", initial_estimate)
    return ClipPlugAndPlay(capture, denoiser=prior, start=start, **parameters)


_SOLVERS: dict[str, Callable[..., nn.Module]] = {
    "static": StaticInversion,
    "slivers": SliverInversion,
    "joint": JointLeastSquares,
    "fista": _fista,
    "pnp_clips": _plug_and_play,
    "udn": UntrainedNetwork,
    "nstm": NeuralSpaceTime,
}


class ClipMethod:
    """A classical method for the clips of one plane: a `learning.method.Method`.

    Attributes:
        solver: what makes films ``(B, N, C, h, w)`` of measurements.
    """

    def __init__(self, capture: CaptureModel, name: str, parameters: Mapping[str, Any]) -> None:
        """Prepare the method; ``parameters`` are all of `CLIP_DEFAULTS`.

        Raises:
            InputError: the camera of stills, a stack of several planes, or values that the method refuses.
        """
        if capture.timing is None:
            raise InputError(name, "got the camera of stills, but it reconstructs clips; take cls, admm or pnp")
        check_one_plane(capture, name)
        self.name, self.capture, self.stage = _LABELS[name], capture, name
        self.solver = _SOLVERS[name](capture, **parameters)

    @property
    def convergence(self) -> dict[str, list[float]]:
        """What the latest capture's iterations made smaller, by its name, after each of them; empty of the other methods."""
        if isinstance(self.solver, FistaTv):
            return {"objective": self.solver.curve}
        return {} if self.fitting is None else {"residual": self.fitting.curve}

    @property
    def fitting(self) -> FilmFitting | None:
        """What fits a network to each capture, for minutes to hours; None of the other methods."""
        return self.solver if isinstance(self.solver, FilmFitting) else None

    def to(self, device: torch.device | str) -> Self:
        """Move what makes films to a device, and return this."""
        self.solver.to(device)
        return self

    @torch.no_grad()
    def volume(self, measurement: Tensor) -> Tensor:
        """Return the frames ``(B, N, C, h, w)`` of measurements ``(B, C, H, W)``: the camera's channels, 1 for white."""
        with threads_for(measurement[0].numel() * self.capture.frames):
            return self.solver(measurement)

    def estimate(self, volume: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of such frames; no further stage is timed. Their disparity is that of the one plane, 0."""
        del clock
        image = linear_to_srgb(self.capture.to_srgb(volume), 1.0, clip=False)
        return Estimate(image, torch.zeros_like(image[:, :, :1]))

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements; the clock's stage is the method's name."""
        with (clock or Clock(measurement.device)).stage(self.stage):
            return self.estimate(self.volume(measurement))
