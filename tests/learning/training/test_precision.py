"""bfloat16 reaches the U-Net only."""

import pytest
import torch

from learning.capture import CaptureModel
from learning.models import build_network
from learning.training.precision import Precision

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
    assert mixed.picture.dtype == mixed.disparity.dtype == torch.float32
    error = (mixed.picture - exact.picture).norm() / exact.picture.norm()
    assert 1e-4 < error < 5e-2  # bfloat16 rounds each number by up to 2^-9 = 2e-3; ten layers


def test_auto_is_float32_on_a_cpu() -> None:
    assert Precision.choose("auto", CPU).kind == "float32"
    assert Precision.choose("bfloat16", CPU).kind == "bfloat16"


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_auto_on_cuda() -> None:
    device = torch.device("cuda")
    expected = "bfloat16" if torch.cuda.is_bf16_supported(including_emulation=False) else "float32"
    assert Precision.choose("auto", device).kind == expected
