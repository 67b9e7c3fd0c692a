"""The networks: shapes, what they share, what they refuse; and the same network as a method."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from learning.layers.inversion import RegularisedInversion
from learning.layers.noise import noise_level
from learning.layers.unet import UNet
from learning.method import Clock, linear_to_srgb
from learning.models import SIZES, LearnedMethod, build_network
from learning.models.flatnet import Inverted, hyperfocal_plane
from simulator.errors import InputError
from simulator.optics.stack import depth_planes

# Every choice beside the thesis's, by itself and together, on both bodies.
KINDS = [
    {},
    {"body": "unet"},
    {"body": "unet", "attention": True, "stem": 2},
    {"stem": 2, "blocks": 2},
    {"refinements": 1},
    {"refinements": 1, "repeats": 2},
    {"refinements": 2, "stem": 2, "noise_aware": False},
    {"noise_aware": False, "joint": False, "refinements": 0, "repeats": 0, "head": "linear"},
    {"body": "unet", "noise_aware": False},
    {"joint": False},
    {"body": "unet", "head": "linear"},
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("name", "planes"), [("flatnet3d", (0, 1, 2)), ("flatnet2d", (1,))])
def test_everything_learns(tiny_capture, name, planes, kind):
    """After two steps: refinements and NAF blocks begin at nothing, and all behind them learns from then on."""
    torch.manual_seed(0)
    network = build_network(tiny_capture, name, "tiny", **kind)
    assert network.inversion.planes == planes
    assert network.joint is None or network.joint.planes == planes
    measurement, weights = torch.rand(2, 3, 48, 48), torch.randn(2, 4, 16, 16)
    optimiser = torch.optim.Adam(network.parameters(), 1e-2)
    for _ in range(3):
        optimiser.step()
        optimiser.zero_grad()
        estimate = network(measurement)
        assert estimate.image.shape == (2, 3, 16, 16)
        assert estimate.disparity.shape == (2, 1, 16, 16)
        (torch.cat(estimate, dim=1) * weights).sum().backward()
    gradients = {key: parameter.grad for key, parameter in network.named_parameters()}
    idle = [key for key, gradient in gradients.items() if gradient is None or not gradient.any()]
    assert idle == []


@pytest.mark.parametrize("noise_aware", [False, True])
@pytest.mark.parametrize("joint", [False, True])
def test_the_body_sees_all_planes_and_how_noisy_it_is(tiny_capture, recorded, noise_aware, joint):
    """Planes by themselves, then jointly, then the decades of noise / signal, of all channels together."""
    network = build_network(tiny_capture, "flatnet3d", "tiny", noise_aware=noise_aware, joint=joint, head="linear")
    output = torch.rand(2, 4, 16, 16)
    network.enhancement = body = recorded(output)
    measurement = 0.3 + torch.rand(2, 3, 48, 48) * torch.tensor([0.05, 0.5])[:, None, None, None]
    own = {"regularisation_lambda": 0.1, "tikhonov": 1.0, "noise_weight": 30.0 if noise_aware else None}
    with torch.no_grad():
        estimate = network(measurement)
        kinds = [False, True][: 1 + joint]
        volumes = [RegularisedInversion(tiny_capture, **own, joint=kind)(measurement).flatten(1, 2) for kind in kinds]
    wanted = torch.cat(volumes, dim=1)
    if noise_aware:
        light = measurement - torch.tensor([0.01, 0.02, 0.03])[:, None, None]
        ratio = noise_level(light)[:, None] ** 2 / light.square().mean(dim=(2, 3))
        level = ratio.mean(dim=1).log10() / 3 + 1
        assert level[1] - level[0] > 0.4
        wanted = torch.cat([wanted, level[:, None, None, None].expand(2, 1, 16, 16)], dim=1)
    torch.testing.assert_close(body.given, wanted)
    assert torch.equal(torch.cat(estimate, dim=1), output)


def test_no_noise_is_a_finite_level(tiny_capture, recorded):
    network = build_network(tiny_capture, "flatnet3d", "tiny", head="linear")
    network.enhancement = body = recorded(torch.rand(1, 4, 16, 16))
    network(torch.from_numpy(tiny_capture.offset).float()[:, None, None].expand(1, 3, 48, 48))
    assert body.given[:, -1].unique().item() == pytest.approx(-8 / 3 + 1)


def test_refinements_see_what_lies_around_the_scene_and_give_the_scene(tiny_capture, recorded):
    """A field of 24 x 28 pixels, all of it within the border: bodies see it, and what they add ends up at its pixels."""
    irradiance = np.pad(tiny_capture.irradiance, ((4, 4), (6, 6)), constant_values=6e-5)
    wide = replace(tiny_capture, irradiance=irradiance)
    network = build_network(wide, "flatnet3d", "tiny", refinements=1).eval()
    (step,) = network.refinements
    network.enhancement = first = recorded(torch.rand(1, 7, 24, 28))
    step.enhancement = second = recorded(torch.zeros(1, 7, 24, 28))
    measurement = 0.1 + torch.rand(1, 3, 48, 48)
    rows, columns = torch.meshgrid(torch.arange(24.0), torch.arange(28.0), indexing="ij")
    with torch.no_grad():
        before = network(measurement)
        second.output[0, :4] = torch.stack([rows, columns, rows - columns, columns - rows])
        after = network(measurement)
        options = {"regularisation_lambda": 0.1, "tikhonov": 1.0, "noise_weight": 30.0}
        volume = RegularisedInversion(replace(wide, scene_shape=(24, 28)), **options)(measurement)
    torch.testing.assert_close(first.given[:, :9], volume.flatten(1, 2))
    assert second.given.shape[-2:] == (24, 28)
    added = torch.cat([one - other for one, other in zip(after, before, strict=True)], dim=1)
    # The scene lies in the field's middle, 4 rows and 6 columns from its edge; rounding of float32
    torch.testing.assert_close(added[0], second.output[0, :4, 4:20, 6:22], atol=1e-4, rtol=0)


def test_a_repeated_refinement_is_a_further_one_of_the_same_weights(tiny_capture):
    torch.manual_seed(0)
    repeated, further, fewer = (
        build_network(tiny_capture, "flatnet3d", "tiny", **numbers).eval()
        for numbers in ({"refinements": 2, "repeats": 1}, {"refinements": 3}, {"refinements": 2})
    )
    weights = {key: value + 0.1 * torch.rand(value.shape) for key, value in repeated.state_dict().items()}
    again = {key.replace(".1.", ".2.", 1): value for key, value in weights.items() if key.startswith("refinements.1.")}
    measurement = 0.1 + torch.rand(1, 3, 48, 48)
    for network, known in ((repeated, weights), (further, weights | again), (fewer, weights)):
        network.load_state_dict(known)
    with torch.no_grad():
        once, twice, never = (network(measurement).image for network in (repeated, further, fewer))
    assert torch.equal(once, twice)
    assert float((once - never).abs().mean()) > 0.01


@pytest.mark.parametrize("name", ["flatnet3d", "flatnet2d"])
def test_a_soft_head_chooses_among_the_planes(tiny_capture, recorded, name):
    """In NumPy: softmax over planes, of radiance and of disparity; the codes of the former; and the body's residual."""
    network = build_network(tiny_capture, name, "tiny")
    planes = network.inversion.planes
    rng = np.random.default_rng(3)
    output = rng.normal(0, 1, (2, 4 + len(planes), 16, 16))
    volumes = rng.normal(0.3, 1.5, (2, 2, len(planes), 3, 16, 16))  # some of it negative, some far above white
    network.enhancement = recorded(torch.from_numpy(output))
    network.double()
    network.choice.to_srgb = torch.linalg.inv(torch.from_numpy(tiny_capture.scene_to_camera))
    network.choice.disparities = torch.from_numpy(tiny_capture.plane_disparities())[list(planes)]
    got = network.enhance(Inverted(torch.from_numpy(volumes), torch.zeros(2, 3, 48, 48), torch.ones(2, 3)))
    weights = np.exp(output[:, 4:]) / np.exp(output[:, 4:]).sum(axis=1, keepdims=True)
    light = sum(weights[:, [k]] * volumes[:, 0, k] for k in range(len(planes)))
    linear = np.moveaxis(np.linalg.solve(tiny_capture.scene_to_camera, np.moveaxis(light, 1, -2)), -2, 1)
    linear = linear.clip(0, 4)
    assert (linear == 4).any()
    codes = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    disparity = sum(weights[:, k] * tiny_capture.plane_disparities()[plane] for k, plane in enumerate(planes))
    np.testing.assert_allclose(got.image.numpy(), output[:, :3] + codes, atol=1e-12)
    np.testing.assert_allclose(got.disparity.numpy()[:, 0], output[:, 3] + disparity, atol=1e-12)


