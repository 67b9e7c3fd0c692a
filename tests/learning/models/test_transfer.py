"""Warm starts: exact for the same camera, and of the same response where planes differ."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from learning.checkpoint import Checkpoint
from learning.models import build_network
from learning.models.transfer import plane_mixing, transfer
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
    return Checkpoint(
        network.eval(), capture, capture.stack.fingerprint, {"network": name, "size": "tiny", **changes}, {}
    )


@pytest.mark.parametrize("name", ["flatnet3d", "flatnet2d"])
def test_same_camera_is_exact(tiny_capture, name):
    checkpoint = trained(tiny_capture, name)
    network = build_network(tiny_capture, name, "tiny").eval()
    measurement = torch.rand(2, 3, 48, 48)
    lines = transfer(network, checkpoint)
    assert len(lines) == 1
    assert lines[0].startswith("copied all")
    with torch.no_grad():
        assert torch.equal(network(measurement).picture, checkpoint.network(measurement).picture)


@pytest.mark.parametrize(("old", "new", "stem"), [(8, 12, 1), (8, 5, 1), (3, 25, 2)])
def test_linear_volumes_have_the_same_response(tiny_capture, old, new, stem):
    checkpoint = trained(with_planes(tiny_capture, old), stem=stem)
    other = with_planes(tiny_capture, new, near_m=0.05, far_m=float("inf"))
    network = build_network(other, "flatnet3d", "tiny", stem=stem).eval()
    lines = transfer(network, checkpoint)
    assert [line.split()[0] for line in lines] == ["resampled"] * 3 + ["copied"]
    flat, slope = torch.rand(2, 1, 3, 16, 16), torch.rand(2, 1, 3, 16, 16)
    volumes = [flat + slope * torch.linspace(1, 0, n)[:, None, None, None] for n in (old, new)]
    with torch.no_grad():
        wanted, got = checkpoint.network.enhance(volumes[0]), network.enhance(volumes[1])
    # The whole network behind the first layer is the same, so its output is; float32 sums in another order.
    torch.testing.assert_close(got.picture, wanted.picture, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(got.disparity, wanted.disparity, atol=1e-4, rtol=1e-4)


def test_filters_and_lambdas_are_interpolated_over_disparity(tiny_capture):
    checkpoint = trained(with_planes(tiny_capture, 8))
    network = build_network(with_planes(tiny_capture, 12), "flatnet3d", "tiny")
    transfer(network, checkpoint)
    for name in ("filters", "log_lambda"):
        old = getattr(checkpoint.network.inversion, name).detach().numpy().reshape(8, -1)
        new = getattr(network.inversion, name).detach().numpy().reshape(12, -1)
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
    volume = torch.rand(1, 1, 3, 16, 16)
    with torch.no_grad():
        torch.testing.assert_close(network.enhance(volume).picture, checkpoint.network.enhance(volume).picture)


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("flatnet2d", {}, "got a FlatNet3D, expected a FlatNet2D"),
        ("flatnet3d", {"filters": 6}, r"enhancement\.\S+ has the shape .*'tiny'"),
        ("flatnet3d", {"levels": 4}, "has the shape .* expected"),
    ],
)
def test_refuses_another_architecture_and_changes_nothing(tiny_capture, name, changes, message):
    network = build_network(with_planes(tiny_capture, 5), name, "tiny", **changes)
    before = {key: value.clone() for key, value in network.state_dict().items()}
    with pytest.raises(InputError, match=message):
        transfer(network, trained(tiny_capture))
    assert all(torch.equal(value, before[key]) for key, value in network.state_dict().items())


def test_refuses_other_channels(tiny_capture):
    stack = replace(tiny_capture.stack, channels=("A", "B", "C"))
    with pytest.raises(InputError, match="channels R, G, B, expected A, B, C"):
        transfer(build_network(replace(tiny_capture, stack=stack), "flatnet3d", "tiny"), trained(tiny_capture))
