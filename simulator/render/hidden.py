"""The surfaces behind those that are seen, by peeling: a ray is sent on until it meets the front of another shape.

A coded mask looks around the edges of near objects: what a pinhole does not see may still light the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.backend import drjit, mitsuba
from simulator.render.gbuffer import NOTHING, centre_rays, film_shape, is_scalar, order_by_id, order_by_registry
from simulator.render.mitsuba_scene import UNITS_PER_M, path_tracer
from simulator.render.scene import Scene, TriangleMesh

# A ray that has crossed this many surfaces without finding another shape sees nothing more.
_MOST_SURFACES = 64
# A second hit of the same shape no further than this is the same place, met once more at an edge between triangles.
_CLEARANCE = 1 + 1e-3


@dataclass(frozen=True)
class HiddenLayer:
    """One layer behind the image.

    Attributes:
        rgb: ``(H, W, 3)`` float32, linear radiance towards the camera if nothing stood before it; zero where there is none.
        depth_m: ``(H, W)`` float64, z of its surface; ``inf`` where there is none.
    """

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float64]


@dataclass(frozen=True)
class _Paths:
    """How the light of a layer is traced: Mitsuba's integrator and sampler, paths per pixel, seed."""

    integrator: Any
    sampler: Any
    samples: int
    seed: int


def hidden_layers(
    loaded: Any, scene: Scene, layers: int, *, samples: int, seed: int, max_depth: int
) -> list[HiddenLayer]:
    """Return the layers behind what each pixel's centre sees, nearest first.

    The next layer is the next surface that faces the camera, be it of another shape or of the same one further on (the far
    side of a ring, the wall behind a fold). Backs do not count, for they are inside of something, unless they are another
    shape's that is open, such as a sheet of paper. All samples of a pixel go through its centre, so that colour and depth
    belong to the same surface.
    ``loaded`` is the ``mitsuba.Scene`` of ``scene``; each pixel of a layer gets ``samples`` light paths of at most
    ``max_depth`` segments.
    """
    mi = mitsuba()
    open_shapes = {number for number, shape in enumerate(scene.shapes) if is_open(shape)}
    integrator = mi.load_dict(path_tracer(max_depth, scene.hide_lights))
    paths = _Paths(integrator, mi.load_dict({"type": "independent"}), samples, seed)
    peel = _peel_one_by_one if is_scalar() else _peel_all
    found = peel(loaded, open_shapes, layers, paths)
    rows, columns = film_shape(loaded)
    result = []
    for rgb, z, shape_id in found:
        valid = shape_id != NOTHING
        depth = np.where(valid, z / UNITS_PER_M, np.inf).reshape(rows, columns)
        light = np.where(valid[:, np.newaxis], rgb, 0).astype(np.float32).reshape(rows, columns, 3)
        result.append(HiddenLayer(light, depth))
    return result


def is_open(shape: object) -> bool:
    """Whether a surface has an edge, like a sheet of paper: one may look at the back of it."""
    if not isinstance(shape, TriangleMesh):
        return False
    # Seams have two vertices at one place; rounding to a millionth of the size brings them together.
    vertices = shape.vertices_m - shape.vertices_m.min(axis=0)
    size = vertices.max() or 1.0
    _, place = np.unique(np.round(vertices / size * 1e6), axis=0, return_inverse=True)
    corners = place.ravel()[shape.faces]
    edges = np.sort(np.concatenate([corners[:, (0, 1)], corners[:, (1, 2)], corners[:, (2, 0)]]), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]  # of triangles without area
    _, uses = np.unique(edges, axis=0, return_counts=True)
    return bool(np.any(uses % 2))


def _peel_all(loaded: Any, open_shapes: set[int], layers: int, paths: _Paths) -> list[tuple[NDArray[Any], ...]]:
    dr, mi = drjit(), mitsuba()
    order = order_by_registry(loaded)
    opened = mi.Bool(np.isin(order, list(open_shapes)))
    ray = mi.Ray3f(centre_rays(loaded))
    hit = loaded.ray_intersect(ray)
    current, current_z, active = dr.reinterpret_array(mi.UInt32, hit.shape), mi.Float(hit.p.z), hit.is_valid()
    result = []
    for layer in range(layers):
        layer_shape, layer_z = dr.zeros(mi.UInt32, dr.width(ray)), dr.zeros(mi.Float, dr.width(ray))
        layer_start, layer_found = dr.zeros(mi.Point3f, dr.width(ray)), dr.zeros(mi.Bool, dr.width(ray))
        searching = mi.Bool(active)
        for _ in range(_MOST_SURFACES):
            following = loaded.ray_intersect(mi.Ray3f(hit.p + ray.d * _step(hit.p.z), ray.d), searching)
            shape = dr.reinterpret_array(mi.UInt32, following.shape)
            searching &= following.is_valid()
            other = shape != current
            front = (dr.dot(following.n, ray.d) < 0) & (other | (following.p.z > _CLEARANCE * current_z))
            reached = searching & (front | (other & dr.gather(mi.Bool, opened, shape, searching)))
            layer_shape = dr.select(reached, shape, layer_shape)
            back = dr.minimum(_step_back(following.p.z), following.t / 2)
            layer_start = dr.select(reached, following.p - ray.d * back, layer_start)
            layer_z = dr.select(reached, following.p.z, layer_z)
            layer_found |= reached
            hit = dr.select(searching, following, hit)
            searching &= ~reached
            dr.eval(hit, searching, layer_shape, layer_start, layer_z, layer_found)
            if not dr.any(searching):
                break
        current, current_z, active = layer_shape, layer_z, layer_found
        rgb = _shade_all(loaded, ray.d, layer_start, layer_found, paths, layer)
        numbered = np.where(np.array(layer_found), order[np.array(layer_shape)], NOTHING)
        result.append((rgb, np.array(layer_z, dtype=np.float64), numbered))
    return result