def test_a_soft_head_chooses_in_float32_under_autocast(tiny_capture, recorded):
    """bfloat16 has 8 bits: planes and disparities would be as coarse."""
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    output = torch.randn(1, 7, 16, 16).bfloat16()
    given = Inverted(torch.rand(1, 2, 3, 3, 16, 16), torch.zeros(1, 3, 48, 48), torch.ones(1, 3))
    network.enhancement = recorded(output)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = network.enhance(given)
    network.enhancement = recorded(output.float())
    wanted = network.enhance(given)
    torch.testing.assert_close(mixed[:2], wanted[:2], rtol=0, atol=0)


def test_colours_and_disparities_of_the_soft_head_are_the_cameras(tiny_capture):
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    np.testing.assert_allclose(network.choice.to_srgb, np.linalg.inv(tiny_capture.scene_to_camera), atol=1e-6)
    np.testing.assert_allclose(network.choice.disparities, [1, 0.5, 0], atol=1e-6)
    assert not any("choice" in key for key in network.state_dict())


@pytest.mark.parametrize("body", ["naf", "unet"])
def test_a_linear_head_begins_at_grey_and_the_middle_disparity(tiny_capture, body):
    torch.manual_seed(0)
    head = build_network(tiny_capture, "flatnet3d", "tiny", body=body, head="linear").enhancement.head
    start = head(torch.zeros(1, head.in_channels, 2, 2))
    assert start.shape[1] == 4
    assert start.unique().tolist() == [0.5]


