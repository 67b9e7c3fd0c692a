"""A hand: bones that are posed by joint angles and grip things of a given width, and one smooth skin around them.

Hand axes: origin at the wrist, x along the stretched fingers, y towards the thumb, z out of the back of the hand; metres.
The sizes are those of an adult's hand (0.19 m from wrist to middle fingertip; Buryanov and Kotiuk, Int. J. Morphol. 2010).

The skin at rest, made once per process, is the level set of a smooth union of round cones, triangulated by surface nets
(Gibson, MERL TR-99-24); poses move it by linear blend skinning.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.layout import rotation
from scenes.meshes import UnitMesh, unit
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]

FOREARM_M = 0.55
"""Elbow side of the forearm: longer than anatomy (a sleeve goes on), so that its end stays out of the image."""

FINGERS = ("thumb", "index", "middle", "ring", "little")
# Where each finger's first bone starts, and how long its three bones are.
_ROOTS_M = np.array(
    [
        (0.021, 0.025, -0.010),
        (0.088, 0.026, 0.001),
        (0.092, 0.005, 0.004),
        (0.086, -0.015, 0.002),
        (0.076, -0.034, -0.003),
    ]
)
_LENGTHS_M = np.array(
    [(0.043, 0.031, 0.024), (0.042, 0.024, 0.019), (0.046, 0.028, 0.020), (0.042, 0.026, 0.020), (0.033, 0.020, 0.017)]
)
# Fingers are spread at rest, so that their surfaces do not grow together.
_SPREAD_RAD = np.radians([0.0, 11.0, 2.0, -8.0, -18.0])
PAD_M = np.array([0.0085, 0.0072, 0.0074, 0.0070, 0.0060])
"""Radii of the fingertips, thumb first."""


def _rest_frames() -> Array:
    """Axes of each finger at rest as columns ``(5, 3, 3)``: along it, its flexion axis, its back."""
    fingers = [rotation([0, 0, 1], angle) for angle in _SPREAD_RAD[1:]]
    along = unit(np.array([0.74, 0.62, -0.25]))
    back = unit(np.cross(along, [0.15, -0.1, -1.0]))
    return np.stack([np.column_stack([along, np.cross(back, along), back]), *fingers])


REST_FRAMES = _rest_frames()


@dataclass(frozen=True)
class Bones:
    """Where the 17 bones are: forearm, palm, then three for each finger from its root, thumb first.

    Attributes:
        starts_m: ``(17, 3)`` their near joints; forearm and palm start at the wrist.
        ends_m: ``(17, 3)`` their far ends; the palm's is the root of the middle finger.
        turns: ``(17, 3, 3)`` rotations from the rest pose.
    """

    starts_m: Array
    ends_m: Array
    turns: Array

    def tip_m(self, finger: int) -> Array:
        """Return the end of a finger's last bone."""
        return self.ends_m[4 + 3 * finger]

    def pad_m(self, finger: int) -> Array:
        """Return the middle of a fingertip's gripping side."""
        last = 4 + 3 * finger
        palmar = -self.turns[last] @ REST_FRAMES[finger][:, 2]
        return 0.3 * self.starts_m[last] + 0.7 * self.ends_m[last] + PAD_M[finger] * palmar


def pose_bones(angles_rad: Array, elbow: Array | None = None) -> Bones:
    """Place the bones of a right hand in its own axes.

    Args:
        angles_rad: ``(5, 4)``: for each finger a turn at its root (of the thumb: opposition about the hand's x axis, of the
            others: abduction towards the thumb), then the flexion of its three joints.
        elbow: unit direction from wrist to elbow in hand axes; None for straight.
    """
    starts, ends, turns = np.zeros((17, 3)), np.zeros((17, 3)), np.tile(np.eye(3), (17, 1, 1))
    if elbow is not None:
        turns[0] = between(np.array([-1.0, 0, 0]), elbow)
    ends[0] = turns[0] @ (-FOREARM_M, 0.0, 0.0)
    ends[1] = _ROOTS_M[2]
    for finger in range(5):
        rest = REST_FRAMES[finger]
        aside = rotation([1, 0, 0] if finger == 0 else [0, 0, 1], (-1 if finger == 0 else 1) * angles_rad[finger, 0])
        frame, joint = aside @ rest, _ROOTS_M[finger]
        for bone in range(3):
            frame = frame @ _flexion(angles_rad[finger, 1 + bone])
            number = 2 + 3 * finger + bone
            starts[number], turns[number] = joint, frame @ rest.T
            joint = joint + _LENGTHS_M[finger, bone] * frame[:, 0]
            ends[number] = joint
    return Bones(starts, ends, turns)


