"""The forward model against a brute-force double sum, its adjoint, its symmetries, torch."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.camera.convolution import StackConvolution
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.camera.shutter import GlobalShutter
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.types import Clip


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


@pytest.mark.parametrize("circular", [False, True])
@pytest.mark.parametrize(
    ("size", "sensor", "scene"),
    [((9, 7), (12, 10), (4, 6)), ((4, 6), (11, 9), (5, 9)), ((21, 18), (8, 7), (4, 3)), ((1, 1), (6, 6), (4, 2))],
    ids=["small PSF", "even PSF", "PSF wider than the sensor", "one pixel"],
)
def test_convolution_equals_the_double_sum(size, sensor, scene, circular):
    rng = np.random.default_rng(1)
    values, planes = rng.normal(size=(2, 3, *size)), rng.normal(size=(2, 3, *scene))
    model = StackConvolution(values, sensor, scene, "circular" if circular else "linear")
    truth = _brute_force(values, planes, sensor, circular)
    np.testing.assert_allclose(model.forward(planes), truth, atol=1e-11)


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
    rng = np.random.default_rng(0)
    stack = _stack(rng, 2, (rows, columns))
    model = ForwardModel(stack, (side + 2 * extra_rows, side + 2 * extra_columns), (side, side), boundary=boundary)
    volume, image = rng.normal(size=(1, 2, 3, side, side)), rng.normal(size=(3, *model.sensor_shape))
    forward, backward = np.vdot(model.forward(volume), image), np.vdot(volume, model.adjoint(image))
    scale = np.linalg.norm(model.forward(volume)) * np.linalg.norm(image)
    assert abs(forward - backward) <= 1e-12 * scale


def test_adjoint_in_float32():
    rng = np.random.default_rng(0)
    model = ForwardModel(_stack(rng, 3, (31, 33), np.float32), (40, 44), (20, 22))
    volume = rng.normal(size=(1, 3, 3, 20, 22)).astype(np.float32)
    image = rng.normal(size=(3, 40, 44)).astype(np.float32)
    forward, backward = np.vdot(model.forward(volume), image), np.vdot(volume, model.adjoint(image))
    scale = np.linalg.norm(model.forward(volume)) * np.linalg.norm(image)
    assert model.forward(volume).dtype == np.float32
    assert abs(forward - backward) <= 1e-5 * scale


def test_shift_equivariance():
    """A scene moved by whole pixels moves the picture, as far as the sensor sees both."""
    rng = np.random.default_rng(0)
    model = ForwardModel(_stack(rng, 1), (40, 40), (16, 16))
    scene = np.zeros((1, 1, 3, 16, 16))
    scene[..., 4:8, 5:9] = rng.uniform(size=(4, 4))
    moved = np.roll(scene, (3, -2), (-2, -1))
    np.testing.assert_allclose(model.forward(moved), np.roll(model.forward(scene), (3, -2), (-2, -1)), atol=1e-12)


def test_depths_go_to_their_own_psf():
    rng = np.random.default_rng(0)
    stack = _stack(rng, 3)
    model = ForwardModel(stack, (12, 12), (4, 4))
    volume = np.zeros((1, 3, 3, 4, 4))
    volume[0, 2, 1, 0, 3] = 2.0
    image = model.forward(volume)
    # Scene (0, 3) lies under sensor (4, 7); the PSF's origin (4, 3) of its 9 x 7 samples lands there.
    np.testing.assert_allclose(image[1, 0:9, 4:11], 2 * stack.values[2, 1], atol=1e-12)
    assert np.abs(image[[0, 2]]).max() < 1e-12


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


def test_frames_are_weighted_by_the_time_that_the_shutter_sees():
    """Three frames of 4, 2 and 4 ms under an exposure of 5 ms: 4, 1 and 0 ms."""
    rng = np.random.default_rng(0)
    stack = _stack(rng, 1)
    edges = np.array([0, 4e-3, 6e-3, 10e-3])
    model = ForwardModel(stack, (12, 12), (4, 4), GlobalShutter(5e-3))
    volume = rng.uniform(size=(3, 1, 3, 4, 4))
    plain = ForwardModel(stack, (12, 12), (4, 4))
    expected = 4e-3 * plain.forward(volume[:1]) + 1e-3 * plain.forward(volume[1:2])
    np.testing.assert_allclose(model.forward(volume, edges), expected, atol=1e-14 * expected.max())
    image = rng.normal(size=(3, 12, 12))
    assert np.vdot(model.forward(volume, edges), image) == pytest.approx(np.vdot(volume, model.adjoint(image, edges)))
    with pytest.raises(InputError, match="lasts"):
        GlobalShutter(20e-3).weights(4, edges)


def test_torch_equals_numpy_and_carries_gradients():
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(0)
    stack = _stack(rng, 3, (31, 33), np.float32)
    tensors = PsfStack(torch.from_numpy(stack.values), stack.depths_m, stack.pixel_pitch_m, stack.channels, "test")
    volume, image = (
        rng.uniform(size=(1, 3, 3, 20, 22)).astype(np.float32),
        rng.uniform(size=(3, 40, 44)).astype(np.float32),
    )
    ours, theirs = (ForwardModel(s, (40, 44), (20, 22)) for s in (stack, tensors))
    # Two float32 FFTs of 2e3 samples: rounding of a few 1e-7 relative to the largest value.
    y, x = ours.forward(volume), ours.adjoint(image)
    np.testing.assert_allclose(theirs.forward(torch.from_numpy(volume)).numpy(), y, atol=1e-6 * y.max())
    np.testing.assert_allclose(theirs.adjoint(torch.from_numpy(image)).numpy(), x, atol=1e-6 * x.max())

    double = PsfStack(
        torch.from_numpy(rng.uniform(size=(2, 1, 5, 5))).requires_grad_(), np.array([0.1, 0.2]), 2e-5, ("Y",), "test"
    )
    light = torch.from_numpy(rng.uniform(size=(1, 2, 1, 4, 4))).requires_grad_()

    def measure(values, light):
        model = ForwardModel(PsfStack(values, double.depths_m, 2e-5, ("Y",), "test"), (6, 6), (4, 4))
        return model.forward(light)

    assert torch.autograd.gradcheck(measure, (double.values, light))  # finite differences in float64


def test_bad_shapes_name_the_argument():
    rng = np.random.default_rng(0)
    stack = _stack(rng, 2)
    for scene, message in (((5, 4), "even or odd"), ((14, 4), "at most as large")):
        with pytest.raises(InputError, match=message):
            ForwardModel(stack, (12, 12), scene)
    with pytest.raises(InputError, match=r"^boundary: "):
        ForwardModel(stack, (12, 12), (4, 4), boundary="mirror")
    model = ForwardModel(stack, (12, 12), (4, 4))
    with pytest.raises(InputError, match=r"^volume: "):
        model.forward(np.zeros((1, 3, 3, 4, 4)))
    with pytest.raises(InputError, match=r"^image: "):
        model.adjoint(np.zeros((3, 4, 4)))
    with pytest.raises(InputError, match=r"^volume: "):
        model.forward(np.zeros((2, 2, 3, 4, 4)))
