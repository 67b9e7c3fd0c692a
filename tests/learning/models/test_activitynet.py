"""ActivityNet and its controls: what each looks at, what is moved in training, what it takes and refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.checkpoint import find_checkpoint, load_checkpoint
from learning.method import Clock, Method, linear_to_srgb, srgb_to_linear
from learning.models import build_network, learned_method, named
from learning.models.activitynet import (
    FRAMES,
    ActivityMethod,
    ActivityNet,
    LensClassifier,
    RawClassifier,
    moved_windows,
)
from learning.models.videonet import VideoNet
from simulator.errors import InputError

CLASSES = ["a", "b", "c"]
SMALL: dict[str, Any] = {"filters": 4, "joint_iterations": 4, "classes": CLASSES}


def built(capture: CaptureModel, name: str = "activitynet", size: str = "tiny", **changes: Any) -> Any:
    """Return a network in which nothing is 0, in evaluation mode."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        network = build_network(capture, name, size, **({"classes": CLASSES} | changes))
        with torch.no_grad():
            for parameter in network.parameters():
                parameter += 0.05 * torch.randn_like(parameter)
    return network.eval()


@pytest.fixture
def measurement() -> Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(0.1, 0.9, size=(2, 3, 48, 48))).float()


@pytest.fixture
def bordered(dotted_camera: Any) -> CaptureModel:
    """A camera that gets light from six pixels around the image."""
    return dotted_camera((48, 48), (16, 16), 33, 4, channels=3, margin=6)


@pytest.fixture
def frames() -> Tensor:
    return torch.rand(2, 4, 3, 16, 16, generator=torch.Generator().manual_seed(2))


class Looking(torch.nn.Module):
    """In place of a classifier: keeps what it is given."""

    def forward(self, own: Tensor, shared: Tensor) -> Tensor:
        self.own, self.shared = own, shared
        return own.new_zeros(len(own), 3)


def test_it_looks_at_the_joint_start_and_the_static_image(bordered: CaptureModel, measurement: Tensor) -> None:
    """As sRGB codes 0..1, four frames and an image of three channels, and the level of the noise: of the image alone."""
    network = built(bordered, size="compact", joint_iterations=4)
    assert network.measnet is None
    network.classifier = seen = Looking()
    with torch.no_grad():
        network(measurement)
        inverted = network.invert(measurement)
    inside = network.image
    for found, light in ((seen.own, inverted.frames), (seen.shared[:, :3], inverted.shared[:, :3])):
        torch.testing.assert_close(found, linear_to_srgb(light[inside], 1.0), rtol=1e-4, atol=1e-5)
    assert seen.own.shape == (2, 4, 3, 16, 16)
    assert torch.equal(seen.shared[:, 3], inverted.shared[:, 3][inside])
    assert inverted.frames.shape[-1] > 16, "it has a border, for windows that move"
    with torch.no_grad():
        torch.testing.assert_close(network.frame_estimates(network.invert(measurement)).clamp(0, 1), seen.own)


def test_measnet_adds_the_inversion_of_what_it_completes(clip_capture: CaptureModel, measurement: Tensor) -> None:
    network = built(clip_capture, **SMALL)
    network.classifier = seen = Looking()
    with torch.no_grad():
        output, known = network(measurement), network.invert(measurement)
        inverted = network.codes(network.wiener.scene(known.measured)).clamp(0, 1)[network.image]
    assert seen.own.shape == (2, 4, 6, 16, 16)
    torch.testing.assert_close(seen.own[:, :, 3:], inverted)
    torch.testing.assert_close(output.measured, known.measured)


def test_windows_move_in_training_alone(bordered: CaptureModel, measurement: Tensor) -> None:
    """By whole pixels, within the border, alike in all frames and in the static image of a clip."""
    network = built(bordered, size="compact", joint_iterations=4)
    network.classifier = seen = Looking()
    with torch.no_grad():
        still = [network(measurement) and seen.own for _ in range(2)]
        network.train()
        moved = [(network(measurement), seen.own, seen.shared)[1:] for _ in range(6)]
        inverted = network.invert(measurement)
        whole, static = network.codes(inverted.frames).clamp(0, 1), network.codes(inverted.shared[:, :3]).clamp(0, 1)
    assert torch.equal(*still)
    places = set()
    border = whole.shape[-1] - 16
    for own, shared in moved:
        for clip in range(2):
            found = [
                (top, left)
                for top in range(border + 1)
                for left in range(border + 1)
                if torch.equal(whole[clip, ..., top : top + 16, left : left + 16], own[clip])
                and torch.equal(static[clip, :, top : top + 16, left : left + 16], shared[clip, :3])
            ]
            assert len(found) == 1
            places |= set(found)
    assert len(places) > 4


