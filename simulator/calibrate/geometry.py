"""Where mask and source were, from how registered PSFs magnify and move: mask distance, zero of the scale, the source's path.

Nothing here is assumed of the mask but that it is the same at every distance. Of two planes the ratio of m = 1 + d / (z + o)
is measured, so d and the offset o of the scale's zero are told apart only by how m bends over 1 / z.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.optics.registration import Match, chained_shifts, likeness, match

MISPLACED = 1e-3
"""Probability, from the scatter of the other planes, below which a plane counts as misplaced (Student's t)."""
_LEAST_MM, _MOST = 0.05, 1.0  # distances that are tried: from this to this share of the nearest depth
_COARSE_STEP = 0.008  # of the logarithm of the outermost planes' magnification: one pixel in a half-width of 128
_COARSE_PX = 256
_FAR = 0.01  # of a magnification's logarithm: from a start so far off, a match may not have converged
_FEW = 4  # planes from which on one can be told to be wrong by the others
_FLOOR, _FLOOR_PX = (
    2e-5,
    0.01,
)  # of a relative magnification and a shift: what registration errs by, on noiseless images


@dataclass(frozen=True)
class Distance:
    """A fitted distance from mask to sensor; standard errors in metres, offset None where it was not fitted."""

    distance_m: float
    distance_std_m: float
    offset_m: float | None = None
    offset_std_m: float | None = None


@dataclass(frozen=True)
class Geometry:
    """What the planes of a calibration say of where things were.

    Attributes:
        matches: of every plane in terms of the next, their magnification free.
        magnifications: ``(K,)`` measured m, its common factor that of ``distance``'s.
        distance: with the distances taken as they are stated; None where the planes do not tell.
        with_offset: the same with the scale's zero free; None below four planes.
        depth_errors_m: ``(K,)`` by how much the source is farther than stated, as the magnification says; NaN if untold.
        depth_std_m: standard deviation of these, without misplaced planes.
        shifts_px: ``(K, 2)`` lateral displacement, as small as can be (see ``chained_shifts``).
        shift_std_px: standard error of a shift against its neighbour's, the greatest of all planes.
        centre_px: ``(2,)`` where the line of the sources meets the sensor's plane, pixels from the grid's origin.
        centre_std_px: its standard error, by how well the sources lie on a line.
        off_line_m: ``(K, 2)`` distance of the sources from that line, metres, x and y; NaN if untold.
        misplaced: planes whose distance disagrees with the others'.
        off_the_line: planes whose source lies off the others' line.
    """

    matches: tuple[Match, ...]
    magnifications: NDArray[np.float64]
    distance: Distance | None
    with_offset: Distance | None
    depth_errors_m: NDArray[np.float64]
    depth_std_m: float
    shifts_px: NDArray[np.float64]
    shift_std_px: float
    centre_px: NDArray[np.float64] | None
    centre_std_px: float
    off_line_m: NDArray[np.float64]
    misplaced: tuple[int, ...]
    off_the_line: tuple[int, ...]


def find_geometry(
    grey: NDArray[np.floating],
    depths_m: NDArray[np.float64],
    pixel_pitch_m: float,
    *,
    nominal_m: float | None = None,
    use_offset: bool = False,
) -> Geometry:
    """Find mask distance, offset and path from planes of a point source.

    Args:
        grey: ``(K, H, W)`` light, background removed.
        depths_m: ``(K,)`` stated depths, increasing.
        pixel_pitch_m: of the images; only lateral distances need it.
        nominal_m: roughly the distance from mask to sensor, metres; None, or one that fits no planes, searches for it.
        use_offset: whether depths are judged with the fitted offset, not as they are stated.
    """
    planes, z = to_numpy(grey), np.asarray(depths_m, np.float64)
    count = len(z)
    start = nominal_m if nominal_m is not None else _searched_distance(planes, z)
    matches = _matches(planes, z, start)
    if nominal_m is not None and not all(one.found for one in matches):  # perhaps too far off to start from
        searched = _searched_distance(planes, z)
        others = _matches(planes, z, searched)
        if sum(one.found for one in others) > sum(one.found for one in matches):
            start, matches = searched, others
    m = 1 + start / z
    found = all(one.found for one in matches)
    chain = np.append(np.cumsum([np.log(one.scale) for one in matches][::-1])[::-1], 0.0)
    variance = _own_variance([one.log_scale_std for one in matches], _FLOOR)
    distance = with_offset = None
    errors, spread, misplaced = np.full(count, np.nan), np.nan, ()
    if count > 1 and found:
        kept, distance, errors, spread = _fit(z, chain, variance, start, offset=False)
        if count >= _FEW:
            both = _fit(z, chain, variance, start, offset=True)
            with_offset = both[1]
            if use_offset:
                kept, _, errors, spread = both
        misplaced = tuple(k for k in range(count) if k not in kept)
        far = (with_offset if use_offset and with_offset else distance).distance_m
        true = z + errors if count > 2 else z
        m = np.exp(chain) * (1 + far / true[-1])
    shifts = chained_shifts(matches, m)
    centre, centre_std, off_line, off_the_line = None, np.nan, np.full((count, 2), np.nan), ()
    if count > 2 and found and distance is not None:
        own = np.sqrt(_own_variance([float(one.shift_std_px.max()) for one in matches], _FLOOR_PX))
        centre, centre_std, off_line, off_the_line = _line(shifts, m, own, pixel_pitch_m)
    return Geometry(
        matches=matches,
        magnifications=m,
        distance=distance,
        with_offset=with_offset,
        depth_errors_m=errors,
        depth_std_m=float(spread),
        shifts_px=shifts,
        shift_std_px=float(max((one.shift_std_px.max() for one in matches), default=0.0)),
        centre_px=centre,
        centre_std_px=centre_std,
        off_line_m=off_line,
        misplaced=misplaced,
        off_the_line=off_the_line,
    )


def _matches(planes: NDArray[np.floating], z: NDArray[np.float64], start: float) -> tuple[Match, ...]:
    m = 1 + start / z
    matches = []
    for k in range(len(z) - 1):
        scale = m[k] / m[k + 1]
        found = match(planes[k], planes[k + 1], scale, free_scale=True)
        if abs(np.log(found.scale / scale)) > _FAR:
            found = match(planes[k], planes[k + 1], found.scale, free_scale=True)
        matches.append(found)
    return tuple(matches)


def _searched_distance(planes: NDArray[np.floating], z: NDArray[np.float64]) -> float:
    """Return the distance at which the planes, magnified as it says, are most alike: good enough to start from."""
    if len(z) < 2:
        return z[0] * 0.1
    factor = max(1, max(planes.shape[1:]) // _COARSE_PX)
    rows, columns = (n // factor * factor for n in planes.shape[1:])
    small = planes[:, :rows, :columns].reshape(len(z), rows // factor, factor, columns // factor, factor).mean((2, 4))
    chosen = np.unique(np.linspace(0, len(z) - 1, 4).round().astype(int))
    reach = np.log1p(_MOST) - np.log1p(_MOST * z[0] / z[-1])
    steps = max(2, int(np.ceil(reach / _COARSE_STEP)))
    tried = np.geomspace(_LEAST_MM * 1e-3, _MOST * z[0], 4 * steps)
    ratio = np.log1p(tried / z[0]) - np.log1p(tried / z[-1])
    tried = np.interp(np.linspace(ratio[0], ratio[-1], steps), ratio, tried)

    def alike(d: float) -> float:
        m = 1 + d / z
        return sum(likeness(small[a], small[b], float(m[a] / m[b])) for a, b in pairwise(chosen))

    return float(tried[np.argmax([alike(float(d)) for d in tried])])


def _own_variance(stds: Sequence[float], floor: float) -> NDArray[np.float64]:
    """Return the variance ``(K,)`` of each plane against its neighbours from the standard errors of pairs, ``(K - 1,)``."""
    pair = np.square(stds) + floor**2
    before, after = np.append(pair[:1], pair), np.append(pair, pair[-1:])
    return (before + after) / 2 if len(pair) else np.zeros(1)


def _model(z: NDArray[np.float64], d: float, offset: float) -> NDArray[np.float64]:
    return np.log1p(d / (z + offset))


def _fit(
    z: NDArray[np.float64], chain: NDArray[np.float64], variance: NDArray[np.float64], start: float, *, offset: bool
) -> tuple[list[int], Distance, NDArray[np.float64], float]:
    """Fit the magnifications' logarithms, known but for their sum, leaving out planes that are misplaced.

    Returns the planes that were kept, the distance, every plane's error of depth and their standard deviation.
    """

    def sensitivity(d: float, o: float) -> NDArray[np.float64]:
        return -d / ((z + o) * (z + o + d))  # d log m / d z

    def solved(kept: list[int], spread: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        from scipy.optimize import least_squares

        part = np.array(kept)
        free = 3 if offset else 2
        weight = 1 / np.sqrt(variance + (sensitivity(start, 0.0) * spread) ** 2)

        def left(p: NDArray[np.float64]) -> NDArray[np.float64]:
            o = p[2] * z[0] if offset else 0.0
            return ((_model(z, np.exp(p[0]) * start, o) + p[1] - chain) * weight)[part]

        first = np.array([0.0, np.mean(chain - _model(z, start, 0.0)), 0.0])[:free]
        low = np.array([-np.inf, -np.inf, -0.9])[:free]
        answer = least_squares(left, first, bounds=(low, np.inf), x_scale="jac")
        return answer.x, np.linalg.pinv(answer.jac.T @ answer.jac)

    def errors(p: NDArray[np.float64]) -> NDArray[np.float64]:
        d, o = np.exp(p[0]) * start, p[2] * z[0] if offset else 0.0
        return (chain - _model(z, d, o) - p[1]) / sensitivity(d, o)

    free = 3 if offset else 2
    own_std = np.sqrt(variance) / -sensitivity(start, 0.0)

    def settled(kept: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Return the answer, its covariance and the sources' scatter about their stated depths."""
        spread = 0.0
        answer, covariance = solved(kept, spread)
        for _ in range(8):
            if len(kept) <= free:
                break
            spread = _scatter(errors(answer)[kept], own_std[kept], len(kept) - free)
            answer, covariance = solved(kept, spread)
        return answer, covariance, spread

    def judged(part: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
        answer, _, spread = settled(part)
        return errors(answer), np.hypot(spread, own_std), len(part) - free

    kept = _without_outliers(list(range(len(z))), judged)
    answer, covariance, spread = settled(kept)
    d = float(np.exp(answer[0]) * start)
    o = (float(answer[2] * z[0]), float(np.sqrt(covariance[2, 2]) * z[0])) if offset else (None, None)
    found = Distance(d, float(np.sqrt(covariance[0, 0]) * d), *o)
    off = errors(answer) if len(z) > free else np.full(len(z), np.nan)
    return kept, found, off, spread if len(kept) > free else np.nan


def _scatter(errors: NDArray[np.float64], own_std: NDArray[np.float64], freedom: int) -> float:
    """Return the standard deviation that errors have on top of their own (Paule and Mandel, J. Res. NBS 87, 377, 1982)."""
    from scipy.optimize import brentq

    def excess(spread: float) -> float:
        return float(np.sum(errors**2 / (own_std**2 + spread**2))) - freedom

    top = float(np.linalg.norm(errors))
    if not (top > 0 and excess(0.0) > 0 > excess(top)):
        return 0.0
    root: Any = brentq(excess, 0.0, top)
    return float(root)


def _without_outliers(
    kept: list[int], solve: Callable[[list[int]], tuple[NDArray[np.float64], NDArray[np.float64], int]]
) -> list[int]:
    """Return the planes without those that all others contradict, the worst first.

    ``solve`` gives, for some planes, the errors of all planes, their standard deviations and the degrees of freedom.
    """
    from scipy.stats import t

    while True:
        worst, most = None, 1.0
        for k in kept:
            errors, std, freedom = solve([j for j in kept if j != k])
            if freedom < 1:
                return kept
            off = np.abs(errors[k]).max() / std[k] / t.isf(MISPLACED / 2, freedom)
            if off > most:
                worst, most = k, off
        if worst is None:
            return kept
        kept = [j for j in kept if j != worst]


def _line(
    shifts_px: NDArray[np.float64], m: NDArray[np.float64], std_px: NDArray[np.float64], pixel_pitch_m: float
) -> tuple[NDArray[np.float64], float, NDArray[np.float64], tuple[int, ...]]:
    """Return where the sources' line meets the sensor and how sure that is (pixels), distances from it (metres), outliers.

    Shifts, known to ``std_px``, are q + b m where all sources lie on a line through q; a source off it by X moves its image
    by (m - 1) X.
    """
    weight = 1 / (m - 1)  # hands err alike at every distance
    columns = np.stack([weight, m * weight], axis=-1)

    def solve(part: list[int]) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
        answer = np.linalg.lstsq(columns[part], shifts_px[part] * weight[part, None])[0]
        off = shifts_px * weight[:, None] - columns @ answer
        freedom = 2 * (len(part) - 2)
        own = np.sqrt(np.mean((std_px * weight)[part] ** 2))  # hands are not told apart from less
        scatter = max(np.sqrt(np.sum(off[part] ** 2) / max(freedom, 1)), own)
        leverage = np.einsum("ki,ij,kj->k", columns, np.linalg.pinv(columns[part].T @ columns[part]), columns)
        return off, scatter * np.sqrt(1 + leverage), freedom

    everything = list(range(len(m)))
    kept = _without_outliers(everything, solve)
    off, std, _ = solve(kept)
    centre = np.linalg.lstsq(columns[kept], shifts_px[kept] * weight[kept, None])[0][0]
    covariance = np.linalg.pinv(columns[kept].T @ columns[kept])[0, 0]
    leverage = np.einsum("ki,ij,kj->k", columns, np.linalg.pinv(columns[kept].T @ columns[kept]), columns)
    scatter = float((std / np.sqrt(1 + leverage))[0])
    return centre, scatter * float(np.sqrt(covariance)), off * pixel_pitch_m, tuple(set(everything) - set(kept))
