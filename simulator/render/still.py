"""One picture of a scene with its depth, as a Clip of a single frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import activate
from simulator.render.gbuffer import centre_depth
from simulator.render.mitsuba_scene import load_scene
from simulator.render.scene import Scene
from simulator.types import FARTHEST_M, Clip, View

# Light paths of camera - surface - ... - light: enough for light to fill the shadows of a crowded scene.
DEFAULT_MAX_DEPTH = 5
# More broken pixels than this mean a broken scene, not a path tracer's rare accident.
_MAX_BROKEN_SHARE = 1e-3


def render_still(
    scene: Scene,
    view: View,
    *,
    samples_per_pixel: int,
    seed: int,
    backend: str,
    source: dict[str, Any],
    label: str | None = None,
    max_depth: int = DEFAULT_MAX_DEPTH,
) -> Clip:
    """Render a scene through the pinhole of a view: linear RGB by path tracing, depth by centre rays.

    The same arguments give the same bytes, whatever the number of threads and the scenes rendered before.

    Args:
        scene: shapes and lights, metres.
        view: image shape, pinhole geometry and depth range.
        samples_per_pixel: light paths per pixel, at least 1; a number that is not close to a x b with a and b near its
            root is rounded up (7 to 8), and what was used is recorded.
        seed: of the path tracer, 0 <= seed < 2**32; draw it from the sample's generator.
        backend: the Mitsuba variant, see `simulator.render.choose_backend`.
        source: where the scene came from, JSON-serialisable; seed, samples, variant and the number of repaired pixels
            are added to it.
        label: class name of an action, or None.
        max_depth: longest light path, in segments.

    Returns:
        A clip of one frame that lasts from 0 to 1 s. Where no surface is seen ``valid`` is false and the depth is the
        view's far depth (`FARTHEST_M` if that is infinite: a depth is never inf).

    Raises:
        InputError: when the samples or the seed are out of range.
        RuntimeError: when more than 0.1 % of the pixels are not finite.
    """
    if samples_per_pixel < 1:
        msg = f"samples_per_pixel: got {samples_per_pixel}, expected at least 1"
        raise InputError(msg)
    if not 0 <= seed < 2**32:
        msg = f"seed: got {seed}, expected 0 <= seed < 2**32"
        raise InputError(msg)
    activate(backend)
    rgb, z, samples = _trace(scene, view, samples_per_pixel, seed, max_depth)
    rgb, repaired = repair(rgb)
    valid = np.isfinite(z)
    limit = min(view.far_m, FARTHEST_M)
    depth = np.where(valid, z, limit).astype(np.float32)
    facts = {"samples_per_pixel": samples, "render_seed": seed, "variant": backend, "repaired_pixels": repaired}
    return Clip(
        rgb=rgb[np.newaxis],
        depth_m=depth[np.newaxis],
        valid=valid[np.newaxis],
        frame_edges_s=np.array([0.0, 1.0]),
        label=label,
        source=source | facts,
    )


def _trace(
    scene: Scene, view: View, samples_per_pixel: int, seed: int, max_depth: int
) -> tuple[NDArray[np.float32], NDArray[np.float64], int]:
    """Render in a function of its own: on return no Mitsuba object is left, else the next scene would recompile."""
    import mitsuba as mi

    loaded = load_scene(scene, view, max_depth)
    image = mi.render(loaded, spp=samples_per_pixel, seed=seed)  # pyright: ignore[reportArgumentType] (stubs know no int)
    samples = int(loaded.sensors()[0].sampler().sample_count())
    return np.array(image, dtype=np.float32), centre_depth(loaded), samples


def repair(rgb: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """Replace pixels that are not finite or are negative by the median of their sound neighbours.

    A path tracer divides by probabilities and now and then yields a NaN; one such pixel would spread over the whole
    measurement. Bright pixels are left alone: clamping them would bias the light.

    Args:
        rgb: ``(H, W, 3)``.

    Returns:
        The repaired picture and the number of pixels that were replaced.

    Raises:
        RuntimeError: when more than 0.1 % of the pixels (and more than one) are broken.
    """
    broken = ~np.all(np.isfinite(rgb) & (rgb >= 0), axis=-1)
    count = int(np.count_nonzero(broken))
    if count == 0:
        return rgb, 0
    if count > max(1, _MAX_BROKEN_SHARE * broken.size):
        msg = f"{count} of {broken.size} rendered pixels are not finite or negative: the scene holds broken values"
        raise RuntimeError(msg)
    repaired = rgb.copy()
    for row, column in np.argwhere(broken):
        window = (slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
        sound = rgb[window][~broken[window]]
        repaired[row, column] = np.median(sound, axis=0) if len(sound) else 0.0
    return repaired, count
