"""Denoising: what it removes, what it keeps, and that it is recorded, refused where absent and the same every time."""

from __future__ import annotations

import importlib.util
import subprocess
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render import Environment, Material, Renderer, Scene, Sphere, SphereLight, activate
from simulator.render.denoise import check_denoiser, denoise, guides
from simulator.render.mitsuba_scene import load_scene
from simulator.types import Clip, View

VIEW = View((24, 24), 80e-6, 1.9e-3, 0.036, 0.2)
Picture = NDArray[np.float32]


@pytest.fixture
def needs_oidn() -> None:
    if importlib.util.find_spec("pyoidn") is None:
        pytest.skip("pyoidn is not installed: pip install 'flatlight[denoise]'")


def noisy_picture() -> tuple[Picture, Picture, Picture, Picture]:
    """A striped wall under light that falls off smoothly: truth, the same with the noise of few paths, albedo, normal."""
    row, column = np.mgrid[:64, :64] / 64
    stripes = np.where((column * 64 // 8 + row * 64 // 16) % 2 == 0, 0.7, 0.2)
    albedo = (stripes[..., np.newaxis] * (1.0, 0.8, 0.5)).astype(np.float32)
    truth = (albedo * (0.3 + np.cos(row - 0.3) * np.cos(column - 0.6))[..., np.newaxis] * 3).astype(np.float32)
    noise = np.random.default_rng(1).gamma(
        4, 1 / 4, (64, 64, 1)
    )  # mean 1, deviation 0.5: most of a path's light or none
    normal = np.broadcast_to(np.array([0, 0, -1], np.float32), truth.shape)
    return truth, (truth * noise).astype(np.float32), albedo, normal


def error(found: Picture, truth: Picture) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


@pytest.mark.usefixtures("needs_oidn")
def test_noise_goes_and_light_above_one_stays() -> None:
    truth, noisy, albedo, normal = noisy_picture()
    found = denoise(noisy, albedo, normal)
    assert truth.max() > 2, "the picture must be brighter than white"
    assert error(noisy, truth) == pytest.approx(0.5, rel=0.05)
    # A mean over the 4000 pixels would leave 0.01; a window of 7 x 7 pixels 0.07. It must be as good as such a window.
    assert error(found, truth) < 0.07
    # Its light is right on the whole, up to the noise's own mean (0.5 / 64) and the bias, about a percent.
    np.testing.assert_allclose(found.mean(axis=(0, 1)), truth.mean(axis=(0, 1)), rtol=0.03)


@pytest.mark.usefixtures("needs_oidn")
def test_torch_stays_out_of_it(python: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    script = (
        "import sys, importlib.util; from simulator.render.denoise import denoiser_name; print(denoiser_name()); "
        "assert 'torch' not in sys.modules"
    )
    done = python("-c", script)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("oidn 2.")


@pytest.mark.usefixtures("needs_oidn")
def test_without_noise_little_changes() -> None:
    truth, _, albedo, normal = noisy_picture()
    assert error(denoise(truth, albedo, normal), truth) < 0.02


@pytest.mark.usefixtures("needs_oidn")
def test_the_same_bytes_for_every_run_and_number_of_threads() -> None:
    _, noisy, albedo, normal = noisy_picture()
    first = denoise(noisy, albedo, normal)
    for threads in (1, 2, 3):
        assert denoise(noisy, albedo, normal, threads).tobytes() == first.tobytes()
    assert denoise(noisy[:, ::-1], albedo[:, ::-1], normal).tobytes() != first.tobytes(), (
        "no view of the array is misread"
    )
    mirrored = denoise(noisy[:, ::-1].copy(), albedo[:, ::-1].copy(), normal)
    assert denoise(noisy[:, ::-1], albedo[:, ::-1], normal).tobytes() == mirrored.tobytes()


def test_guides_are_means_over_the_pixel(geometry: Any) -> None:
    left = (
        0.1 * 0.25 * VIEW.pixel_pitch_m / VIEW.distance_m
    )  # a quarter pixel off the middle: 0.75 of pixel 12 is covered
    wall = geometry.upright(left, -0.9, 0.9, 0.9, 0.1, geometry.plain(0.8, 0.4, 0.2))
    activate("scalar_rgb")
    albedo, normal = guides(load_scene(Scene((wall,), (Environment(np.ones(3)),)), VIEW, 5), seed=4)
    # 4 x 4 strata give the share of a quarter exactly.
    expected = np.repeat([0.0, 0.75, 1.0], (12, 1, 11))[:, np.newaxis]
    np.testing.assert_allclose(albedo, np.broadcast_to(expected * (0.8, 0.4, 0.2), albedo.shape), atol=1e-6)
    np.testing.assert_allclose(normal, np.broadcast_to(expected * (0, 0, -1), normal.shape), atol=1e-6)


@pytest.mark.usefixtures("needs_oidn")
def test_a_denoised_still_has_less_error_and_says_so() -> None:
    grey = Material(np.full((2, 2, 3), 0.6, np.float32))
    ball = Sphere(np.array([0.0, 0.0, 0.1]), 0.03, grey, np.eye(3))
    wall = Sphere(np.array([0.0, 0.0, 5.15]), 5.0, grey, np.eye(3))
    lamp = SphereLight(np.array([0.5, -0.5, -0.3]), 0.3, np.array([10.0, 9, 8]))
    scene = Scene((ball, wall), (lamp,))

    def still(renderer: Renderer, samples: int, seed: int) -> Clip:
        return renderer.still(scene, VIEW, samples_per_pixel=samples, seed=seed, source={"family": "ball"})

    plain = still(Renderer("scalar_rgb"), 4, 3)
    clean = still(Renderer("scalar_rgb", denoise=True), 4, 3)
    truth = still(Renderer("scalar_rgb"), 256, 4)
    assert error(clean.rgb, truth.rgb) < 0.7 * error(plain.rgb, truth.rgb)
    assert clean.depth_m.tobytes() == plain.depth_m.tobytes()
    assert clean.source.pop("denoised").startswith("oidn 2.")
    assert clean.source == plain.source


def test_a_missing_package_is_named_before_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for ask in (check_denoiser, lambda: Renderer("scalar_rgb", denoise=True)):
        with pytest.raises(InputError, match=r"^render\.denoise: "):
            ask()
    Renderer("scalar_rgb")
