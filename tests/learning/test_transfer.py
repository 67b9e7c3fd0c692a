"""Weights for another camera: the same answer to what both see alike, and refusals that change nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from learning.checkpoint import Checkpoint, load_checkpoint
from learning.models import build_network
from learning.models.flatnet import Inverted
from learning.transfer import for_camera, plane_mixing, transfer
from simulator.errors import InputError
from simulator.optics.stack import depth_planes


def with_planes(capture, count, near_m=0.01, far_m=0.2):
    values = np.resize(np.asarray(capture.stack.values), (count, *capture.stack.values.shape[1:]))
    return capture.with_stack(replace(capture.stack, values=values, depths_m=depth_planes(near_m, far_m, count)))


def trained(capture, name="flatnet3d", **changes):
    """Return a checkpoint whose weights differ everywhere from where networks begin."""
    torch.manual_seed(1)
    network = build_network(capture, name, "tiny", **changes)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    network(torch.rand(2, 3, 48, 48))
    architecture = {"network": name, "size": "tiny", **changes}
    return Checkpoint(network.eval(), capture, capture.stack.fingerprint, architecture, {})


@pytest.mark.parametrize("name", ["flatnet3d", "flatnet2d"])
@pytest.mark.parametrize("changes", [{}, {"body": "unet", "head": "linear"}])
def test_same_camera_is_exact(tiny_capture, name, changes):
    checkpoint = trained(tiny_capture, name, **changes)
    network = build_network(tiny_capture, name, "tiny", **changes).eval()
    measurement = torch.rand(2, 3, 48, 48)
    lines = transfer(network, checkpoint)
    assert len(lines) == 1
    assert lines[0].startswith("copied all")
    with torch.no_grad():
        assert torch.equal(network(measurement).image, checkpoint.network(measurement).image)


# What is resampled: P and lambda (and its weight of noise) of one or both inversions, the first convolution, and a soft
# head's last one, weights and biases.
@pytest.mark.parametrize(
    ("changes", "resampled"),
    [
        ({}, 9),
        ({"body": "unet"}, 9),
        ({"stem": 2}, 9),
        ({"body": "unet", "stem": 2, "attention": True}, 9),
        ({"joint": False}, 6),
        ({"head": "linear"}, 7),
        ({"body": "unet", "noise_aware": False, "joint": False, "head": "linear"}, 3),
        ({"stem": 2, "noise_aware": False}, 7),
        ({"refinements": 1}, 15),
    ],
)
@pytest.mark.parametrize(("old", "new"), [(8, 12), (8, 5), (3, 25)])
def test_linear_volumes_have_the_same_response(tiny_capture, old, new, changes, resampled):
    """The estimate of a linear head, the residual of a soft one; whose choice, before softmax, is that at the same share."""
    checkpoint = trained(with_planes(tiny_capture, old), **changes)
    other = with_planes(tiny_capture, new, near_m=0.05, far_m=float("inf"))
    network = build_network(other, "flatnet3d", "tiny", **changes).eval()
    lines = transfer(network, checkpoint)
    assert [line.split()[0] for line in lines] == ["resampled"] * resampled + ["copied"]
    flat, slope = torch.rand(2, 2, 1, 3, 16, 16), torch.rand(2, 2, 1, 3, 16, 16)
    outputs = []
    for each, planes in ((checkpoint.network, old), (network, new)):
        volumes = flat + slope * torch.linspace(1, 0, planes)[:, None, None, None]
        noise = torch.tensor([0.1, 0.001])[:, None] if each.noise_aware else None
        each.enhancement.register_forward_hook(lambda _, __, output: outputs.append(output))
        with torch.no_grad():
            each.enhance(Inverted(volumes[:, : 1 if each.joint is None else 2], torch.empty(0), noise))
    wanted, got = (output.double().numpy() for output in outputs)
    # The whole network behind the first layer is the same, so its output is; float32 sums in another order.
    np.testing.assert_allclose(got[:, :4], wanted[:, :4], atol=1e-4, rtol=1e-4)
    if network.soft:
        shares = [np.linspace(0, 1, planes) for planes in (new, old)]
        chosen = np.apply_along_axis(lambda each: np.interp(shares[0], shares[1], each), 1, wanted[:, 4:])
        np.testing.assert_allclose(got[:, 4:], chosen, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("stem", [1, 2])
@pytest.mark.parametrize(("old", "new"), [(8, 12), (8, 5), (3, 25)])
def test_a_choice_shared_out_among_planes_has_the_same_response(tiny_capture, old, new, stem):
    """A refinement's first layer sees volumes as `FlatNet` does, and the weights of a choice, whose sum is 1, beside them."""
    checkpoint = trained(with_planes(tiny_capture, old), refinements=1, stem=stem)
    network = build_network(with_planes(tiny_capture, new), "flatnet3d", "tiny", refinements=1, stem=stem).eval()
    transfer(network, checkpoint)
    light, rest = torch.rand(2, 1, 3, 16, 16), torch.rand(2, 5, 16, 16)
    chosen = (3 * torch.randn(2, new, 16, 16)).softmax(dim=1)
    shares = [np.linspace(0, 1, planes) for planes in (new, old)]
    hats = np.stack([np.interp(shares[0], shares[1], unit) for unit in np.eye(old)])  # of old planes, at new ones
    shared = torch.einsum("on,bnhw->bohw", torch.from_numpy(hats).float(), chosen)
    outputs = []
    for each, planes, weights in ((checkpoint.network, old, shared), (network, new, chosen)):
        volume = light * torch.linspace(1, 0, planes)[:, None, None, None]
        per_plane = torch.cat([volume, weights[:, :, None]], dim=2).flatten(1, 2)
        with torch.no_grad():
            outputs.append(each.refinements[0].enhancement(torch.cat([per_plane, rest], dim=1))[:, :4].double().numpy())
    np.testing.assert_allclose(outputs[1], outputs[0], atol=1e-4, rtol=1e-4)  # float32


