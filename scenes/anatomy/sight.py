"""What a camera sees of a surface, by a few exact rays through the picture: far cheaper than rendering it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.types import View

Array = NDArray[np.float64]

_RAYS = 9


@dataclass(frozen=True)
class Glance:
    """Where rays through the middles and edges of a picture meet a surface first.

    Attributes:
        points_m: ``(N, 3)`` in the camera's coordinates, of the rays that meet it.
        face: ``(N,)`` the faces that they meet.
        missed: how many rays meet nothing.
    """

    points_m: Array
    face: NDArray[np.int64]
    missed: int


def glance(view: View, vertices_m: Array, faces: NDArray[np.integer]) -> Glance:
    """Follow 9 x 9 rays, evenly over the picture and to its very edges, to the nearest face that looks at the camera.

    A ray r meets the triangle (a, b, c) where the triple products r.(a x b), r.(b x c), r.(c x a) agree in sign; their sum is
    r.n with the normal n, and the depth is a.n / r.n (homogeneous rasterisation, Olano and Greer, 1997).

    Args:
        view: the camera's view.
        vertices_m: ``(V, 3)`` in the camera's coordinates.
        faces: ``(F, 3)``.
    """
    columns = np.linspace(-1, 1, _RAYS) * view.tan_half_width
    points, met = [np.empty((0, 3))], [np.empty(0, np.int64)]
    ahead = np.flatnonzero((vertices_m[:, 2] > 0)[faces].any(axis=1))
    for row in np.linspace(-1, 1, _RAYS) * view.tan_half_height:
        above = (vertices_m[:, 1] > row * vertices_m[:, 2])[faces[ahead]].sum(axis=1)
        crossed = ahead[(above > 0) & (above < 3)]  # faces on both sides of the row: few are left
        a, b, c = (vertices_m[faces[crossed, corner]] for corner in range(3))
        edges = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)])
        offset = np.einsum("ij,ij->i", a, edges[1])
        looking = offset < 0
        crossed, edges, offset = crossed[looking], edges[:, looking], offset[looking]
        if not len(crossed):
            continue
        rays = np.stack([columns, np.full(_RAYS, row), np.ones(_RAYS)])
        products = edges @ rays
        inside = (products <= 0).all(axis=0)
        inverse_depth = np.where(inside, products.sum(axis=0) / offset[:, np.newaxis], 0)
        nearest = inverse_depth.max(axis=0)
        points.append((rays[:, nearest > 0] / nearest[nearest > 0]).T)
        met.append(crossed[inverse_depth.argmax(axis=0)[nearest > 0]])
    found = np.concatenate(met)
    return Glance(np.concatenate(points), found, _RAYS**2 - len(found))