def test_every_place_of_a_window_is_as_likely() -> None:
    torch.manual_seed(0)
    numbers = torch.arange(100.0).reshape(1, 1, 1, 10, 10).expand(9000, -1, -1, -1, -1)
    own, _ = moved_windows(numbers, numbers[:, 0], (8, 8))
    assert own.shape == (9000, 1, 1, 8, 8)
    places, counts = own[..., 0, 0].unique(return_counts=True)
    assert places.tolist() == [0, 1, 2, 10, 11, 12, 20, 21, 22]
    # 1000 +- 30 each: five standard deviations.
    assert (counts - 1000).abs().max() < 150


def test_windows_go_on_where_there_is_no_border() -> None:
    torch.manual_seed(0)
    image = torch.rand(1, 1, 1, 8, 8)
    whole = torch.nn.functional.pad(image[:, 0], (1, 1, 1, 1), mode="replicate")[0, 0]
    possible = [whole[top : top + 8, left : left + 8] for top in range(3) for left in range(3)]
    for _ in range(9):
        own, nothing = moved_windows(image, image[:, 0, :0], (8, 8))
        assert sum(torch.equal(own[0, 0, 0], each) for each in possible) == 1
        assert nothing.shape == (1, 0, 8, 8)


@pytest.mark.parametrize("which", FRAMES)
def test_a_lens_shows_all_frames_or_one(clip_capture: CaptureModel, frames: Tensor, which: str) -> None:
    network = built(clip_capture, "lens_classifier", "compact", frames=which)
    radiance = srgb_to_linear(frames, clip_capture.white)
    assert network.inputs(torch.zeros(0), None, radiance) == (radiance,)
    network.classifier = seen = Looking()
    with torch.no_grad():
        network(radiance)
        own = seen.own.clone()
        network(radiance.flip(0))
        assert torch.equal(seen.own, own.flip(0)), "of its own clip alone, the same each time"
    if which == "all":
        torch.testing.assert_close(own, frames)
    elif which == "middle":
        torch.testing.assert_close(own, frames[:, 2:3])
    else:
        for found, clip in zip(own, frames, strict=True):
            assert not torch.allclose(found, clip)
            means = (sorted(each.mean(dim=(1, 2, 3)).tolist()) for each in (found, clip))
            assert next(means) == pytest.approx(next(means), rel=1e-5)


def test_shuffled_frames_come_in_every_order(clip_capture: CaptureModel) -> None:
    """In training another one each time; at test, over clips: with 4 frames there are 24 orders."""
    network = built(clip_capture, "lens_classifier", "compact", frames="shuffled")
    clips = torch.rand(300, 4, 3, 2, 2)
    at_test = {tuple(network._order(clip).tolist()) for clip in clips}
    network.train()
    torch.manual_seed(0)
    in_training = {tuple(network._order(clips[0]).tolist()) for _ in range(300)}
    # The chance that one of 24 misses in 300 draws is 24 (23/24)^300 = 7e-5.
    assert len(at_test) == len(in_training) == 24


def test_lens_frames_are_moved_in_training(clip_capture: CaptureModel, frames: Tensor) -> None:
    network = built(clip_capture, "lens_classifier", "compact")
    network.classifier = seen = Looking()
    torch.manual_seed(3)
    radiance = srgb_to_linear(frames, clip_capture.white)
    network.train()(radiance)
    assert seen.own.shape == frames.shape
    assert not torch.allclose(seen.own, frames)
    # What is moved in is the edge's continuation: no new values.
    assert set(seen.own.flatten().tolist()) <= set(linear_to_srgb(radiance, clip_capture.white).flatten().tolist())


def test_a_raw_capture_is_in_units_of_its_mean_and_scaled_pixel_by_pixel(
    clip_capture: CaptureModel, measurement: Tensor
) -> None:
    network = built(clip_capture, "raw_classifier", "compact")
    network.classifier = seen = Looking()
    light = measurement - torch.tensor([0.01, 0.02, 0.03])[:, None, None]
    light = light / light.mean(dim=(1, 2, 3), keepdim=True)
    network.train()(measurement)
    variance, mean = torch.var_mean(light, dim=0, correction=0)
    close = {"rtol": 0, "atol": 1e-4}  # float32: small differences of light are divided by small deviations
    torch.testing.assert_close(seen.own[:, 0], (light - mean) / (variance + network.scaling.eps).sqrt(), **close)
    network.scaling.running_mean, network.scaling.running_var = mean.flatten(), 4 * variance.flatten()
    network.eval()(measurement)
    torch.testing.assert_close(seen.own[:, 0], (light - mean) / (4 * variance + network.scaling.eps).sqrt(), **close)
    assert seen.shared.shape[1] == 0
    assert network.inputs(measurement, None, torch.zeros(0)) == (measurement,)
    with pytest.raises(InputError, match="measurement"):
        network(measurement[..., :40])


