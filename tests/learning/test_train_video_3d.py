"""Training a VideoNet3D: it learns, begins with a FlatNet3D that it leaves alone, and says what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel, capture_model
from learning.checkpoint import load_checkpoint
from learning.clip_examples import ClipExample
from learning.clip_loss import ClipDepthLoss
from learning.config import Video3DLossConfig, Video3DTrainConfig, training_kind
from learning.data import ExampleSet
from learning.method import Estimate, linear_to_srgb
from learning.resume import BEST, LAST
from learning.simulate import Augmentation
from learning.train_video_3d import Video3DTraining, train_video_3d
from learning.validation import PREVIEW
from simulator.dataset import open_dataset
from simulator.errors import InputError

Settings = Callable[..., Video3DTrainConfig]


@pytest.fixture
def moving_settings(moving_dataset: Path, checkpoints: list[Path], tmp_path: Path) -> Settings:
    """Return a function that makes a small training; sections are changed key by key."""

    def make(output: str = "out", **changes: Any) -> Video3DTrainConfig:
        data = {"train": str(moving_dataset), "cache": str(tmp_path / "cache"), "workers": 0, "draws": 1}
        plain: dict[str, Any] = {"name": "tiny", "output": str(tmp_path / output), "seed": 3, "data": data}
        plain |= {"network": {"name": "videonet3d", "size": "tiny", "joint_iterations": 3}, "device": "cpu"}
        plain |= {"init_from": str(checkpoints[0]), "steps": 8, "batch": 4, "validate_every": 4, "log_every": 2}
        for key, value in changes.items():
            plain[key] = plain[key] | value if isinstance(value, dict) and key in plain else value
        return Video3DTrainConfig.model_validate(plain)

    return make


@pytest.mark.slow
def test_learns_frames_and_depth_beyond_its_flatnet(
    moving_settings: Settings, moving_dataset: Path, checkpoints: list[Path]
) -> None:
    idle = train_video_3d(moving_settings("idle", steps=1, optimiser={"learning_rate": 1e-9}))
    changes: dict[str, Any] = {"optimiser": {"learning_rate": 5e-3}, "data": {"augment": Augmentation(still=0.3)}}
    result = train_video_3d(moving_settings(steps=60, validate_every=20, **changes))
    # Eight clips of random textures: little of them can be known from the other ones.
    assert result.best["score"] > idle.best["score"] + 0.5
    for name in ("psnr_db", "moving_psnr_db", "depth_rmse_cm", "depth", "intensity"):
        assert np.isfinite(result.best[name])
    assert (result.folder / PREVIEW).stat().st_size > 1000
    best = load_checkpoint(result.folder / BEST, network="videonet3d")
    flat = load_checkpoint(checkpoints[0])
    assert best.architecture["still"] == flat.architecture
    weights = best.network.state_dict()
    for name, values in flat.network.state_dict().items():
        assert torch.equal(weights[f"joint.still.{name}"], values), name

    # What was logged, from the file, clip by clip in NumPy
    validation = open_dataset(moving_dataset, "validation")
    capture = capture_model(validation, white=best.capture.white)
    psnrs, errors_cm = [], []
    for measurement, radiance, depth_m, valid in ExampleSet(validation):
        with torch.no_grad():
            image, disparity = (each[0].double().numpy().clip(0, 1) for each in best.network(measurement[None]))
        truth = linear_to_srgb(radiance.double(), capture.white).numpy()
        psnrs.append(-10 * np.log10(np.mean((image - truth) ** 2)))
        found_cm = 100 / (1 / 0.2 + disparity * (1 / 0.01 - 1 / 0.2))
        errors_cm.append(np.sqrt(np.mean((found_cm - 100 * depth_m.numpy())[valid.numpy()] ** 2)))
    # What validation begins with is kept in half precision, and so is the depth
    assert result.best["psnr_db"] == pytest.approx(np.mean(psnrs), abs=0.05)
    assert result.best["depth_rmse_cm"] == pytest.approx(np.mean(errors_cm), rel=5e-3)
    score = (result.best["psnr_db"] + result.best["moving_psnr_db"]) / 2 - 20 * np.log10(result.best["depth_rmse_cm"])
    assert result.best["score"] == pytest.approx(score, rel=1e-9)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_a_gpu_finds_what_a_cpu_finds(moving_settings: Settings) -> None:
    """With what it begins with computed ahead, there, and kept apart."""
    found = [
        train_video_3d(moving_settings(device, device=device, steps=1, optimiser={"learning_rate": 1e-9})).best
        for device in ("cpu", "cuda")
    ]
    # Conjugate gradients amplify rounding to some 1e-3, and the network's body runs in bfloat16: 2^-9
    assert found[1]["psnr_db"] == pytest.approx(found[0]["psnr_db"], abs=0.1)
    assert found[1]["depth_rmse_cm"] == pytest.approx(found[0]["depth_rmse_cm"], rel=0.02)


@pytest.mark.slow
def test_a_resumed_training_is_the_same(moving_settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    changes: dict[str, Any] = {"data": {"augment": Augmentation(still=0.5)}}
    whole = train_video_3d(moving_settings("whole", **changes))
    first, step = moving_settings("parts", **changes), Video3DTraining._step

    def stopped(training: Video3DTraining, wrapped: Any, batch: Any, stop: Any) -> bool:
        stop.wanted = training.progress.step == 4  # of 8
        return step(training, wrapped, batch, stop)

    monkeypatch.setattr(Video3DTraining, "_step", stopped)
    with pytest.raises(KeyboardInterrupt):
        train_video_3d(first)
    monkeypatch.setattr(Video3DTraining, "_step", step)
    again = train_video_3d(first)
    assert again.steps == 3
    one, other = (load_checkpoint(each.folder / LAST).network.state_dict() for each in (whole, again))
    for name, values in one.items():
        assert torch.equal(values, other[name]), name


def test_what_nobody_saw_is_not_learned(tiny_capture: CaptureModel) -> None:
    """A depth of 0 means that a pixel saw nothing."""
    training = Video3DTraining.__new__(Video3DTraining)
    training._capture, training._loss = tiny_capture, ClipDepthLoss(Video3DLossConfig(), tiny_capture)
    radiance = torch.rand(1, 4, 3, 16, 16)
    depth_m = torch.full((1, 4, 1, 16, 16), 0.05)
    depth_m[0, 1, 0, 2, 3] = 0
    nothing = torch.zeros(0)
    example = ClipExample(nothing, radiance, nothing, nothing, nothing, depth_m)

    def total(*place: int) -> float:
        disparity = torch.full_like(depth_m, 0.5)
        disparity[place] = 0.1
        return float(training._losses(Estimate(radiance, disparity), example)["total"])

    assert total(0, 1, 0, 2, 3) != total(0, 1, 0, 2, 4)
    depth_m[0, 1, 0, 2, 4] = 0
    assert total(0, 1, 0, 2, 3) == total(0, 1, 0, 2, 4)


@pytest.mark.slow
def test_goes_on_from_one_of_its_own(moving_settings: Settings) -> None:
    first = train_video_3d(moving_settings("first", steps=4)).folder / BEST
    again = train_video_3d(moving_settings("again", steps=1, init_from=str(first), optimiser={"learning_rate": 1e-9}))
    known = load_checkpoint(first)
    assert again.best["psnr_db"] == pytest.approx(known.record["validation"]["best"]["psnr_db"], abs=1e-3)
    with pytest.raises(InputError, match=r"best\.safetensors: .*; take a checkpoint of the same size"):
        train_video_3d(moving_settings("other", init_from=str(first), network={"filters": 4}))


def test_what_makes_no_sense_is_refused(
    moving_settings: Settings, clip_dataset: Path, tiny_dataset: Path, clip_checkpoint: Path
) -> None:
    with pytest.raises(InputError, match=r"^init_from: got a checkpoint of videonet, .*expected a flatnet3d"):
        train_video_3d(moving_settings(init_from=str(clip_checkpoint)))
    with pytest.raises(InputError, match=r"^stack: got one plane, expected several"):
        train_video_3d(moving_settings(data={"train": str(clip_dataset)}))
    with pytest.raises(InputError, match=r"^capture: got the camera of stills"):
        train_video_3d(moving_settings(data={"train": str(tiny_dataset)}))
    assert training_kind({"network": {"name": "videonet3d"}}) is Video3DTrainConfig
