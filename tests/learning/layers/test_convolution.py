"""Convolution of stacks: in bfloat16 the gradient is float32's, whatever memory held before."""

import pytest
import torch

from learning.layers.convolution import Conv3d


def fill_freed_memory_with_nan():
    for size in (64, 256, 864, 1728, 4096, 8192, 65536):
        [torch.full((size,), float("nan")) for _ in range(8)]


@pytest.mark.parametrize("frames", [1, 2, 3, 8])
@pytest.mark.parametrize("groups", [1, 16])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last_3d])
def test_bfloat16_gradient_is_that_of_float32(frames, groups, layout):
    torch.manual_seed(0)
    convolution = Conv3d(16, 16, 3, padding=1, groups=groups)
    image = torch.randn(2, 16, frames, 6, 6).contiguous(memory_format=layout)
    wanted = torch.autograd.grad(convolution(image).square().mean(), list(convolution.parameters()))
    for _ in range(3):
        fill_freed_memory_with_nan()
        with torch.autocast("cpu", torch.bfloat16):
            made = convolution(image)
        found = torch.autograd.grad(made.float().square().mean(), list(convolution.parameters()))
        for one, true in zip(found, wanted, strict=True):
            assert float((one - true).norm() / true.norm()) < 0.02  # 8 bits of mantissa: 0.004 a factor
