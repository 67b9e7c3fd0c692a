"""PSF stacks by wave optics: many depths and wavelengths from one mask transform per wavelength.

On-axis light from depth z is the paraxial identity I_z(x) = m^-2 I_deff(x / m), m = 1 + d/z, d_eff = z d / (z + d):
a plane wave propagated to the shorter distance and magnified (Goodman, Introduction to Fourier Optics, section 5.3).
Magnified pixels are integrated exactly, by dividing them by m instead of stretching the field.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from simulator.arrays import Array, fft2, ifft, is_torch, module, namespace, next_fast_len, pad2d
from simulator.errors import InputError
from simulator.optics.even_filter import Quadrant, blocks, each_rows
from simulator.optics.kernel import PixelKernel, kernel_reach_m
from simulator.optics.mask import Mask
from simulator.optics.propagation import holds_steep_waves, spread_samples
from simulator.optics.psf_stack import PsfStack, check_depths
from simulator.optics.resample import Band, box_integral
from simulator.optics.spectrum import quantile_lines
from simulator.optics.transfer import Transfer, band_edge_m
from simulator.types import CameraGeometry

Model = Literal["scaled_distance", "scaled_psf"]
MAX_GRID = 2**14  # samples per axis: 2 GB per complex64 field
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class PsfConfig:
    """How to compute a PSF stack.

    Attributes:
        depths_m: z from the mask plane, metres, strictly increasing; the last may be ``inf``.
        model: ``scaled_distance`` keeps the change of the diffraction distance with depth; ``scaled_psf`` (the thesis's
            eq. 2.1, for comparison) only magnifies the PSF of infinity.
        wavelengths_per_channel: quantile lines per channel.
        oversampling: grid samples per mask pixel and axis.
        accept_error: sampling error up to which the stack is accepted; None accepts 0.05 and warns above 0.01.
    """

    depths_m: tuple[float, ...]
    model: Model = "scaled_distance"
    wavelengths_per_channel: int = 3
    oversampling: int = 1
    accept_error: float | None = None

    def __post_init__(self) -> None:
        check_depths(np.asarray(self.depths_m))
        if self.model not in ("scaled_distance", "scaled_psf"):
            msg = f"model: got {self.model!r}, expected 'scaled_distance' or 'scaled_psf'"
            raise InputError(msg)


def compute_psf_stack(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    *,
    xp: str = "numpy",
    threads: int = 1,
    progress: Progress | None = None,
) -> PsfStack:
    """Compute the PSFs of a mask for every depth and channel, with the sampling proven first.

    Args:
        mask: the mask; its arrays decide the precision and, if they are torch tensors, the device and gradients.
        camera: distance, binned pixel pitch and spectral response.
        psf_config: depths, model, wavelengths, sampling.
        xp: ``numpy`` or ``torch``.
        threads: depths computed at a time (NumPy only); each needs one more complex grid, 160 MB at full size.
        progress: called with (done, total) after every PSF.

    Returns:
        The stack, ``values`` ``(K, C, N, N)`` with N odd and wide enough for all the light that is followed: the sum of each
        PSF times the pixel area equals the mask's transmitted area for a smooth mask, and falls short of it by the
        diffraction orders beyond ``kernel.ORDERS`` (5-6 % for a PhlatCam) for a staircase. ``provenance["sampling"]`` holds
        the measured sampling error, which does not see those orders.

    Raises:
        InputError: when the sampling error is above 5 % (or ``accept_error``), or the mask and camera do not fit.
    """
    from simulator.optics.sampling import prove_sampling

    if not camera.mask_to_sensor_m > 0:
        msg = f"mask_to_sensor_m: got {camera.mask_to_sensor_m:g}; the mask lies in front of the sensor, so it is positive"
        raise InputError(msg)
    lines = quantile_lines(camera.response, psf_config.wavelengths_per_channel)
    sampling = prove_sampling(mask, camera, psf_config)
    on_device = mask if is_torch(mask.height_m) else _to(mask, xp)
    size = stack_size(mask, camera, psf_config)
    total, done = len(lines) * len(psf_config.depths_m), 0

    per_line = []
    for line in lines:
        images = []
        for image in depth_images(on_device, camera, psf_config, line.wavelength_m, size, threads=threads):
            images.append(image)
            done += 1
            if progress is not None:
                progress(done, total)
        per_line.append(images)
    ns = namespace(on_device.height_m)
    planes = []
    for channel in range(len(camera.response.channels)):
        mine = [(line.weight, images) for line, images in zip(lines, per_line, strict=True) if line.channel == channel]
        planes.append(ns.stack([sum(w * images[k] for w, images in mine) for k in range(len(psf_config.depths_m))]))
    return PsfStack(
        values=ns.stack(planes, axis=1),
        depths_m=np.asarray(psf_config.depths_m, np.float64),
        pixel_pitch_m=camera.pixel_pitch_m,
        channels=camera.response.channels,
        fingerprint=psf_fingerprint(mask, camera, psf_config),
        provenance={
            "kind": "computed",
            "mask": mask.provenance(),
            "mask_to_sensor_m": camera.mask_to_sensor_m,
            "response": camera.response.label,
            "lines": [[camera.response.channels[line.channel], line.wavelength_m, line.weight] for line in lines],
            "model": psf_config.model,
            "oversampling": psf_config.oversampling,
            "sampling": sampling,
        },
    )


def depth_images(
    mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, wavelength_m: float, size: int, *, threads: int = 1
) -> Iterator[Array]:
    """Yield the PSF ``(size, size)`` of one wavelength for each depth, in the stored frame (turned by 180 degrees)."""
    pitch_m, d = float(mask.pitch_m / psf_config.oversampling), float(camera.mask_to_sensor_m)
    window = [n * psf_config.oversampling for n in mask.shape]
    reach_m, limited = _reach(mask, camera, psf_config, wavelength_m)
    margin = math.ceil(reach_m / pitch_m)
    band = (margin * pitch_m, margin * pitch_m) if limited else None
    padded = tuple(2 * next_fast_len(n // 2 + margin + 1) for n in window)
    if max(padded) > MAX_GRID:
        msg = (
            f"oversampling: {psf_config.oversampling} needs a grid of {padded} samples of {pitch_m:g} m for the mask and "
            f"the light that it spreads; more than {MAX_GRID} is refused: use a coarser or narrower mask or less oversampling"
        )
        raise InputError(msg)
    field = pad2d(mask.transmission(wavelength_m, psf_config.oversampling), padded, (margin, margin))
    spectrum = fft2(field, overwrite=True)
    origin = [margin + (n - 1) / 2 for n in window]
    kernel = PixelKernel(padded, pitch_m, wavelength_m, reach_m, like=spectrum)
    transfer = Transfer(padded, pitch_m, wavelength_m, like=spectrum)
    centres = (np.arange(size) - size // 2) * camera.pixel_pitch_m

    spare: list[Array] = []  # fresh memory for every depth would cost as much as a tenth of the work

    def image(depth_m: float) -> Array:
        magnification = 1 + d / float(depth_m)  # a NumPy scalar would turn float32 arrays into float64
        distance = d / magnification if psf_config.model == "scaled_distance" else d
        smooth = partial(transfer.quadrant, distance, band)
        quadrant = kernel.quadrant(distance) if mask.profile == "staircase" else smooth
        rows, columns = (
            box_integral(at, pitch_m, centres / magnification, camera.pixel_pitch_m / magnification) for at in origin
        )
        wave = spare.pop() if spare else namespace(spectrum).empty_like(spectrum)
        binned = _on_pixels(spectrum, quadrant, rows, columns, wave)
        if not is_torch(spectrum):  # a tensor may still want its gradient
            spare.append(wave)
        return namespace(spectrum).flip(binned / float(camera.pixel_pitch_m**2))

    if threads == 1 or is_torch(spectrum):
        yield from map(image, psf_config.depths_m)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(image, psf_config.depths_m)


def _on_pixels(spectrum: Array, quadrant: Quadrant, rows: Band, columns: Band, wave: Array) -> Array:
    """Return the intensity of a filtered spectrum, integrated over pixels; ``wave`` is memory for the wave half-way."""
    xp = namespace(spectrum)
    height, width = spectrum.shape

    def filter_rows(part: slice, weights: Array) -> None:
        wave[part] = ifft(spectrum[part] * weights, -1, overwrite=True)

    each_rows(spectrum, (height, width), quadrant, filter_rows)
    real = xp.real(wave)
    bin_rows, bin_columns = rows.prepared(real, height), columns.prepared(real, width)
    tall = xp.empty((len(rows.first), width), dtype=real.dtype, device=real.device)
    for part in blocks(spectrum, width, height):
        field = ifft(wave[:, part], -2)
        tall[:, part] = bin_rows(xp.real(field) ** 2 + xp.imag(field) ** 2, -2)
    # Blocks again: for one large product BLAS would wake threads of its own.
    return xp.concat([bin_columns(tall[part], -1) for part in blocks(spectrum, len(rows.first), width)], axis=0)


def _reach(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, wavelength_m: float) -> tuple[float, bool]:
    """Return how far sideways (metres) the mask's light is followed to the sensor, and whether steeper light must be cut.

    A smooth mask's light lies in the band of its own samples. A finer grid holds steeper waves too, which only the
    aperture's hard edge feeds: they are cut softly, or every doubling of the oversampling would widen the grid.
    """
    d = camera.mask_to_sensor_m
    if mask.profile == "staircase":
        return kernel_reach_m(mask.pitch_m, wavelength_m, d), False
    spread_m = spread_samples(mask.pitch_m, wavelength_m, d) * mask.pitch_m
    limited = psf_config.oversampling > 1 or holds_steep_waves(mask.pitch_m, wavelength_m)
    return spread_m + (band_edge_m(wavelength_m, d) if limited else 0), limited


def stack_size(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> int:
    """Return the odd width in sensor pixels that holds all the light that is followed, at the nearest depth."""
    lines = quantile_lines(camera.response, psf_config.wavelengths_per_channel)
    reach_m = max(_reach(mask, camera, psf_config, line.wavelength_m)[0] for line in lines)
    half = (max(mask.shape) * mask.pitch_m / 2 + reach_m) * (1 + camera.mask_to_sensor_m / psf_config.depths_m[0])
    return 2 * math.ceil(half / camera.pixel_pitch_m) + 1


def psf_fingerprint(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> str:
    """Return a hash of everything that decides the stack's values."""
    response = camera.response
    sha = hashlib.sha256(mask.digest().encode())
    sha.update(repr((camera.mask_to_sensor_m, camera.pixel_pitch_m, response.channels)).encode())
    sha.update(
        np.ascontiguousarray(response.wavelengths_m).tobytes() + np.ascontiguousarray(response.weights).tobytes()
    )
    sha.update(repr(replace(psf_config, accept_error=None)).encode())
    return sha.hexdigest()


def _to(mask: Mask, xp: str) -> Mask:
    ns: Any = module(xp)
    return replace(mask, height_m=ns.asarray(mask.height_m), amplitude=ns.asarray(mask.amplitude))