def _flexion(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def between(start: Array, end: Array) -> Array:
    """Return the smallest rotation from one unit vector to another."""
    axis = np.cross(start, end)
    if np.linalg.norm(axis) < 1e-9:
        across = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        return np.eye(3) if start @ end > 0 else rotation(across, np.pi)
    return rotation(axis, float(np.arctan2(np.linalg.norm(axis), start @ end)))


def _pose(*rows: tuple[float, float, float, float]) -> Array:
    return np.radians(np.array(rows, dtype=float))


OPEN = _pose((25, 0, 5, 5), (0, 8, 10, 5), (0, 6, 10, 5), (0, 8, 12, 6), (2, 10, 14, 8))
RELAXED = _pose((35, 5, 15, 15), (-4, 22, 30, 15), (0, 28, 34, 18), (4, 32, 36, 20), (8, 35, 36, 20))
POINTING = _pose((60, 15, 35, 30), (-6, 4, 6, 3), (-2, 80, 95, 50), (5, 84, 95, 50), (11, 86, 92, 50))
_CLOSED = _pose((88, -10, 2, 24), (-9, 59, 48, 25), (-2, 61, 48, 25), (6, 63, 50, 25), (13, 65, 52, 25))
_WIDE = _pose((82, -34, 2, 6), (-5, 14, 26, 14), (0, 14, 26, 14), (4, 16, 28, 15), (8, 18, 30, 16))
_GRIP_FINGERS = (1, 2, 3)


@dataclass(frozen=True)
class Grip:
    """A grip between thumb and fingers, in hand axes.

    Attributes:
        angles_rad: ``(5, 4)`` of `pose_bones`.
        centre_m: middle between the thumb's pad and the fingers' pads.
        axis: unit vector from the thumb to the fingers.
        approach: unit vector across the axis, from the hand towards what it grips.
    """

    angles_rad: Array
    centre_m: Array
    axis: Array
    approach: Array


def grip_angles(openness: float) -> Array:
    """Return the joint angles of a grip: 0 closed as in a pinch, 1 as wide as it goes."""
    return _CLOSED + openness * (_WIDE - _CLOSED)


def _pads(angles_rad: Array) -> tuple[Array, Array]:
    bones = pose_bones(angles_rad)
    return bones.pad_m(0), np.mean([bones.pad_m(finger) for finger in _GRIP_FINGERS], axis=0)


@functools.cache
def _grip_widths() -> tuple[Array, Array]:
    """Return openness and the width between the pads, for a fine range of grips."""
    openness = np.linspace(0, 1, 41)
    widths = [float(np.linalg.norm(np.subtract(*_pads(grip_angles(share))))) for share in openness]
    return openness, np.array(widths)


def widest_grip_m() -> float:
    """Return the greatest width that a hand of size 1 can grip."""
    return float(_grip_widths()[1][-1])


@functools.lru_cache(maxsize=64)
def grip(width_m: float) -> Grip:
    """Return the grip whose pads are ``width_m`` apart: at least 8 mm, since pads are soft, and as far as the hand gets."""
    width_m = max(width_m, 0.008)
    openness, widths = _grip_widths()
    angles = grip_angles(float(np.interp(width_m, widths, openness)))
    thumb, fingers = _pads(angles)
    centre, axis = (thumb + fingers) / 2, unit(fingers - thumb)
    approach = unit(np.array([1.0, 0, 0]) - axis[0] * axis)
    return Grip(angles, centre, axis, approach)


_CUFF_M = -0.05
_UV_SPAN_M = (-FOREARM_M - 0.05, 0.22)
CUFF_ROW_SHARE = (_CUFF_M - _UV_SPAN_M[0]) / (_UV_SPAN_M[1] - _UV_SPAN_M[0])
"""Where a sleeve ends, as a share of the texture's rows: the first is at the elbow, the last beyond the fingertips."""

# Bone number, radius at its start and at its end.
_FINGER_RADII_M = (
    *((2, 0.0150, 0.0115), (3, 0.0112, 0.0100), (4, 0.0100, 0.0080)),
    *((5, 0.0098, 0.0090), (6, 0.0090, 0.0080), (7, 0.0080, 0.0068)),
    *((8, 0.0100, 0.0092), (9, 0.0092, 0.0082), (10, 0.0082, 0.0070)),
    *((11, 0.0095, 0.0088), (12, 0.0088, 0.0078), (13, 0.0078, 0.0066)),
    *((14, 0.0085, 0.0076), (15, 0.0076, 0.0068), (16, 0.0068, 0.0058)),
)
# How far, in metres, the influence of a bone reaches beyond its own surface: forearm, palm, fingers.
_REACH_M = np.array([0.014, 0.010, *[0.0035] * 15])
_PARENTS = np.array([1, 0, *np.ravel([(1, 2 + 3 * f, 3 + 3 * f) for f in range(5)])])


@dataclass(frozen=True)
class HandSurface:
    """The rest surface.

    Attributes:
        mesh: in metres, not of unit size.
        left_faces: its triangles when it is mirrored.
        weights: ``(V, 17)``, shares of the bones in each vertex.
        joints_m: ``(17, 3)`` where the bones start.
    """

    mesh: UnitMesh
    left_faces: NDArray[np.int64]
    weights: Array
    joints_m: Array


def _cone(points: Array, start: Array, end: Array, r0: float, r1: float) -> Array:
    """Distance to a capsule whose radius goes linearly from one end to the other (exact enough for slender ones)."""
    axis = end - start
    share = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    return np.linalg.norm(points - start - share[:, np.newaxis] * axis, axis=1) - (r0 + (r1 - r0) * share)


def _smooth_union(distances: list[Array], width_m: float) -> Array:
    """Soft minimum; corners between the parts fill up over about ``width_m``."""
    stack = np.stack(distances)
    least = stack.min(axis=0)
    return least - width_m * np.log(np.exp((least - stack) / width_m).sum(axis=0))


def _palm_and_fingers(points: Array) -> list[Array]:
    """Distances to the bones' own surfaces at rest, forearm and palm first."""
    rest = pose_bones(np.zeros((5, 4)))
    flat = points * (1, 1, 1.32)  # a forearm and a wrist are wider than thick
    forearm = _smooth_union(
        [
            _cone(flat, np.array([0.012, 0, 0]), np.array([-0.16, 0, 0]), 0.0255, 0.037),
            _cone(flat, np.array([-0.16, 0, 0]), np.array([-FOREARM_M, 0, 0]), 0.037, 0.046),
        ],
        0.006,
    )
    carpus = np.array([(0.010, 0.013, -0.001), (0.010, 0.004, 0), (0.010, -0.006, 0), (0.010, -0.014, -0.002)])
    palm = [
        _cone(points, carpus[f - 1], rest.starts_m[2 + 3 * f] - (0.004, 0, 0.0015), 0.0145, 0.0112) for f in range(1, 5)
    ]
    palm.append(_cone(points, np.array([0.018, -0.022, -0.008]), np.array([0.062, -0.032, -0.008]), 0.014, 0.012))
    palm.append(_cone(points, np.array([0.020, 0.015, -0.009]), np.array([0.052, 0.026, -0.009]), 0.015, 0.010))
    parts = [forearm, _smooth_union(palm, 0.006)]
    parts += [_cone(points, rest.starts_m[b], rest.ends_m[b], r0, r1) for b, r0, r1 in _FINGER_RADII_M]
    return parts


def _distance(points: Array) -> Array:
    parts = _palm_and_fingers(points)
    hand = _smooth_union([parts[1], *parts[2:]], 0.0022)
    return _smooth_union([hand, parts[0]], 0.006)


def _gradient(points: Array, step: float = 2e-4) -> Array:
    offsets = step * np.eye(3)
    return np.stack([_distance(points + o) - _distance(points - o) for o in offsets], axis=1) / (2 * step)


@functools.cache
def hand_surface() -> HandSurface:
    """Return the rest surface, the same in every process."""
    axes = (  # fine around the fingers, coarse along the arm
        np.concatenate(
            [np.linspace(-FOREARM_M - 0.07, -0.12, 6), np.linspace(-0.085, -0.02, 4), np.arange(0, 0.215, 0.0095)]
        ),
        np.concatenate(
            [np.linspace(-0.078, -0.049, 4)[:-1], np.arange(-0.049, 0.049, 0.0063), np.arange(0.054, 0.112, 0.008)]
        ),
        np.concatenate(
            [np.arange(-0.053, -0.03, 0.008), np.arange(-0.026, 0.021, 0.0068), np.arange(0.026, 0.055, 0.008)]
        ),
    )
    vertices, faces = surface_nets(axes, _distance(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)))
    for _ in range(3):  # the grid is coarse: walk to the surface itself
        slope = _gradient(vertices)
        vertices = vertices - 0.8 * (_distance(vertices) / np.maximum((slope**2).sum(1), 0.25))[:, np.newaxis] * slope
    uv = np.column_stack(
        [vertices[:, 1] / 0.2 + 0.5, (vertices[:, 0] - _UV_SPAN_M[0]) / (_UV_SPAN_M[1] - _UV_SPAN_M[0])]
    )
    mesh = UnitMesh(vertices, unit(_gradient(vertices)), uv, faces)
    return HandSurface(mesh, faces[:, ::-1].copy(), _weights(vertices), pose_bones(np.zeros((5, 4))).starts_m)


