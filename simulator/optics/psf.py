"""PSFs by wave optics: first the plain formula of one wavelength and depth, then whole stacks by one of three models."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, is_torch, module, namespace, number
from simulator.errors import InputError
from simulator.optics.exact import exact_images, exact_points, exact_width_m
from simulator.optics.mask import Mask
from simulator.optics.propagation import angular_spectrum
from simulator.optics.resample import box_integral
from simulator.optics.scaled import scaled_images, scaled_points, scaled_width_m
from simulator.optics.sources import Source
from simulator.optics.spectra import Line, quantile_lines, shared_lines
from simulator.optics.stack import UNPROVEN, PsfStack, check_depths
from simulator.types import CameraGeometry, Layer, SpectralResponse

Model = Literal["scaled_distance", "scaled_psf", "exact"]
Progress = Callable[[int, int], None]


def plain_psf(
    mask: Mask,
    distance_m: float,
    wavelength_m: float,
    depth_m: float,
    pixel_pitch_m: float,
    size: int,
    *,
    oversampling: int = 1,
) -> NDArray[np.float64]:
    """Return the PSF of one wavelength and depth by the plain formula; the rest of this file gives the same, fast.

    A point source at depth z on the axis lights the mask, whose field crosses the distance d to the sensor, where every
    pixel collects the intensity that falls on it::

        U(x, y) = t(x, y) (z / r) exp(ik (r - z)),  r^2 = x^2 + y^2 + z^2
        PSF = integral over a pixel of |angular spectrum of U over d|^2 / pixel area

    Source: Goodman, Introduction to Fourier Optics, sections 3.10 (angular spectrum) and 5.1 (thin element).

    Args:
        mask: the mask, NumPy.
        distance_m: mask to sensor through air, metres.
        wavelength_m: metres.
        depth_m: z of the source from the mask plane, metres, or ``inf``.
        pixel_pitch_m: of the sensor, metres.
        size: odd number of pixels; light beyond them is left out.
        oversampling: grid samples per mask pixel and axis; the grid must hold the source's wave and the mask's light.

    Returns:
        ``(size, size)`` irradiance per unit irradiance at the mask's centre, in the stored frame (rotated by 180 degrees).
    """
    pitch_m = mask.pitch_m / oversampling
    transmission = mask.transmission(wavelength_m, oversampling).astype(np.complex128)
    margins = [max(0, math.ceil((size * pixel_pitch_m / pitch_m - n) / 2)) for n in transmission.shape]
    field = np.pad(transmission, [(margin, margin) for margin in margins])

    # The spherical wave of the source on the mask; a source at infinity sends a plane one.
    y, x = ((np.arange(n) - (n - 1) / 2) * pitch_m for n in field.shape)
    if math.isfinite(depth_m):
        r = np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + depth_m**2)
        field = field * (depth_m / r) * np.exp(2j * np.pi / wavelength_m * (r - depth_m))

    # From the mask to the sensor.
    intensity = np.abs(angular_spectrum(field, pitch_m, wavelength_m, distance_m)) ** 2

    # Pixels add up the samples inside them, those on their edges in part.
    centres_m = (np.arange(size) - size // 2) * pixel_pitch_m
    for axis, n in ((-2, field.shape[0]), (-1, field.shape[1])):
        pixels = box_integral((n - 1) / 2, pitch_m, centres_m, pixel_pitch_m)
        intensity = pixels.prepared(intensity, n)(intensity, axis)
    return intensity[::-1, ::-1] / pixel_pitch_m**2


@dataclass(frozen=True)
class PsfConfig:
    """How to compute a PSF stack.

    Attributes:
        depths_m: z from the mask plane, metres, strictly increasing; the last may be ``inf``.
        model: ``scaled_distance`` keeps the change of the diffraction distance with depth and is fast; ``scaled_psf`` (the
            thesis's eq. 2.1, for comparison) only magnifies the PSF of infinity; ``exact`` scales nothing.
        wavelengths_per_channel: quantile lines per channel.
        shared_wavelengths: wavelengths that all channels share, in place of each channel's own; None for its own.
        oversampling: grid samples per mask pixel and axis.
        accept_error: sampling error up to which the stack is accepted; None accepts 0.05 and warns above 0.01.
    """

    depths_m: tuple[float, ...]
    model: Model = "scaled_distance"
    wavelengths_per_channel: int = 3
    oversampling: int = 1
    accept_error: float | None = None
    shared_wavelengths: int | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        check_depths(np.asarray(self.depths_m))
        object.__setattr__(self, "depths_m", tuple(float(depth) for depth in self.depths_m))
        if self.model not in get_args(Model):
            raise InputError("model", f"got {self.model!r}, expected one of {', '.join(get_args(Model))}")


def psf_lines(response: SpectralResponse, psf_config: PsfConfig) -> list[Line]:
    """Return the wavelengths that stand for each channel, with their weights."""
    if psf_config.shared_wavelengths is not None:
        return shared_lines(response, psf_config.shared_wavelengths)
    return quantile_lines(response, psf_config.wavelengths_per_channel)


def compute_psf_stack(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    *,
    xp: str = "numpy",
    threads: int = 1,
    progress: Progress | None = None,
    lines: Sequence[Line] | None = None,
) -> PsfStack:
    """Compute the PSFs of a mask for every depth and channel; how good they are, ``proven_psf_stack`` measures.

    Args:
        mask: the mask; its arrays decide the precision and, if they are torch tensors, the device and gradients.
        camera: distance (a torch scalar to have its gradient), binned pixel pitch and spectral response.
        psf_config: depths, model, wavelengths, sampling.
        xp: ``numpy`` or ``torch``.
        threads: depths computed at a time (NumPy only); each needs one more complex grid, 160 MB at full size.
        progress: called with (done, total) after every PSF.
        lines: wavelengths and weights in place of the response's quantile lines; weights may be torch scalars.

    Returns:
        The stack, ``values`` ``(K, C, N, N)`` with N odd and wide enough for all the light that is followed: the sum of each
        PSF times the pixel area equals the mask's transmitted area for a smooth mask, and falls short of it by the
        diffraction orders beyond ``kernel.ORDERS`` (6-9 % for a PhlatCam) for a staircase. ``provenance["sampling"]`` is
        ``UNPROVEN``.
    """
    own_lines = lines is None
    lines = psf_lines(camera.response, psf_config) if lines is None else lines
    on_device = mask if is_torch(mask.height_m) else _to(mask, xp)
    size = max(_size(mask, camera, psf_config, line.wavelength_m) for line in lines)
    by_wavelength: dict[float, list[Line]] = {}
    for line in lines:
        by_wavelength.setdefault(line.wavelength_m, []).append(line)
    total, done = len(by_wavelength) * len(psf_config.depths_m), 0

    planes: list[list[Any]] = [[0.0] * len(psf_config.depths_m) for _ in camera.response.channels]
    for wavelength_m, shares in by_wavelength.items():
        images = depth_images(on_device, camera, psf_config, wavelength_m, size, threads=threads)
        for k, image in enumerate(images):
            for line in shares:
                planes[line.channel][k] = planes[line.channel][k] + line.weight * image
            done += 1
            if progress is not None:
                progress(done, total)
    ns = namespace(on_device.height_m)
    return PsfStack(
        values=ns.stack([ns.stack(depths) for depths in planes], axis=1),
        depths_m=np.asarray(psf_config.depths_m, np.float64),
        pixel_pitch_m=camera.pixel_pitch_m,
        channels=camera.response.channels,
        fingerprint=psf_fingerprint(mask, camera, psf_config, None if own_lines else lines),
        provenance={
            "kind": "computed",
            "mask": mask.provenance(),
            "mask_to_sensor_m": number(camera.mask_to_sensor_m),
            "gap": _layers(camera.gap),
            "window": _layers(camera.window),
            "response": camera.response.label,
            "lines": [
                [camera.response.channels[line.channel], line.wavelength_m, number(line.weight)] for line in lines
            ],
            "model": psf_config.model,
            "oversampling": psf_config.oversampling,
            "sampling": UNPROVEN,
        },
    )


def depth_images(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelength_m: float,
    size: int,
    *,
    threads: int = 1,
    direction: tuple[float, float] = (0.0, 0.0),
) -> Iterator[Array]:
    """Yield the PSF ``(size, size)`` of one wavelength for each depth, in the stored frame (rotated by 180 degrees).

    Args:
        mask: the mask.
        camera: distance or layers, binned pixel pitch.
        psf_config: depths, model, oversampling.
        wavelength_m: metres.
        size: odd number of pixels; the centre is where the ray through the mask's centre arrives.
        threads: NumPy only.
        direction: tangents (x, y) of the sources' direction from the mask's centre; model ``exact`` only.

    Raises:
        InputError: for an oblique direction with a model that knows on-axis sources only.
    """
    sources = _sources(camera, psf_config, wavelength_m, direction)
    settings: dict[str, Any] = {"oversampling": psf_config.oversampling, "threads": threads}
    if psf_config.model == "exact":
        return exact_images(mask, camera, sources, size, **settings)
    if not sources[0].on_axis:
        raise InputError(
            "direction", f"got {direction}, but model {psf_config.model!r} knows the axis only; use 'exact'"
        )
    return scaled_images(mask, camera, sources, size, diffracted=psf_config.model == "scaled_distance", **settings)


def sampled_intensity(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelength_m: float,
    depth_m: float,
    count: int,
    rng: np.random.Generator,
    *,
    direction: tuple[float, float] = (0.0, 0.0),
    threads: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a model's irradiance at random points of its own grid, before pixels integrate it.

    The points are drawn from the mask's geometric shadow, where a PSF has most of its light.

    Args:
        mask: the mask (NumPy).
        camera: distance or layers.
        psf_config: model and oversampling; its depths do not matter.
        wavelength_m: metres.
        depth_m: of the source, metres.
        count: number of points.
        rng: draws them.
        direction: as in ``depth_images``.
        threads: as in ``depth_images``.

    Returns:
        ``(count, 2)`` points x, y on the physical sensor from the PSF's centre, metres, and ``(count,)`` |U|^2.
    """
    one = replace(psf_config, depths_m=(depth_m,))
    (source,) = _sources(camera, one, wavelength_m, direction)
    if psf_config.model == "exact":
        return exact_points(mask, camera, source, count, rng, oversampling=psf_config.oversampling, threads=threads)
    diffracted = psf_config.model == "scaled_distance"
    return scaled_points(mask, camera, source, count, rng, oversampling=psf_config.oversampling, diffracted=diffracted)


def stack_size(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> int:
    """Return the odd width in sensor pixels that holds all the light that is followed, at the nearest depth."""
    lines = psf_lines(camera.response, psf_config)
    return max(_size(mask, camera, psf_config, line.wavelength_m) for line in lines)


def _size(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, wavelength_m: float) -> int:
    nearest = _sources(camera, psf_config, wavelength_m, (0.0, 0.0))[0]
    width_m = exact_width_m if psf_config.model == "exact" else scaled_width_m
    return 2 * math.ceil(width_m(mask, camera, nearest, psf_config.oversampling) / 2 / camera.pixel_pitch_m) + 1


def _sources(
    camera: CameraGeometry, psf_config: PsfConfig, wavelength_m: float, direction: tuple[float, float]
) -> list[Source]:
    if not camera.mask_to_sensor_m > 0:
        raise InputError("mask_to_sensor_m", f"got {camera.mask_to_sensor_m:g}, expected positive metres")
    window = tuple((layer.thickness_m, layer.material.index(wavelength_m)) for layer in camera.window)
    return [Source(wavelength_m, float(depth), direction, window) for depth in psf_config.depths_m]


def psf_fingerprint(
    mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, lines: Sequence[Line] | None = None
) -> str:
    """Return a hash of everything that decides the stack's values."""
    response = camera.response
    sha = hashlib.sha256(mask.digest().encode())
    sha.update(repr((number(camera.mask_to_sensor_m), camera.pixel_pitch_m, response.channels)).encode())
    if camera.gap or camera.window:
        sha.update(repr((camera.gap, camera.window)).encode())
    sha.update(
        np.ascontiguousarray(response.wavelengths_m).tobytes() + np.ascontiguousarray(response.weights).tobytes()
    )
    sha.update(repr(replace(psf_config, accept_error=None)).encode())
    if psf_config.shared_wavelengths is not None:
        sha.update(f"shared {psf_config.shared_wavelengths}".encode())
    if lines is not None:
        sha.update(repr([(line.channel, line.wavelength_m, number(line.weight)) for line in lines]).encode())
    return sha.hexdigest()


def _layers(layers: Sequence[Layer]) -> list[dict[str, Any]]:
    return [{"thickness_m": layer.thickness_m, "material": layer.material.name} for layer in layers]


def _to(mask: Mask, xp: str) -> Mask:
    ns: Any = module(xp)
    return replace(mask, height_m=ns.asarray(mask.height_m), amplitude=ns.asarray(mask.amplitude))
