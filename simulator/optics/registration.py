"""How measured PSFs of several depths lie on each other: magnification, lateral shift and exposure, found from the images.

A mask point u casts its light from a source at (X_k, z_k) onto x = m_k u - (m_k - 1) X_k, with m_k = 1 + d / z_k: a plane is
the mask's pattern, magnified about the grid's origin and shifted by t_k. Planes are compared in pairs, which leaves t_k known
but for b m_k, whatever b: that only names another point of the mask its centre. The line on which the sources lie, if they
lie on one, meets the sensor's plane at the centre of magnification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.optics.resample import magnified
from simulator.optics.stack import PsfStack

FOUND = 0.5
"""Correlation of two band-passed planes from which on they count as the same pattern; unlike ones stay below 0.2."""
_FINE, _COARSE = 1.0, 8.0  # pixels: what is finer is noise, what is coarser is glow and background
_MOST_PIXELS = 1_000_000  # larger images are binned: a hundredth of a pixel stays one
_TILES = 5  # per side
_STEPS, _DONE_PX = 20, 1e-3
_NEWTON_STEPS = 8


# ---- a pair of planes


@dataclass(frozen=True)
class Match:
    """How a PSF lies in another: ``reference(x) ~ moving((x - shift) / scale)``, x in pixels from the grid's origin.

    Attributes:
        scale: magnification of the moving image.
        shift_px: ``(2,)`` x and y, pixels.
        log_scale_std: standard error of the scale's logarithm; 0 where the scale was given.
        shift_std_px: ``(2,)`` standard errors of the shift.
        correlation: of the two once they lie on each other, both band-passed; see ``FOUND``.
    """

    scale: float
    shift_px: NDArray[np.float64]
    log_scale_std: float
    shift_std_px: NDArray[np.float64]
    correlation: float

    @property
    def found(self) -> bool:
        """Whether the two show the same pattern."""
        return self.correlation >= FOUND


def match(
    reference: NDArray[np.floating[Any]], moving: NDArray[np.floating[Any]], scale: float, *, free_scale: bool = False
) -> Match:
    """Lay an image on another by shift and, where it is free, magnification.

    The maximum of the cross-correlation starts Gauss and Newton's least squares (Lucas and Kanade, IJCAI 1981) on images
    without what is finer than a pixel or coarser than eight. Standard errors are those of a jackknife over 25 tiles: what is
    left is less noise than a PSF that changed with depth, and neighbouring pixels share that.

    Args:
        reference: ``(H, W)``.
        moving: ``(H, W)``; best the plane that is magnified less, which then covers the reference's grid.
        scale: magnification to start from, right to about 1 %.
        free_scale: whether it is found, too.
    """
    fixed, other, origin, binning = _binned(reference, moving)
    fixed, other = _band(fixed, scale), _band(other)
    if not (fixed.any() and other.any()):
        return Match(scale, np.zeros(2), np.inf, np.full(2, np.inf), 0.0)
    shift: Any = _peak(_cross(_warped(other, scale, np.zeros(2), origin), fixed))
    y, x = np.arange(fixed.shape[0])[:, None] - origin[0], np.arange(fixed.shape[1]) - origin[1]
    inner = _inner(fixed.shape)
    normal, right, warped = np.empty(0), np.empty(0), other
    for _ in range(_STEPS):
        warped = _warped(other, scale, shift, origin)
        gain = _inner_product(fixed, warped, inner) / _inner_product(warped, warped, inner)
        dy, dx = (gain * slope for slope in np.gradient(warped))
        columns: list[Any] = [dy, dx] + [dy * (y - shift[0]) + dx * (x - shift[1])] * free_scale
        jacobian = -np.stack([column[inner] for column in columns] + [-gain * warped[inner]], axis=-1)
        left = fixed[inner] - gain * warped[inner]
        normal, right = _tile_sums(jacobian, left, inner)
        step: Any = np.linalg.lstsq(normal.sum(0), right.sum(0))[0]  # stripes do not say how far along themselves
        shift = shift + step[:2]
        grows = float(step[2]) if free_scale else 0.0
        scale *= np.exp(grows)
        if max(np.abs(step[:2]).max(), abs(grows) * max(fixed.shape) / 2) < _DONE_PX:
            break
    std = _jackknife(normal, right)
    norms = _inner_product(fixed, fixed, inner) * _inner_product(warped, warped, inner)
    return Match(
        scale=float(scale),
        shift_px=shift[::-1] * binning,
        log_scale_std=float(std[2]) if free_scale else 0.0,
        shift_std_px=std[1::-1] * binning,
        correlation=float(_inner_product(fixed, warped, inner) / np.sqrt(norms)),
    )


def likeness(reference: NDArray[np.floating[Any]], moving: NDArray[np.floating[Any]], scale: float) -> float:
    """Return the correlation of a band-passed image with another, magnified, at the best shift in whole pixels."""
    fixed, other, origin, _ = _binned(reference, moving)
    fixed, other = _band(fixed, scale), _warped(_band(other), scale, np.zeros(2), origin)
    norms = float(np.linalg.norm(fixed) * np.linalg.norm(other))
    return float(np.fft.ifft2(_cross(other, fixed)).real.max()) / norms if norms > 0 else 0.0


def registration_shift(reference: NDArray[np.float64], image: NDArray[np.float64]) -> tuple[float, float]:
    """Return how far an image is shifted against a reference, x and y, parts of a pixel included.

    The maximum of the cross-correlation, found to the pixel and refined by Newton's steps on its Fourier series (Guizar-
    Sicairos, Thurman and Fienup, Opt. Lett. 33, 156, 2008). Unlike a centroid it does not follow noise far from the PSF.

    Args:
        reference: ``(H, W)``.
        image: ``(H, W)``; it must not be shifted by more than half the width.

    Example:
        >>> spot = np.exp(-(np.arange(-10, 11)[:, None] ** 2 + np.arange(-10, 11) ** 2) / 8.0)
        >>> registration_shift(spot, np.roll(spot, (1, -2), (0, 1)))
        (-2.0, 1.0)
    """
    cross = _cross(reference, image)
    shift = _peak(cross)
    fy, fx = (np.fft.fftfreq(n) for n in reference.shape)
    frequencies = np.stack(np.broadcast_arrays(fy[:, None], fx[None, :])) * 2 * np.pi
    for _ in range(_NEWTON_STEPS):
        terms = cross * np.exp(1j * np.tensordot(shift, frequencies, 1))
        gradient = np.array([-np.sum(f * terms.imag) for f in frequencies])
        hessian = np.array([[-np.sum(f * g * terms.real) for g in frequencies] for f in frequencies])
        shift = shift - np.linalg.solve(hessian, gradient)
    row, column = (float(np.round(value, 9)) for value in shift)
    return column + 0.0, row + 0.0  # no minus zero


def _cross(reference: NDArray[np.float64], image: NDArray[np.float64]) -> NDArray[np.complex128]:
    return np.conj(np.fft.fft2(reference)) * np.fft.fft2(image)


def _peak(cross: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Return row and column of the highest cross-correlation, whole pixels."""
    peak = np.unravel_index(np.argmax(np.fft.ifft2(cross).real), cross.shape)
    return np.array([(p + n // 2) % n - n // 2 for p, n in zip(peak, cross.shape, strict=True)], np.float64)


def _binned(*images: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], int]:
    """Return two images of at most ``_MOST_PIXELS``, their origin (row and column, in parts of a pixel) and the binning."""
    shape = images[0].shape
    binning = int(np.ceil(np.sqrt(shape[0] * shape[1] / _MOST_PIXELS)))
    rows, columns = (n // binning for n in shape)
    small = [
        np.asarray(image, np.float64)[: rows * binning, : columns * binning]
        .reshape(rows, binning, columns, binning)
        .mean(axis=(1, 3))
        for image in images
    ]
    origin = (np.array([n // 2 for n in shape]) - (binning - 1) / 2) / binning
    return small[0], small[1], origin, binning


def _band(image: NDArray[np.float64], scale: float = 1.0) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(image, _FINE * scale) - gaussian_filter(image, _COARSE * scale)


def _warped(
    image: NDArray[np.float64], scale: float, shift: NDArray[np.float64], origin: NDArray[np.float64]
) -> NDArray[np.float64]:
    from scipy.ndimage import affine_transform

    return affine_transform(image, np.full(2, 1 / scale), origin - (origin + shift) / scale, order=3)  # pyright: ignore[reportArgumentType]


def _inner(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the pixels that the band-pass's reflection at the border hardly reaches; at least eight tenths per axis."""
    inner = np.zeros(shape, bool)
    rows, columns = (min(round(2 * _COARSE), n // 10) for n in shape)
    inner[rows : shape[0] - rows, columns : shape[1] - columns] = True
    return inner


def _inner_product(a: NDArray[np.float64], b: NDArray[np.float64], inner: NDArray[np.bool_]) -> float:
    return float(a[inner] @ b[inner])


def _tile_sums(
    jacobian: NDArray[np.float64], left: NDArray[np.float64], inner: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the normal equations' two sides for every tile, ``(T, n, n)`` and ``(T, n)``."""
    rows, columns = (np.arange(n) * _TILES // n for n in inner.shape)
    tile = (rows[:, None] * _TILES + columns)[inner]
    parts = [jacobian[tile == t] for t in range(_TILES**2)]
    sides = [part.T @ left[tile == t] for t, part in enumerate(parts)]
    return np.stack([part.T @ part for part in parts]), np.stack(sides)


def _jackknife(normal: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the standard errors of a least-squares solution from what it is without each of its parts."""
    without = np.stack(
        [np.linalg.lstsq(normal.sum(0) - a, right.sum(0) - b)[0] for a, b in zip(normal, right, strict=True)]
    )
    return np.sqrt((len(without) - 1) * without.var(axis=0))


# ---- a stack


@dataclass(frozen=True)
class Registration:
    """Where the planes of a measured stack lie, and how long each was exposed.

    Attributes:
        shifts_px: ``(K, 2)`` x and y by which each plane is displaced, pixels.
        exposures: ``(K,)`` factor by which each plane is too bright.
        matches: of every plane in terms of the next.
    """

    shifts_px: NDArray[np.float64]
    exposures: NDArray[np.float64]
    matches: tuple[Match, ...] = ()

    @classmethod
    def none(cls, planes: int) -> Registration:
        """Return that of planes that are taken as they are."""
        return cls(np.zeros((planes, 2)), np.ones(planes))

    def record(self) -> dict[str, Any]:
        """Return what provenance keeps of it."""
        return {
            "shifts_px": self.shifts_px.round(4).tolist(),
            "exposures": self.exposures.round(5).tolist(),
            "correlations": [round(match.correlation, 4) for match in self.matches],
            "unlike_neighbours": [[k, k + 1] for k, match in enumerate(self.matches) if not match.found],
        }


def register_stack(
    stack: PsfStack, mask_to_sensor_m: float, *, lateral: bool = True, exposure: bool = True
) -> Registration:
    """Find the shift and the exposure of every plane of a measured stack.

    Shifts are removed by moving the source onto one axis, the one through the grid's origin; which direction that axis has
    is nothing that the images say, and the planes are moved as little as possible (sum of the shifts' absolute values).
    To exposures belongs all that is common to a plane but the law of a stack, whose planes share the irradiance at the
    mask's centre: a plane has the light of the next one, magnified, where both reach; from a near source the mask's
    rim gets (z / r)^3 of its centre's irradiance.

    Args:
        stack: measured, its background removed.
        mask_to_sensor_m: d, metres of air.
        lateral: whether shifts are found, or zero.
        exposure: whether exposures are found, or alike.
    """
    if not 0 < mask_to_sensor_m < np.inf:
        raise InputError("mask_to_sensor_m", f"got {mask_to_sensor_m!r}, expected positive metres")
    grey = to_numpy(stack.values).mean(axis=1, dtype=np.float64)
    m = 1 + mask_to_sensor_m / stack.depths_m
    matches = tuple(match(grey[k], grey[k + 1], m[k] / m[k + 1]) for k in range(len(grey) - 1))
    shifts = chained_shifts(matches, m) if lateral else np.zeros((len(grey), 2))
    exposures = np.ones(len(grey))
    if exposure:
        exposures = relative_exposures(grey, shifts, m, stack.depths_m, stack.pixel_pitch_m)
    return Registration(shifts, exposures, matches)


def chained_shifts(matches: Sequence[Match], magnifications: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the shifts ``(K, 2)`` of planes from those of neighbours, as small as they can be; unlike planes share one.

    Args:
        matches: K - 1, of plane k as the reference and plane k + 1.
        magnifications: ``(K,)`` m.
    """
    m = magnifications
    shifts = np.zeros((len(m), 2))
    for k in reversed(range(len(matches))):
        step = matches[k].shift_px if matches[k].found else 0.0
        shifts[k] = step + m[k] / m[k + 1] * shifts[k + 1]
    return shifts - m[:, None] * np.array([_weighted_median(axis / m, m) for axis in shifts.T])


def _weighted_median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    """Return the value v that makes the sum of weights times |values - v| smallest."""
    order = np.argsort(values)
    return float(values[order][np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)])


def relative_exposures(
    grey: NDArray[np.float64],
    shifts_px: NDArray[np.float64],
    m: NDArray[np.float64],
    depths_m: NDArray[np.float64],
    pitch_m: float,
    totals: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the factor by which each plane is too bright, from the light of neighbours laid on each other.

    Args:
        grey: ``(K, H, W)`` light.
        shifts_px: ``(K, 2)`` where the planes lie.
        m: ``(K,)`` their magnifications.
        depths_m: ``(K,)``.
        pitch_m: of the pixels, metres.
        totals: ``(K,)`` light of the planes before noise below zero was cut off, which adds light; None takes what is there.
    """
    energy = grey.sum(axis=(1, 2))
    light = energy if totals is None else totals
    log_ratio = np.zeros(len(m))
    for k in reversed(range(len(m) - 1)):
        scale = m[k] / m[k + 1]
        other = magnified(grey[k + 1], scale, shifts_px[k] - scale * shifts_px[k + 1])
        rim = [_irradiance(grey[k + 1], m[k + 1], depth, pitch_m) for depth in depths_m[k : k + 2]]
        reaches = other.sum() / energy[k + 1]
        log_ratio[k] = log_ratio[k + 1] + np.log(light[k] / rim[0] / (light[k + 1] * reaches / rim[1]))
    exposures = np.exp(log_ratio)
    return exposures * np.mean(light / exposures) / light.mean()  # the stack's throughput stays


def _irradiance(light: NDArray[np.float64], m: float, depth_m: float, pitch_m: float) -> float:
    """Return the mean irradiance, relative to the centre's, of mask points that a PSF shows, from a source at a depth."""
    y, x = ((np.arange(n) - n // 2) * pitch_m / m / depth_m for n in light.shape)
    return float(np.average((1 + y[:, None] ** 2 + x**2) ** -1.5, weights=light))
