"""The forward model against a brute-force double sum, its adjoint, its symmetries, torch."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.camera.convolution import StackConvolution
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.types import Clip, Surroundings


def _stack(rng, depths=3, size=(9, 7), dtype=np.float64, depths_m=None):
    values = rng.uniform(size=(depths, 3, *size)).astype(dtype)
    depths_m = np.linspace(0.04, 0.2, depths) if depths_m is None else depths_m
    return PsfStack(values, depths_m, 20e-6, ("R", "G", "B"), "test")


def _brute_force(values, planes, sensor_shape, circular):
    """Every scene pixel adds its PSF, pixel by pixel, at the place that the conventions say."""
    depths, channels, rows, columns = values.shape
    _, _, height, width = planes.shape
    out = np.zeros((channels, *sensor_shape))
    for k in range(depths):
        for i in range(height):
            for j in range(width):
                for a in range(rows):
                    for b in range(columns):
                        r = i + (sensor_shape[0] - height) // 2 + a - rows // 2
                        x = j + (sensor_shape[1] - width) // 2 + b - columns // 2
                        if circular:
                            r, x = r % sensor_shape[0], x % sensor_shape[1]
                        if 0 <= r < sensor_shape[0] and 0 <= x < sensor_shape[1]:
                            out[:, r, x] += values[k, :, a, b] * planes[k, :, i, j]
    return out


INSIDE = [((9, 7), (12, 10), (4, 6)), ((4, 6), (11, 9), (5, 9)), ((21, 18), (8, 7), (4, 3)), ((1, 1), (6, 6), (4, 2))]
BEYOND = [((5, 4), (6, 5), (14, 9)), ((4, 3), (3, 8), (17, 8)), ((1, 1), (4, 4), (8, 2)), ((9, 25), (2, 3), (12, 5))]


@pytest.mark.parametrize(
    ("size", "sensor", "scene", "boundary"),
    [(*shapes, boundary) for boundary in ("linear", "circular") for shapes in INSIDE]
    + [(*shapes, "linear") for shapes in BEYOND],
)
def test_convolution_equals_the_double_sum(size, sensor, scene, boundary):
    """For small, even and wide PSFs and single pixels, and for scenes with a margin beyond the sensor."""
    rng = np.random.default_rng(1)
    values, planes = rng.normal(size=(2, 3, *size)), rng.normal(size=(2, 3, *scene))
    model = StackConvolution(values, sensor, scene, boundary)
    reference = _brute_force(values, planes, sensor, boundary == "circular")
    np.testing.assert_allclose(model.forward(planes), reference, atol=1e-11)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(1, 24),
    st.integers(1, 24),
    st.integers(1, 12),
    st.integers(0, 8),
    st.integers(0, 8),
    st.sampled_from(["linear", "circular"]),
)
def test_adjoint_is_the_transpose_to_rounding(rows, columns, side, extra_rows, extra_columns, boundary):
    inner, outer = (side, side), (side + 2 * extra_rows, side + 2 * extra_columns)
    _check_adjoint((rows, columns), outer, inner, boundary)
    if boundary == "linear":
        _check_adjoint((rows, columns), inner, outer, boundary)  # a scene with margins beyond the sensor


def _check_adjoint(size, sensor_shape, scene_shape, boundary):
    rng = np.random.default_rng(0)
    for dtype, tolerance in ((np.float64, 1e-12), (np.float32, 1e-5)):
        model = ForwardModel(_stack(rng, 2, size, dtype), sensor_shape, scene_shape, boundary=boundary)
        volume = rng.normal(size=(1, 2, 3, *scene_shape)).astype(dtype)
        image = rng.normal(size=(3, *sensor_shape)).astype(dtype)
        forward, backward = model.forward(volume), model.adjoint(image)
        products = [
            np.vdot(a.astype(np.float64), b.astype(np.float64)) for a, b in ((forward, image), (volume, backward))
        ]
        assert abs(products[0] - products[1]) <= tolerance * np.linalg.norm(forward) * np.linalg.norm(image)


def _clip(rgb, depth_m, edges=(0.0, 1.0)):
    frames = len(rgb)
    depth = np.broadcast_to(np.asarray(depth_m, np.float32), rgb.shape[:3]).copy()
    return Clip(rgb.astype(np.float32), depth, np.ones((frames, *rgb.shape[1:3]), bool), np.asarray(edges, np.float64))


def test_clip_at_a_plane_uses_that_plane_and_between_planes_mixes_in_disparity():
    rng = np.random.default_rng(0)
    depths_m = np.array([0.05, 0.1, 0.2])
    stack = _stack(rng, 3, dtype=np.float32, depths_m=depths_m)
    model = ForwardModel(stack, (12, 12), (4, 4))
    rgb = rng.uniform(size=(1, 4, 4, 3))

    def single(k, light):
        volume = np.zeros((1, 3, 3, 4, 4), np.float32)
        volume[0, k] = np.moveaxis(light[0], -1, 0)
        return model.forward(volume)

    for k, depth in enumerate(depths_m):
        np.testing.assert_allclose(model.forward_clip(_clip(rgb, depth)), single(k, rgb), rtol=2e-5, atol=1e-5)
    disparity = 0.3 / 0.05 + 0.7 / 0.1
    between = model.forward_clip(_clip(rgb, 1 / disparity))
    np.testing.assert_allclose(between, single(0, 0.3 * rgb) + single(1, 0.7 * rgb), rtol=2e-5, atol=1e-5)
    nearest = ForwardModel(stack, (12, 12), (4, 4), depth_rule=DepthRule("nearest"))
    np.testing.assert_allclose(nearest.forward_clip(_clip(rgb, 1 / disparity)), single(1, rgb), rtol=2e-5, atol=1e-5)


def test_infinite_depth_is_a_plane():
    rng = np.random.default_rng(0)
    stack = _stack(rng, 2, dtype=np.float32, depths_m=np.array([0.1, np.inf]))
    model = ForwardModel(stack, (12, 12), (4, 4))
    rgb = rng.uniform(size=(1, 4, 4, 3))
    for depth, weights in ((np.inf, (0, 1)), (0.2, (0.5, 0.5))):
        volume = np.stack([w * np.moveaxis(rgb[0], -1, 0) for w in weights])[None].astype(np.float32)
        np.testing.assert_allclose(model.forward_clip(_clip(rgb, depth)), model.forward(volume), rtol=1e-5, atol=1e-5)


def test_depths_outside_the_planes_are_refused_unless_allowed():
    rng = np.random.default_rng(0)
    stack = _stack(rng, 3, dtype=np.float32)
    clip = _clip(rng.uniform(size=(1, 4, 4, 3)), 0.02)
    with pytest.raises(InputError, match=r"^clip: "):
        ForwardModel(stack, (12, 12), (4, 4)).forward_clip(clip)
    ForwardModel(stack, (12, 12), (4, 4), depth_rule=DepthRule(max_clamped=1.0)).forward_clip(clip)


def test_light_beside_the_image_counts_where_it_is_clamped():
    """By its brightness and the irradiance of its direction, in image and surroundings; a single plane clamps nothing."""
    rng = np.random.default_rng(0)
    irradiance = rng.uniform(size=(8, 8)).astype(np.float32)
    light, depth = np.zeros((1, 2, 2, 3), np.float32), np.full((1, 2, 2), 0.1, np.float32)
    light[0, 0, 0], light[0, 0, 1], depth[0, 0, 1] = 1, (2, 3, 4), 0.5  # as seen: a quarter of the field each
    image = np.full((1, 4, 4, 3), 0.25)
    clip = replace(_clip(image, 0.1), surroundings=Surroundings(light, depth, 4))
    clip.depth_m[0, 3, 3] = 0.01
    field = np.zeros((8, 8))
    field[:4, :4], field[:4, 4:] = 3, 9
    field[2:6, 2:6] = 0.75
    clamped = np.zeros((8, 8), bool)
    clamped[:4, 4:], clamped[2:6, 2:6], clamped[5, 5] = True, False, True
    expected = (field * irradiance)[clamped].sum() / (field * irradiance).sum()
    stack = _stack(rng, 3, dtype=np.float32)
    share = ForwardModel(stack, (12, 12), (8, 8), irradiance=irradiance).clamped_light(clip)
    assert share == pytest.approx(expected, rel=1e-5)  # sums in float32
    assert ForwardModel(_stack(rng, 1), (12, 12), (8, 8)).clamped_light(clip) == 0


@pytest.mark.parametrize(
    ("key", "use"),
    [
        ("scene_shape", lambda model: model((5, 4))),
        ("scene_shape", lambda model: model((14, 4), boundary="circular")),
        ("boundary", lambda model: model(boundary="mirror")),
        ("volume", lambda model: model().forward(np.zeros((1, 3, 3, 4, 4)))),
        ("volume", lambda model: model().forward(np.zeros((2, 2, 3, 4, 4)))),
        ("image", lambda model: model().adjoint(np.zeros((3, 4, 4)))),
    ],
)
def test_bad_shapes_name_the_argument(key, use):
    stack = _stack(np.random.default_rng(0), 2)
    with pytest.raises(InputError, match=rf"^{key}: "):
        use(lambda scene=(4, 4), **options: ForwardModel(stack, (12, 12), scene, **options))
