"""Each section of the file reaches the loop: what the YAML says is what the training does."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

import learning.training.loop as loop
from learning.checkpoint import load_checkpoint
from learning.config.train import TrainConfig
from learning.data import Draw, ExampleSet
from learning.display import measure_white
from learning.losses import ReconstructionLoss
from learning.train import train
from learning.training.folder import BEST, LAST
from simulator.dataset import open_dataset

Settings = Callable[..., TrainConfig]


def test_noise_of_the_file(settings: Settings, monkeypatch: pytest.MonkeyPatch, tiny_dataset: Path) -> None:
    """The first batch is the noiseless measurement with 20 dB of noise, not the stored one of 40 dB."""
    seen: list[torch.Tensor] = []
    step = loop.Training._step

    def spy(self: loop.Training, wrapped: Any, batch: Any, stop: Any) -> bool:
        seen.append(batch.measurement)
        return step(self, wrapped, batch, stop)

    monkeypatch.setattr(loop.Training, "_step", spy)
    train(settings(steps=1, batch=32, data={"noise_db": (20.0, 20.0)}))
    dataset = open_dataset(tiny_dataset, "train")
    order = [draw.position for draw in loop.Batches(32, 32, seed=3).batch(0)]
    clean = torch.stack([torch.from_numpy(dataset.stored(position).measurement()[1]) for position in order])
    peak = clean.amax(dim=(1, 2, 3), keepdim=True)
    error = ((seen[0] - clean) / peak).clamp(-1, 1)
    bright = clean > 0.4 * peak  # four times the noise away from the clipping at 0
    bright &= clean < 1 - 0.4 * peak
    assert float(error[bright].std()) == pytest.approx(0.1, rel=0.03)  # of thousands of pixels
    again = ExampleSet(dataset, noise_db=(20.0, 20.0), seed=3)[Draw(order[0], 0)]
    assert torch.equal(again.measurement, seen[0][0])


def test_white_and_network_of_the_file(settings: Settings, tiny_dataset: Path) -> None:
    result = train(settings(steps=1, network={"filters": 6, "levels": 1}))
    checkpoint = load_checkpoint(result.folder / LAST)
    assert checkpoint.capture.white == measure_white(open_dataset(tiny_dataset, "train")) != 1
    assert checkpoint.architecture["filters"] == 6
    first = next(value for value in checkpoint.network.enhancement.parameters() if value.ndim == 4)
    assert first.shape[0] == 6


def test_gradient_clip_of_the_file(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """Adam hides the length of a gradient, so it is looked at where the optimiser takes it."""
    norms: list[float] = []
    step = torch.optim.AdamW.step

    def spy(self: torch.optim.AdamW, *arguments: Any) -> Any:
        gradients = [value.grad for group in self.param_groups for value in group["params"]]
        norms.append(float(torch.stack([value.norm() for value in gradients if value is not None]).norm()))
        return step(self, *arguments)

    monkeypatch.setattr(torch.optim.AdamW, "step", spy)
    train(settings("clipped", steps=1, optimiser={"gradient_clip": 1e-6}))
    train(settings("free", steps=1))
    assert norms[0] == pytest.approx(1e-6, rel=1e-3)
    assert norms[1] > 1e-3


def test_best_is_the_least_loss(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    totals = iter([3.0, 1.0, 2.0])
    monkeypatch.setattr(
        loop, "validate", lambda *_, **__: {"total": next(totals), "psnr_db": 1.0, "depth_rmse_cm": 1.0}
    )
    result = train(settings(steps=3, validate_every=1))
    assert (result.best["step"], result.best["total"]) == (2, 1.0)
    assert load_checkpoint(result.folder / BEST).record["step"] == 2
    record = load_checkpoint(result.folder / LAST).record
    assert (record["validation"]["best"]["step"], record["validation"]["last"]["total"]) == (2, 2.0)


def test_seeds_make_the_same_loss_small(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []
    build = ReconstructionLoss.__init__

    def spy(self: ReconstructionLoss, *arguments: Any, seed: int, **others: Any) -> None:
        made.append(seed)
        build(self, *arguments, seed=seed, **others)

    monkeypatch.setattr(ReconstructionLoss, "__init__", spy)
    for seed in (1, 2):
        train(settings(f"seed{seed}", steps=1, seed=seed))
    train(settings("another", steps=1, loss={"perceptual_seed": 5}))
    assert made == [0, 0, 5]


def test_a_record_names_no_folder_of_this_machine(settings: Settings, tiny_dataset: Path, tmp_path: Path) -> None:
    first = train(settings("first", steps=1))
    config = settings("made here", steps=2, start=str(first.folder / LAST), data={"cache": str(tmp_path / "cache")})
    path = tmp_path / "tiny.yaml"
    path.write_text(json.dumps(config.dump()))
    overrides = ["steps=1", f"output={tmp_path / 'over there'}", f"data.validation={tiny_dataset}"]
    result = train(path, overrides)
    record = load_checkpoint(result.folder / LAST).record
    text = json.dumps(record)
    assert "/" not in text.replace("1/m", "")
    assert "\\\\" not in text
    assert str(tmp_path.parent).encode() not in (result.folder / LAST).read_bytes()
    assert record["command"] == (
        f"flatlight train tiny.yaml --set steps=1 --set 'output=over there' --set data.validation={tiny_dataset.name}"
    )
    assert record["config"]["start"] == LAST
    assert record["config"]["data"]["stack"] == "nominal"
    dataset = open_dataset(tiny_dataset, "train")
    assert record["data sets"]["train"]["fingerprint"] == dataset.fingerprint
    assert record["data sets"]["train"]["name"] == dataset.info.name
    assert record["start"]["architecture"] == load_checkpoint(first.folder / LAST).architecture
