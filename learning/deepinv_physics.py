"""The camera as a linear operator of deepinv, whose solvers, denoisers and networks then work on lensless captures.

Needs the extra ``deepinv``. Nothing else here imports it; see docs/deepinv.md.

Source: Tachella et al., DeepInverse: A Python package for solving imaging inverse problems with deep learning, JOSS 2025.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from simulator.arrays import to_numpy
from simulator.camera.forward import ForwardModel
from simulator.camera.noise import GaussianNoise, NoNoise
from simulator.camera.readout import BinnedReadout
from simulator.camera.sensor import Sensor
from simulator.errors import InputError

try:
    from deepinv import physics as deepinv_physics
except ImportError as error:
    raise InputError(
        "deepinv", "is not installed; install the extra: pip install 'flatlight[deepinv,learn]'"
    ) from error

_MOST_STEPS, _SETTLED = 300, 1e-7
"""Of the power iteration: the relative change of its estimate at which it ends leaves the norm right to some 1e-5."""


class LenslessPhysics(deepinv_physics.LinearPhysics):
    """``A x = forward(x) / norm``, of a batch, with `ForwardModel.adjoint` / norm as its transpose; the norm of A is 1.

    An image x is irradiance at the mask in the camera's channels, ``(B, C, h, w)``. As deepinv has them, more axes stand
    between channels and rows: a volume of K planes is ``(B, C, K, h, w)``, a clip of T frames ``(B, C, T, h, w)``, a clip of
    volumes ``(B, C, T, K, h, w)``. So ``deepinv.models.TimeAgnosticNet`` applies a denoiser of images frame by frame, or
    plane by plane. A measurement is ``(B, C, H, W)``.

    Attributes:
        norm: the largest singular value of the forward model, by power iteration; ``norm * A(x)`` is in its own unit.
        unit: share of full scale per unit of A x with a sensor, else 1; see `from_digital`.
    """

    def __init__(
        self,
        model: ForwardModel,
        frame_edges_s: NDArray[np.float64] | None = None,
        noise_model: nn.Module | None = None,
        *,
        device: torch.device | str = "cpu",
    ) -> None:
        """Move the PSFs to the device, in float32, and find the norm; arguments as of `as_physics`."""
        chosen: Any = noise_model or deepinv_physics.ZeroNoise()
        super().__init__(noise_model=chosen, device=device)
        values = torch.as_tensor(to_numpy(model.stack.values), dtype=torch.float32, device=device)
        self.model, self.edges_s = model.with_values(values), frame_edges_s
        planes, frames = len(values), 1 if frame_edges_s is None else len(frame_edges_s) - 1
        self._axes = (frames,) * (frame_edges_s is not None) + (planes,) * (planes > 1)
        self._inner = (frames, planes)
        self.image_shape = (values.shape[1], *self._axes, *model.scene_shape)
        self.norm, self.unit, self.offset = 1.0, 1.0, torch.zeros((values.shape[1], 1, 1), device=device)
        self.norm = self._largest_singular_value(device)

    def A(self, x: Tensor, **_: object) -> Tensor:  # noqa: N802  (deepinv's name)
        """Return ``(B, C, H, W)`` of images of `image_shape`, without noise."""
        if tuple(x.shape[1:]) != self.image_shape:
            raise InputError("x", f"got shape {tuple(x.shape)}, expected (B, {', '.join(map(str, self.image_shape))})")
        volume = x.reshape(*x.shape[:2], *self._inner, *x.shape[-2:]).permute(2, 3, 0, 1, 4, 5)
        return self.model.forward(volume, self.edges_s) / self.norm

    def A_adjoint(self, y: Tensor, **_: object) -> Tensor:  # noqa: N802
        """Return the transpose's images of measurements ``(B, C, H, W)``."""
        volume = self.model.adjoint(y, self.edges_s) / self.norm
        return volume.permute(2, 3, 0, 1, 4, 5).reshape(len(y), *self.image_shape)

    def from_digital(self, numbers: Tensor) -> Tensor:
        """Return a stored measurement, DN / 2^bits, in the unit of A x: less what is stored in darkness, by gain and norm."""
        return (numbers - self.offset) / self.unit

    def _largest_singular_value(self, device: torch.device | str) -> float:
        generator = torch.Generator().manual_seed(0)
        vector = torch.rand((1, *self.image_shape), generator=generator).to(device)  # not negative, like A^T A's own
        square = 0.0
        with torch.no_grad():
            for _ in range(_MOST_STEPS):
                vector = vector / vector.norm()
                vector = self.A_adjoint(self.A(vector))
                before, square = square, float(vector.norm())
                if abs(square - before) < _SETTLED * square:
                    break
        return square**0.5


