"""The depth planes of a configuration, in metres."""

from __future__ import annotations

from simulator.config.psf import Planes
from simulator.optics.stack import depth_planes


def plane_depths_m(chosen: Planes) -> tuple[float, ...]:
    """Return the planes, metres from the mask, nearest first; the last may be ``inf``."""
    if chosen.depths_cm is not None:
        return tuple(depth * 1e-2 for depth in chosen.depths_cm)
    if chosen.depths == 1:
        return (chosen.nearest_cm * 1e-2,)
    assert chosen.near_cm is not None
    assert chosen.far_cm is not None
    assert chosen.depths is not None
    planes = depth_planes(chosen.near_cm * 1e-2, chosen.far_cm * 1e-2, chosen.depths, chosen.spacing)
    return tuple(float(depth) for depth in planes)
