"""The networks: shapes, what they share, what they refuse; and the same network as a method."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from learning.layers.inversion import RegularisedInversion
from learning.method import Clock
from learning.models import SIZES, LearnedMethod, build_network
from learning.models.flatnet import hyperfocal_plane
from simulator.errors import InputError
from simulator.optics.stack import depth_planes


@pytest.mark.parametrize(("name", "planes"), [("flatnet3d", (0, 1, 2)), ("flatnet2d", (1,))])
def test_estimate_of_a_measurement(tiny_capture, name, planes):
    torch.manual_seed(0)
    network = build_network(tiny_capture, name, "tiny")
    assert network.inversion.planes == planes
    estimate = network(torch.rand(2, 3, 48, 48))
    assert estimate.image.shape == (2, 3, 16, 16)
    assert estimate.disparity.shape == (2, 1, 16, 16)
    (estimate.image.mean() + estimate.disparity.mean()).backward()
    gradients = {key: parameter.grad for key, parameter in network.named_parameters()}
    assert all(gradient is not None and bool(gradient.any()) for gradient in gradients.values())


def test_the_network_sees_the_inversion_of_every_plane(tiny_capture):
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "tiny").eval()
    measurement = torch.rand(1, 3, 48, 48)
    with torch.no_grad():
        volume = RegularisedInversion(tiny_capture, regularisation_lambda=0.1, tikhonov=1.0)(measurement)
        output = network.enhancement(volume.reshape(1, 9, 16, 16))
        estimate = network(measurement)
    assert torch.equal(torch.cat(estimate, dim=1), output)


def test_learning_begins_at_grey_and_the_middle_disparity(tiny_capture):
    torch.manual_seed(0)
    head = build_network(tiny_capture, "flatnet3d", "tiny").enhancement.head
    assert head(torch.zeros(1, head.in_channels, 2, 2)).unique().tolist() == [0.5]


@pytest.mark.parametrize(("depths", "plane"), [(1, 0), (3, 1), (8, 3), (25, 12)])
def test_hyperfocal_plane_is_in_the_middle_of_the_disparities(tiny_capture, depths, plane):
    values = np.repeat(np.asarray(tiny_capture.stack.values)[:1], depths, axis=0)
    for far_m in (0.2, float("inf")):
        stack = replace(tiny_capture.stack, values=values, depths_m=depth_planes(0.03, far_m, depths))
        assert hyperfocal_plane(tiny_capture.with_stack(stack)) == plane


def test_sizes_are_the_theses_and_smaller(tiny_capture):
    assert SIZES["thesis"] == {"filters": 64, "levels": 5, "attention": True, "stem": 1}
    networks = (build_network(tiny_capture, "flatnet3d", size) for size in ("tiny", "compact"))
    counts = [sum(parameter.numel() for parameter in network.parameters()) for network in networks]
    assert counts[0] < 20_000 < 2_000_000 < counts[1] < 2_500_000


def test_refuses_unknown_names(tiny_capture):
    for name, arguments in (("network", ("flatnet4d",)), ("size", ("flatnet3d", "huge"))):
        with pytest.raises(InputError, match=f"^{name}: "):
            build_network(tiny_capture, *arguments)
    with pytest.raises(InputError, match=r"^width: "):
        build_network(tiny_capture, "flatnet3d", "tiny", width=3)


def test_method_is_the_network_in_evaluation_mode(tiny_capture):
    torch.manual_seed(0)
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    network(torch.rand(4, 3, 48, 48))  # moves the running means away from where they began
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


def test_method_works_the_inversion_out_once_and_again_when_weights_change(tiny_capture, monkeypatch):
    """As constrained least squares; the same as the network itself, whatever happens to it in between."""
    network = build_network(tiny_capture, "flatnet3d", "tiny").eval()
    calls, live = [], RegularisedInversion.inverse
    monkeypatch.setattr(RegularisedInversion, "inverse", lambda layer: calls.append(None) or live(layer))
    method, measurement = LearnedMethod("ours", network, tiny_capture), torch.rand(1, 3, 48, 48)

    def check(worked_out, measurement=measurement):
        calls.clear()
        got = method.reconstruct(measurement)
        assert len(calls) == worked_out
        with torch.no_grad():
            wanted = network(measurement)
        torch.testing.assert_close(got, wanted, rtol=0, atol=0)
        return got.image

    first = check(worked_out=0)
    assert torch.equal(check(worked_out=0), first)
    with torch.no_grad():
        network.inversion.log_lambda.add_(2)
    assert not torch.equal(check(worked_out=1), first)
    check(worked_out=0)
    other = build_network(tiny_capture, "flatnet3d", "tiny", regularisation_lambda=0.03)
    network.load_state_dict(other.state_dict())
    check(worked_out=1)
    network.inversion.filters.data = network.inversion.filters.data * 2
    check(worked_out=1)
    network.double()
    check(worked_out=1, measurement=measurement.double())


def test_method_keeps_the_mode_when_it_fails(tiny_capture):
    network = build_network(tiny_capture, "flatnet2d", "tiny")
    with pytest.raises(InputError, match=r"^measurement: "):
        LearnedMethod("ours", network, tiny_capture).reconstruct(torch.rand(1, 3, 48, 50))
    assert network.training
