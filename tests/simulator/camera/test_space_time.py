"""The forward model over time against the brute-force double sum, its identities, its adjoint, torch, its memory.

Relative tolerances are those of double or single precision sums of some thousand terms, unless a line says more.
"""

import tracemalloc
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import convolve2d

from simulator.camera.forward import ForwardModel
from simulator.camera.planes import split_planes
from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, RowShutter, Shutter
from simulator.camera.slivers import exposed_part, sliver_edges, sliver_means, split_measurement
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.types import Clip, Surroundings

SENSOR, SCENE = (24, 18), (10, 8)
LINE_S, OPEN_S, FRAME_S = 1e-4, 6e-4, 2.5e-4
SHUTTERS = {
    "global": GlobalShutter(2.3e-3),
    "rolling": RollingShutter(OPEN_S, LINE_S),
    "rolling up": RollingShutter(OPEN_S, LINE_S, "up"),
    "dual": DualRollingShutter(OPEN_S, 2 * LINE_S),
    "dual centre out, binned": DualRollingShutter(OPEN_S, LINE_S, "centre_out", binning=2),
    "rows": RowShutter(np.sort(np.random.default_rng(3).uniform(0, 3e-3, (SENSOR[0], 2)), axis=1)),
}
shutters = pytest.mark.parametrize("shutter", SHUTTERS.values(), ids=SHUTTERS.keys())


def _stack(depths=3, dtype=np.float64, seed=0):
    values = np.random.default_rng(seed).uniform(size=(depths, 3, 9, 7)).astype(dtype)
    return PsfStack(values, np.linspace(0.04, 0.2, depths), 20e-6, ("R", "G", "B"), "test")


def _edges(shutter: Shutter, frame_s=FRAME_S):
    """Edges of frames that cover the shutter, not all of one length."""
    edges = np.arange(int(shutter.duration_s(SENSOR[0]) / frame_s) + 2) * frame_s
    edges[1:-1] += 0.3 * frame_s * np.sin(np.arange(1, len(edges) - 1))
    return edges


def _clip(frames, seed=5, frame_s=FRAME_S):
    rng = np.random.default_rng(seed)
    shape = (frames, *SCENE)
    return Clip(
        rng.uniform(size=(*shape, 3)).astype(np.float32),
        rng.uniform(0.04, 0.2, shape).astype(np.float32),
        np.ones(shape, bool),
        np.arange(frames + 1) * frame_s,
    )


def _open_share(shutter: Shutter, row: int, begin: float, end: float) -> float:
    """Mean over the physical rows behind a stored row of the share of begin..end in which they are open, row by row."""
    shares = []
    for opening, closing in shutter.windows_s(SENSOR[0])[row]:
        shares.append(max(0.0, min(end, closing) - max(begin, opening)) / (end - begin))
    return sum(shares) / len(shares)


def _double_sum(stack, shutter, volume, edges):
    """sum_t dt_t S[t, r] sum_k (H (*) V)[r, x] by direct convolution of every frame and plane, and loops over rows."""
    height, width = SENSOR
    total = np.zeros((3, height, width))
    for frame, begin, end in zip(volume, edges[:-1], edges[1:], strict=True):
        image = np.zeros((3, height, width))
        for psf, plane in zip(stack.values, frame, strict=True):
            for c in range(3):
                placed = np.zeros(SENSOR)
                top, left = (height - SCENE[0]) // 2, (width - SCENE[1]) // 2
                placed[top : top + SCENE[0], left : left + SCENE[1]] = plane[c]
                image[c] += convolve2d(placed, psf[c], mode="same")  # of an odd kernel: centred on its middle
        for stored in range(height):
            physical = height - 1 - stored
            total[:, stored] += (end - begin) * _open_share(shutter, physical, begin, end) * image[:, stored]
    return total


@shutters
@pytest.mark.parametrize("depths", [1, 3], ids=["2D", "moving 3D"])
def test_equals_the_double_sum_over_frames_and_planes(shutter, depths):
    stack, edges = _stack(depths), _edges(shutter)
    volume = np.random.default_rng(1).uniform(size=(len(edges) - 1, depths, 3, *SCENE))
    reference = _double_sum(stack, shutter, volume, edges)
    found = ForwardModel(stack, SENSOR, SCENE, shutter).forward(volume, edges)
    np.testing.assert_allclose(found, reference, atol=1e-13 * reference.max())


