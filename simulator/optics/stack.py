"""The PSF stack: one image per depth and channel, with its scale, its frame and where it came from."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from simulator.arrays import Array, to_numpy
from simulator.errors import InputError

UNPROVEN = "unproven"
"""``provenance["sampling"]`` of a computed stack whose sampling error was never measured; data sets refuse it."""


@dataclass(frozen=True)
class PsfStack:
    """Point spread functions of one camera.

    A value is sensor irradiance per irradiance at the mask. The stored frame is the physical sensor's image rotated by
    180 degrees, so that a pinhole's image is upright; the origin lies on sample ``(H // 2, W // 2)``.

    Attributes:
        values: ``(K, C, H, W)``, not negative; the sum over (H, W) times ``pixel_pitch_m**2`` is the power (square metres)
            that reaches the plane per unit irradiance on the mask.
        depths_m: ``(K,)`` float64 z from the mask plane, metres, strictly increasing; the last may be ``inf``.
        pixel_pitch_m: pitch of the (binned) pixels, metres.
        channels: one name per channel.
        fingerprint: hash of everything that decided the values.
        provenance: how the stack was made and its errors; JSON-serialisable.

    Raises:
        InputError: when shapes, order or values break these rules.
    """

    values: Array
    depths_m: np.ndarray
    pixel_pitch_m: float
    channels: tuple[str, ...]
    fingerprint: str
    provenance: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.values.ndim != 4:
            raise InputError("values", f"expected (K, C, H, W), got shape {tuple(self.values.shape)}")
        depths, channels = self.values.shape[:2]
        check_depths(self.depths_m)
        if len(self.depths_m) != depths or len(self.channels) != channels:
            raise InputError(
                "depths_m, channels",
                f"got {len(self.depths_m)} and {len(self.channels)} for values of shape {tuple(self.values.shape)}",
            )
        if not 0 < self.pixel_pitch_m <= 1:
            raise InputError("pixel_pitch_m", f"got {self.pixel_pitch_m}, expected metres (2.4 um is 2.4e-6)")
        energy = self.energy_m2()
        if not np.all(np.isfinite(energy)) or to_numpy(self.values).min() < 0:
            raise InputError("values", "expected finite and not negative: a PSF is an intensity")
        dark = np.argwhere(energy <= 0)
        if len(dark):
            k, c = dark[0]
            raise InputError(
                "values",
                f"zero everywhere at {self.depths_m[k]:g} m, channel {self.channels[c]!r}: no light reaches the "
                "sensor; check the mask's amplitude or the measured image",
            )

    def energy_m2(self) -> np.ndarray:
        """Return the power per unit irradiance, ``(K, C)`` float64 square metres."""
        power = np.sum(to_numpy(self.values), axis=(-2, -1), dtype=np.float64)
        return np.asarray(power) * self.pixel_pitch_m**2


def of_depths(stack: PsfStack, kept: Sequence[int] | np.ndarray) -> PsfStack:
    """Return the part of a stack that has the depths with these indices, which increase."""
    kept = [int(index) for index in kept]
    if kept == list(range(len(stack.depths_m))):
        return stack
    identity = hashlib.sha256(f"{stack.fingerprint} {kept}".encode()).hexdigest()
    return replace(stack, values=stack.values[kept], depths_m=stack.depths_m[kept], fingerprint=identity)


def with_channels(stack: PsfStack, channels: tuple[str, ...], option: str) -> PsfStack:
    """Return a stack for a camera of these channels, where it has as many, or where one serves for all.

    One PSF serves each of several channels, and equal ones are one: what was measured in grey is the same whatever it was
    stored as. An InputError, which names ``option``, refuses the rest.
    """
    own = stack.channels
    if own == channels:
        return stack
    values = stack.values
    if len(own) > 1 and np.array_equal(to_numpy(values), np.broadcast_to(to_numpy(values)[:, :1], values.shape)):
        values = values[:, :1]
    if values.shape[1] not in (1, len(channels)):
        reason = f"got PSFs of {', '.join(own)}, which differ, for a camera of {', '.join(channels)}"
        raise InputError(option, f"{reason}; give PSFs of this camera")
    repeated = np.repeat(to_numpy(values), len(channels) // values.shape[1], axis=1)
    identity = hashlib.sha256(f"{stack.fingerprint} {' '.join(channels)}".encode()).hexdigest()
    return replace(stack, values=repeated, channels=channels, fingerprint=identity)


def check_depths(depths_m: np.ndarray) -> None:
    """Refuse depths that are not positive and strictly increasing."""
    depths = np.asarray(depths_m, np.float64)
    if depths.ndim != 1 or depths.size == 0:
        raise InputError("depths_m", f"expected a list of at least one depth, got {depths_m!r}")
    if not np.all(depths > 0):
        bad = depths[~(depths > 0)][0]
        raise InputError("depths_m", f"got {bad:g} m, expected positive: z from the mask plane into the scene")
    if not np.all(depths[1:] > depths[:-1]):
        raise InputError("depths_m", f"must increase strictly from near to far, got {depths.tolist()}")


def depth_planes(near_m: float, far_m: float, count: int, spacing: str = "disparity") -> np.ndarray:
    """Return ``count`` depths from near to far.

    Args:
        near_m: nearest depth, metres.
        far_m: farthest depth, metres; may be ``inf`` with ``disparity``.
        count: number of planes, from 1 (which gives the middle of the range).
        spacing: even steps in ``disparity`` (1/z), in ``log`` z or in ``linear`` z.

    Raises:
        InputError: for an empty range, a count below 1 or an infinite depth with another spacing.
    """
    forms = {
        "disparity": (lambda z: 1 / z, lambda s: 1 / s if s else np.inf),
        "log": (np.log, np.exp),
        "linear": (float, float),
    }
    if spacing not in forms:
        raise InputError("spacing", f"got {spacing!r}, expected one of {', '.join(forms)}")
    if count < 1 or not 0 < near_m < far_m:
        raise InputError(
            "near, far, count",
            f"got {near_m:g} m, {far_m:g} m and {count}, expected 0 < near < far and at least one depth",
        )
    if np.isinf(far_m) and spacing != "disparity":
        raise InputError("far", f"infinite, which spacing {spacing!r} cannot divide; use spacing 'disparity'")
    to_scale, to_depth = forms[spacing]
    first, last = to_scale(near_m), to_scale(far_m)
    steps = np.linspace(first, last, count) if count > 1 else np.array([(first + last) / 2])
    depths = np.array([to_depth(step) for step in steps], np.float64)
    if count > 1:
        depths[0], depths[-1] = near_m, far_m
    return depths
