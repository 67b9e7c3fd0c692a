"""Where solids go in a view's frustum (balls, even in disparity, of sizes that fit the image), and how they are rotated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.errors import InputError
from simulator.types import View

Array = NDArray[np.float64]
# Solids and wall stay this far inside near and far, so that rounding to float32 never puts a depth outside.
_MARGIN = 1e-3
# An infinite far depth is filled this many times the near depth deep: the rest is the last 2 % of the disparities.
_DEPTHS_OF_INFINITY = 50.0
_LEAST_RATIO = 1.1
_TRIES = 12
_SIZES = (0.14, 0.42)  # of 30 balls, relative to half the image
_EDGE = 1.05  # centres lie a little beyond the image's edge, too


@dataclass(frozen=True)
class Ball:
    """A solid's bounding sphere, metres."""

    centre_m: NDArray[np.float64]
    radius_m: float


def far_end(view: View) -> float:
    """Return how deep scenes of this view reach, metres: the far depth, or 50 times the near depth if that is infinite.

    Raises:
        InputError: when near and far are too close for solids to fit in between.
    """
    if math.isinf(view.near_m):
        reason = "the PSF's only plane lies at infinity, where solids have no size; set scene.near_cm and scene.far_cm"
        raise InputError("scene", reason)
    if math.isinf(view.far_m):
        return _DEPTHS_OF_INFINITY * view.near_m
    if not view.far_m >= _LEAST_RATIO * view.near_m:
        raise InputError(
            "scene",
            f"solids do not fit between near {view.near_m:g} m and far {view.far_m:g} m; "
            f"expected far of at least {_LEAST_RATIO} x near: set scene.near_cm and scene.far_cm, or widen the PSF's depths",
        )
    return view.far_m


def place_balls(view: View, count: int, rng: np.random.Generator) -> list[Ball]:
    """Draw ``count`` balls, each wholly between near and far, with centres in view; they seldom overlap.

    The nearest points of the balls are uniform in disparity (1/z). A ball of relative size s = radius / centre depth has
    its nearest point at (1 - s) and its farthest at (1 + s) of the centre's depth, which bounds s. Sizes in the image
    fall with the square root of the count, so that coverage stays about the same.
    """
    near, far = view.near_m * (1 + _MARGIN), far_end(view) * (1 - _MARGIN)
    half = np.array([view.tan_half_width, view.tan_half_height])
    largest = _largest(near, far)
    balls: list[Ball] = []
    for _ in range(count):
        size = min(largest, half.min() * _crowd(count) * rng.uniform(*_SIZES))
        depth = _depth(size, near, far, rng)
        # Only the place across is tried again: else free depths would be favoured.
        balls.append(_freest(rng.uniform(-_EDGE, _EDGE, (_TRIES, 2)) * half, size, depth, balls))
    return balls


def place_balls_beside(view: View, count: int, before: list[Ball], rng: np.random.Generator) -> list[Ball]:
    """Draw balls for the view's margin, as dense as ``count`` are in the image but at most half as many: then larger ones.

    None of these hides more of the image than its own do, which are ``before``; more lie where more light comes from (cos^4).
    """
    near, far = view.near_m * (1 + _MARGIN), far_end(view) * (1 - _MARGIN)
    image, whole = (np.array([v.tan_half_width, v.tan_half_height]) for v in (view, view.field))
    wanted = count * (float(np.prod(whole / image)) - 1)
    number = min(count // 2, round(wanted))  # each costs as much as one in the image: light that it blocks goes on
    usual = image.min() * _crowd(count) * np.array(_SIZES)
    balls = list(before)
    for _ in range(number):
        size = min(_largest(near, far), math.sqrt(wanted / number) * rng.uniform(*usual))
        depth = _depth(size, near, far, rng)
        edge = np.minimum(_EDGE * image + max(0.0, 1.3 * (size - usual[1])), whole)
        tangents = rng.uniform(-1, 1, (100 * _TRIES, 2)) * whole
        lit = rng.random(len(tangents)) < (1 + np.sum(tangents**2, axis=1)) ** -2
        across = tangents[np.any(np.abs(tangents) >= edge, axis=1) & lit][:_TRIES]
        if len(across):  # none where the margin is narrower than what the image's own balls reach into
            balls.append(_freest(across, size, depth, balls))
    return balls[len(before) :]


def _crowd(count: int) -> float:
    """Return the factor of sizes by which so many balls cover as much of an image as 30 do."""
    return float(np.clip(math.sqrt(30 / count), 0.4, 2.0))


def _largest(near_m: float, far_m: float) -> float:
    """Return the largest relative size: at most half of the depth range (in log z) goes to one ball."""
    root = math.sqrt(far_m / near_m)
    return min(0.45, (root - 1) / (root + 1))


def _depth(size: float, near_m: float, far_m: float, rng: np.random.Generator) -> float:
    """Draw the depth of a ball's centre, so that its nearest point is uniform in disparity."""
    return 1 / rng.uniform((1 + size) / ((1 - size) * far_m), 1 / near_m) / (1 - size)


def _freest(across: Array, size: float, depth_m: float, others: list[Ball]) -> Ball:
    """Return a ball of relative size at the first of some places, tangents ``(n, 2)``, that is free, or the freest."""
    centres = np.column_stack([across * depth_m, np.full(len(across), depth_m)])
    gaps = _gaps(centres, size * depth_m, others)
    free = np.flatnonzero(gaps > 0)
    return Ball(centres[free[0] if len(free) else np.argmax(gaps)], size * depth_m)


def _gaps(centres: NDArray[np.float64], radius: float, others: list[Ball]) -> NDArray[np.float64]:
    """Free space to the nearest other ball as a share of both radii, for each centre; negative where they overlap."""
    if not others:
        return np.full(len(centres), np.inf)
    distance = np.linalg.norm(centres[:, np.newaxis] - np.array([other.centre_m for other in others]), axis=-1)
    reach = radius + np.array([other.radius_m for other in others])
    return np.min(distance / reach - 1, axis=1)


def random_rotation(rng: np.random.Generator) -> Array:
    """Return a uniformly distributed rotation matrix, from a random unit quaternion (Shoemake, 1992)."""
    w, x, y, z = (q := rng.standard_normal(4)) / math.sqrt(float(q @ q))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation(axis: ArrayLike, angle_rad: float) -> Array:
    """Return the matrix that turns by an angle about an axis, right-handed (Rodrigues).

    Example:
        >>> (rotation([0, 0, 1], math.pi / 2) @ [1, 0, 0]).round(6).tolist()
        [0.0, 1.0, 0.0]
    """
    x, y, z = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle_rad) * cross + (1 - math.cos(angle_rad)) * cross @ cross