@pytest.mark.parametrize("body", ["naf", "unet"])
def test_a_soft_head_begins_at_the_planes_mean(tiny_capture, body):
    """Without the last convolution's weights: nothing is added, and no plane is preferred."""
    network = build_network(tiny_capture, "flatnet3d", "tiny", body=body)
    torch.nn.init.zeros_(network.enhancement.head.weight)
    volumes = network.invert(measurement := torch.rand(1, 3, 48, 48)).volumes
    estimate = network(measurement)
    torch.testing.assert_close(estimate.disparity, torch.full((1, 1, 16, 16), 0.5))
    mean = torch.einsum("ac,bchw->bahw", network.choice.to_srgb, volumes[:, 0].mean(dim=1)).clamp(0, 4)
    torch.testing.assert_close(estimate.image, linear_to_srgb(mean, 1.0, clip=False))


@pytest.mark.parametrize(("depths", "plane"), [(1, 0), (3, 1), (8, 3), (25, 12)])
def test_hyperfocal_plane_is_in_the_middle_of_the_disparities(tiny_capture, depths, plane):
    values = np.repeat(np.asarray(tiny_capture.stack.values)[:1], depths, axis=0)
    for far_m in (0.2, float("inf")):
        stack = replace(tiny_capture.stack, values=values, depths_m=depth_planes(0.03, far_m, depths))
        assert hyperfocal_plane(tiny_capture.with_stack(stack)) == plane


