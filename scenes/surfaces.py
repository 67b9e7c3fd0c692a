"""Surfaces from a grid of points, and smooth normals for any triangles: for what bends from scene to scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Return the triangles ``(2 (rows - 1) (columns - 1), 3)`` of a grid of points stored row by row.

    They run counter-clockwise seen from the side to which the cross product (along columns) x (along rows) points.

    Example:
        >>> grid_faces(2, 2)
        array([[0, 1, 2],
               [1, 3, 2]])
    """
    corner = (np.arange(rows - 1)[:, np.newaxis] * columns + np.arange(columns - 1)).ravel()
    right, below = corner + 1, corner + columns
    return np.concatenate([np.stack([corner, right, below], 1), np.stack([right, below + 1, below], 1)])


def face_cross(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """Return the normals of triangles ``(F, 3)``, as long as twice their areas."""
    a, b, c = (vertices[faces[:, side]] for side in range(3))
    return np.cross(b - a, c - a)


def smooth_normals(vertices: Array, faces: NDArray[np.integer], weld: NDArray[np.integer] | None = None) -> Array:
    """Return unit normals ``(V, 3)``: the means of the adjoining triangles' normals, weighted by area.

    Args:
        vertices: ``(V, 3)``.
        faces: ``(F, 3)``.
        weld: ``(V,)`` group numbers of vertices that share one normal, of `welded`; None keeps each vertex apart, so that
            a seam shows.
    """
    place = np.arange(len(vertices)) if weld is None else weld
    cross = face_cross(vertices, faces)
    sums = np.zeros((place.max() + 1, 3))
    for side in range(3):
        np.add.at(sums, place[faces[:, side]], cross)
    return unit(sums)[place]


def welded(vertices: Array, tolerance: float = 1e-6) -> NDArray[np.int64]:
    """Return group numbers ``(V,)`` that vertices at the same place share, within a tolerance in their own units."""
    _, place = np.unique(np.round(vertices / tolerance), axis=0, return_inverse=True)
    return place.ravel()


def unit(vectors: Array) -> Array:
    """Return vectors ``(..., 3)`` at length 1; zero ones stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