def _weights(vertices: Array) -> Array:
    """Share each vertex between its nearest bone and that bone's neighbours in the skeleton."""
    distance = np.maximum(np.stack(_palm_and_fingers(vertices), axis=1), 0)
    nearest = distance.argmin(axis=1)
    related = np.eye(17, dtype=bool)
    related[np.arange(17), _PARENTS] = related[_PARENTS, np.arange(17)] = True
    weights = np.exp(-distance / _REACH_M) * related[nearest]
    return weights / weights.sum(axis=1, keepdims=True)


def surface_nets(axes: tuple[Array, Array, Array], values: Array) -> tuple[Array, NDArray[np.int64]]:
    """Triangulate where a function on a grid changes sign: one vertex for each cell that the surface crosses.

    Args:
        axes: coordinates of the grid along x, y and z, increasing; they need not be even.
        values: the function, negative inside, ``x`` slowest.

    Returns:
        Vertices ``(V, 3)`` and triangles ``(F, 3)``, counter-clockwise seen from outside.
    """
    shape = tuple(len(axis) for axis in axes)
    field = values.reshape(shape)
    inside = field < 0
    cells = tuple(n - 1 for n in shape)
    sums, counts = np.zeros((*cells, 3)), np.zeros(cells)
    crossings = []
    for along in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[along], high[along] = slice(None, -1), slice(1, None)
        a, b = field[tuple(low)], field[tuple(high)]
        index = np.argwhere(inside[tuple(low)] != inside[tuple(high)])
        at = tuple(index.T)
        share = a[at] / (a[at] - b[at])
        points = np.stack([axes[k][index[:, k]] for k in range(3)], axis=1)
        points[:, along] += share * np.diff(axes[along])[index[:, along]]
        others = [k for k in range(3) if k != along]
        for i in (0, 1):
            for j in (0, 1):
                cell = index.copy()
                cell[:, others[0]] -= i
                cell[:, others[1]] -= j
                np.add.at(sums, tuple(cell.T), points)
                np.add.at(counts, tuple(cell.T), 1)
        crossings.append((along, index, inside[tuple(low)][at]))
    number = np.full(cells, -1)
    used = counts > 0
    number[used] = np.arange(used.sum())
    faces = [_quads(number, *crossing) for crossing in crossings]
    return sums[used] / counts[used][:, np.newaxis], np.concatenate(faces)


