"""Processes that share a batch train as one does."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from learning.camera import CaptureModel
from learning.config import TrainConfig, load_file
from learning.distributed import Precision, Processes, processes
from learning.models import build_network
from learning.resume import LAST
from learning.train import FlatNetTraining, train
from learning.validation import METRICS
from simulator.errors import InputError

ROOT = Path(__file__).resolve().parents[3]


def test_cuda_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match=r"^device: "), processes("cuda"):
        pass


def test_batch_statistics_of_one_process_are_not_those_of_all(settings: Callable[..., TrainConfig]) -> None:
    """Only on GPUs, where torch takes them over all processes."""
    config = settings(batch=6, network={"body": "unet"})
    both = Processes(torch.device("cpu"), 0, 2)
    with pytest.raises(InputError, match=r"^network\.body: "):
        FlatNetTraining.plan(config, both)
    FlatNetTraining.plan(config, Processes(torch.device("cpu")))
    FlatNetTraining.plan(settings(batch=6), both)


def test_what_processes_cannot_share_is_named(settings: Callable[..., TrainConfig]) -> None:
    """A batch in equal parts; of the 8 validation scenes each needs one, and some may have more than others."""
    FlatNetTraining.plan(settings(batch=6), Processes(torch.device("cpu"), 0, 3))
    for key, batch, count in (("batch", 5, 2), (r"data\.validation", 9, 9)):
        with pytest.raises(InputError, match=f"^{key}: "):
            FlatNetTraining.plan(settings(batch=batch), Processes(torch.device("cpu"), 0, count))


@pytest.mark.slow
def test_two_processes_are_one_with_the_whole_batch(tiny_dataset: Path, tmp_path: Path) -> None:
    data = {"train": str(tiny_dataset), "cache": str(tmp_path / "cache"), "workers": 0, "noise_db": [30.0, 40.0]}
    plain = {"name": "tiny", "output": "one", "data": data, "network": {"size": "tiny"}}
    plain |= {"steps": 10, "batch": 6, "log_every": 1, "validate_every": 5, "device": "cpu"}
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(plain))
    train(load_file(TrainConfig, path))
    script = tmp_path / "run.py"
    code = "from learning.config import TrainConfig, load_file\nfrom learning.train import train\n"
    script.write_text(f"{code}train(load_file(TrainConfig, {str(path)!r}, ['output=two']))\n")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", str(script)]
    env = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    options: Any = {"cwd": ROOT, "env": env, "capture_output": True, "text": True, "timeout": 300, "check": False}
    done = subprocess.run(command, **options)
    assert done.returncode == 0, done.stderr
    assert "FutureWarning" not in done.stderr
    logs = ((tmp_path / name / METRICS).read_text() for name in ("one", "two"))
    one, two = ([json.loads(line) for line in log.splitlines()] for log in logs)
    assert len(one) == len(two) == 12
    for first, second in zip(one, two, strict=True):
        assert (first["step"], first["kind"]) == (second["step"], second["kind"])
        # Sums in another order: 1e-6 in a step, which ten steps of Adam make larger.
        assert second["total"] == pytest.approx(first["total"], rel=1e-3 if first["step"] > 1 else 1e-5)
        assert second["depth"] == pytest.approx(first["depth"], rel=1e-3)
    assert (tmp_path / "two" / LAST).exists()
    # One that cannot have the folder tells the others, which would wait for it for hours.
    script.write_text(f"{code}train(load_file(TrainConfig, {str(path)!r}, ['output=two', 'seed=9']))\n")
    done = subprocess.run(command, **options | {"timeout": 100})
    assert done.returncode != 0
    assert "seed: 0 -> 9" in done.stderr


CPU = torch.device("cpu")


@pytest.mark.parametrize("body", ["naf", "unet"])
def test_inversion_stays_exact(tiny_capture: CaptureModel, body: str) -> None:
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "tiny", body=body).eval()
    given, kinds = [], []
    network.enhancement.register_forward_pre_hook(lambda _, inputs: given.append(inputs[0]))
    network.enhancement.register_forward_hook(lambda _, __, output: kinds.append(output.dtype))
    measurement = 0.1 + 0.1 * torch.rand(2, 3, 48, 48)
    with torch.no_grad():
        exact, mixed = (Precision(kind, CPU).estimate(network, measurement) for kind in ("float32", "bfloat16"))
    assert torch.equal(given[0], given[1])
    assert kinds == [torch.float32, torch.bfloat16]
    assert mixed.image.dtype == mixed.disparity.dtype == torch.float32
    error = (mixed.image - exact.image).norm() / exact.image.norm()
    assert 1e-4 < error < 5e-2  # bfloat16 rounds each number by up to 2^-9 = 2e-3; ten layers


def test_auto_is_float32_on_a_cpu() -> None:
    assert Precision.choose("auto", CPU).kind == "float32"
    assert Precision.choose("bfloat16", CPU).kind == "bfloat16"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_auto_on_cuda() -> None:
    device = torch.device("cuda")
    expected = "bfloat16" if torch.cuda.is_bf16_supported(including_emulation=False) else "float32"
    assert Precision.choose("auto", device).kind == expected