def _shade_all(loaded: Any, direction: Any, start: Any, found: Any, paths: _Paths, layer: int) -> NDArray[np.float32]:
    """Trace the light of the pixels that have something in this layer, from a point just before it.

    The others take part as idle lanes: every number of rays would be compiled as a kernel of its own.
    """
    dr, mi = drjit(), mitsuba()
    count, samples = dr.width(direction), paths.samples
    # Opaque, for every seed would be a constant of another kernel.
    paths.sampler.seed(dr.opaque(mi.UInt32, (paths.seed + layer) % 2**32), count * samples)
    pixel = dr.arange(mi.UInt32, count * samples) // samples
    towards, begin = dr.gather(mi.Vector3f, direction, pixel), dr.gather(mi.Point3f, start, pixel)
    ray, active = mi.RayDifferential3f(mi.Ray3f(begin, towards)), dr.gather(mi.Bool, found, pixel)
    radiance, _, _ = paths.integrator.sample(loaded, paths.sampler, ray, active=active)
    radiance = dr.select(active, radiance, 0)
    return np.array(radiance, dtype=np.float64).T.reshape(count, samples, 3).mean(axis=1).astype(np.float32)


def _step_back(z: Any) -> Any:
    """How far before a surface the path to it begins, in Mitsuba's units, unless another surface is nearer.

    With 1e-4 Embree, which culls packets of coherent rays together, loses some of those that start at a flat wall.
    """
    return 1e-3 * z


def _step(z: Any) -> Any:
    """How far behind a surface the ray goes on, in Mitsuba's units: a hundred times float32's rounding.

    Along the ray itself: Mitsuba's own ``spawn_ray`` steps along the normal, which shifts the ray sideways by 10 um and the
    depth of a slanted surface behind by 1e-4.
    """
    return 1e-5 * z


def _moved(point: Any, direction: Any, distance: float) -> Any:
    """Return a point further along a direction, in a scalar variant."""
    return mitsuba().Point3f(np.array(point) + np.array(direction) * distance)


def _peel_one_by_one(loaded: Any, open_shapes: set[int], layers: int, paths: _Paths) -> list[tuple[NDArray[Any], ...]]:
    mi = mitsuba()
    order = order_by_id(loaded)
    rows, columns = film_shape(loaded)
    count = rows * columns
    rgb, z = np.zeros((layers, count, 3), np.float32), np.full((layers, count), np.inf)
    ids = np.full((layers, count), NOTHING)
    paths.sampler.seed(paths.seed, 1)
    for pixel, ray in enumerate(centre_rays(loaded)):
        hit = loaded.ray_intersect(ray)
        for layer in range(layers):
            if not hit.is_valid():
                break
            current, current_z = hit.shape.id(), hit.p.z
            for _ in range(_MOST_SURFACES):
                hit = loaded.ray_intersect(mi.Ray3f(_moved(hit.p, ray.d, _step(hit.p.z)), ray.d))
                if not hit.is_valid():
                    break
                other = hit.shape.id() != current
                front = np.dot(np.array(hit.n), np.array(ray.d)) < 0 and (other or hit.p.z > _CLEARANCE * current_z)
                if front or (other and order[hit.shape.id()] in open_shapes):
                    break
            else:
                break
            if not hit.is_valid():
                break
            ids[layer, pixel], z[layer, pixel] = order[hit.shape.id()], hit.p.z
            start = _moved(hit.p, ray.d, -min(_step_back(hit.p.z), hit.t / 2))
            towards = mi.RayDifferential3f(mi.Ray3f(start, ray.d))
            light = [np.array(paths.integrator.sample(loaded, paths.sampler, towards)[0]) for _ in range(paths.samples)]
            rgb[layer, pixel] = np.mean(light, axis=0)
    return list(zip(rgb, z, ids, strict=True))
