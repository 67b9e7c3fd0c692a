"""Pictures that a denoiser learns from, and its training: it learns, and goes on as if it had never stopped."""

from __future__ import annotations

import pickle
import signal
from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from learning.camera import CaptureModel
from learning.checkpoint import load_denoiser
from learning.classical.method import build_classical
from learning.commands import train_denoiser as command
from learning.config import DenoiserConfig
from learning.data import CACHE, Draw, ExampleSet
from learning.pictures import Pictures
from learning.resume import BEST, LAST
from learning.simulate import Augmentation
from learning.train_denoiser import train_denoiser
from simulator.dataset import open_dataset
from simulator.errors import InputError

Array = NDArray[np.floating]

pytestmark = pytest.mark.usefixtures("ctrl_c")


@pytest.fixture
def pictures(tiny_dataset: Path, tiny_camera: CaptureModel) -> Pictures:
    return Pictures(open_dataset(tiny_dataset, "train"), tiny_camera, (0.01, 0.3), seed=0)


def test_pictures_are_decided_by_seed_sample_and_draw(pictures: Pictures) -> None:
    one, same, other = (pictures[Draw(3, number)] for number in (5, 5, 6))
    assert all(torch.equal(a, b) for a, b in zip(one, same, strict=True))
    assert not torch.equal(one.noisy, other.noisy)


