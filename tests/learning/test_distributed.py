"""Processes that share a batch train as one does."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import torch.distributed as dist
import yaml
from torch import nn

from learning.camera import CaptureModel
from learning.distributed import Precision, processes, synchronise_batch_norm
from learning.models import build_network
from learning.resume import LAST
from learning.train import train
from learning.validation import METRICS
from simulator.errors import InputError

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def lone_group(tmp_path: Path) -> Iterator[None]:
    """A group of one process."""
    dist.init_process_group("gloo", init_method=f"file://{tmp_path / 'meet'}", rank=0, world_size=1)
    yield
    dist.destroy_process_group()


@pytest.mark.usefixtures("lone_group")
@pytest.mark.parametrize("affine", [True, False])
def test_batch_norm_of_one_is_torchs(affine: bool) -> None:
    torch.manual_seed(0)
    own, theirs = (nn.Sequential(nn.BatchNorm2d(3, affine=affine)).double() for _ in range(2))
    synchronise_batch_norm(own, "cpu")
    assert type(own[0]) is not type(theirs[0])
    images = 5 + 3 * torch.randn(4, 3, 6, 5, dtype=torch.float64)
    inputs = [images.clone().requires_grad_() for _ in range(2)]
    weights = torch.randn(4, 3, 6, 5, dtype=torch.float64)
    outputs = [layer(given) for layer, given in zip((own, theirs), inputs, strict=True)]
    for output in outputs:
        (output * weights).sum().backward()
    # Sums in another order, float64.
    assert torch.allclose(outputs[0], outputs[1], atol=1e-12)
    assert torch.allclose(inputs[0].grad, inputs[1].grad, atol=1e-12)  # pyright: ignore[reportArgumentType]
    for name, value in theirs.state_dict().items():
        assert torch.allclose(own.state_dict()[name], value, atol=1e-12), name
    if affine:
        assert torch.allclose(own[0].weight.grad, theirs[0].weight.grad, rtol=1e-12)  # pyright: ignore
    own.eval()
    theirs.eval()
    assert torch.allclose(own(images), theirs(images), atol=1e-12)


def test_cuda_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match=r"^device: "), processes("cuda"):
        pass


@pytest.mark.slow
def test_two_processes_are_one_with_the_whole_batch(tiny_dataset: Path, tmp_path: Path) -> None:
    data = {"train": str(tiny_dataset), "cache": str(tmp_path / "cache"), "workers": 0, "noise_db": [30.0, 40.0]}
    plain = {"name": "tiny", "output": "one", "data": data, "network": {"size": "tiny", "attention": True}}
    plain |= {"steps": 10, "batch": 6, "log_every": 1, "validate_every": 5, "device": "cpu"}
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(plain))
    train(path)
    script = tmp_path / "run.py"
    script.write_text(f"from learning.train import train\ntrain({str(path)!r}, ['output=two'])\n")
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
    script.write_text(f"from learning.train import train\ntrain({str(path)!r}, ['output=two', 'seed=9'])\n")
    done = subprocess.run(command, **options | {"timeout": 100})
    assert done.returncode != 0
    assert "seed: 0 -> 9" in done.stderr


CPU = torch.device("cpu")


def test_inversion_stays_exact(tiny_capture: CaptureModel) -> None:
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "tiny").eval()
    volumes, kinds = [], []
    network.inversion.register_forward_hook(lambda _, __, output: volumes.append(output))
    network.enhancement.register_forward_hook(lambda _, __, output: kinds.append(output.dtype))
    measurement = 0.1 + 0.1 * torch.rand(2, 3, 48, 48)
    with torch.no_grad():
        exact, mixed = (Precision(kind, CPU).estimate(network, measurement) for kind in ("float32", "bfloat16"))
    assert torch.equal(volumes[0], volumes[1])
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