@shutters
def test_a_static_scene_gives_the_global_measurement_scaled_by_each_rows_exposure(shutter):
    stack, edges = _stack(), _edges(shutter)
    scene = np.random.default_rng(1).uniform(size=(1, 3, 3, *SCENE))
    moving = ForwardModel(stack, SENSOR, SCENE, shutter).forward(np.repeat(scene, len(edges) - 1, axis=0), edges)
    still = ForwardModel(stack, SENSOR, SCENE, GlobalShutter(1.0)).forward(scene)
    opened = [sum(close - open_ for open_, close in row) / len(row) for row in shutter.windows_s(SENSOR[0])]
    close = partial(np.testing.assert_allclose, atol=1e-13 * moving.max(), rtol=0)
    close(moving, still * np.array(opened)[::-1, None])
    close(ForwardModel(stack, SENSOR, SCENE, shutter).forward(scene), moving)  # a still lasts
    mean = ForwardModel(stack, SENSOR, SCENE, shutter, time="mean")
    np.testing.assert_allclose(
        mean.forward(np.repeat(scene, len(edges) - 1, 0), edges), still, atol=1e-13 * still.max()
    )
    np.testing.assert_allclose(mean.forward(scene), still, atol=1e-13 * still.max())


@pytest.mark.parametrize("name", ["global", "rolling", "dual", "rows"])
def test_lit_frames_reproduce_their_sliver(name):
    """A scene that shines in one sliver only leaves the global image of it, times that sliver's weights, and no more."""
    shutter, frames, slivers = SHUTTERS[name], 12, 4
    edges = np.linspace(0, shutter.duration_s(SENSOR[0]), frames + 1)
    stack = _stack(1)
    model = ForwardModel(stack, SENSOR, SCENE, shutter)
    scene = np.random.default_rng(1).uniform(size=(1, 1, 3, *SCENE))
    still = ForwardModel(stack, SENSOR, SCENE).forward(scene)
    weights = model.sliver_weights(edges, slivers)
    parts = np.zeros((slivers, 3, *SENSOR))
    for n in range(slivers):
        volume = np.zeros((frames, 1, 3, *SCENE))
        volume[3 * n : 3 * n + 3] = scene
        parts[n] = model.forward(volume, edges)
        expected = 3 * np.diff(edges)[0] * weights[n][:, None] * still
        np.testing.assert_allclose(parts[n], expected, atol=1e-13 * expected.max())
    whole = model.forward(np.repeat(scene, frames, axis=0), edges)
    np.testing.assert_allclose(parts.sum(axis=0), whole, atol=1e-13 * whole.max())
    cut = split_measurement(whole, weights)
    assert cut.shape == (slivers, 3, *SENSOR)
    np.testing.assert_allclose(cut[1], whole * weights[1][None, :, None], rtol=1e-14)


@shutters
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, 1e-5), (np.float64, 1e-12)])
def test_adjoint_is_the_transpose(shutter, dtype, tolerance):
    stack, edges = _stack(dtype=dtype), _edges(shutter)
    rng = np.random.default_rng(2)
    model = ForwardModel(stack, SENSOR, SCENE, shutter)
    # Positive, so that no sum cancels and the tolerance is that of the sums themselves.
    volume = rng.uniform(size=(len(edges) - 1, 3, 3, *SCENE)).astype(dtype)
    image = rng.uniform(size=(3, *SENSOR)).astype(dtype)
    left = np.vdot(model.forward(volume, edges).astype(np.float64), image.astype(np.float64))
    back = model.adjoint(image, edges)
    assert back.dtype == dtype
    assert back.shape == volume.shape
    right = np.vdot(volume.astype(np.float64), back.astype(np.float64))
    assert left == pytest.approx(right, rel=tolerance)


@pytest.mark.parametrize("name", ["global", "dual", "rows"])
def test_torch_equals_numpy_and_gradients_are_the_adjoint(name):
    torch = pytest.importorskip("torch")
    shutter, stack = SHUTTERS[name], _stack()
    edges = _edges(shutter)
    rng = np.random.default_rng(2)
    volume, image = rng.uniform(size=(len(edges) - 1, 3, 3, *SCENE)), rng.normal(size=(3, *SENSOR))
    expected = ForwardModel(stack, SENSOR, SCENE, shutter)
    values = torch.from_numpy(stack.values).requires_grad_()
    tensors = PsfStack(values, stack.depths_m, stack.pixel_pitch_m, stack.channels, "test")
    model = ForwardModel(tensors, SENSOR, SCENE, shutter)
    light = torch.from_numpy(volume).requires_grad_()
    found = model.forward(light, edges)
    reference = expected.forward(volume, edges)
    np.testing.assert_allclose(found.detach().numpy(), reference, atol=1e-13 * reference.max())
    found.backward(torch.from_numpy(image))
    adjoint = expected.adjoint(image, edges)
    np.testing.assert_allclose(light.grad.numpy(), adjoint, atol=1e-12 * np.abs(adjoint).max())
    np.testing.assert_allclose(
        model.adjoint(torch.from_numpy(image), edges).detach().numpy(), adjoint, atol=1e-12 * np.abs(adjoint).max()
    )
    # The model is linear in the PSFs too: <dA/dH, H> is A itself.
    assert float((values.grad * values.detach()).sum()) == pytest.approx(np.vdot(image, found.detach().numpy()))


