"""What a capture says of a clip, against matrices that loops fill; joint least squares against the dense solution."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
from scipy.linalg import block_diag

from learning.camera import CaptureModel
from learning.layers import space_time
from learning.layers.noise import noise_level
from learning.layers.space_time import JOINT, ClipProblem, JointLeastSquares
from learning.timing import Timing
from simulator.camera.shutter import DualRollingShutter, RowShutter
from simulator.errors import InputError

pytestmark = pytest.mark.usefixtures("double")

SENSOR, SCENE, PSF = (12, 11), (4, 3), (7, 8)
EDGES_S = np.array([0, 2.0, 5.0, 8.0]) * 1e-3  # three frames, not of one length; the capture lasts 2 + 5 ms
SHUTTER = DualRollingShutter(2e-3, 1e-3)
UNEVEN = RowShutter(np.sort(np.random.default_rng(2).uniform(0, 8e-3, (SENSOR[0], 2)), axis=1))


@pytest.fixture
def film_camera(camera: Callable[..., CaptureModel]) -> Callable[..., CaptureModel]:
    """Make a camera of clips; with a ``margin`` light comes from around the image, with ``uneven`` rows differ."""

    def make(planes: int = 1, margin: int = 0, uneven: bool = False) -> CaptureModel:
        still = camera(SENSOR, SCENE, PSF, depths_m=(0.02, 0.05)[:planes], channels=("R", "G"))
        field = tuple(side + 2 * margin for side in SCENE)
        irradiance = np.random.default_rng(5).uniform(0.5, 0.9, field).astype(np.float32)
        exposure = UNEVEN.exposures_s(SENSOR[0])[::-1]
        shutter: dict[str, Any] = {"timing": Timing(SHUTTER, EDGES_S)}
        if uneven:
            shutter = {"timing": Timing(UNEVEN, EDGES_S), "row_exposure": exposure / exposure.mean()}
        return replace(still, irradiance=irradiance, **shutter)

    return make


def shares(capture: CaptureModel) -> np.ndarray:
    """Return how long each stored row is open in each frame, over the mean row's exposure: loops; ``(N, H)``."""
    assert capture.timing is not None
    found = np.zeros((len(EDGES_S) - 1, SENSOR[0]))
    windows = capture.timing.shutter.windows_s(SENSOR[0])[:, 0]
    for row, (opening, closing) in enumerate(windows):
        for frame, (begin, end) in enumerate(pairwise(EDGES_S)):
            found[frame, SENSOR[0] - 1 - row] = max(0.0, min(end, closing) - max(begin, opening))
    return found / np.mean(windows[:, 1] - windows[:, 0])


def dense(capture: CaptureModel, channel: int) -> np.ndarray:
    """Return A of one channel, ``(H W, N K rows columns)``: each PSF's sample put where it falls, over sqrt(sum H^2)."""
    values = np.asarray(capture.stack.values, np.float64)[:, channel]
    field = capture.field_shape
    weights = shares(capture)
    matrix = np.zeros((*SENSOR, len(weights), len(values), *field))
    top, left = ((a - b) // 2 for a, b in zip(SENSOR, field, strict=True))
    for (plane, a, b), value in np.ndenumerate(values):
        for i, j in np.ndindex(*field):
            row, column = top + i + a - PSF[0] // 2, left + j + b - PSF[1] // 2
            if 0 <= row < SENSOR[0] and 0 <= column < SENSOR[1]:
                matrix[row, column, :, plane, i, j] += weights[:, row] * value
    return matrix.reshape(np.prod(SENSOR), -1) / np.sqrt(np.mean(np.sum(values**2, axis=(1, 2))))


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal(shape))


CAMERAS: list[dict[str, Any]] = [{}, {"margin": 2}, {"planes": 2, "margin": 5}, {"uneven": True, "margin": 1}]
cameras = pytest.mark.parametrize("which", CAMERAS, ids=["plain", "margin", "planes, field beyond sensor", "uneven"])


