"""NAF networks: one block against loops in NumPy, sizes, frames, layouts, gradients."""

import numpy as np
import pytest
import torch
from torch import nn

from learning.layers.naf import NafBlock, NafNet
from simulator.errors import InputError


def randomised(network: nn.Module, seed: int = 0) -> nn.Module:
    """Give each parameter numbers of its own, residual scales, norms and biases too."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, generator=generator, dtype=parameter.dtype))
    return network


def block_by_loops(x: np.ndarray, w: dict[str, np.ndarray]) -> np.ndarray:
    """Return a NAF block's output ``(C, h, w)``, pixel by pixel, as equations of the paper's figure 3c."""
    channels, height, width = x.shape

    def norm(pixel, name):
        return (pixel - pixel.mean()) / np.sqrt(pixel.var() + 1e-6) * w[f"{name}.weight"] + w[f"{name}.bias"]

    def mix(pixel, name):
        return w[f"{name}.weight"].reshape(-1, len(pixel)) @ pixel + w[f"{name}.bias"]

    wide = np.zeros((2 * channels, height + 2, width + 2))  # the depthwise convolution sees zeros outside
    for r in range(height):
        for c in range(width):
            wide[:, r + 1, c + 1] = mix(norm(x[:, r, c], "norm"), "widen")
    gated = np.zeros_like(x)
    for r in range(height):
        for c in range(width):
            near = (wide[:, r : r + 3, c : c + 3] * w["spread.weight"][:, 0]).sum((1, 2)) + w["spread.bias"]
            gated[:, r, c] = near[:channels] * near[channels:]
    gated *= mix(gated.mean((1, 2)), "attend")[:, None, None]
    out = x.copy()
    for r in range(height):
        for c in range(width):
            out[:, r, c] += w["beta"].ravel() * mix(gated[:, r, c], "narrow")
            wide_pixel = mix(norm(out[:, r, c], "mix_norm"), "mix_widen")
            out[:, r, c] += w["gamma"].ravel() * mix(wide_pixel[:channels] * wide_pixel[channels:], "mix_narrow")
    return out


def test_block_is_the_published_one(double):
    block = randomised(NafBlock(5))
    image = torch.randn(1, 5, 6, 7, generator=torch.Generator().manual_seed(1))
    wanted = block_by_loops(image[0].numpy(), {name: value.numpy() for name, value in block.state_dict().items()})
    with torch.no_grad():
        np.testing.assert_allclose(block(image)[0].numpy(), wanted, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_block_begins_as_the_identity(dimensions):
    image = torch.randn(2, 4, *(5,) * dimensions)
    with torch.no_grad():
        assert torch.equal(NafBlock(4, dimensions)(image), image)


@pytest.mark.parametrize(("size", "stem"), [((16, 16), 1), ((17, 19), 1), ((1, 30), 1), ((24, 20), 2), ((13, 21), 4)])
def test_any_size_of_image(size, stem):
    network = NafNet(5, 2, filters=4, levels=3, stem=stem)
    image = torch.rand(2, 5, *size)
    continued = nn.functional.pad(image, (0, -size[1] % (4 * stem), 0, -size[0] % (4 * stem)), mode="replicate")
    with torch.no_grad():
        torch.testing.assert_close(network(image), network(continued)[..., : size[0], : size[1]])


@pytest.mark.parametrize("size", [(1, 8, 8), (2, 9, 7), (5, 16, 12)])
def test_any_number_of_frames(size):
    assert NafNet(3, 4, filters=2, levels=3, dimensions=3)(torch.rand(2, 3, *size)).shape == (2, 4, *size)


def test_one_frame_in_3d_is_an_image(double):
    """The frames before and after are zeros, as are pixels outside: the kernels' middle slices are a network in 2D."""
    solid = randomised(NafNet(3, 2, filters=4, blocks=2, levels=1, dimensions=3))
    flat = NafNet(3, 2, filters=4, blocks=2, levels=1)
    flat.load_state_dict(
        {name: w[:, :, w.shape[2] // 2] if w.ndim == 5 else w.reshape(flat.state_dict()[name].shape)
         for name, w in solid.state_dict().items()}
    )  # fmt: skip
    image = torch.rand(2, 3, 9, 8)
    with torch.no_grad():
        torch.testing.assert_close(solid(image[:, :, None])[:, :, 0], flat(image))


def test_each_picture_of_a_batch_stands_alone(double):
    """No statistics over a batch: a picture's output does not depend on its neighbours, nor on training or evaluation."""
    network, batch = randomised(NafNet(3, 2, filters=4, levels=2)), torch.rand(4, 3, 12, 10)
    order = torch.tensor([2, 0, 3, 1])
    with torch.no_grad():
        together = network.train()(batch)
        torch.testing.assert_close(network(batch[order]), together[order])
        torch.testing.assert_close(network.eval()(batch[:1]), together[:1])


def test_skips_join_levels_of_their_own():
    """Without its skips the picture is seen through the deepest level only."""
    torch.manual_seed(0)
    network, image = NafNet(1, 1, filters=4, levels=3), torch.rand(1, 1, 16, 16)
    for enlarge in network.enlarge:
        nn.init.zeros_(enlarge.get_parameter("mix.weight"))
    with torch.no_grad():  # with blocks that hand on, what remains is intro and head
        torch.testing.assert_close(network(image), network.head(network.intro(image)))


def test_channels_last_gives_the_same():
    network = randomised(NafNet(3, 2, filters=8, levels=3))
    image = torch.rand(2, 3, 24, 24)
    with torch.no_grad():
        plain = network(image)
        other = network.to(memory_format=torch.channels_last)(image.to(memory_format=torch.channels_last))
    torch.testing.assert_close(other, plain, atol=1e-4, rtol=1e-4)  # another order of float32 sums


@pytest.mark.parametrize("dimensions", [2, 3])
def test_bfloat16_autocast_trains(dimensions):
    torch.manual_seed(0)
    network = randomised(NafNet(3, 2, filters=4, blocks=2, levels=3, dimensions=dimensions))
    with torch.autocast("cpu", torch.bfloat16):
        network(torch.rand(2, 3, *(8,) * dimensions)).float().square().mean().backward()
    gradients = {name: parameter.grad for name, parameter in network.named_parameters()}
    assert [name for name, g in gradients.items() if g is None or not torch.isfinite(g).all() or not g.any()] == []


def test_layout_is_kept_without_copies():
    """Each block gets and gives its channels side by side in memory: that is where its speed comes from."""
    strides = []
    network = NafNet(3, 2, filters=4, levels=3)
    for module in network.modules():
        if isinstance(module, NafBlock):
            module.register_forward_hook(lambda _m, given, made: strides.append((given[0].stride(1), made.stride(1))))
    network(torch.rand(2, 3, 16, 16))
    assert strides == [(1, 1)] * 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"blocks": 0}, "^blocks: "), ({"dimensions": 3, "stem": 2}, "^dimensions: ")],
)
def test_refuses(arguments, message):
    with pytest.raises(InputError, match=message):
        NafNet(3, 2, **arguments)
