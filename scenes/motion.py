"""How things turn and move: rotations, smooth courses in time, and meshes put into place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.meshes import UnitMesh
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]


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


def minimum_jerk(share: ArrayLike) -> Array:
    """Return how far a reaching hand is, 0..1, after a share 0..1 of its time (Flash and Hogan, 1985); clipped outside.

    Example:
        >>> minimum_jerk([0.0, 0.5, 1.0]).tolist()
        [0.0, 0.5, 1.0]
    """
    t = np.clip(share, 0, 1)
    return t**3 * (10 - 15 * t + 6 * t**2)


def placed(mesh: UnitMesh, material: Material, centre_m: ArrayLike, size_m: ArrayLike, turn: Array) -> TriangleMesh:
    """Return a unit mesh as a thing of a scene.

    Args:
        mesh: inside the unit ball.
        material: of its surface.
        centre_m: where its origin goes, metres.
        size_m: metres per unit, one number or one for each of its own axes.
        turn: rotation matrix from its own axes to the world's.
    """
    scale = np.broadcast_to(np.asarray(size_m, dtype=float), 3)
    normals = mesh.normals / scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return TriangleMesh(
        vertices_m=np.asarray(centre_m) + (mesh.vertices * scale) @ turn.T,
        normals=normals @ turn.T,
        uv=mesh.uv,
        faces=mesh.faces,
        material=material,
    )