@cameras
def test_forward_and_adjoint_are_the_matrix_and_its_transpose(film_camera: Any, which: dict[str, Any]) -> None:
    capture = film_camera(**which)
    problem = ClipProblem(capture)
    frames, planes, channels, *field = problem.shape
    light, image = draw(frames, planes, 2, channels, *field), draw(2, channels, *SENSOR, seed=1)
    seen, back = problem(light), problem.adjoint(image)
    assert seen.shape == image.shape
    assert back.shape == light.shape
    for channel in range(channels):
        matrix = dense(capture, channel)
        for each in range(2):
            # Sums of some hundred terms of order 1 in float64.
            wanted = matrix @ light[:, :, each, channel].numpy().ravel()
            np.testing.assert_allclose(seen[each, channel].numpy().ravel(), wanted, rtol=0, atol=1e-13 * len(wanted))
            wanted = matrix.T @ image[each, channel].numpy().ravel()
            found = back[:, :, each, channel].numpy().ravel()
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13 * len(wanted))


@cameras
def test_adjoint_is_the_transpose(film_camera: Any, which: dict[str, Any]) -> None:
    problem = ClipProblem(film_camera(**which))
    frames, planes, channels, *field = problem.shape
    # Positive, so that no sum cancels and the tolerance is that of the sums themselves.
    light, image = draw(frames, planes, 3, channels, *field).abs(), draw(3, channels, *SENSOR, seed=1).abs()
    there, back = (problem(light) * image).sum().item(), (light * problem.adjoint(image)).sum().item()
    assert there == pytest.approx(back, rel=1e-12)


@cameras
def test_the_misfits_gradient_is_the_adjoint_of_the_residual(film_camera: Any, which: dict[str, Any]) -> None:
    problem = ClipProblem(film_camera(**which))
    frames, planes, channels, *field = problem.shape
    light, target = draw(frames, planes, 2, channels, *field).requires_grad_(), draw(2, channels, *SENSOR, seed=1)
    (0.5 * (problem(light) - target).square().sum()).backward()
    with torch.no_grad():
        wanted = problem.adjoint(problem(light) - target)
    torch.testing.assert_close(light.grad, wanted, rtol=0, atol=1e-12 * float(wanted.abs().max()))


@cameras
def test_images_are_the_middle_of_light(film_camera: Any, which: dict[str, Any]) -> None:
    """As bright as the brightest pixel of the image would be; the margin goes on as the image's ends do."""
    capture = film_camera(**which)
    problem = ClipProblem(capture)
    frames, planes, channels, *field = problem.shape
    film = draw(2, frames, planes, channels, *SCENE)
    light = problem.light(film)
    assert light.shape == (frames, planes, 2, channels, *field)
    torch.testing.assert_close(problem.film(light), film, rtol=1e-14, atol=0)
    image = film.numpy() * (capture.scene_irradiance / capture.scene_irradiance.max().astype(np.float64))
    margin = which.get("margin", 0)
    wanted = np.pad(image, [(0, 0)] * 4 + [(margin, margin)] * 2, mode="edge")
    np.testing.assert_allclose(light.numpy(), np.moveaxis(wanted, 0, 2), rtol=1e-14)


