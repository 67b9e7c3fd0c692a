"""VideoNet3D: what it begins with, its FlatNet3D, which stays as it is, what its body sees and says, what it refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor

from learning.camera import CaptureModel
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.layers.noise import level_image, noise_ratio
from learning.layers.space_time import JOINT, ClipProblem, JointLeastSquares
from learning.method import Clock, linear_to_srgb
from learning.models import build_network, learned_method, named
from learning.models.videonet3d import VideoNet3D
from simulator.errors import InputError

STILL = {"network": "flatnet3d", "size": "tiny", "filters": 4}
SMALL: dict[str, Any] = {"filters": 4, "joint_iterations": 3, "joint_planes": 3}


def measured(capture: CaptureModel) -> Tensor:
    """Return two captures of smooth light that rises from frame to frame, at all planes, without noise."""
    rng = np.random.default_rng(0)
    light = gaussian_filter(rng.uniform(0, 1, (4, 3, 2, 3, *capture.field_shape)), (0, 0, 0, 0, 3, 3))
    light *= np.arange(1, 5)[:, None, None, None, None, None] / 12
    seen = capture.space_time(np.zeros(1)).forward(light * capture.irradiance * capture.white)
    return torch.from_numpy(capture.gain * seen + capture.offset[:, None, None]).float()


@pytest.fixture
def measurement(moving_capture: CaptureModel) -> Tensor:
    return measured(moving_capture)


def network(capture: CaptureModel, **changes: Any) -> VideoNet3D:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        built = build_network(capture, "videonet3d", "tiny", still=STILL, **SMALL | changes)
    assert isinstance(built, VideoNet3D)
    return built


def seen_as(capture: CaptureModel, measurement: Tensor, light: Tensor, other: Tensor) -> Tensor:
    """Return the captures with other light in place of the estimated, by the sum over frames and planes in float64."""
    frames = other.expand_as(light).double() - light.double()
    model = capture.with_planes(light.shape[1]).space_time(frames)
    brightness = capture.gain * capture.white * float(capture.scene_irradiance.max())
    return measurement + brightness * model.forward(frames).to(measurement)


def still_estimates(net: VideoNet3D, capture: CaptureModel, measurement: Tensor) -> tuple[Tensor, Tensor]:
    """Return image and disparity of another build of the net's FlatNet3D, for the camera without a shutter."""
    still = build_network(replace(capture, timing=None), **named(STILL))
    still.load_state_dict(net.joint.still.state_dict())
    with torch.no_grad():
        image, disparity = still.eval()(measurement)
    return image, disparity


@pytest.mark.parametrize(("dimensions", "margin"), [(2, 2), (3, 0)])
def test_it_begins_between_its_flatnets_estimates(moving_capture: CaptureModel, dimensions: int, margin: int) -> None:
    """Half-way between that of the capture as it is, and that of it as if all rows had seen the frame; also with a margin."""
    fall = 1 - np.linspace(-0.5, 0.5, 16 + 2 * margin, dtype=np.float32) ** 2
    capture = replace(moving_capture, irradiance=moving_capture.irradiance.max() * fall[:, None] * fall)
    measurement = measured(capture)
    net = network(capture, dimensions=dimensions, joint_planes=3)
    film = net(measurement)
    light = net.joint.joint.light(measurement)
    whole = still_estimates(net, capture, measurement)
    assert film.image.shape == (2, 4, 3, 16, 16)
    assert film.disparity.shape == (2, 4, 1, 16, 16)
    for frame in range(4):
        stilled = seen_as(capture, measurement, light, light[frame : frame + 1])
        alone = still_estimates(net, capture, stilled)
        for found, parts in zip(film, zip(whole, alone, strict=True), strict=True):
            torch.testing.assert_close(found[:, frame], sum(parts) / 2, rtol=0, atol=1e-4)  # float32
            assert float((parts[0] - parts[1]).abs().mean()) > 1e-3, "the two are told apart"
    assert float(film.image.detach().std(dim=1).mean()) > 0.01