def test_thesis_size_is_the_theses_network(tiny_capture):
    """A U-Net of 64 to 1024 filters with attention behind the plane-wise inversion of fixed lambda, its output linear."""
    wanted = {"body": "unet", "filters": 64, "levels": 5, "attention": True, "stem": 1}
    assert SIZES["thesis"] == wanted | {
        "noise_aware": False,
        "joint": False,
        "refinements": 0,
        "repeats": 0,
        "head": "linear",
    }
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "thesis", filters=2).eval()
    unet = UNet(9, 4, filters=2, levels=5, attention=True)
    inversion = RegularisedInversion(tiny_capture, regularisation_lambda=0.1, tikhonov=1.0)
    names = {
        f"{part}.{key}" for part, each in (("enhancement", unet), ("inversion", inversion)) for key in each.state_dict()
    }
    assert set(network.state_dict()) == names
    assert set(dict(inversion.named_parameters())) == {"filters", "log_lambda"}
    unet.load_state_dict(network.enhancement.state_dict())
    measurement = torch.rand(1, 3, 48, 48)
    with torch.no_grad():
        output = unet.eval()(inversion(measurement).reshape(1, 9, 16, 16))
        estimate = network(measurement)
    assert torch.equal(torch.cat(estimate, dim=1), output)


def test_smaller_sizes_are_ours(tiny_capture):
    ours = {
        "body": "naf",
        "blocks": 1,
        "stem": 1,
        "noise_aware": True,
        "joint": True,
        "refinements": 0,
        "repeats": 0,
        "head": "soft",
    }
    for size, numbers in (("compact", {"filters": 24, "levels": 4}), ("tiny", {"filters": 8, "levels": 3})):
        assert SIZES[size] == ours | numbers
    networks = (build_network(tiny_capture, "flatnet3d", size) for size in ("tiny", "compact"))
    counts = [sum(parameter.numel() for parameter in network.parameters()) for network in networks]
    assert counts[0] < 30_000 < 500_000 < counts[1] < 2_500_000


@pytest.mark.parametrize(
    ("wrong", "changes"),
    [
        ("attention", {"attention": True}),
        ("blocks", {"body": "unet", "blocks": 2}),
        ("blocks", {"blocks": 0}),
        ("body", {"body": "resnet"}),
        ("head", {"head": "hard"}),
        ("repeats", {"repeats": 1}),
    ],
)
def test_refuses_what_a_body_has_not(tiny_capture, wrong, changes):
    with pytest.raises(InputError, match=f"^{wrong}: "):
        build_network(tiny_capture, "flatnet3d", "tiny", **changes)


def test_refuses_unknown_names(tiny_capture):
    for name, arguments in (("network", ("flatnet4d",)), ("size", ("flatnet3d", "huge"))):
        with pytest.raises(InputError, match=f"^{name}: "):
            build_network(tiny_capture, *arguments)
    with pytest.raises(InputError, match=r"^width: "):
        build_network(tiny_capture, "flatnet3d", "tiny", width=3)


@pytest.mark.parametrize("body", ["naf", "unet"])
def test_method_is_the_network_in_evaluation_mode(tiny_capture, body):
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "tiny", body=body)
    network(torch.rand(4, 3, 48, 48))  # moves the running means of batch normalisation away from where they began
    method, clock, measurement = LearnedMethod("ours", network, tiny_capture), Clock(), torch.rand(3, 3, 48, 48)
    assert network.training
    before = {key: value.clone() for key, value in network.state_dict().items()}
    estimate = method.reconstruct(measurement, clock)
    assert network.training
    assert all(torch.equal(value, before[key]) for key, value in network.state_dict().items())
    assert list(clock.seconds) == ["inversion", "network"]
    assert all(seconds > 0 for seconds in clock.seconds.values())
    assert not estimate.image.requires_grad
    wanted = network.eval()(measurement)
    torch.testing.assert_close(estimate.image, wanted.image.detach())
    torch.testing.assert_close(estimate.disparity, wanted.disparity.detach())
    # One at a time is the same as together: nothing is normalised over the batch.
    torch.testing.assert_close(method.reconstruct(measurement[:1]).image, estimate.image[:1], atol=1e-5, rtol=1e-4)


def test_method_keeps_the_mode_when_it_fails(tiny_capture):
    network = build_network(tiny_capture, "flatnet2d", "tiny")
    with pytest.raises(InputError, match=r"^measurement: "):
        LearnedMethod("ours", network, tiny_capture).reconstruct(torch.rand(1, 3, 48, 50))
    assert network.training
