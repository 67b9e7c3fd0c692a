"""Plug-and-play ADMM: without a prior it is non-negative least squares; with one it finds what a prior must."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from torch import Tensor

from learning.camera import CaptureModel
from learning.classical.admm import Admm
from learning.classical.method import build_classical
from learning.classical.plug_and_play import PlugAndPlay
from learning.data import ExampleSet
from learning.layers.noise import noise_level
from learning.method import linear_to_srgb
from learning.metrics import psnr
from simulator.camera.forward import ForwardModel
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

SENSOR, SCENE, PSF = (16, 14), (8, 6), 7


class Plain:
    """A prior that finds nothing wrong, and remembers what it was told."""

    def __init__(self) -> None:
        self.told: list[Tensor] = []

    def planes(self, volume: Tensor, noise: Tensor) -> Tensor:
        self.told.append(noise)
        return volume.clone()


class Smooth:
    """Blurs each plane, more where there is more noise: the exact denoiser of a prior |grad S|^2 on a periodic grid."""

    def planes(self, volume: Tensor, noise: Tensor) -> Tensor:
        rows, columns = (2 - 2 * torch.cos(2 * torch.pi * torch.fft.fftfreq(size)) for size in volume.shape[-2:])
        strength = 400 * noise[:, None, None, None, None] ** 2
        spectrum = torch.fft.fft2(volume) / (1 + strength * (rows[:, None] + columns))
        return torch.fft.ifft2(spectrum).real.to(volume)


def camera(planes: int, scene: tuple[int, int] = SCENE, sensor: tuple[int, int] = SENSOR) -> CaptureModel:
    values = np.random.default_rng(0).random((planes, 1, PSF, PSF)) ** 6
    return CaptureModel(
        stack=PsfStack(values, np.linspace(0.1, 0.2, planes), 1e-5, ("G",), "random"),
        sensor_shape=sensor,
        scene_shape=scene,
        gain=2.0,
        offset=np.array([0.1]),
        irradiance=np.random.default_rng(1).uniform(0.5, 0.8, scene).astype(np.float32),
        scene_to_camera=np.eye(1, 3),
        white=1.5,
    )


def measure(capture: CaptureModel, volume: np.ndarray, noise: float) -> np.ndarray:
    model = ForwardModel(capture.stack, capture.sensor_shape, capture.scene_shape)
    clean = capture.gain * model.forward((volume * capture.white * capture.irradiance)[None])
    return clean + capture.offset[0] + noise * clean.max() * np.random.default_rng(2).standard_normal(clean.shape)


@pytest.mark.parametrize(("noise_last", "tolerance"), [(0.1, 1e-5), (0.05, 1e-6)])
def test_without_a_prior_it_is_non_negative_least_squares(noise_last: float, tolerance: float) -> None:
    """Against an active-set solver on the matrix of the simulator's forward model, with penalties that rise or stay.

    Multipliers that are not scaled anew when the penalty rises leave an error of 2e-4.
    """
    capture = camera(2)
    volume = np.zeros((2, 1, *SCENE))
    volume[0, 0, 1:4, 1:3], volume[1, 0, 4:7, 2:5] = 1.0, 0.6
    measurement = measure(capture, volume, 0.02)
    model = ForwardModel(capture.stack, capture.sensor_shape, capture.scene_shape)
    unit = np.eye(volume.size).reshape(-1, *volume.shape)
    columns = [(2 * 1.5 * model.forward((each * capture.irradiance)[None])).ravel() for each in unit]
    best, _ = nnls(np.stack(columns, axis=1), (measurement - 0.1).ravel())
    prior = Plain()
    method = PlugAndPlay(
        capture, denoiser=prior, prior=0.05, noise_first=0.3, noise_last=noise_last, iterations=300, dtype=torch.float64
    )
    found = method(torch.from_numpy(measurement)[None])[0].numpy()
    assert found.min() >= 0
    np.testing.assert_allclose(found.ravel(), best, atol=tolerance)
    unit = noise_level((torch.from_numpy(measurement)[None] - 0.1) * method.scale)
    np.testing.assert_allclose(torch.cat(prior.told) / unit, 0.3 * (noise_last / 0.3) ** (np.arange(300) / 299))


def test_without_a_prior_it_is_admm_step_by_step() -> None:
    """The penalty is prior / noise^2."""
    capture = camera(2)
    measurement = torch.from_numpy(measure(capture, np.full((2, 1, *SCENE), 0.5), 0.02))[None]
    settings: dict[str, Any] = {"iterations": 7, "dtype": torch.float64}
    plain = PlugAndPlay(capture, denoiser=Plain(), prior=0.05, noise_first=0.1, noise_last=0.1, **settings)
    admm = Admm(capture, tv=0, sparsity=0, weights=(0.5, 0, 0.05 / 0.1**2), **settings)
    torch.testing.assert_close(plain(measurement), admm(measurement), rtol=1e-9, atol=1e-12)


def test_a_prior_finds_a_smooth_picture_at_its_depth() -> None:
    """A smooth bump at one of three depths in much noise: least squares sees it nearest in another one."""
    scene = (16, 16)
    capture = camera(3, scene, (22, 22))
    rows, columns = np.mgrid[-1:1:16j, -1:1:16j]
    volume = np.zeros((3, 1, *scene))
    volume[1, 0] = np.exp(-8 * (rows**2 + columns**2))
    measurement = torch.from_numpy(measure(capture, volume, 0.15))[None]
    settings: dict[str, Any] = {"iterations": 60, "dtype": torch.float64}
    method = PlugAndPlay(capture, denoiser=Smooth(), prior=0.02, noise_first=0.3, noise_last=0.1, **settings)
    found, alone = (each(measurement)[0].numpy() for each in (method, Admm(capture, tv=0, sparsity=0, **settings)))
    errors = [np.sqrt(np.mean((each - volume) ** 2)) for each in (found, alone)]
    assert errors[0] < 0.6 * errors[1]
    assert [int(each.sum(axis=(1, 2, 3)).argmax()) for each in (found, alone)] == [1, 0]


def test_what_is_taken_away_follows_the_noise_of_each_measurement() -> None:
    """White noise on a grey wall, a hundred times as much in the second measurement of a batch."""
    evenly = np.ones((30, 30), np.float32)  # structure as fine as pixels would count as noise
    capture, prior = replace(camera(2, (30, 30), (40, 40)), irradiance=evenly), Plain()
    grey, dark = measure(capture, np.full((2, 1, 30, 30), 0.5), 0.0), 0.1
    noise = np.array([0.002, 0.2]) * (grey.max() - dark)
    drawn = grey + noise[:, None, None, None] * np.random.default_rng(5).standard_normal((2, *grey.shape))
    settings: dict[str, Any] = {"prior": 0.3, "noise_first": 2.0, "noise_last": 0.1, "iterations": 2}
    method = PlugAndPlay(capture, denoiser=prior, dtype=torch.float64, **settings)
    method(torch.from_numpy(drawn))
    np.testing.assert_allclose(prior.told[0], 2.0 * noise * float(method.scale), rtol=0.2)  # 300 values: 0.06
    np.testing.assert_allclose(prior.told[1], prior.told[0] / 20)


@pytest.mark.parametrize(("noise_db", "gain_db"), [(20, 0.5), (30, 2), (50, 6)])
def test_as_it_comes_it_beats_one_colour_in_much_noise_and_in_little(
    tiny_dataset: Path, tiny_camera: CaptureModel, noise_db: float, gain_db: float
) -> None:
    """Six scenes, none tuned on. With one strength for all levels it fell 2 dB behind at 20 dB."""
    examples = ExampleSet(open_dataset(tiny_dataset, "validation"), noise_db=(noise_db, noise_db))
    measured, radiance, *_ = (torch.stack(parts) for parts in zip(*(examples[n] for n in range(6)), strict=True))
    truth = linear_to_srgb(radiance, tiny_camera.white)
    found = build_classical(tiny_camera, "pnp").reconstruct(measured).clamped().image
    grey = truth.mean(dim=(0, 2, 3), keepdim=True).expand_as(truth)
    assert float((psnr(found, truth) - psnr(grey, truth)).mean()) > gain_db


def test_the_misfit_falls_as_iterations_go_on() -> None:
    capture = camera(2)
    volume = np.zeros((2, 1, *SCENE))
    volume[0, 0, 1:4, 1:3], volume[1, 0, 4:7, 2:5] = 1.0, 0.6
    measurement = measure(capture, volume, 0.01)
    model = ForwardModel(capture.stack, capture.sensor_shape, capture.scene_shape)
    misfits = []
    for iterations in (2, 8, 32):
        method = PlugAndPlay(
            capture, denoiser=Smooth(), prior=1e-4, noise_first=0.2, noise_last=0.01, iterations=iterations
        )
        found = method(torch.from_numpy(measurement).float()[None])[0].numpy()
        seen = capture.gain * model.forward((found * capture.white * capture.irradiance)[None])
        misfits.append(float(np.linalg.norm(seen + 0.1 - measurement)))
    assert misfits[0] > 5 * misfits[1] > 0
    assert misfits[1] > 1.05 * misfits[2]  # the last few per cent, slowly: the prior holds against them


def test_each_measurement_is_a_problem_of_its_own() -> None:
    capture = camera(2)
    both = torch.from_numpy(np.stack([measure(capture, np.full((2, 1, *SCENE), x), 0.02) for x in (1.0, 0.2)]))
    method = PlugAndPlay(
        replace(capture), denoiser=Smooth(), prior=0.02, noise_first=0.2, noise_last=0.05, iterations=6,
        dtype=torch.float64,
    )  # fmt: skip
    torch.testing.assert_close(method(both[1:])[0], method(both)[1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"prior": 0.0}, "^prior: "), ({"noise_first": float("nan")}, "^noise_first: "),
     ({"noise_last": 0.0}, "^noise_last: "), ({"noise_last": 0.3}, "^noise_last: "), ({"iterations": 0}, "^iterations: ")],
)  # fmt: skip
def test_refuses(change: dict[str, Any], message: str) -> None:
    settings: dict[str, Any] = {
        "denoiser": Plain(),
        "prior": 0.1,
        "noise_first": 0.2,
        "noise_last": 0.1,
        "iterations": 3,
    }
    with pytest.raises(InputError, match=message):
        PlugAndPlay(camera(2), **settings | change)