def test_the_thesis_size_completes_slivers(clip_capture: CaptureModel, measurement: Tensor) -> None:
    network = built(clip_capture, size="thesis", filters=4, levels=2)
    assert network.joint is None
    assert not network.noise_aware
    with torch.no_grad():
        answer = network(measurement)
    assert answer.logits.shape == (2, 3)
    assert answer.measured.shape == (2, 4, 3, 48, 48)


def test_a_videonet_gives_its_inversion_and_measnet(clip_capture: CaptureModel) -> None:
    sizes = {"filters": 4, "joint_iterations": 4}
    torch.manual_seed(5)
    known = build_network(clip_capture, "videonet", "tiny", **sizes)
    assert isinstance(known, VideoNet)
    with torch.no_grad():
        for parameter in known.parameters():
            parameter += 1
    network = built(clip_capture, **SMALL)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    (line,) = network.take(known, "file")
    after, given = network.state_dict(), known.state_dict()
    common = [name for name in after if name.startswith(("inversion.", "measnet.", "wiener."))]
    assert line == f"copied {len(common)} of {len(after)} tensors"
    for name, value in after.items():
        assert torch.equal(value, given[name] if name in common else before[name])


def test_what_it_cannot_take(clip_capture: CaptureModel, tiny_capture: CaptureModel) -> None:
    network = built(clip_capture, **SMALL)
    before = {name: value.clone() for name, value in network.state_dict().items()}
    without = build_network(clip_capture, "videonet", "tiny", filters=4, joint_iterations=4, measnet=False)
    wider = build_network(clip_capture, "videonet", "tiny", filters=8, joint_iterations=4)
    other = built(clip_capture, **SMALL | {"classifier": "cnn3d"})
    for known in (without, wider, other, build_network(tiny_capture, "flatnet2d", "tiny")):
        with pytest.raises(InputError, match=r"^file"):
            network.take(known, "file")
    for name, value in network.state_dict().items():
        assert torch.equal(value, before[name])
    same = built(clip_capture, **SMALL)
    assert network.take(same, "file")
    assert all(torch.equal(value, same.state_dict()[name]) for name, value in network.state_dict().items())


@pytest.mark.parametrize("name", ["activitynet", "raw_classifier", "lens_classifier"])
def test_stills_are_refused(tiny_capture: CaptureModel, name: str) -> None:
    with pytest.raises(InputError, match="stills"):
        build_network(tiny_capture, name, classes=CLASSES)


def test_several_planes_are_refused(clip_capture: CaptureModel, tiny_capture: CaptureModel) -> None:
    several = replace(clip_capture, stack=tiny_capture.stack)
    with pytest.raises(InputError, match="3 planes, but ActivityNet knows one"):
        build_network(several, "activitynet", classes=CLASSES)


def test_as_a_method_it_shows_what_it_looks_at_and_names_classes(
    clip_capture: CaptureModel, measurement: Tensor
) -> None:
    network = built(clip_capture, **SMALL)
    method = learned_method("mine", network, clip_capture)
    assert isinstance(method, ActivityMethod)
    checked: Method = method
    clock = Clock()
    estimate, chances = checked.reconstruct(measurement), method.recognise(measurement, clock)[1]
    assert list(clock.seconds) == ["joint", "network"]
    torch.testing.assert_close(chances.sum(dim=1), torch.ones(2))
    with torch.no_grad():
        torch.testing.assert_close(chances, network(measurement).logits.softmax(dim=1))
        torch.testing.assert_close(estimate.image, network.frame_estimates(network.invert(measurement)))
    assert estimate.disparity.shape == (2, 4, 1, 16, 16)


def test_what_looks_at_no_capture_is_no_method(clip_capture: CaptureModel) -> None:
    for name in ("lens_classifier", "raw_classifier"):
        with pytest.raises(InputError, match="reconstructs nothing"):
            learned_method("mine", built(clip_capture, name, "compact"), clip_capture)


def test_names_and_sizes(clip_capture: CaptureModel) -> None:
    network = build_network(clip_capture, **named({"network": "activitynet", "size": "tiny", **SMALL}))
    assert isinstance(network, ActivityNet)
    assert network.classes == ("a", "b", "c")
    assert isinstance(built(clip_capture, "raw_classifier", "compact"), RawClassifier)
    assert isinstance(built(clip_capture, "lens_classifier", "compact"), LensClassifier)
    for changes in ({"frames": "every"}, {"classifier": "vgg"}, {"size": "tiny"}, {"filters": 3}):
        with pytest.raises(InputError):
            build_network(clip_capture, "lens_classifier", **{"classes": CLASSES, **changes})


def test_the_shipped_file_is_small_and_says_its_scenes() -> None:
    path = find_checkpoint("activitynet")
    assert path.stat().st_size < 1.5e6
    assert load_checkpoint(path).record["scenes"]["train"] == ["activity, seed 7, train"]
