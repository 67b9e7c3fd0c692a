"""ADMM against a bound on its objective that another method proves, and where it must find what is there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.signal import fftconvolve

from learning.camera import CaptureModel, plain_capture, typical_white
from learning.classical.admm import Admm, add_adjoint, difference_power, differences
from learning.classical.method import PlanarMethod
from simulator.camera.forward import ForwardModel
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

SENSOR, SCENE, PSF = (13, 12), (7, 6), 9
TV, SPARSITY = 0.05, 0.02


def camera(planes: int, channels: int = 1, scale: float = 1.0, field: tuple[int, int] = SCENE) -> CaptureModel:
    """Return a camera whose PSFs reach beyond the sensor, with vignetting, gain, offset and white of its own."""
    values = np.random.default_rng(0).random((planes, channels, PSF, PSF)) ** 6 * scale
    names = ("R", "G", "B")[:channels]
    return CaptureModel(
        stack=PsfStack(values, np.linspace(0.1, 0.2, planes), 1e-5, names, "random"),
        sensor_shape=SENSOR,
        scene_shape=SCENE,
        gain=2.0,
        offset=np.full(channels, 0.1),
        irradiance=np.random.default_rng(1).uniform(0.5, 0.8, field).astype(np.float32),
        scene_to_camera=np.eye(channels, 3),
        white=1.5,
    )


def scene(planes: int, channels: int = 1, field: tuple[int, int] = SCENE) -> np.ndarray:
    """Return a volume ``(K, C, h, w)`` of radiance / white: boxes, one in each plane; and what shines beside the image."""
    volume = np.full((planes, channels, *field), 0.6)
    top, left = ((whole - part) // 2 for whole, part in zip(field, SCENE, strict=True))
    image = volume[..., top : top + SCENE[0], left : left + SCENE[1]]
    image[:] = 0
    for plane in range(planes):
        image[plane, :, 1 + plane : 4 + plane, 1 + plane : 3 + plane] = 1 - 0.3 * plane
    return volume


def measure(capture: CaptureModel, volume: np.ndarray, noise: float = 0.02) -> np.ndarray:
    """Return the measurement ``(C, H, W)`` by the simulator's forward model."""
    model = ForwardModel(capture.stack, capture.sensor_shape, capture.field_shape)
    clean = capture.gain * model.forward((volume * capture.white * capture.irradiance)[None])
    error = noise * clean.max() * np.random.default_rng(2).standard_normal(clean.shape)
    return clean + error + capture.offset[:, None, None]