def test_its_body_sees_all_that_it_begins_with(
    moving_capture: CaptureModel, measurement: Tensor, recorded: Any
) -> None:
    """Of what it answers, a frame's first three channels are added to the image, the fourth to the disparity.

    The sigmoids of the fifth and sixth are the shares that the frame's own estimates have in image and disparity.
    """
    net = network(moving_capture, joint_planes=2)
    answer = torch.randn(2, 4 * 6, 16, 16, generator=torch.Generator().manual_seed(2))
    body = recorded(answer)
    net.body.body = body
    film = net(measurement)
    ends = moving_capture.stack
    ends = replace(ends, values=ends.values[[0, 2]], depths_m=ends.depths_m[[0, 2]])
    joint = JointLeastSquares(moving_capture.with_stack(ends), **JOINT | {"iterations": 3})  # pyright: ignore[reportArgumentType]
    found = joint.light(measurement)
    light = joint.problem.film(found)
    inverse = torch.from_numpy(np.linalg.inv(moving_capture.scene_to_camera)).float()
    codes = linear_to_srgb(torch.einsum("ac,bnchw->bnahw", inverse, light.sum(dim=2)).clamp(0, 4), 1.0, clip=False)
    image, disparity = still_estimates(net, moving_capture, measurement)
    frames = [seen_as(moving_capture, measurement, found, one) for one in found.split(1)]
    each = [still_estimates(net, moving_capture, one) for one in frames]
    images, disparities = (torch.stack(parts, dim=1) for parts in zip(*each, strict=True))
    mean = seen_as(moving_capture, measurement, found, found.mean(dim=0, keepdim=True))
    volumes = net.joint.still.invert(mean).volumes.detach()
    level = level_image(noise_ratio(measurement - net.joint.still.inversion.offset), image)
    own = torch.cat([light.flatten(2, 3), codes, images, disparities], dim=2)
    expected = torch.cat([own.flatten(1, 2), volumes.flatten(1, 3), image, disparity, level], dim=1)
    torch.testing.assert_close(body.given, expected, rtol=0, atol=2e-4 * float(expected.abs().max()))
    added = answer.unflatten(1, (4, 6))
    shares = 1 / (1 + (-added[:, :, 4:]).exp())
    between = image[:, None] + shares[:, :, :1] * (images - image[:, None])
    torch.testing.assert_close(film.image, between + added[:, :, :3], rtol=0, atol=1e-4)
    between = disparity[:, None] + shares[:, :, 1:] * (disparities - disparity[:, None])
    torch.testing.assert_close(film.disparity, between + added[:, :, 3:4], rtol=0, atol=1e-4)


def test_without_its_changes_a_capture_is_that_of_a_still_scene(moving_capture: CaptureModel) -> None:
    """Of the true frames in place of estimated ones, by the convolution of stills in float64."""
    problem = ClipProblem(moving_capture)
    light = torch.rand(4, 3, 1, 3, *moving_capture.field_shape, generator=torch.Generator().manual_seed(0))
    shown = moving_capture.white * float(moving_capture.scene_irradiance.max())
    still = moving_capture.forward_model(np.zeros(1)).forward(shown * light[2:3, :, 0].double().numpy())
    expected = moving_capture.gain * torch.from_numpy(still).float()
    seen = problem(light) / problem.scale
    torch.testing.assert_close(problem.instead(seen, light, light[2:3])[0], expected, rtol=1e-5, atol=1e-6)


def test_only_its_body_learns(moving_capture: CaptureModel, measurement: Tensor) -> None:
    net = network(moving_capture)
    film = net(measurement)
    (film.image.sum() + film.disparity.sum()).backward()
    learning = {name for name, parameter in net.named_parameters() if parameter.grad is not None}
    assert learning == {name for name, _ in net.named_parameters() if name.startswith("body.")}


def test_what_it_begins_with_can_be_kept(moving_capture: CaptureModel, measurement: Tensor) -> None:
    """It is told apart by the weights of the still network and the numbers of the least squares."""
    net = network(moving_capture)
    start = net.initial_estimate(measurement)
    assert start.shape == (2, (4 * (3 * 3 + 3 + 1) + 2 * 3 * 3 + 4) * 16 * 16)
    for found, expected in zip(net(measurement, start), net(measurement), strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)
    told = net.joint.told
    assert network(moving_capture).joint.told == told
    assert network(moving_capture, joint_iterations=4).joint.told != told
    repeated = build_network(moving_capture, "videonet3d", "tiny", still=STILL | {"repeats": 0}, **SMALL)
    repeated.load_state_dict(net.state_dict())
    assert repeated.joint.told != told  # as another architecture may have the same weights
    with torch.no_grad():
        net.joint.still.inversion.log_lambda += 1
    assert net.joint.told != told


def test_its_file_and_method(moving_capture: CaptureModel, measurement: Tensor, tmp_path: Path) -> None:
    net = network(moving_capture)
    with torch.no_grad():
        for parameter in net.body.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(4))
    path = tmp_path / "net.safetensors"
    architecture = {"network": "videonet3d", "size": "tiny", "still": STILL, **SMALL}
    save_checkpoint(path, net, architecture=architecture, capture=moving_capture, record={})
    known = load_checkpoint(path)
    assert known.architecture["still"] == STILL
    clock = Clock()
    estimate = learned_method("moving", known.network, known.capture).reconstruct(measurement, clock)
    assert list(clock.seconds) == ["joint", "network"]
    for found, expected in zip(estimate, net(measurement), strict=True):
        torch.testing.assert_close(found, expected, rtol=0, atol=1e-5)


def test_other_cameras_and_networks_are_refused(tiny_capture: CaptureModel, clip_capture: CaptureModel) -> None:
    with pytest.raises(InputError, match=r"^capture: got the camera of stills, but VideoNet3D is for clips"):
        network(tiny_capture)
    with pytest.raises(InputError, match=r"^stack: got one plane, expected several .* or videonet$"):
        network(clip_capture)
    moving = replace(tiny_capture, timing=clip_capture.timing)
    with pytest.raises(InputError, match=r"^still: got the network videonet, expected flatnet3d"):
        build_network(moving, "videonet3d", "tiny", still={"network": "videonet"})
    with pytest.raises(InputError, match=r"^still.size: got 'huge', expected one of"):
        build_network(moving, "videonet3d", "tiny", still={"network": "flatnet3d", "size": "huge"})
