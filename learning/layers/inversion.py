"""Inversion of a lensless measurement in the Fourier domain: a regularised division at every depth, or a learned filter.

S(z) = F^-1{F(Y) conj(FH(z)) / (|FH(z)|^2 + lambda(z) |FP(z)|^2)}: thesis equations 4.10 and 4.11; with the Laplacian for P
and a fixed lambda, the constrained least squares of 5.2 and 5.3 (Gonzalez and Woods, Digital Image Processing, section 5.9).

S = F^-1{F(W) F(Y)}, W = F^-1{conj(FH) / (K + |FH|^2)} at first, a filter W of the whole measurement's size that starts as
Wiener's: thesis equation 4.1; Khan et al., FlatNet, TPAMI 2020.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from learning.camera import CaptureModel, check_lit
from learning.layers.noise import noise_ratio
from learning.layers.padding import (
    AxisPlan,
    as_pairs,
    axis_plans,
    check_measurement,
    from_pairs,
    pad_measurement,
    scene_of,
    spectrum_of,
    spectrum_of_scene,
)
from simulator.arrays import to_numpy
from simulator.errors import InputError

_LEAST = 1e-8
"""Least denominator as a share of the PSF's mean spectral power: far below any noise, above float32's rounding of sums."""

LAPLACIAN = ((0.0, -1.0, 0.0), (-1.0, 4.0, -1.0), (0.0, -1.0, 0.0))


class FourierInversion(nn.Module):
    """What inversions share: the numbers of the camera, and the period of the FFT on which sensor, PSFs and scene lie.

    The arithmetic is float32 under autocast too, and torch's default precision at construction otherwise. Buffers have three
    axes at most, complex ones are pairs of real numbers: so they follow a module to another memory format or precision.
    """

    scale: Tensor
    offset: Tensor
    row_exposure: Tensor

    def __init__(self, capture: CaptureModel) -> None:
        """Prepare what is divided by; an InputError refuses an image of which parts send no light to the sensor."""
        super().__init__()
        self.rows, self.columns = axis_plans(capture)
        check_lit(capture)
        irradiance = capture.scene_irradiance.astype(np.float64)
        self._keep("scale", torch.from_numpy(1 / (capture.gain * capture.white * irradiance)))
        self._keep("offset", torch.from_numpy(capture.offset)[:, None, None])
        exposed = np.ones(1) if capture.row_exposure is None else capture.row_exposure
        self._keep("row_exposure", torch.from_numpy(exposed)[:, None])

    def light(self, measurement: Tensor) -> Tensor:
        """Return measurements ``(..., C, H, W)`` without their offset, as if all rows had the same exposure."""
        return (measurement.to(self.offset.dtype) - self.offset) / self.row_exposure

    def spectrum(self, light: Tensor) -> Tensor:
        """Return the spectrum ``(..., C, L // 2 + 1, M)`` of light, continued to the period."""
        return spectrum_of(pad_measurement(light, self.rows, self.columns))

    def _keep(self, name: str, values: Tensor) -> None:
        self.register_buffer(name, values.to(torch.get_default_dtype()), persistent=False)

    def _kernel(self, psfs: NDArray[np.floating]) -> Tensor:
        """Return PSFs ``(..., h, w)`` with their origin at 0 of the period, float64."""
        return torch.from_numpy(self.columns.place(self.rows.place(psfs.astype(np.float64), -2), -1))


class RegularisedInversion(FourierInversion):
    """From a measurement to one estimate of the whole scene per depth plane: sharp where the depth is right.

    Learned are P, a 3 x 3 filter per plane that the channels share, and lambda per plane and channel, in units of the PSF's
    mean spectral power, so that the same number means the same for every mask and scale. Where lambda follows the noise it is
    ``exp(log_lambda) + exp(log_noise_weight) sigma^2 / signal``: Wiener's ratio of noise to signal has the second term alone.

    Joint, all planes share one denominator, the mean of their spectral powers: the least squares of the whole stack, each
    plane of which gets the light that the others do not explain as well.

    Attributes:
        planes: indices of the stack's planes that it inverts at.
        disparities: of these planes, 0 to 1.
        channels: names of the camera's.
    """

    power: Tensor
    numerator: Tensor
    energy: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        planes: Sequence[int] | None = None,
        *,
        regularisation_lambda: float = 1e-2,
        tikhonov: float = 0.0,
        noise_weight: float | None = None,
        joint: bool = False,
        learned: bool = True,
    ) -> None:
        """Prepare the spectra of the PSFs.

        Args:
            capture: the camera.
            planes: indices of the planes to invert at; None takes all.
            regularisation_lambda: initial, as a multiple of the PSF's mean spectral power.
            tikhonov: Tikhonov term that P begins with beside the Laplacian, its response at frequency zero. A mask as wide as
                the scene and more has zeros of FH so near to frequency zero that the Laplacian hardly holds them.
            noise_weight: initial weight of the ratio of noise to signal in lambda; None: lambda does not follow the noise.
            joint: invert all planes at once.
            learned: whether P and lambda are parameters or stay as they are.

        Raises:
            InputError: a lambda or weight that is not positive, a Tikhonov term below zero.
        """
        super().__init__(capture)
        for name, value in (("regularisation_lambda", regularisation_lambda), ("noise_weight", noise_weight)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(name, f"got {value!r}, expected a positive number")
        if not 0 <= tikhonov < math.inf:
            raise InputError("tikhonov", f"got {tikhonov!r}, expected a finite number that is not negative")
        self.planes = tuple(range(len(capture.stack.depths_m))) if planes is None else tuple(planes)
        self.disparities = capture.plane_disparities()[list(self.planes)]
        self.channels = capture.stack.channels
        kernel = self._kernel(to_numpy(capture.stack.values)[list(self.planes)])
        # Parseval: the mean over all frequencies. PSFs of power 1 keep float32 far from its limits.
        energy = kernel.square().sum(dim=(-2, -1), keepdim=True)
        root = (energy.mean(dim=0, keepdim=True) if joint else energy).sqrt()
        spectrum = spectrum_of(kernel / root)
        power = spectrum.abs().square()
        # Of a P without response at a frequency where the PSF has none either, nothing else is left to divide by.
        power = (power.mean(dim=0, keepdim=True) if joint else power) + _LEAST
        self._keep("power", _twice(power).flatten(0, 1))
        self._keep("numerator", as_pairs(spectrum.conj() / root).flatten(0, 1))
        self._keep("energy", root.square().expand(len(kernel), -1, -1, -1).flatten(0, 1))
        kernels, channels = kernel.shape[:2]
        begin = torch.tensor([LAPLACIAN] * kernels)  # Tensor.repeat would import SymPy where weights have no memory
        begin[:, 1, 1] += tikhonov

        def weights(value: float) -> nn.Parameter:
            return nn.Parameter(torch.full((kernels, channels), math.log(value)), requires_grad=learned)

        self.filters = nn.Parameter(begin, requires_grad=learned)
        self.log_lambda = weights(regularisation_lambda)
        self.log_noise_weight = None if noise_weight is None else weights(noise_weight)

    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, K, C, h, w)``, irradiance-corrected radiance in the camera's channels, 1 for white.

        ``measurement`` is ``(B, C, H, W)`` DN / 2^bits; an InputError refuses another shape than the camera's.
        """
        check_measurement(measurement, self.offset, self.rows, self.columns)
        with torch.autocast(measurement.device.type, enabled=False):
            light = self.light(measurement)
            return self.volume(self.spectrum(light), None if self.log_noise_weight is None else noise_ratio(light))

    def volume(self, spectrum: Tensor, noise: Tensor | None = None) -> Tensor:
        """Return the volume of light with a `spectrum` ``(B, C, ...)`` and ratios of noise to signal ``(B, C)``."""
        numerators, powers, filters = self._terms()
        weights = self._weights(noise).expand(-1, len(spectrum), -1)
        return _Division.apply(spectrum, numerators, powers, filters, weights, self.rows, self.columns) * self.scale

    def reproject(self, volume: Tensor) -> Tensor:
        """Return the light ``(B, C, H, W)`` that a volume as `volume` gives it sends to the sensor: what this inverts.

        On the same grid, of a batch: `simulator.camera.forward` has the same for whole scenes over time.
        """
        radiated = (volume / self.scale).unbind(1)
        psfs = from_pairs(self.numerator).conj() * self.energy
        planes = zip(radiated, psfs.unflatten(0, self.log_lambda.shape), strict=True)
        spectrum = sum(spectrum_of_scene(plane, self.rows, self.columns) * psf for plane, psf in planes)
        tall = torch.fft.ifft(torch.as_tensor(spectrum), dim=-1)[..., : self.columns.sensor]
        return torch.fft.irfft(tall, self.rows.length, dim=-2)[..., : self.rows.sensor, :]

    def inverses(self, noise: Tensor | None = None) -> Iterator[Tensor]:
        """Yield W(z) of equation 4.11 plane by plane, ``(B, C, L // 2 + 1, M)`` complex; B is 1 without ``noise``."""
        for numerator, *denominator in zip(*self._terms(), self._weights(noise), strict=True):
            yield from_pairs(as_pairs(numerator) * _reciprocal(*denominator))

    def _terms(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return conj(FH) ``(K, C, L // 2 + 1, M)``, and `_twice` |FH|^2, as many, and |FP|^2 ``(K, L // 2 + 1, 2 M)``."""
        numerators = from_pairs(self.numerator).unflatten(0, self.log_lambda.shape)
        powers = self.power.unflatten(0, (-1, len(self.channels))).expand(len(self.planes), -1, -1, -1)
        return numerators, powers, _twice(self._filter_power())

    def _weights(self, noise: Tensor | None) -> Tensor:
        """Return lambda ``(K, B, C)`` for ratios of noise to signal ``(B, C)``; B is 1 without them."""
        own = self.log_lambda.exp()[:, None]
        if self.log_noise_weight is None or noise is None:
            return own
        return own + self.log_noise_weight.exp()[:, None] * noise

    def _filter_power(self) -> Tensor:
        """Return |FP|^2, ``(K, L // 2 + 1, M)``: the transform of P's autocorrelation, which is real and has 25 terms."""
        planes = len(self.filters)
        taps = nnf.conv2d(self.filters[None], self.filters[:, None], padding=2, groups=planes)[0]
        (tall_cos, tall_sin), (wide_cos, wide_sin) = (self._waves(axis.length) for axis in (self.rows, self.columns))
        half = slice(self.rows.length // 2 + 1)
        power = tall_cos[half] @ taps @ wide_cos.T - tall_sin[half] @ taps @ wide_sin.T
        return power.relu()  # not below 0 where it is 0 but for rounding

    def _waves(self, length: int) -> tuple[Tensor, Tensor]:
        shifts, turns = (torch.arange(n, device=self.filters.device, dtype=self.filters.dtype) for n in (5, length))
        angles = 2 * math.pi / length * turns[:, None] * (shifts - 2)
        return angles.cos(), angles.sin()


def _twice(values: Tensor) -> Tensor:
    """Return real numbers ``(..., M)`` as factors of the pairs of complex ones, ``(..., 2 M)``: twice as fast as theirs."""
    return values[..., None].expand(*values.shape, 2).flatten(-2)


def _reciprocal(power: Tensor, filtered: Tensor, weight: Tensor) -> Tensor:
    """Return the reciprocal denominator of W, ``(B, C, L // 2 + 1, 2 M)``: a complex division costs twice the time."""
    return torch.addcmul(power, weight[..., None, None], filtered).reciprocal_()


class _Division(torch.autograd.Function):
    """The scenes of a spectrum times W(z), plane by plane and, on a CPU, sample by sample: all between stays in its cache.

    The way back works the quotients out anew. What automatic differentiation would keep of them, at every plane, comes back
    from main memory so slowly that forwards and back took 1.4 times as long.
    """

    @staticmethod
    def forward(
        ctx: Any,
        spectrum: Tensor,
        numerators: Tensor,
        powers: Tensor,
        filters: Tensor,
        weights: Tensor,
        rows: AxisPlan,
        columns: AxisPlan,
    ) -> Tensor:
        """Return scenes ``(B, K, C, h, w)`` of a spectrum ``(B, C, L // 2 + 1, M)``.

        ``numerators`` and ``powers``, constants, and ``filters`` are those of `_terms`; ``weights`` are ``(K, B, C)``.
        """
        ctx.save_for_backward(spectrum, numerators, powers, filters, weights)
        ctx.plans = rows, columns
        volume = weights.new_empty((len(spectrum), len(filters), len(numerators[0]), rows.size, columns.size))
        for plane, part in _parts(volume):
            quotient = spectrum[part] * numerators[plane]
            as_pairs(quotient).mul_(_reciprocal(powers[plane], filters[plane], weights[plane, part]))
            volume[part, plane] = scene_of(quotient, rows, columns)
        return volume

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        """Return the gradients of spectrum, filters and weights."""
        spectrum, numerators, powers, filters, weights = ctx.saved_tensors
        rows, columns = ctx.plans
        # An inverse transform's adjoint is the transform over its length; the half of the rows that is left out counts, too.
        shares = torch.full((rows.length // 2 + 1, 1), 2 / (rows.length * columns.length)).to(filters)
        shares[0 :: rows.length // 2 if rows.length % 2 == 0 else len(shares)] /= 2
        shared = filters * shares
        of_spectrum = torch.zeros_like(spectrum) if ctx.needs_input_grad[0] else None
        of_filters, of_weights = torch.zeros_like(filters), torch.empty_like(weights)
        for plane, part in _parts(gradient):
            reciprocal = _reciprocal(powers[plane], filters[plane], weights[plane, part])
            change = spectrum_of_scene(gradient[part, plane], rows, columns)
            pairs = as_pairs(change).mul_(reciprocal)
            if of_spectrum is not None:
                of_spectrum[part].addcmul_(change, numerators[plane].conj())
            quotient = spectrum[part] * numerators[plane]
            products = as_pairs(quotient).mul_(reciprocal).mul_(pairs).flatten(2)
            of_weights[plane, part] = products @ shared[plane].flatten()
            of_filters[plane].flatten().addmv_(products.flatten(0, 1).T, weights[plane, part].flatten())
        of_spectrum = None if of_spectrum is None else of_spectrum.mul_(shares)
        return of_spectrum, None, None, of_filters.mul_(-shares), of_weights.neg_(), None, None


def _parts(volume: Tensor) -> Iterator[tuple[int, slice]]:
    """Yield every plane, and of the samples of a volume ``(B, K, ...)`` those that are divided at once."""
    samples, planes = volume.shape[:2]
    many = samples_at_once(volume)
    for plane in range(planes):
        for first in range(0, samples, many):
            yield plane, slice(first, first + many)


def samples_at_once(batch: Tensor) -> int:
    """Return how many samples of a batch are best worked on together: all on a GPU, one where a cache must hold them."""
    return 1 if batch.device.type == "cpu" else max(len(batch), 1)


class WienerInversion(FourierInversion):
    """From measurements of a scene at one depth to the scene, frame by frame.

    Learned is the spectrum of W, every frequency of its own, in units of its initial root mean square: one learning rate then
    serves it and the networks behind it, whatever the scale of the PSF. A spectrum rather than W itself saves two transforms
    per step; the transform is unitary but for a constant, so that gradient steps are the same.
    """

    root: Tensor

    def __init__(
        self, capture: CaptureModel, plane: int = 0, *, noise_to_signal: float = 1e-2, learned: bool = True
    ) -> None:
        """Prepare Wiener's filter of one plane; ``noise_to_signal`` is K as a multiple of the PSF's mean spectral power.

        Raises:
            InputError: a plane that the stack does not have, or a ratio that is not positive.
        """
        super().__init__(capture)
        if not (math.isfinite(noise_to_signal) and noise_to_signal > 0):
            raise InputError("noise_to_signal", f"got {noise_to_signal!r}, expected a positive number")
        if not 0 <= plane < len(capture.stack.depths_m):
            raise InputError("plane", f"got {plane}, expected 0 to {len(capture.stack.depths_m) - 1}")
        kernel = self._kernel(to_numpy(capture.stack.values)[plane])
        power = kernel.square().sum(dim=(-2, -1), keepdim=True)
        spectrum = spectrum_of(kernel)
        wiener = spectrum.conj() / (spectrum.abs().square() + noise_to_signal * power)
        root = wiener.abs().square().mean(dim=(-2, -1), keepdim=True).sqrt()
        self._keep("root", root)
        self.weight = nn.Parameter(as_pairs(wiener / root).to(torch.get_default_dtype()), requires_grad=learned)

    def forward(self, measurements: Tensor) -> Tensor:
        """Return ``(B, C, h, w)`` or ``(B, N, C, h, w)``, radiance in the camera's channels, 1 for white.

        ``measurements`` are ``(B, C, H, W)``, or frames ``(B, N, C, H, W)``; an InputError refuses another camera's shape.
        """
        check_measurement(measurements, self.offset, self.rows, self.columns, frames=True)
        with torch.autocast(measurements.device.type, enabled=False):
            return self.scene(self.light(measurements))

    def scene(self, light: Tensor) -> Tensor:
        """Return the same of measurements without their offset, whose rows have the same exposure; see `light`."""
        return scene_of(self.spectrum(light) * self.inverse(), self.rows, self.columns) * self.scale

    def inverse(self) -> Tensor:
        """Return F(W), ``(C, L // 2 + 1, M)`` complex."""
        return from_pairs(self.weight) * self.root
