"""What tests of scenes share: frusta, and rays cast by trimesh, to check geometry by something that is not ours."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from simulator.types import View

Array = NDArray[np.float64]


def _cast_rays(vertices: Array, faces: NDArray[np.integer], rays: Array) -> tuple[Array, NDArray[np.int64]]:
    """Follow rays (x, y, 1) from the origin to the first of the triangles, seen from either side.

    By trimesh's planes and barycentric coordinates, without its search tree, which needs a package more.

    Returns:
        Depths z, inf where nothing is met, and the faces' numbers.
    """
    triangles = 1e3 * vertices[faces]  # millimetres: trimesh's tolerances are absolute
    numbers = np.flatnonzero((triangles[..., 2] > 0).any(axis=1))
    triangles = triangles[numbers]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    depths, met = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for number, ray in enumerate(rays):
        count = len(triangles)
        places, valid = trimesh.intersections.planes_lines(
            triangles[:, 0], normals, np.zeros((count, 3)), np.tile(ray, (count, 1))
        )
        weights = trimesh.triangles.points_to_barycentric(triangles[valid], places)
        inside = np.flatnonzero((weights > -1e-9).all(axis=1) & (places[:, 2] > 0))
        if len(inside):
            first = inside[places[inside, 2].argmin()]
            depths[number], met[number] = 1e-3 * places[first, 2], numbers[np.flatnonzero(valid)[first]]
    return depths, met


VIEWS = {
    "default": View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2),
    "wide": View((64, 128), 60e-6, 1.9e-3, 0.01, 0.2),
    "narrow": View((384, 320), 2.4e-6, 1.0e-2, 0.1, 0.5),
    "infinite": View((128, 128), 19.2e-6, 1.9e-3, 0.036, math.inf),
    "thin": View((128, 128), 19.2e-6, 1.9e-3, 0.1, 0.115),
}


@pytest.fixture(params=VIEWS.values(), ids=VIEWS.keys())
def view(request: pytest.FixtureRequest) -> View:
    """Return each of some very different frusta."""
    return request.param


@pytest.fixture(scope="session")
def cast_rays() -> Callable[..., tuple[Array, NDArray[np.int64]]]:
    """Return the function that casts rays."""
    return _cast_rays