class DenseProblem:
    """The problem of one channel with matrices that loops fill: A, D, target; and a bound on its objective.

    Of all light that may be there: of the whole field.
    """

    def __init__(self, capture: CaptureModel, measurement: np.ndarray, channel: int = 0) -> None:
        values, field = capture.stack.values[:, channel], capture.field_shape
        norm = np.sqrt(np.mean(np.sum(values**2, axis=(-2, -1))))
        matrix = np.zeros((*SENSOR, len(values), *field))
        top, left = ((a - b) // 2 for a, b in zip(SENSOR, field, strict=True))
        for (k, a, b), value in np.ndenumerate(values / norm):
            for i in range(field[0]):
                for j in range(field[1]):
                    row, column = top + i + a - PSF // 2, left + j + b - PSF // 2
                    if 0 <= row < SENSOR[0] and 0 <= column < SENSOR[1]:
                        matrix[row, column, k, i, j] += value
        self.forward = matrix.reshape(np.prod(SENSOR), -1)
        unit = np.eye(len(values) * field[0] * field[1]).reshape(-1, len(values), *field)
        steps = [np.diff(unit, axis=axis).reshape(len(unit), -1) for axis in (-2, -1)]
        self.gradient = np.concatenate(steps, axis=1).T
        brightest = capture.scene_irradiance.astype(np.float64).max()
        self.brightness = np.broadcast_to(capture.irradiance.astype(np.float64) / brightest, (len(values), *field))
        signal = measurement[channel] - capture.offset[channel]
        self.target = (signal / (capture.gain * capture.white * brightest * norm)).ravel()

    def objective(self, volume: np.ndarray) -> float:
        """Return the objective of radiance / white ``(K, h, w)``."""
        light = (volume * self.brightness).ravel()
        misfit = np.sum((self.forward @ light - self.target) ** 2) / 2
        return float(misfit + TV * np.abs(self.gradient @ light).sum() + SPARSITY * np.abs(light).sum())

    def bound(self) -> float:
        """Return a number that no volume's objective is below, nearly attained.

        Multipliers p of A S and t of D S, |t| <= tv: if A^T p + D^T t + sparsity >= 0, then -|p|^2 / 2 - p . target bounds
        the objective from below (weak duality), which a last scaling makes exactly true.
        """
        _, p, t = self._saddle_point(4000)
        p *= min(1.0, SPARSITY / np.max(-(self.forward.T @ p + self.gradient.T @ t)))
        return float(-np.sum(p**2) / 2 - p @ self.target)

    def solution(self) -> np.ndarray:
        """Return the light that the objective is least for, flat."""
        return self._saddle_point(8000)[0]

    def _saddle_point(self, iterations: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return light and multipliers by the method of Chambolle and Pock, 2011."""
        step = 0.99 / np.linalg.norm(np.concatenate([self.forward, self.gradient]), 2)
        light = np.zeros(self.forward.shape[1])
        ahead, p, t = light, np.zeros(len(self.forward)), np.zeros(len(self.gradient))
        for _ in range(iterations):
            p = (p + step * (self.forward @ ahead - self.target)) / (1 + step)
            t = np.clip(t + step * (self.gradient @ ahead), -TV, TV)
            new = np.maximum(light - step * (self.forward.T @ p + self.gradient.T @ t + SPARSITY), 0)
            ahead, light = 2 * new - light, new
        return light, p, t


@pytest.mark.parametrize("planes", [1, 2])
def test_reaches_the_least_objective(planes: int) -> None:
    """With vignetting: the dense problem takes radiance, so an estimate that lacks the irradiance map misses the bound."""
    capture = camera(planes)
    measurement = measure(capture, scene(planes))
    problem = DenseProblem(capture, measurement)
    objectives = []
    for iterations in (1, 10, 400):
        method = Admm(capture, tv=TV, sparsity=SPARSITY, iterations=iterations, dtype=torch.float64)
        volume = method(torch.from_numpy(measurement)[None])[0, :, 0].numpy()
        assert volume.min() >= 0
        objectives.append(problem.objective(volume))
    # The bound holds for any volume, so the objective is above it, and falls to it.
    bound = problem.bound()
    assert bound * (1 - 1e-9) <= objectives[2] <= bound * 1.001
    assert objectives[0] > objectives[1] > objectives[2]
    assert objectives[0] > 1.2 * objectives[2]


# Fields: two pixels around the image; wider than the sensor of 13 x 12, in one direction or both.
@pytest.mark.slow
@pytest.mark.parametrize(("planes", "field"), [(1, (11, 10)), (2, (11, 10)), (1, (9, 16)), (2, (9, 16)), (1, (17, 14))])
def test_light_from_beside_the_image_stays_there(planes: int, field: tuple[int, int]) -> None:
    """What is given is the image of the whole field's solution, by the method that proves the bound; not of the image's."""
    capture = camera(planes, field=field)
    measurement = measure(capture, scene(planes, field=field))
    problem = DenseProblem(capture, measurement)
    light = problem.solution().reshape(planes, *field)
    wanted = (light / problem.brightness)[:, *capture.scene_in_field]
    settings: dict[str, Any] = {"tv": TV, "sparsity": SPARSITY, "iterations": 1000, "dtype": torch.float64}
    got = Admm(capture, **settings)(torch.from_numpy(measurement)[None])[0, :, 0].numpy()
    assert got.shape == (planes, *SCENE)
    np.testing.assert_allclose(got, wanted, atol=0.05)  # of white; both methods are slow where little is known
    # Whoever says that there is no other light finds it in the image.
    alone = replace(capture, irradiance=capture.scene_irradiance)
    pushed = Admm(alone, **settings)(torch.from_numpy(measurement)[None])[0, :, 0].numpy()
    assert pushed.sum() > 1.5 * got.sum()


def test_one_plane_has_converged_after_the_iterations_that_are_the_default() -> None:
    """A letter through 25 points and the light around it; with the weights of several planes, 100 reach 27.7 dB."""
    rng = np.random.default_rng(0)
    psf = np.zeros((24, 24))
    psf[rng.integers(0, 24, 25), rng.integers(0, 24, 25)] = rng.uniform(0.5, 1, 25)
    light = np.full((87, 103), 0.1)
    light[30:60, 35:45] = light[50:60, 35:65] = 1
    measurement = fftconvolve(light, psf, mode="valid")
    measurement += rng.normal(0, 0.01 * measurement.max(), measurement.shape)
    stack = PsfStack(psf[None, None], np.array([np.inf]), 1e-5, ("grey",), "points")
    unit = plain_capture(stack, measurement.shape)
    capture = replace(unit, white=typical_white(unit, measurement[None]))
    there, far = (
        PlanarMethod(capture, "admm", given).volume(torch.from_numpy(measurement)[None, None])
        for given in ({}, {"iterations": 1500})
    )
    assert float(-10 * (there - far).square().mean().log10()) > 35


def test_parameters_mean_the_same_for_every_mask_gain_and_white() -> None:
    volumes = []
    for scale in (1.0, 1e-3):  # a mask that passes a thousandth
        capture = camera(2, scale=scale)
        measurement = torch.from_numpy(measure(capture, scene(2)))[None]
        volumes.append(Admm(capture, tv=TV, sparsity=SPARSITY, iterations=40, dtype=torch.float64)(measurement))
    brighter = replace(capture, gain=capture.gain * 5, white=capture.white * 7, offset=capture.offset * 0)
    method = Admm(brighter, tv=TV, sparsity=SPARSITY, iterations=40, dtype=torch.float64)
    volumes.append(method((measurement - 0.1) * 35))
    for other in volumes[1:]:
        np.testing.assert_allclose(other.numpy(), volumes[0].numpy(), rtol=1e-9, atol=1e-12)


def test_each_measurement_and_channel_is_a_problem_of_its_own() -> None:
    capture = camera(2, 3)
    measurement = torch.from_numpy(np.stack([measure(capture, scene(2, 3) * x) for x in (1.0, 0.2)]))
    settings = {"tv": TV, "sparsity": SPARSITY, "iterations": 30, "dtype": torch.float64}
    both = Admm(capture, **settings)(measurement)
    stack = PsfStack(capture.stack.values[:, 1:2], capture.stack.depths_m, 1e-5, ("G",), "green")
    green = replace(capture, stack=stack, offset=capture.offset[1:2], scene_to_camera=capture.scene_to_camera[1:2])
    alone = Admm(green, **settings)(measurement[1:, 1:2])
    np.testing.assert_allclose(alone[0, :, 0].numpy(), both[1, :, 1].numpy(), rtol=1e-9, atol=1e-12)


def test_single_precision_is_enough() -> None:
    capture = camera(2)
    measurement = torch.from_numpy(measure(capture, scene(2)))[None]
    settings: dict[str, Any] = {"tv": TV, "sparsity": SPARSITY, "iterations": 100}
    single, double = (Admm(capture, **settings, dtype=kind)(measurement) for kind in (torch.float32, torch.float64))
    assert single.dtype == torch.float32
    np.testing.assert_allclose(single.numpy(), double.numpy(), rtol=0, atol=2e-5)  # of white, after 100 iterations


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tv": -0.1}, "^tv: "),
        ({"sparsity": np.inf}, "^sparsity: "),
        ({"weights": (1.0, 0.0, 1.0)}, "^weights: "),
        ({"iterations": 0}, "^iterations: "),
        ({"light": "dark"}, "^light: "),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Admm(camera(1), **{"tv": TV, "sparsity": SPARSITY, "iterations": 3} | settings)


def test_a_measurement_of_another_shape_is_refused() -> None:
    with pytest.raises(InputError, match=r"^measurement: "):
        Admm(camera(1), tv=TV, sparsity=SPARSITY, iterations=3)(torch.zeros(1, 1, 12, 12))


def test_another_precision_keeps_the_imaginary_part() -> None:
    """Spectra made for float32 and moved; ADMM made for float64 is the same but for the rounding of the spectra."""
    settings: dict[str, Any] = {"tv": TV, "sparsity": SPARSITY, "iterations": 30}
    measurement = torch.from_numpy(np.random.default_rng(6).uniform(size=(1, 3, *SENSOR)))
    made = Admm(camera(2, 3), **settings, dtype=torch.float64)(measurement)
    moved = Admm(camera(2, 3), **settings).to(torch.float64)(measurement)
    torch.testing.assert_close(moved, made, rtol=0, atol=1e-5 * float(made.abs().max()))


def test_adjoint_is_the_transpose() -> None:
    generator = torch.Generator().manual_seed(0)
    image = torch.randn(2, 5, 7, dtype=torch.float64, generator=generator)
    rows, columns = (torch.randn(part.shape, dtype=torch.float64, generator=generator) for part in differences(image))
    back = torch.zeros_like(image)
    add_adjoint(back, rows, columns)
    there = sum((a * b).sum() for a, b in zip(differences(image), (rows, columns), strict=True))
    np.testing.assert_allclose(float((back * image).sum()), float(there), rtol=1e-13)


def test_power_is_the_spectrum_of_periodic_differences() -> None:
    image = np.random.default_rng(0).random((6, 9))
    energy = sum(np.sum((np.roll(image, -1, axis) - image) ** 2) for axis in (0, 1))
    weight = np.array(
        [1.0, 2, 2, 2, 2]
    )  # of an odd length, all columns but the first of the half spectrum stand for two
    spectrum = np.abs(np.fft.rfft2(image)) ** 2 * weight * difference_power(6, 9, torch.float64).numpy()
    np.testing.assert_allclose(spectrum.sum() / image.size, energy, rtol=1e-12)
