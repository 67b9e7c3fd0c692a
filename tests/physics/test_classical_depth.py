"""Depth by classical methods where it must be found: light at known planes, measured through PSFs of an asymmetric mask."""

import itertools
from itertools import product

import numpy as np
import pytest

from simulator.camera.forward import ForwardModel
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.spectra import Line
from simulator.optics.stack import depth_planes
from simulator.types import CameraGeometry, SpectralResponse

torch = pytest.importorskip("torch")
pytest.importorskip("ortools")

from learning.camera import CaptureModel  # noqa: E402
from learning.classical.method import DEFAULTS, build_classical  # noqa: E402

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")
SCENE, SENSOR, PLANES = (24, 28), (72, 76), 4
# The thesis's cost and the centroid of light, each with the volumes of both methods; without noise a small lambda does.
METHODS = [
    (
        "cls",
        {"regularisation_lambda": 1e-3, "cost": "defocus", "measure": "gradient", "contrast": 0.3, "window_px": 2.0},
    ),
    (
        "cls",
        {"regularisation_lambda": 1e-3, "cost": "spread", "measure": "laplacian", "contrast": 16.0, "window_px": 2.0},
    ),
    ("admm", {"tv": 1e-3, "sparsity": 1e-3, "iterations": 100, "cost": "defocus", "contrast": 3.0, "window_px": 1.0}),
    ("admm", {"tv": 1e-3, "sparsity": 1e-3, "iterations": 100, "cost": "spread", "contrast": 1.0, "window_px": 1.0}),
]


@pytest.fixture(scope="module")
def capture():
    """Random open squares before the sensor: planes from 3 mm to 10 cm, magnified by 1.67 to 1.02; sensor holds all light."""
    stack = psf_stack(depth_planes(3e-3, 0.1, PLANES))
    y, x = (np.arange(SCENE[0]) - 11.5)[:, None] / 60, (np.arange(SCENE[1]) - 13.5) / 60
    gain = 0.5 / float(np.asarray(stack.values).sum(axis=(2, 3)).mean())
    return CaptureModel(
        stack=stack,
        sensor_shape=SENSOR,
        scene_shape=SCENE,
        gain=gain,
        offset=np.array([0.02]),
        irradiance=(1 / (1 + y**2 + x**2) ** 2).astype(np.float32),
        scene_to_camera=np.array([[0.2, 0.7, 0.1]]),
    )


@pytest.fixture(scope="module")
def between():
    """Return a function: plane to the stack of the one depth midway, in disparity, to the next."""
    inverse = 1 / depth_planes(3e-3, 0.1, PLANES)
    stacks = [psf_stack([2 / (a + b)]) for a, b in itertools.pairwise(inverse)]
    return stacks.__getitem__


def psf_stack(depths_m):
    amplitude = np.zeros((140, 140), np.float32)
    rng = np.random.default_rng(5)
    for row, column in rng.integers(0, 132, (24, 2)):
        amplitude[row : row + 8, column : column + 8] = 1
    mask = Mask(np.zeros_like(amplitude), amplitude, 4e-6, name="squares")
    camera = CameraGeometry(2e-3, 20e-6, GREEN)
    depths_m = tuple(float(z) for z in depths_m)
    return compute_psf_stack(mask, camera, PsfConfig(depths_m, "scaled_distance"), lines=[Line(0, 532e-9, 1.0)])


def measure(capture, light):
    """Return what a camera stores of radiance ``(K, h, w)``, alike in all colours, as a batch of one."""
    model = ForwardModel(capture.stack, SENSOR, SCENE)
    volume = (light * capture.irradiance).astype(np.float32)[None, :, None]
    stored = capture.offset[:, None, None] + capture.gain * model.forward(volume)
    return torch.from_numpy(stored.astype(np.float32))[None]


def planes_found(capture, name, parameters, light):
    method = build_classical(capture, name, parameters)
    disparity = method.reconstruct(measure(capture, light)).disparity[0, 0].numpy()
    return np.abs(disparity[..., None] - capture.plane_disparities()).argmin(axis=-1)


@pytest.mark.parametrize(("name", "parameters"), METHODS)
def test_two_patches_are_found_at_their_planes(capture, name, parameters):
    rng = np.random.default_rng(1)
    light = np.zeros((PLANES, *SCENE))
    patches = {0: np.s_[3:11, 3:12], 2: np.s_[13:22, 15:26]}
    for plane, window in patches.items():
        light[plane][window] = rng.choice([0.1, 1.0], light[plane][window].shape)
    labels = planes_found(capture, name, parameters | {"pairwise": 0.3}, light)
    for plane, window in patches.items():
        assert (labels[window] == plane).mean() > 0.9


@pytest.mark.parametrize(("name", "parameters"), METHODS)
@pytest.mark.parametrize("plane", range(PLANES))
def test_a_textured_wall_is_found_nearly_everywhere(capture, name, parameters, plane):
    light = np.zeros((PLANES, *SCENE))
    light[plane] = np.random.default_rng(2).choice([0.1, 1.0], SCENE)
    labels = planes_found(capture, name, parameters | {"pairwise": 0.3}, light)
    # Of light that CLS leaves on all planes, the centroid of a wall at an outer plane lies inwards here and there.
    expected = 0.8 if (name, parameters["cost"]) == ("cls", "spread") else 0.95
    assert (labels == plane).mean() > expected


@pytest.mark.parametrize("before", range(PLANES - 1))
def test_a_textured_wall_between_two_planes_is_found_between_them(capture, between, before):
    """Its PSF is that of its own depth, midway in disparity, which the method does not know.

    By ADMM, whose light goes to the planes around it; what CLS finds of a PSF that it does not know lies anywhere.
    """
    light = np.random.default_rng(2).choice([0.1, 1.0], SCENE)[None]
    own = capture.with_stack(between(before))
    method = build_classical(capture, *METHODS[3])
    disparity = method.reconstruct(measure(own, light)).disparity[0, 0, 3:-3, 3:-3].numpy()
    near, far = capture.plane_disparities()[[before, before + 1]]
    # A label to either side of the middle; with planes alone the median would be off by half an interval at least.
    assert abs(np.median(disparity) - (near + far) / 2) <= 0.3 * (near - far)
    assert ((disparity < near) & (disparity > far)).mean() > 0.6


@pytest.mark.parametrize(("name", "near", "far"), [(name, *pair) for name, pair in product(DEFAULTS, [(0, 2), (3, 1)])])
def test_defaults_find_the_order_of_two_patches(capture, name, near, far):
    """Defaults are for noise; without it they still must tell what is nearer."""
    rng = np.random.default_rng(3)
    light = np.zeros((PLANES, *SCENE))
    windows = np.s_[2:12, 2:13], np.s_[12:23, 14:27]
    for plane, window in zip((near, far), windows, strict=True):
        light[plane][window] = rng.choice([0.1, 1.0], light[plane][window].shape)
    labels = planes_found(capture, name, {}, light)
    assert np.sign(labels[windows[0]].mean() - labels[windows[1]].mean()) == np.sign(near - far)
    assert abs(labels[windows[0]].mean() - labels[windows[1]].mean()) > 0.5
