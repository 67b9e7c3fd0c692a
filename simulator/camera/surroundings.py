"""What shines beside a clip's image: frames of the whole field, and surroundings for images that come without."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.types import FARTHEST_M, Clip, Surroundings, View

BLACK, CONTINUE, OWN = WORDS = ("black", "continue", "own")
"""What may stand in an image's place."""


def whole_frames(clip: Clip, field_shape: tuple[int, int]) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Yield light ``(H, W, 3)`` and depth ``(H, W)`` of each frame over a field: the image amid its surroundings.

    Raises:
        InputError: the clip's image and surroundings do not make a field of this shape.
    """
    around, image_shape = clip.surroundings, clip.rgb.shape[1:3]
    if around is None or image_shape == tuple(field_shape):
        if image_shape != tuple(field_shape):
            raise InputError(
                "clip",
                f"its frames are {image_shape} without surroundings, but the model was made for a field of "
                f"{tuple(field_shape)}; simulator.camera.surroundings.surrounded adds them",
            )
        yield from zip(clip.rgb, clip.depth_m, strict=True)
        return
    spanned = tuple(size * around.coarseness for size in around.rgb.shape[1:3])
    for inner, outer in ((image_shape, field_shape), (field_shape, spanned)):
        if any(small > large or (large - small) % 2 for small, large in zip(inner, outer, strict=True)):
            raise InputError(
                "clip",
                f"its frames are {image_shape} in surroundings of {spanned}, but the model was made for a field of "
                f"{tuple(field_shape)}",
            )
    kept, image = _middle(spanned, field_shape), _middle(field_shape, image_shape)
    for number, (rgb, depth_m) in enumerate(zip(clip.rgb, clip.depth_m, strict=True)):
        coarse = number % len(around.rgb)
        light, depth = (
            values.repeat(around.coarseness, axis=0).repeat(around.coarseness, axis=1)[kept]
            for values in (around.rgb[coarse], around.depth_m[coarse])
        )
        light[image], depth[image] = rgb, depth_m
        yield light, depth


def _middle(outer: tuple[int, ...], inner: tuple[int, ...]) -> tuple[slice, ...]:
    return tuple(slice((large - small) // 2, (large + small) // 2) for large, small in zip(outer, inner, strict=True))


def surrounded(clip: Clip, view: View, rule: str | NDArray[np.float32] | None) -> Clip:
    """Return a clip with surroundings for a view with a margin; one that brings its own, or needs none, stays as it is.

    Args:
        clip: images of the view's shape.
        view: with the margin.
        rule: ``black``: nothing shines beside the image; ``continue``: the image goes on mirrored, again and again, at its
            own depths; ``own``: what the clip brings, as without a rule; or an image of the whole field, linear RGB
            ``(h, w, 3)`` of `View.coarse_field`'s shape, at the far depth.

    Raises:
        InputError: there is no rule and the clip has no surroundings, or there are both.
    """
    if view.margin == (0, 0):
        return clip
    if clip.surroundings is not None:
        if rule is not None and not _is(rule, OWN):
            text = "given, but these scenes know what is beside their images; leave it out"
            raise InputError("scene.surroundings", text)
        return clip
    coarse, coarseness = view.coarse_field
    far_m = min(view.far_m, FARTHEST_M)
    if rule is None or _is(rule, OWN):
        raise InputError(
            "scene.surroundings",
            f"{'missing' if rule is None else 'got own'}, and these scenes say nothing of what is beside their images, for "
            "which scene.margin asks; expected black, continue (the image goes on, mirrored) or an image file, or leave "
            "scene.margin out",
        )
    if _is(rule, CONTINUE):
        frames = [_continued(*frame, coarse.shape, coarseness) for frame in zip(clip.rgb, clip.depth_m, strict=True)]
        light, depth = zip(*frames, strict=True)
        around = Surroundings(np.stack(light), np.stack(depth), coarseness)
    else:
        light = np.zeros((*coarse.shape, 3), np.float32) if isinstance(rule, str) else rule
        around = Surroundings(light[None], np.full((1, *coarse.shape), far_m, np.float32), coarseness)
    return replace(clip, surroundings=around)


def _is(rule: str | NDArray[np.float32], word: str) -> bool:
    return isinstance(rule, str) and rule == word


def _continued(
    rgb: NDArray[np.float32], depth_m: NDArray[np.float32], shape: tuple[int, int], coarseness: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a frame that goes on mirrored: the mean light over coarse pixels, and the depth in the middle of each."""
    margins = [((coarseness * size - image) // 2,) * 2 for size, image in zip(shape, depth_m.shape, strict=True)]
    light = np.pad(rgb, [*margins, (0, 0)], mode="symmetric")
    light = light.reshape(shape[0], coarseness, shape[1], coarseness, 3).mean(axis=(1, 3))
    middle = slice(coarseness // 2, None, coarseness)
    return light, np.pad(depth_m, margins, mode="symmetric")[middle, middle]