def test_a_cache_keeps_scenes_without_measurements_and_gives_the_same_pictures(
    pictures: Pictures, tiny_dataset: Path, tiny_camera: CaptureModel, tmp_path: Path
) -> None:
    """The scenes that are re-simulated in training, kept once for both."""
    train = open_dataset(tiny_dataset, "train")
    cached = pickle.loads(pickle.dumps(Pictures(train, tiny_camera, (0.01, 0.3), 0, tmp_path)))  # as a worker gets it
    for position in (0, 31):
        assert all(torch.equal(a, b) for a, b in zip(cached[position], pictures[position], strict=True))
    before = sorted(tmp_path.rglob("*"))
    ExampleSet(train, augment=Augmentation(), cache=tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    scene = next(each for each in before if each.name == CACHE)
    assert "measurement" not in (np.load(scene, mmap_mode="r").dtype.names or ())


def test_noise_is_white_and_as_strong_as_said(pictures: Pictures) -> None:
    drawn = [pictures[Draw(n % 32, n)] for n in range(200)]
    levels = np.array([float(each.noise) for each in drawn])
    assert levels.min() >= 0.01
    assert levels.max() <= 0.3
    # Uniform in the logarithm: its mean is that of the ends, with a standard error of log(30) / sqrt(12 x 200)
    assert abs(np.log(levels).mean() - np.log(0.01 * 0.3) / 2) < 3 * np.log(30) / (12 * 200) ** 0.5
    units = torch.stack([(each.noisy - each.clean) / each.noise for each in drawn])
    assert float(units.std()) == pytest.approx(1, abs=0.01)  # 150 000 numbers: 0.002
    assert abs(float(units.mean())) < 0.01


@pytest.fixture
def whole(tiny_dataset: Path, tiny_camera: CaptureModel) -> Callable[[int], tuple[Array, Array]]:
    """Return a function: a scene's light over white, in the camera's colours, with vignetting, and its depth."""
    field = tiny_camera.irradiance / tiny_camera.irradiance.max() / tiny_camera.white
    examples = ExampleSet(open_dataset(tiny_dataset, "train"))

    def light(position: int) -> tuple[Array, Array]:
        example = examples[position]
        colours = np.einsum("ca,ahw->chw", tiny_camera.scene_to_camera, example.radiance.numpy())
        return colours * field, example.depth_m[0].numpy()

    return light


def test_pictures_are_whole_or_one_plane_of_linear_light(pictures: Pictures, whole: Any) -> None:
    """Less than all light where other planes have their share; never more."""
    shares = []
    for number in range(200):
        position = number % 32
        clean = pictures[Draw(position, number)].clean
        assert float(clean.min()) >= 0
        shares.append(float(clean.sum()) / whole(position)[0].sum())
    # Times a brightness of 0.4 to 1.6: whole ones lie within, and planes below what a whole one has at least.
    assert max(shares) < 1.6
    assert sum(share > 0.4 for share in shares) > 0.2 * 200
    assert sum(share < 0.4 for share in shares) > 0.2 * 200


def test_planes_hold_the_light_of_their_depths(pictures: Pictures, whole: Any) -> None:
    """As shares of all light, up to a gain, they rise along disparity and fall again, alike in all colours."""
    planes = 0
    for number in range(60):
        position = number % 32
        light, depth_m = whole(position)
        clean = pictures[Draw(position, number)].clean.numpy()
        if not clean.any():  # a plane that holds nothing
            continue
        seen = light.min(axis=0) > 1e-3 * light.max()
        order = np.argsort(depth_m[seen])
        fits = []
        for turned in (np.rot90(side, turns, (1, 2)) for side in (clean, clean[..., ::-1]) for turns in range(4)):
            for exchanged in permutations(range(3)):
                shares = (turned[list(exchanged)][:, seen] / light[:, seen])[:, order]
                if np.ptp(shares, axis=0).max() < 1e-3 * shares.max():
                    along = shares.mean(axis=0) / shares.max()
                    rises, falls = np.split(np.diff(along), [along.argmax()])
                    fits.append((rises > -1e-3).all() and (falls < 1e-3).all())
                    planes += np.ptp(along) > 0.5
        assert any(fits), number
    assert planes > 15


@pytest.fixture
def denoiser_settings(tiny_dataset: Path, tmp_path: Path) -> Callable[..., DenoiserConfig]:
    def make(output: str = "out", **changes: Any) -> DenoiserConfig:
        plain: dict[str, Any] = {"output": str(tmp_path / output), "seed": 3, "device": "cpu"}
        plain |= {"data": {"train": str(tiny_dataset), "cache": False, "workers": 0}}
        plain |= {"network": {"filters": 4, "levels": 2}, "steps": 5, "batch": 4, "validate_every": 2, "log_every": 1}
        return DenoiserConfig.model_validate(plain | changes)

    return make


def test_learns(denoiser_settings: Callable[..., DenoiserConfig]) -> None:
    config = denoiser_settings(steps=30, validate_every=30, optimiser={"learning_rate": 1e-2})
    best = train_denoiser(config).best
    assert best["psnr_db"] > best["noisy_psnr_db"] + 2  # dB
    assert best["score"] == pytest.approx(-10 * np.log10(best["total"]))  # of squared errors
    _, record = load_denoiser(Path(config.output) / BEST)
    assert record["data sets"]["train"]["samples"] == 32
    assert record["step"] == best["step"]


def test_goes_on_as_if_it_had_never_stopped(denoiser_settings: Callable[..., DenoiserConfig]) -> None:
    def stop(stage: str, done: int, total: int) -> None:
        if done == 2:
            signal.raise_signal(signal.SIGINT)

    whole, parts = denoiser_settings("whole"), denoiser_settings("parts")
    train_denoiser(whole)
    with pytest.raises(KeyboardInterrupt):
        train_denoiser(parts, progress=stop)
    assert train_denoiser(parts).steps == 3
    one, two = (load_denoiser(Path(each.output) / LAST)[0].state_dict() for each in (whole, parts))
    assert all(torch.equal(one[name], two[name]) for name in one)


def test_refuses_another_training_in_its_folder(denoiser_settings: Callable[..., DenoiserConfig]) -> None:
    train_denoiser(denoiser_settings(steps=1))
    with pytest.raises(InputError, match=r"^output: "):
        train_denoiser(denoiser_settings(steps=1, seed=4))


@pytest.mark.slow
def test_pictures_of_another_size_are_refused_before_the_folder_is_made(
    denoiser_settings: Callable[..., DenoiserConfig], tiny_dataset: Path, learning_trial: Any
) -> None:
    counts = {"train": 0, "validation": 1, "test": 0}
    other = learning_trial.generate(dataset=counts, scene={"size": [16, 20]}, psf={"as_captured": None})
    data = {"train": str(tiny_dataset), "validation": str(other), "cache": False, "workers": 0}
    config = denoiser_settings("training", data=data)
    with pytest.raises(InputError, match=r"^data\.validation: .*16 x 20.* 16 x 16"):
        train_denoiser(config)
    assert not Path(config.output).exists()


def test_the_command_trains_what_a_reconstruction_takes(
    tiny_dataset: Path, tiny_capture: CaptureModel, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "denoiser.yaml"
    text = f"output: out\ndata: {{train: {tiny_dataset}, cache: false, workers: 0}}\nsteps: 2\nbatch: 2\n"
    file.write_text(text, encoding="utf-8")
    command(file, ["network.filters=4", "network.levels=2"])
    made = tmp_path / "out" / BEST
    out = capsys.readouterr().out
    assert "2 steps" in out
    assert str(made) in out
    command(file, ["network.filters=4", "network.levels=2"])
    assert "finished before" in capsys.readouterr().out
    _, record = load_denoiser(made)
    assert record["command"].startswith("flatlight train-denoiser denoiser.yaml --set network.filters=4")
    build_classical(tiny_capture, "pnp", {"denoiser": str(made)})