class SensorNoise(deepinv_physics.PoissonGaussianNoise):
    """deepinv's Poisson-Gaussian noise with a gain and a sigma for each channel, whose bins hold other numbers of pixels."""

    gain: Tensor
    sigma: Tensor

    def forward(self, x: Tensor, gain: object = None, sigma: object = None, seed: Any = None, **_: object) -> Tensor:
        """Return measurements ``(B, C, H, W)`` with noise; as its parent, but gain and sigma are those of the sensor."""
        if gain is not None or sigma is not None:
            raise InputError("gain, sigma", "are the sensor's; build the physics for another sensor, or leave them out")
        self.rng_manual_seed(seed)
        self.to(x.device)
        per_channel = self.gain[:, None, None]
        photons = torch.poisson((x / per_channel).clamp_min(0), generator=self.rng)
        return photons * per_channel + self.randn_like(x) * self.sigma[:, None, None]


def as_physics(
    model: ForwardModel,
    frame_edges_s: NDArray[np.float64] | None = None,
    *,
    sensor: Sensor | None = None,
    noise_model: nn.Module | None = None,
    device: torch.device | str = "cpu",
) -> LenslessPhysics:
    """Return a camera as physics of deepinv, scaled to norm 1.

    A sensor's noise becomes one of deepinv's: white Gaussian noise `GaussianNoise`; photons, dark current, read noise, row
    errors (as if each value had its own), dark-signal non-uniformity and rounding a `PoissonGaussianNoise`, a gain and a
    sigma per channel. Left out are PRNU, saturation and rounding itself; y has no black level and no mean dark current.

    Args:
        model: the camera; its PSFs, shutter, boundary.
        frame_edges_s: ``(T + 1,)`` seconds of a clip's frames, for a model with a shutter; None of stills.
        sensor: whose noise the measurements get, and whose full scale sets `LenslessPhysics.unit`; its readout must be
            ``binned_rgb``, and its deviation known without the image.
        noise_model: any other of deepinv, in the unit of A x, in place of a sensor's.
        device: of the PSFs; images must be there, too.

    Raises:
        InputError: a sensor whose noise deepinv's models cannot express.
    """
    if sensor is not None and noise_model is not None:
        raise InputError("noise_model", "got both a sensor and a noise model; give one of them")
    physics = LenslessPhysics(model, frame_edges_s, noise_model, device=device)
    if sensor is None:
        return physics
    share = physics.norm / sensor.full_scale  # of full scale, per unit of A x
    physics.unit = share
    if isinstance(sensor.noise, NoNoise):
        return physics
    if isinstance(sensor.noise, GaussianNoise):
        if sensor.noise.std is None and sensor.noise.peak == "sample":
            reason = (
                "is relative to each sample's peak, which deepinv's noise does not know; give peak: full_scale, or std"
            )
            raise InputError("psnr_db", reason)
        std = sensor.noise.standard_deviation(torch.ones(1))
        physics.noise_model = deepinv_physics.GaussianNoise(std / share).to(device)
        return physics
    if sensor.readout != "binned_rgb":
        raise InputError("readout", f"got {sensor.readout}, expected binned_rgb: a mosaic is no operator on channels")
    channels = model.stack.values.shape[1]
    light = np.ones((channels, sensor.shape[0], 1))
    balance = np.broadcast_to(sensor.balance(light), (channels, 1, 1))
    electrons = (
        sensor.full_well_e * BinnedReadout(sensor.binning).pixels(channels) * balance
    )  # per unit share of full scale
    dark = np.asarray(sensor.dark_noise(light)) / balance
    physics.noise_model = SensorNoise(
        torch.as_tensor(1 / electrons[:, 0, 0] / share, dtype=torch.float32),
        torch.as_tensor(dark.mean(axis=(-2, -1)) / share, dtype=torch.float32),
    ).to(device)
    physics.unit = share * sensor.dn_range / 2**sensor.bit_depth
    stored = torch.as_tensor(sensor.noiseless(np.zeros((channels, *sensor.shape))), dtype=torch.float32, device=device)
    physics.offset = stored.mean(dim=(-2, -1), keepdim=True)
    return physics