@pytest.mark.parametrize("name", ["global", "dual", "rows"])
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 2)], ids=str)
@pytest.mark.parametrize("kind", ["numpy", "torch"])
def test_volumes_of_a_batch_are_those_of_each(name, batch, kind):
    """``(T, K, ..., C, h, w)`` and back, NumPy and torch, against one call for each; and against direct convolution."""
    shutter, stack = SHUTTERS[name], _stack()
    edges = _edges(shutter)
    rng = np.random.default_rng(2)
    volume = rng.uniform(size=(len(edges) - 1, 3, *batch, 3, *SCENE))
    volume[0] = 0  # a dark frame, and one that shines in one sample only
    volume[1].reshape(3, -1, 3, *SCENE)[:, 1:] = 0
    image = rng.normal(size=(*batch, 3, *SENSOR))
    single = ForwardModel(stack, SENSOR, SCENE, shutter)
    if kind == "torch":
        torch = pytest.importorskip("torch")
        tensors = replace(stack, values=torch.from_numpy(stack.values))
        model = ForwardModel(tensors, SENSOR, SCENE, shutter)
        light = torch.from_numpy(volume).requires_grad_()
        seen, back = model.forward(light, edges), model.adjoint(torch.from_numpy(image), edges)
        seen.backward(torch.from_numpy(image))
        np.testing.assert_allclose(light.grad.numpy(), back.numpy(), atol=1e-12 * np.abs(back.numpy()).max())
        seen, back = seen.detach().numpy(), back.numpy()
    else:
        given = volume.copy()
        seen, back = single.forward(volume, edges), single.adjoint(image, edges)
        np.testing.assert_array_equal(volume, given)  # sums are made elsewhere
    assert seen.shape == (*batch, 3, *SENSOR)
    assert back.shape == volume.shape
    for at in np.ndindex(*batch):
        one = volume[(slice(None), slice(None), *at)]
        reference = single.forward(one, edges)
        np.testing.assert_allclose(seen[at], reference, atol=1e-13 * reference.max())
        reference = single.adjoint(image[at], edges)
        np.testing.assert_allclose(
            back[(slice(None), slice(None), *at)], reference, atol=1e-13 * np.abs(reference).max()
        )
    last = tuple(size - 1 for size in batch)
    reference = _double_sum(stack, shutter, volume[(slice(None), slice(None), *last)], edges)
    np.testing.assert_allclose(seen[last], reference, atol=1e-13 * reference.max())


def test_a_batch_in_the_dark_is_dark():
    stack, edges = _stack(), _edges(SHUTTERS["dual"])
    seen = ForwardModel(stack, SENSOR, SCENE, SHUTTERS["dual"]).forward(
        np.zeros((len(edges) - 1, 3, 2, 3, *SCENE)), edges
    )
    assert seen.shape == (2, 3, *SENSOR)
    assert not seen.any()


def test_volumes_and_images_of_other_shapes_are_refused():
    stack, edges = _stack(), _edges(SHUTTERS["dual"])
    model = ForwardModel(stack, SENSOR, SCENE, SHUTTERS["dual"])
    frames = len(edges) - 1
    for shape in ((frames, 3, *SCENE), (frames, 2, 3, *SCENE), (frames, 3, 2, 2, *SCENE), (frames, 3, 3, 8, 10)):
        with pytest.raises(InputError, match=r"^volume: "):
            model.forward(np.zeros(shape), edges)
    for shape in (SENSOR, (2, 2, *SENSOR), (3, 18, 24)):
        with pytest.raises(InputError, match=r"^image: "):
            model.adjoint(np.zeros(shape), edges)