@pytest.mark.parametrize("planes", [3, 5])
def test_refinements_that_a_checkpoint_has_not_begin_anew(tiny_capture, planes):
    checkpoint = trained(tiny_capture, refinements=1)
    network = build_network(with_planes(tiny_capture, planes), "flatnet3d", "tiny", refinements=2)
    before = {key: value.clone() for key, value in network.state_dict().items()}
    *_, line = transfer(network, checkpoint)
    further = {key for key in before if key.startswith("refinements.1.")}
    assert line == f"1 refinement of {len(further)} tensors, not in it, begin anew"
    after, found = network.state_dict(), checkpoint.network.state_dict()
    assert all(torch.equal(after[key], before[key]) for key in further)
    assert after.keys() - further == found.keys()
    if planes == 3:
        assert all(torch.equal(after[key], found[key]) for key in found)
    with pytest.raises(InputError, match=r"^checkpoint: refinements\."):
        transfer(build_network(tiny_capture, "flatnet3d", "tiny"), checkpoint)


def test_filters_and_lambdas_are_interpolated_over_disparity(tiny_capture):
    checkpoint = trained(with_planes(tiny_capture, 8))
    network = build_network(with_planes(tiny_capture, 12), "flatnet3d", "tiny")
    transfer(network, checkpoint)
    for part in ("inversion", "joint"):
        for name in ("filters", "log_lambda", "log_noise_weight"):
            old = getattr(getattr(checkpoint.network, part), name).detach().numpy().reshape(8, -1)
            new = getattr(getattr(network, part), name).detach().numpy().reshape(12, -1)
            wanted = np.stack([np.interp(np.linspace(0, 7, 12), np.arange(8), column) for column in old.T], 1)
            np.testing.assert_allclose(new, wanted, atol=1e-6)  # float32


def test_planes_need_not_be_even_in_disparity():
    old, new = np.array([1.0, 0.9, 0.2, 0.0]), np.array([1.0, 0.55, 0.1])
    np.testing.assert_allclose(plane_mixing(old, new) @ old, new)
    np.testing.assert_allclose(plane_mixing(old, new)[1], [0, 0.5, 0.5, 0])


def test_one_plane_serves_another(tiny_capture):
    checkpoint = trained(with_planes(tiny_capture, 8), "flatnet2d")
    network = build_network(with_planes(tiny_capture, 3), "flatnet2d", "tiny").eval()
    transfer(network, checkpoint)
    given = Inverted(torch.rand(1, 1, 1, 3, 16, 16), torch.empty(0), torch.full((1, 3), 0.01))
    with torch.no_grad():
        got, wanted = network.enhance(given), checkpoint.network.enhance(given)
    torch.testing.assert_close(got.image, wanted.image)
    # What is added to the disparity of the plane is the same; the middle of 8 planes is at 4 / 7, of 3 at 1 / 2.
    torch.testing.assert_close(got.disparity - 1 / 2, wanted.disparity - 4 / 7)


OTHERS = [
    *({"filters": 6}, {"levels": 4}, {"stem": 2}, {"blocks": 2}),
    *({"body": "unet"}, {"head": "linear"}, {"joint": False}, {"noise_aware": False}),
]


@pytest.mark.parametrize(
    ("name", "changes", "other"),
    [
        ("flatnet2d", {}, {}),
        *(("flatnet3d", change, {}) for change in OTHERS),
        *(("flatnet3d", {}, other) for other in OTHERS),
    ],
)
@pytest.mark.parametrize("planes", [3, 5])
def test_refuses_another_architecture_and_changes_nothing(tiny_capture, name, changes, other, planes):
    network = build_network(with_planes(tiny_capture, planes), name, "tiny", **changes)
    before = {key: value.clone() for key, value in network.state_dict().items()}
    checkpoint = replace(trained(tiny_capture, **other), path=Path("flatnet.safetensors"))
    with pytest.raises(InputError, match=r"^flatnet\.safetensors: "):
        transfer(network, checkpoint)
    assert all(torch.equal(value, before[key]) for key, value in network.state_dict().items())


def test_refuses_other_channels(tiny_capture):
    stack = replace(tiny_capture.stack, channels=("A", "B", "C"))
    with pytest.raises(InputError, match=r"^checkpoint: "):
        transfer(build_network(replace(tiny_capture, stack=stack), "flatnet3d", "tiny"), trained(tiny_capture))


def test_a_videonet_is_nothing_for_a_flatnet_to_begin_with(clip_checkpoint, tiny_capture):
    with pytest.raises(InputError, match=r"video\.safetensors: "):
        transfer(build_network(tiny_capture, "flatnet2d", "tiny"), load_checkpoint(clip_checkpoint))


def test_a_network_for_another_camera_keeps_its_weights(tiny_capture):
    checkpoint, other = trained(tiny_capture), with_planes(tiny_capture, 5)
    state = torch.get_rng_state()
    network = for_camera(checkpoint, other)
    assert torch.equal(torch.get_rng_state(), state)
    assert len(network.inversion.disparities) == 5
    fresh = build_network(other, **checkpoint.named)
    transfer(fresh, checkpoint)
    assert all(torch.equal(value, fresh.state_dict()[key]) for key, value in network.state_dict().items())