@cameras
def test_a_measurement_is_the_forward_model_of_what_was_there(film_camera: Any, which: dict[str, Any]) -> None:
    """Y = offset + gain sum share H (*) (irradiance white film), by matrices, whatever gain, white and offset are."""
    capture = replace(film_camera(**which), gain=7.0, white=0.3, offset=np.array([0.4, -0.1]))
    problem = ClipProblem(capture)
    frames, planes, channels, *field = problem.shape
    radiance = np.random.default_rng(4).random((channels, frames, planes, *field))  # over white
    values = np.asarray(capture.stack.values, np.float64)
    measured = []
    for channel in range(channels):
        blur = dense(capture, channel) * np.sqrt(np.mean(np.sum(values[:, channel] ** 2, axis=(1, 2))))
        exposed = capture.gain * blur @ (capture.white * radiance[channel] * capture.irradiance).ravel()
        measured.append(capture.offset[channel] + exposed.reshape(SENSOR))
    measurement = torch.from_numpy(np.stack(measured))[None]
    relative = capture.irradiance / capture.scene_irradiance.max().astype(np.float64)
    light = torch.from_numpy(np.moveaxis(radiance * relative, 0, 2))[:, :, None]
    target = problem.target(measurement)
    torch.testing.assert_close(target, problem(light), rtol=0, atol=1e-12 * float(target.abs().max()))
    wanted = radiance[..., *capture.scene_in_field]
    np.testing.assert_allclose(problem.film(light)[0].numpy(), np.moveaxis(wanted, 0, 2), rtol=1e-12)
    assert not problem(problem.dark(2)).any()
    assert problem.dark(2).shape == (frames, planes, 2, channels, *field)


def test_stills_dark_pixels_and_other_shapes_are_refused(film_camera: Any) -> None:
    capture = film_camera(margin=1)
    irradiance = capture.irradiance.copy()
    irradiance[0] = 0  # beside the image
    ClipProblem(replace(capture, irradiance=irradiance))
    irradiance[1, 1] = 0
    with pytest.raises(InputError, match=r"^irradiance: got 0 at 1 "):
        ClipProblem(replace(capture, irradiance=irradiance))
    with pytest.raises(InputError, match=r"^capture: "):
        ClipProblem(replace(capture, timing=None))
    with pytest.raises(InputError, match=r"^measurement: "):
        ClipProblem(capture).target(torch.zeros(1, 2, 12, 12))


PRIOR: dict[str, Any] = {"static": 0.3, "moving": 0.5, "memory": 1.7, "sharpest": 0.08, "decay": 1.3}
PRIOR |= {"correlation": 0.6, "noise": 1.7}