def _quads(
    number: NDArray[np.int64], along: int, index: NDArray[np.int64], leaving: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Join the four cells around each crossed edge; ``leaving`` where the surface is left in the axis' direction."""
    first, second = (along + 1) % 3, (along + 2) % 3
    corners = []
    for i, j in ((1, 1), (0, 1), (0, 0), (1, 0)):
        cell = index.copy()
        cell[:, first] -= i
        cell[:, second] -= j
        corners.append(number[tuple(cell.T)])
    a, b, c, d = (np.where(leaving, corners[k], corners[(4 - k) % 4]) for k in range(4))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


@dataclass(frozen=True)
class HandLook:
    """What a hand looks like.

    Attributes:
        material: its texture runs from the elbow (first row) to the fingertips, and across the hand.
        size: 1 is an adult's, 0.19 m from wrist to fingertip.
        slim: thickness over that of the model.
        left: whether it is a left hand.
        sleeve_m: how far a sleeve stands off the arm; 0 for a bare one.
    """

    material: Material
    size: float = 1.0
    slim: float = 1.0
    left: bool = False
    sleeve_m: float = 0.0


def posed_hand(look: HandLook, bones: Bones, frame: Array, wrist_m: Array) -> TriangleMesh:
    """Return the hand in a pose, given by the bones of a right hand of size 1, with its wrist at a place in metres.

    Columns of ``frame`` (3, 3) are the hand's x, y and z axes: left-handed axes for a left hand, which mirrors the bones.
    """
    surface = hand_surface()
    rest = surface.mesh.vertices * (1, 1, look.slim)
    if look.sleeve_m:
        cover = np.clip((_CUFF_M + 0.005 - rest[:, :1]) / 0.01, 0, 1)
        rest = rest + look.sleeve_m * cover * surface.mesh.normals
    shifts = bones.starts_m - np.einsum("bij,bj->bi", bones.turns, surface.joints_m)
    blended = np.einsum("vb,bij->vij", surface.weights, bones.turns)
    local = np.einsum("vij,vj->vi", blended, rest) + surface.weights @ shifts
    normals = np.einsum("vij,vj->vi", blended, surface.mesh.normals)
    faces = surface.left_faces if look.left else surface.mesh.faces
    return TriangleMesh(
        vertices_m=wrist_m + look.size * local @ frame.T,
        normals=unit(normals @ frame.T),
        uv=surface.mesh.uv,
        faces=faces,
        material=look.material,
    )