@shutters
def test_a_clip_is_the_volume_of_its_planes(shutter):
    """forward_clip builds lazily what forward takes whole; frames after the shutter has closed change nothing."""
    stack = _stack(dtype=np.float32)
    frames = int(shutter.duration_s(SENSOR[0]) / FRAME_S) + 1
    clip = _clip(frames + 5)
    model = ForwardModel(stack, SENSOR, SCENE, shutter)
    seen = exposed_part(clip, shutter, SENSOR[0])
    assert frames - 1 <= len(seen.rgb) <= frames
    volume = np.stack(
        [
            split_planes(np.moveaxis(rgb, -1, 0), z, stack.depths_m)
            for rgb, z in zip(clip.rgb, clip.depth_m, strict=True)
        ]
    )
    reference = model.forward(volume, clip.frame_edges_s)
    np.testing.assert_allclose(model.forward_clip(clip), reference, atol=2e-6 * reference.max())
    np.testing.assert_array_equal(model.forward_clip(seen), model.forward_clip(clip))


def test_global_measurements_are_those_of_the_slivers_mean_scenes():
    shutter, slivers = SHUTTERS["rows"], 3
    stack = _stack(1, np.float32)
    clip = _clip(12, frame_s=shutter.duration_s(SENSOR[0]) / 12)
    model = ForwardModel(stack, SENSOR, SCENE, shutter)
    found = list(model.global_measurements(clip, slivers))
    assert len(found) == slivers
    exposures = shutter.exposures_s(SENSOR[0])[::-1, None]
    for n, measurement in enumerate(found):
        mean = clip.rgb[4 * n : 4 * n + 4].astype(np.float64).mean(axis=0)
        expected = ForwardModel(stack, SENSOR, SCENE).forward(np.moveaxis(mean, -1, 0)[None, None]) * exposures
        np.testing.assert_allclose(measurement, expected, atol=2e-6 * expected.max())
    means = sliver_means(clip, slivers)
    np.testing.assert_allclose(means.rgb[1], clip.rgb[4:8].mean(axis=0), rtol=1e-6)
    np.testing.assert_array_equal(means.depth_m[1], clip.depth_m[6])  # the frame in the middle, not a mean
    np.testing.assert_allclose(means.frame_edges_s, clip.frame_edges_s[::4])


def test_what_shines_beside_the_image_is_averaged_like_it():
    rng = np.random.default_rng(3)
    light, depth = rng.random((12, 3, 3, 3)).astype(np.float32), rng.uniform(1, 2, (12, 3, 3)).astype(np.float32)
    clip = _clip(12)
    moving = sliver_means(replace(clip, surroundings=Surroundings(light, depth, 4)), 3).surroundings
    assert moving is not None
    np.testing.assert_allclose(moving.rgb[1], light[4:8].mean(axis=0), rtol=1e-6)
    np.testing.assert_array_equal(moving.depth_m[1], depth[6])
    still = Surroundings(light[:1], depth[:1], 4)
    assert sliver_means(replace(clip, surroundings=still), 3).surroundings is still


def test_moving_3d_measurements_of_a_sliver_keep_every_frames_depth():
    """A point that steps through three depths within a sliver: its global measurement is the mean over the depths."""
    stack = _stack(3, np.float32)
    shutter = GlobalShutter(3 * FRAME_S)
    rgb = np.zeros((3, *SCENE, 3), np.float32)
    rgb[:, 4, 4] = 1
    depth = np.broadcast_to(stack.depths_m[:, None, None], (3, *SCENE)).astype(np.float32)
    clip = Clip(rgb, depth, np.ones((3, *SCENE), bool), np.arange(4) * FRAME_S)
    found = ForwardModel(stack, SENSOR, SCENE, shutter).global_measurements(clip, 1)
    (found,) = found
    mean_psf = stack.values.mean(axis=0) * 3 * FRAME_S
    row, column = 4 + (SENSOR[0] - SCENE[0]) // 2, 4 + (SENSOR[1] - SCENE[1]) // 2
    cut = found[:, row - 4 : row + 5, column - 3 : column + 4]
    np.testing.assert_allclose(cut, mean_psf, rtol=1e-5)


def test_frames_of_unequal_length_count_as_long_as_they_last():
    """Frames of 1 and 3 ms in turn: slivers, their scenes, their weights and global measurements are means over time."""
    shutter = RollingShutter(4e-3, 0.5e-3)
    edges = np.concatenate([[0], np.cumsum(np.tile([1e-3, 3e-3], 4))])
    shutter_model = ForwardModel(_stack(1, np.float32), SENSOR, SCENE, shutter)
    clip = replace(_clip(8), frame_edges_s=edges)
    means = sliver_means(clip, 2)
    expected = (1 * clip.rgb[4] + 3 * clip.rgb[5] + 1 * clip.rgb[6] + 3 * clip.rgb[7]) / 8
    np.testing.assert_allclose(means.rgb[1], expected, rtol=1e-6)
    np.testing.assert_array_equal(means.frame_edges_s, edges[[0, 4, 8]])
    shares = shutter.weights(SENSOR[0], edges)[4:] * np.array([1, 3, 1, 3])[:, None] / 8
    weights = shutter_model.sliver_weights(edges, 2)
    np.testing.assert_allclose(weights[1], shares.sum(axis=0)[::-1], rtol=1e-12)
    *_, found = shutter_model.global_measurements(clip, 2)
    still = ForwardModel(_stack(1, np.float32), SENSOR, SCENE, GlobalShutter(4e-3))
    reference = still.forward(np.moveaxis(expected, -1, 0)[None, None])
    np.testing.assert_allclose(found, reference, atol=2e-6 * reference.max())