def covariance(capture: CaptureModel) -> np.ndarray:
    """Return the prior's covariance of the light of two channels, from its formulas: of colour, time and space, multiplied.

    Over space it is the transform of the spectrum of S S^T, a sum of cosines for every pair of pixels of the periodic field.
    """
    frames, (rows, columns) = capture.frames, capture.field_shape
    time = np.zeros((frames, frames))
    for n, m in np.ndindex(frames, frames):
        time[n, m] = PRIOR["static"] ** 2 + PRIOR["moving"] ** 2 * np.exp(-abs(n - m) / PRIOR["memory"])
    y, x = (np.array([n if n <= side // 2 else n - side for n in range(side)]) / side for side in (rows, columns))
    power = 1 / (1 + (y[:, None] ** 2 + x**2) / PRIOR["sharpest"] ** 2) ** PRIOR["decay"]
    power /= power.mean()  # of a pixel, the variance is 1
    places = np.array(list(np.ndindex(rows, columns)))
    apart = places[:, None] - places
    waves = 2 * np.pi * (apart[..., 0, None, None] * y[:, None] + apart[..., 1, None, None] * x)
    space = np.mean(power * np.cos(waves), axis=(-2, -1))
    colour = [[1, PRIOR["correlation"]], [PRIOR["correlation"], 1]]
    return np.kron(colour, np.kron(time, space))


@cameras
def test_joint_least_squares_is_the_mean_of_the_gaussian(film_camera: Any, which: dict[str, Any]) -> None:
    """K A^T (A K A^T + s^2)^-1 y with dense matrices; s is a multiple of the noise that is found in the measurement."""
    if which.get("planes", 1) > 1:  # the covariance below is of one plane
        which = {"margin": 5}
    capture = film_camera(**which)
    method = JointLeastSquares(capture, iterations=250, **PRIOR)
    measurement = torch.from_numpy(np.random.default_rng(8).random((1, 2, *SENSOR)) * 0.1 + 0.3)
    light = method.light(measurement)
    prior, noise = covariance(capture), PRIOR["noise"] * noise_level(measurement).item()
    matrix = block_diag(*(dense(capture, channel) for channel in range(2)))
    target = method.problem.target(measurement)[0].numpy()
    variance = (noise * method.problem.scale.numpy() * np.ones_like(target)) ** 2
    seen = matrix @ prior @ matrix.T + np.diag(variance.ravel())
    wanted = prior @ matrix.T @ np.linalg.solve(seen, target.ravel())
    # Conjugate gradients in float64, until the residual no longer falls
    found = light[:, 0, 0].transpose(0, 1).numpy().ravel()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-7 * np.abs(wanted).max())
    image = wanted.reshape(2, 3, *capture.field_shape)[..., *capture.scene_in_field]
    image = image * capture.scene_irradiance.max().astype(np.float64) / capture.scene_irradiance
    np.testing.assert_allclose(
        method(measurement)[0].transpose(0, 1).numpy(), image, rtol=0, atol=1e-7 * np.abs(image).max()
    )


def test_a_few_steps_explain_most_of_a_capture(film_camera: Any) -> None:
    capture = film_camera(margin=2)
    problem = ClipProblem(capture)
    y, x = np.mgrid[:8, :7] / 8
    true = np.stack([(1 + np.sin(3 * x + n) * np.cos(2 * y)) / 2 for n in range(3)])  # smooth, and it moves
    light = torch.from_numpy(np.stack([true, 0.6 * true], axis=1))[:, None, None]
    measurement = problem(light) / problem.scale + problem.offset
    target, misfits = problem.target(measurement), [1.0]
    for iterations in (1, 4, 16):
        found = JointLeastSquares(capture, iterations=iterations, **PRIOR).light(measurement)
        misfits.append(float((problem(found) - target).norm() / target.norm()))
    assert misfits[0] > misfits[1] > misfits[2] > misfits[3]
    assert misfits[2] < 0.2
    assert misfits[3] < 0.03


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("at_once", [1, 3])  # as on a CPU, and as on a GPU
def test_captures_of_a_batch_do_not_know_of_each_other(
    film_camera: Any, at_once: int, uneven: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where one is ten times as bright, and where one is dark."""
    monkeypatch.setattr(space_time, "samples_at_once", lambda *_: at_once)
    capture = film_camera(margin=1, uneven=uneven)
    method = JointLeastSquares(capture, **dict(JOINT) | {"iterations": 4})
    drawn = np.random.default_rng(3).random((3, 2, *SENSOR)) * np.array([1.0, 0.1, 0.0])[:, None, None, None]
    batch = torch.from_numpy(drawn + capture.offset[:, None, None])
    together = method(batch)
    assert together.isfinite().all()
    assert together.shape == (3, 3, 2, *SCENE)
    for each, alone in zip(together, batch.split(1), strict=True):
        # Rounding of the transforms, which each step amplifies
        torch.testing.assert_close(each, method(alone)[0], rtol=0, atol=1e-11 * float(each.abs().max()))


def test_what_is_found_has_no_gradient_and_nothing_to_be_trained(film_camera: Any) -> None:
    method = JointLeastSquares(film_camera(), **JOINT)
    assert not method.state_dict()
    assert not method(torch.rand(1, 2, *SENSOR).requires_grad_()).requires_grad
    assert method.told == JOINT


WRONG = [(name, value) for name in JOINT for value in ((-0.1, 1) if name == "correlation" else (0, -1.0, math.inf))]


@pytest.mark.parametrize(("name", "value"), [*WRONG, *((name, math.nan) for name in JOINT)])
def test_numbers_that_make_no_prior_are_refused(film_camera: Any, name: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"^{name}: "):
        JointLeastSquares(film_camera(), **dict(JOINT) | {name: value})


def test_changes_that_are_never_forgotten_are_refused(film_camera: Any) -> None:
    JointLeastSquares(film_camera(), **dict(JOINT) | {"memory": 1e6})
    with pytest.raises(InputError, match=r"^static, moving, memory: got 0\.1, 0\.2, 1e\+18: "):
        JointLeastSquares(film_camera(), **dict(JOINT) | {"memory": 1e18})
