"""How soft bodies and sheets change their form: maps of points with a phase, all smooth in time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.meshes import UnitMesh
from scenes.surfaces import grid_faces, smooth_normals, welded
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]
Bend = Callable[[Array, float], Array]
"""Points ``(V, 3)`` of a unit body and a phase in radians, to where they are."""


def squash(points: Array, stretch: float) -> Array:
    """Stretch points along y by a factor, and across by its root's inverse, so that volumes stay.

    Example:
        >>> squash(np.array([[1.0, 1.0, 0.0]]), 4.0).tolist()
        [[0.5, 4.0, 0.0]]
    """
    return points * np.array([stretch**-0.5, stretch, stretch**-0.5])


def pulsing(strength: float) -> Bend:
    """Return a body that turns long and flat by turns, at constant volume; ``strength`` is the logarithm of the stretch."""
    return lambda points, phase: squash(points, math.exp(strength * math.sin(phase)))


def jelly(directions: Array, strength: float) -> Bend:
    """Return a body through which waves run: a shear and a bulge, as of jelly that was knocked.

    Args:
        directions: ``(2, 3)`` unit vectors, along which the waves run and in which they push, at right angles.
        strength: how far points move, in radii.
    """
    along, push = directions

    def bend(points: Array, phase: float) -> Array:
        depth = points @ along
        swing = strength * np.sin(phase - 1.6 * depth)
        bulge = 1 + 0.45 * strength * np.sin(2 * phase - 2.4 * depth)
        middle = np.outer(depth, along)
        return middle + (points - middle) * bulge[:, np.newaxis] + np.outer(swing, push)

    return bend


def twisting(strength: float) -> Bend:
    """Return a body that is wrung about its y axis, back and forth; ``strength`` in radians at the ends."""

    def bend(points: Array, phase: float) -> Array:
        angle = strength * math.sin(phase) * points[:, 1]
        cos, sin = np.cos(angle), np.sin(angle)
        x, y, z = points.T
        return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=1)

    return bend


def bowing(strength: float) -> Bend:
    """Return a body whose y axis bends into an arc of ``strength`` radians, to one side and the other."""

    def bend(points: Array, phase: float) -> Array:
        curve = strength * math.sin(phase) / 2
        x, y, z = points.T
        angle = curve * y
        # sin(a) / a and (1 - cos(a)) / a have no trouble at a = 0 in this form.
        length = y * np.sinc(angle / np.pi)
        sag = y * np.sin(angle / 2) * np.sinc(angle / 2 / np.pi)
        return np.stack([x * np.cos(angle) + sag, length - x * np.sin(angle), z], axis=1)

    return bend


def flapping(strength: float, waves: float, slope: float) -> Bend:
    """Return a flag on a pole along its edge x = -1: waves run to the free edge and grow on their way.

    Args:
        strength: amplitude at the free edge, in half widths.
        waves: how many wavelengths fit on the flag.
        slope: how far the crests lean, in radians of phase per unit of height.
    """

    def bend(points: Array, phase: float) -> Array:
        share = (points[:, 0] + 1) / 2
        lag = phase - 2 * np.pi * waves * share - slope * points[:, 1]
        push = strength * share**0.8 * np.sin(lag)
        # What goes sideways is missing ahead: the cloth does not stretch much.
        shortened = points[:, 0] - 0.35 * strength**2 * waves * share * np.ones_like(push)
        return np.stack([shortened, points[:, 1], points[:, 2] + push], axis=1)

    return bend


def rippling(strength: float, waves: float, slope: float) -> Bend:
    """Return a free sheet, a falling paper or a ray: waves run along it and both its ends swing; see `flapping`."""

    def bend(points: Array, phase: float) -> Array:
        lag = phase - np.pi * waves * points[:, 0] - slope * points[:, 1]
        return points + np.outer(strength * np.sin(lag) * (0.4 + 0.6 * points[:, 0] ** 2), (0.0, 0, 1))

    return bend


def sheet(rows: int, columns: int, aspect: float) -> UnitMesh:
    """Return an open rectangle in the x-y plane, x from -1 to 1 and y from -aspect to aspect, facing -z."""
    y, x = np.meshgrid(np.linspace(-aspect, aspect, rows), np.linspace(-1, 1, columns), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    uv = np.stack([(x + 1) / 2, (y + aspect) / 2], axis=-1).reshape(-1, 2)
    faces = grid_faces(rows, columns)[:, ::-1]
    return UnitMesh(vertices, smooth_normals(vertices, faces), uv, faces)


class Soft:
    """A mesh that is bent anew in each frame, with the normals that belong to its form."""

    def __init__(self, mesh: UnitMesh, bend: Bend) -> None:
        self._mesh, self._bend = mesh, bend
        self._weld = welded(mesh.vertices)
        if len(mesh.vertices) == 3 * len(mesh.faces):  # a faceted body: its edges stay sharp
            self._weld = np.arange(len(mesh.vertices))

    def reach(self) -> float:
        """Return the farthest that a vertex gets from the origin, over all phases, with 2 % to spare."""
        phases = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        bent = (self._bend(self._mesh.vertices, float(phase)) for phase in phases)
        return 1.02 * max(float(np.linalg.norm(points, axis=1).max()) for points in bent)

    def placed(self, phase: float, material: Material, centre_m: Array, size_m: float, turn: Array) -> TriangleMesh:
        """Return the body at a phase as a thing of a scene; the other arguments are those of `scenes.motion.placed`."""
        vertices = self._bend(self._mesh.vertices, phase)
        normals = smooth_normals(vertices, self._mesh.faces, self._weld)
        return TriangleMesh(
            vertices_m=np.asarray(centre_m) + size_m * vertices @ turn.T,
            normals=normals @ turn.T,
            uv=self._mesh.uv,
            faces=self._mesh.faces,
            material=material,
        )