def test_a_clip_that_does_not_cover_the_shutter_is_no_still():
    """Whatever is cut off as not seen, what is left must last from the first row's opening to the last one's closing."""
    model = ForwardModel(_stack(1, np.float32), SENSOR, SCENE, GlobalShutter(1e-2))
    for edges in ([5, 6, 7, 8], [9e-3, 0.02, 0.03, 0.04], [-3e-3, -2e-3, -1e-3, 9e-3]):
        clip = replace(_clip(3), frame_edges_s=np.array(edges, np.float64))
        for expose in (model.forward_clip, lambda c: model.global_measurements(c, 1)):
            with pytest.raises(InputError, match=r"0 to 0\.01 s"):
                expose(clip)


def test_frames_before_and_after_the_capture_are_not_seen():
    late = RowShutter(np.array([[1.0e-3, 2.0e-3]] * SENSOR[0]))  # a trigger a millisecond after the clip's start
    clip = _clip(16)  # of 0.25 ms: the shutter sees frames 4 to 7
    seen = exposed_part(clip, late, SENSOR[0])
    np.testing.assert_array_equal(seen.rgb, clip.rgb[4:8])
    np.testing.assert_array_equal(seen.frame_edges_s, clip.frame_edges_s[4:9])
    model = ForwardModel(_stack(1, np.float32), SENSOR, SCENE, late)
    np.testing.assert_array_equal(model.forward_clip(seen), model.forward_clip(clip))


@pytest.mark.parametrize("shift", [-2e-16, 0.0, 2e-16])
def test_rounding_of_edges_decides_nothing(shift):
    """60 frames at 2000 per second last 30 ms within rounding: a shutter of 30 ms sees them all, and no frame more."""
    shutter = GlobalShutter(30e-3)
    edges = np.arange(62) / 2000 + np.where(np.arange(62) == 60, shift * 30, 0)
    clip = replace(_clip(61), frame_edges_s=edges)
    assert len(exposed_part(clip, shutter, SENSOR[0]).rgb) == 60
    short = replace(_clip(60), frame_edges_s=edges[:61])
    shares = shutter.weights(SENSOR[0], short.frame_edges_s)
    np.testing.assert_allclose(np.diff(short.frame_edges_s) @ shares, 30e-3, rtol=1e-12)


def test_memory_does_not_grow_with_frames():
    stack = _stack(3, np.float32)
    peaks = {}
    for frames in (20, 200):
        model = ForwardModel(stack, SENSOR, SCENE, RollingShutter(OPEN_S, LINE_S))
        clip = _clip(frames, frame_s=3e-3 / frames)
        model.forward_clip(clip)
        tracemalloc.start()
        model.forward_clip(clip)
        peaks[frames] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    # What grows are a few numbers per frame and pixel or row: clamped pixels' masks and the weights, no planes.
    assert peaks[200] - peaks[20] < 180 * (6 * SCENE[0] * SCENE[1] + 40 * SENSOR[0])
    assert 180 * stack.values[:, :, 0, 0].size * SCENE[0] * SCENE[1] * 4 > 3 * (peaks[200] - peaks[20])


def test_what_cannot_be_done_is_said():
    stack = _stack(1, np.float32)
    rolling = ForwardModel(stack, SENSOR, SCENE, RollingShutter(OPEN_S, LINE_S))
    with pytest.raises(InputError, match=r"0 to 0\.001 s.* 0 to 0\.0029 s"):
        rolling.forward_clip(_clip(4))
    without = partial(ForwardModel, stack, SENSOR, SCENE)
    for key, ask in (
        ("slivers", lambda: rolling.global_measurements(_clip(12), 5)),
        ("slivers", lambda: sliver_edges(np.arange(5.0), 0)),
        ("volume", lambda: without().forward_clip(_clip(4))),
        ("shutter", lambda: without().sliver_weights(np.arange(5.0), 2)),
        ("time", lambda: without(time="sum")),
    ):
        with pytest.raises(InputError, match=rf"^{key}: "):
            ask()
