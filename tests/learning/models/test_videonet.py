"""VideoNet: what goes where in every architecture, what it begins with, what it re-simulates, what it takes and refuses."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any, TypeVar

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.checkpoint import find_checkpoint, load_checkpoint
from learning.classical.by_name import build_method
from learning.layers.inversion import RegularisedInversion, WienerInversion
from learning.layers.noise import noise_ratio
from learning.layers.space_time import JOINT, ClipProblem, JointLeastSquares
from learning.method import Clock, Method, linear_to_srgb
from learning.models import build_network, full_architecture, learned_method
from learning.models.clip_network import STARTS
from learning.models.videonet import VIDEO_SIZES, VideoMethod, VideoNet
from learning.timing import Timing
from simulator.camera.shutter import RollingShutter, RowShutter
from simulator.errors import InputError

TINY: dict[str, Any] = {
    **{"initial_estimate": "joint", "measnet": True, "dimensions": 2, "body": "naf", "filters": 4, "blocks": 1},
    **{
        "levels": 2,
        "stem": 2,
        "refinements": 1,
        "repeats": 0,
        "noise_aware": True,
        "joint_iterations": 4,
        "joint_noise": 1.0,
        "joint_correlation": 0.0,
    },
}
EVERY = [
    {"initial_estimate": start, "measnet": measnet, "dimensions": dimensions, "body": body}
    for start, measnet, dimensions, body in product(STARTS, (True, False), (2, 3), ("naf", "unet"))
]
Network = TypeVar("Network", bound=nn.Module)
every = pytest.mark.parametrize("which", EVERY, ids=["-".join(map(str, each.values())) for each in EVERY])


@pytest.fixture
def measurement() -> Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(0.1, 0.9, size=(2, 3, 48, 48))).float()


@pytest.fixture(scope="module")
def spread(clip_capture: CaptureModel) -> CaptureModel:
    """The camera with dots over the whole sensor, as a mask that suits a rolling shutter has them."""
    values = np.zeros((1, 3, 81, 81), np.float32)
    rows, columns = np.random.default_rng(5).integers(0, 81, (2, 90))
    values[:, :, rows, columns] = np.random.default_rng(6).uniform(0.5, 1, (3, 90))
    return clip_capture.with_stack(replace(clip_capture.stack, values=values))


@pytest.fixture(scope="module")
def uneven(spread: CaptureModel) -> CaptureModel:
    """The same with a shutter whose rows are open for 2 to 14 ms."""
    opens_s = np.random.default_rng(1).uniform(0, 1e-3, 48)
    shutter = RowShutter(np.stack([opens_s, opens_s + np.random.default_rng(2).uniform(2e-3, 14e-3, 48)], axis=-1))
    exposures = shutter.exposures_s(48)[::-1]
    return replace(spread, timing=Timing(shutter, np.arange(5) * 4e-3), row_exposure=exposures / exposures.mean())


def network(capture: CaptureModel, seed: int = 0, **changes: Any) -> VideoNet:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return VideoNet(capture, **TINY | changes)


def shaken(net: Network, size: float = 0.1) -> Network:
    """Move all parameters: bodies begin with heads and residuals of 0, behind which nothing is seen."""
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += size * torch.randn(parameter.shape, generator=generator, dtype=torch.float64).to(parameter)
    return net


def codes(light: Tensor | np.ndarray, capture: CaptureModel) -> np.ndarray:
    """Return sRGB codes of light ``(..., C, h, w)`` in the camera's channels, 0 to 4 times white, by the standard's curve."""
    linear = np.einsum("ac,...chw->...ahw", np.linalg.inv(capture.scene_to_camera), np.asarray(light, np.float64))
    linear = linear.clip(0, 4)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


@every
def test_every_architecture_gives_frames_and_learns_with_all_its_weights(
    clip_capture: CaptureModel, measurement: Tensor, which: dict[str, Any]
) -> None:
    net = shaken(network(clip_capture, **which))
    film = net(measurement)
    assert film.image.shape == (2, 4, 3, 16, 16)
    assert film.measured.shape == ((2, 4, 3, 48, 48) if which["measnet"] else (0,))
    generator = torch.Generator().manual_seed(1)
    total = sum((each * torch.randn(each.shape, generator=generator)).sum() for each in film)
    assert isinstance(total, Tensor)
    total.backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None, name
        assert bool(parameter.grad.isfinite().all()), name
        assert bool(parameter.grad.any()), name
    assert not [name for name in net.state_dict() if "joint" in name]


@pytest.mark.parametrize("frames", [1, 5])
@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("margin", [0, 5, 20])
def test_other_numbers_of_frames_and_fields(
    clip_capture: CaptureModel, measurement: Tensor, frames: int, dimensions: int, margin: int
) -> None:
    """A field that goes on beyond the border of 8 pixels, and one that ends before; the image keeps its size."""
    timing = replace(clip_capture.timing, frame_edges_s=np.linspace(0, 16e-3, frames + 1))
    irradiance = np.pad(clip_capture.irradiance, margin, constant_values=8e-5)
    capture = replace(clip_capture, timing=timing, irradiance=irradiance)
    for start in STARTS:
        net = network(capture, dimensions=dimensions, initial_estimate=start)
        film = net(measurement)
        assert film.image.shape == (2, frames, 3, 16, 16)
        assert film.measured.shape == (2, frames, 3, 48, 48)
        found = net.initial_estimate(measurement)
        assert (found is None) == (start != "joint")
        if found is not None:
            side, rim = 16 + 2 * min(margin, 8), slice(min(margin, 8), min(margin, 8) + 16)
            assert found.shape == (2, frames, 3, side, side)
            numbers: dict[str, Any] = dict(JOINT) | {"iterations": 4}
            wanted = JointLeastSquares(capture, **numbers)(measurement)  # of the whole field
            torch.testing.assert_close(found[..., rim, rim], wanted, rtol=1e-4, atol=1e-4 * float(wanted.abs().max()))


@pytest.mark.parametrize("body", ["naf", "unet"])
@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize(("start", "measnet"), [*product(STARTS, (True, False))])
def test_at_first_it_gives_what_it_begins_with(
    clip_capture: CaptureModel, measurement: Tensor, start: Any, measnet: bool, dimensions: int, body: str
) -> None:
    """In sRGB codes: heads begin with 0, so bodies and refinements add nothing."""
    shape = {"initial_estimate": start, "measnet": measnet, "dimensions": dimensions, "body": body}
    with torch.no_grad():
        film = network(clip_capture, **shape)(measurement)
    still = replace(clip_capture, timing=None)
    inversion = RegularisedInversion(still, regularisation_lambda=0.3, tikhonov=1.0, noise_weight=30.0)
    offset = torch.from_numpy(clip_capture.offset).float()[:, None, None]
    slivers = (measurement - offset)[:, None] * torch.from_numpy(clip_capture.row_shares)[:, None, :, None].float()
    with torch.no_grad():
        if start == "joint":
            numbers: dict[str, Any] = dict(JOINT) | {"iterations": 4}
            light = JointLeastSquares(clip_capture, **numbers)(measurement)
        elif start == "static":
            light = inversion(measurement).expand(-1, 4, -1, -1, -1)
        elif measnet:  # which completes the slivers to measurements; those are inverted
            light = WienerInversion(still, noise_to_signal=1.0)(slivers + offset)
        else:  # each is inverted, with the lambda of the whole capture's noise
            noise = noise_ratio(measurement - offset)
            every = slivers.unbind(1)
            light = torch.stack([inversion.volume(inversion.spectrum(each), noise)[:, 0] for each in every], dim=1)
    wanted = codes(light, clip_capture)
    # float32, behind transforms and a curve with a slope of 12.92
    np.testing.assert_allclose(film.image.numpy(), wanted, rtol=0, atol=1e-4 * max(1, np.abs(wanted).max()))
    if measnet and start == "slivers":
        torch.testing.assert_close(film.measured, slivers, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("start", STARTS)
def test_bodies_are_given_all_that_is_known(clip_capture: CaptureModel, measurement: Tensor, start: Any) -> None:
    """MeasNet the measurements, the slivers, which rows were open, the capture; EnhanceNet and refinements what was inverted.

    All are told the noise level. Only MeasNet has learned something: what it adds is in units of the capture.
    """
    net = network(clip_capture, initial_estimate=start)
    assert net.measnet is not None
    assert net.wiener is not None
    shaken(net.measnet)
    own: dict[str, Tensor] = {}
    shared: dict[str, Tensor] = {}

    def keep(name: str, module: nn.Module) -> None:
        def hook(_: nn.Module, given: tuple[Tensor, Tensor]) -> None:
            own[name], shared[name] = given

        module.register_forward_pre_hook(hook)

    for name, module in (("measnet", net.measnet), ("enhance", net.enhancement), ("refine", net.refinements[0])):
        keep(name, module)
    with torch.no_grad():
        film = net(measurement)
        light = measurement - torch.from_numpy(clip_capture.offset).float()[:, None, None]
        shares = torch.from_numpy(clip_capture.row_shares)[:, None, :, None].float()
        noise = noise_ratio(light)
        level = (1 + noise.mean(dim=1).log10() / 3)[:, None, None, None]  # about 0 at 1/1000, 1 where noise is all
        still = replace(clip_capture, timing=None)
        inversion = RegularisedInversion(still, regularisation_lambda=0.3, tikhonov=1.0, noise_weight=30.0)
        static = inversion(measurement)[:, 0]
        slivers = light[:, None] * shares
        each = inversion.volume(inversion.spectrum(slivers.flatten(0, 1)), noise.repeat_interleave(4, dim=0))[:, 0]
        frames = {"slivers": each.unflatten(0, (2, 4)), "static": static[:, None].expand(-1, 4, -1, -1, -1)}
        frames |= {"joint": net.initial_estimate(measurement)}
        known = slivers if start == "slivers" else net._seen(frames[start])
        unit = light.square().mean(dim=(1, 2, 3)).sqrt()[:, None, None, None, None]
        completed = known + unit * net.measnet(own["measnet"], shared["measnet"])
        inverted = net.wiener.scene(completed)
        image = torch.from_numpy(codes(inverted if start == "slivers" else frames[start], clip_capture)).float()
        of_frames, of_all = net._residuals(image, light, noise)
    pixels, image_level = level.expand(-1, -1, 48, 48), level.expand(-1, -1, 16, 16)
    masks = shares.expand(2, -1, 1, -1, 48)
    wanted = {
        "measnet": ([known / unit, slivers / unit, masks], [light / unit[:, 0], pixels]),
        "enhance": ([frames[start], inverted, image], [static, image_level]),
        "refine": ([of_frames, image], [of_all, static, image_level]),
    }
    close: dict[str, Any] = {"rtol": 1e-4, "atol": 2e-4}  # float32, behind transforms and a curve with a slope of 12.92
    torch.testing.assert_close(film.measured, completed, **close)
    for name, (of_frame, of_clip) in wanted.items():
        torch.testing.assert_close(own[name], torch.cat(of_frame, dim=2), **close)
        torch.testing.assert_close(shared[name], torch.cat(of_clip, dim=1), **close)


def test_a_start_that_is_known_is_taken(clip_capture: CaptureModel, measurement: Tensor) -> None:
    net = shaken(network(clip_capture))
    with torch.no_grad():
        found = net.initial_estimate(measurement)
        assert found is not None
        inside, outside = net(measurement), net(measurement, found)
        other = net(measurement, 0.5 * found)
    for one, two in zip(inside, outside, strict=True):
        torch.testing.assert_close(one, two, rtol=1e-6, atol=1e-6)
    assert float((other.image - inside.image).abs().max()) > 0.01
    flat = network(clip_capture)(measurement, torch.full((2, 4, 3, 16, 16), 0.5))
    grey = codes(np.full((3, 1, 1), 0.5), clip_capture)
    np.testing.assert_allclose(flat.image.detach().numpy(), np.broadcast_to(grey, (2, 4, 3, 16, 16)), atol=1e-5)
    for start in ("static", "slivers"):
        assert network(clip_capture, initial_estimate=start).initial_estimate(measurement) is None


def moving(capture: CaptureModel) -> np.ndarray:
    """Return radiance over white, linear sRGB ``(N, 3, h, w)``: a wall brighter at one side, a spot that moves."""
    y, x = np.mgrid[:16, :16] / 15
    film = np.broadcast_to(np.stack([0.1 + 0.3 * y, 0.2 + 0.2 * x, 0.3 + 0 * x]), (capture.frames, 3, 16, 16)).copy()
    for frame in range(capture.frames):
        film[frame, :, 2:6, 1 + 3 * frame : 5 + 3 * frame] = np.array([0.9, 0.7, 0.5])[:, None, None]
    return film


def exposed(capture: CaptureModel, film: np.ndarray) -> np.ndarray:
    """Return the noise-free measurement ``(1, C, H, W)``, by the camera's own operator in float64."""
    light = np.einsum("ca,nahw->nchw", capture.scene_to_camera, film) * capture.white * capture.irradiance
    exact = replace(capture, stack=replace(capture.stack, values=capture.stack.values.astype(np.float64)))
    seen = exact.space_time(light).forward(light[:, None])
    return (capture.offset[:, None, None] + capture.gain * seen)[None]


def srgb(film: np.ndarray) -> np.ndarray:
    return np.where(film <= 0.0031308, 12.92 * film, 1.055 * np.maximum(film, 0.0031308) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("which", ["clip_capture", "spread", "uneven"])
def test_nothing_is_left_of_the_true_frames(which: str, double: None, request: pytest.FixtureRequest) -> None:
    """Also where rows differ in exposure. Of frames that are wrong, what is left is inverted row by row."""
    capture: CaptureModel = request.getfixturevalue(which)
    film = moving(capture)
    measurement = torch.from_numpy(exposed(capture, film))
    net = network(capture, noise_aware=False)
    light = net.inversion.light(measurement)
    right, wrong = (torch.from_numpy(srgb(each))[None] for each in (film, film[::-1].copy()))
    assert capture.timing is not None
    with torch.no_grad():
        found = net._residuals(right, light, None)
        of_frames, of_all = net._residuals(wrong, light, None)
    scale = float(of_frames.abs().max())  # not frame by frame: some rows see nothing of what changed
    for residual, other in zip(found, (of_frames, of_all), strict=True):
        assert residual.shape == other.shape
        # The curve's digits are the standard's: there and back, codes are 3e-8 off.
        assert float(residual.abs().max()) < 1e-5 * scale
    difference = measurement - torch.from_numpy(exposed(capture, film[::-1]))
    still = replace(capture, timing=None)
    inversion = RegularisedInversion(still, regularisation_lambda=0.3, tikhonov=1.0)
    offset = torch.from_numpy(capture.offset)[:, None, None]
    with torch.no_grad():
        wanted = inversion(offset + difference)[:, 0]
        torch.testing.assert_close(of_all, wanted, rtol=0, atol=1e-5 * float(wanted.abs().max()))
        for frame, share in enumerate(capture.timing.row_shares(48)):
            weight = torch.from_numpy(share / share.mean())[:, None]
            wanted = inversion(offset + difference * weight)[:, 0]
            torch.testing.assert_close(of_frames[:, frame], wanted, rtol=0, atol=1e-5 * scale)


@pytest.mark.parametrize("which", ["spread", "uneven"])
def test_measurements_that_are_completed_are_those_of_all_rows(
    which: str, double: None, request: pytest.FixtureRequest
) -> None:
    """Begun with the true frames, MeasNet adds nothing at first: what a global shutter would see of each frame."""
    capture: CaptureModel = request.getfixturevalue(which)
    film = moving(capture)
    begun = torch.from_numpy(np.einsum("ca,nahw->nchw", capture.scene_to_camera, film))[None]
    net = network(capture)
    with torch.no_grad():
        measured = net(torch.from_numpy(exposed(capture, film)), begun).measured[0].numpy()
    for frame in range(4):
        alone = replace(capture, timing=None, row_exposure=None)
        wanted = exposed(alone, film[frame : frame + 1])[0] - capture.offset[:, None, None]
        np.testing.assert_allclose(measured[frame], wanted, rtol=0, atol=1e-12 * wanted.max())


FLASHES = {0: (2, 10), 1: (9, 3), 3: (12, 12)}  # in each frame, where three by three pixels are lit


def test_what_is_at_the_top_stays_there_and_what_is_first_is_first(spread: CaptureModel) -> None:
    """The static inversion has all in every frame, where it was; joint least squares have each when it was."""
    film = np.full((4, 3, 16, 16), 0.02)
    for frame, (row, column) in FLASHES.items():
        film[frame, :, row : row + 3, column : column + 3] = 1.0
    film[2] = film.mean(axis=0)
    given = torch.from_numpy(exposed(spread, film)).float()
    with torch.no_grad():
        joint, static = (
            network(spread, initial_estimate=start, joint_iterations=20, noise_aware=False)(given).image[0].mean(dim=1)
            for start in ("joint", "static")
        )
    for frame, (row, column) in FLASHES.items():
        place = (slice(row, row + 3), slice(column, column + 3))
        assert int(joint[:, *place].mean(dim=(1, 2)).argmax()) == frame
        others = [value for other, value in FLASHES.items() if other != frame]
        mirrored = [(13 - row, column), (row, 13 - column), (13 - row, 13 - column)]
        for top, left in (each for each in mirrored if each not in others):
            there = (0, slice(top, top + 3), slice(left, left + 3))
            assert static[0, *place].mean() > static[*there].mean() + 0.05
    torch.testing.assert_close(static[0], static[3], rtol=0, atol=1e-6)


def test_captures_of_a_batch_do_not_know_of_each_other(clip_capture: CaptureModel, measurement: Tensor) -> None:
    for body in ("naf", "unet"):
        net = shaken(network(clip_capture, body=body)).eval()
        with torch.no_grad():
            together = net(measurement)
            for index in range(2):
                alone = net(measurement[index : index + 1])
                for one, other in zip(alone, together, strict=True):
                    torch.testing.assert_close(one[0], other[index], rtol=0, atol=1e-4 * float(other.abs().max()))


def test_bodies_in_bfloat16_all_else_in_float32(clip_capture: CaptureModel, measurement: Tensor) -> None:
    net = shaken(network(clip_capture), 0.02)
    with torch.no_grad():
        exact = net(measurement)
        with torch.autocast("cpu", torch.bfloat16):
            rounded = net(measurement)
    assert rounded.image.dtype == rounded.measured.dtype == torch.float32
    for one, other in zip(rounded, exact, strict=True):
        assert not torch.equal(one, other)
        # 2^-9 in each number of a few layers
        assert float((one - other).abs().max()) < 0.05 * float(other.abs().max())
    begun = network(clip_capture)
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        first = begun(measurement).image
    with torch.no_grad():
        torch.testing.assert_close(first, begun(measurement).image, rtol=0, atol=1e-6)


def test_as_a_method(clip_capture: CaptureModel, measurement: Tensor) -> None:
    """In evaluation mode, which is left as it was; timed stage by stage."""
    for start, stages in (("joint", ["joint", "network"]), ("static", ["network"])):
        net = shaken(network(clip_capture, initial_estimate=start, body="unet")).train()
        before = {name: value.clone() for name, value in net.state_dict().items()}
        method, clock = VideoMethod("ours", net, clip_capture), Clock()
        estimate = method.reconstruct(measurement, clock)
        assert (method.name, list(clock.seconds)) == ("ours", stages)
        assert net.training
        assert all(torch.equal(value, before[name]) for name, value in net.state_dict().items())
        assert estimate.disparity.shape == (2, 4, 1, 16, 16)
        assert not estimate.disparity.any()
        assert not estimate.image.requires_grad
        with torch.no_grad():
            torch.testing.assert_close(estimate.image, net.eval()(measurement).image, rtol=1e-5, atol=1e-5)


def test_the_thesis_has_u_nets_of_32_to_128_filters_on_zero_filled_slivers(clip_capture: CaptureModel) -> None:
    net = build_network(clip_capture, "videonet", "thesis")
    assert net.measnet is not None
    for body in (net.measnet.body, net.enhancement.body):
        widths = [level[0].out_channels for level in body.down]  # pyright: ignore[reportAttributeAccessIssue, reportIndexIssue]
        assert widths == [32, 64, 128]
    assert (net.start, net.noise_aware, net.joint, len(net.refinements)) == ("slivers", False, None, 0)
    assert not [name for name in net.state_dict() if "noise" in name]


@pytest.mark.parametrize("size", VIDEO_SIZES)
def test_sizes_are_their_numbers_with_what_is_changed(clip_capture: CaptureModel, size: str) -> None:
    full = full_architecture({"network": "videonet", "size": size, "filters": 4, "joint_iterations": 3})
    assert full == {"network": "videonet", "size": size} | VIDEO_SIZES[size] | {"filters": 4, "joint_iterations": 3}
    changed = build_network(clip_capture, "videonet", size, filters=4)
    whole = VideoNet(clip_capture, **VIDEO_SIZES[size] | {"filters": 4})
    shapes = [{name: value.shape for name, value in each.state_dict().items()} for each in (changed, whole)]
    assert shapes[0] == shapes[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"initial_estimate": "dark"}, "^initial_estimate: "),
        ({"body": "resnet"}, "^body: "),
        ({"body": "unet", "blocks": 2}, "^blocks: "),
        ({"filters": 0}, "^filters: "),
        ({"levels": 0}, "^levels: "),
        ({"dimensions": 4}, "^dimensions: "),
        ({"attention": True}, "^attention: "),
        ({"refinements": 0, "repeats": 1}, "^repeats: "),
    ],
)
def test_what_makes_no_sense_is_refused(clip_capture: CaptureModel, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        build_network(clip_capture, "videonet", "tiny", **changes)


def test_other_cameras_and_sizes_are_refused(tiny_capture: CaptureModel, clip_capture: CaptureModel) -> None:
    with pytest.raises(InputError, match=r"^capture: "):
        build_network(tiny_capture, "videonet", "tiny")
    with pytest.raises(InputError, match=r"^stack: "):
        build_network(replace(tiny_capture, timing=clip_capture.timing), "videonet", "tiny")
    with pytest.raises(InputError, match=r"^size: "):
        build_network(clip_capture, "videonet", "huge")
    with pytest.raises(InputError, match=r"^size: "):
        full_architecture({"network": "videonet", "size": "huge"})
    with pytest.raises(InputError, match=r"^measurement: "):
        network(clip_capture)(torch.zeros(1, 3, 48, 47))
    with pytest.raises(InputError, match=r"^capture: "):
        build_network(clip_capture, "flatnet3d", "tiny")


INNER = {"filters": 8, "levels": 3, "blocks": 2}


@pytest.mark.parametrize("body", ["naf", "unet"])
@pytest.mark.parametrize("stem", [1, 2])
def test_takes_the_inside_of_a_flatnet(
    tiny_capture: CaptureModel, clip_capture: CaptureModel, body: Any, stem: int
) -> None:
    """All between the first and the last convolution of its body; these, MeasNet and the refinements begin as they do."""
    sizes = INNER | {"body": body, "blocks": 2 if body == "naf" else 1}
    known = build_network(tiny_capture, "flatnet2d", "tiny", **sizes, stem=stem)
    net = network(clip_capture, **sizes)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    (line,) = net.take(known, "flatnet.safetensors")
    ends = ("intro.", "head.", "down.0.0.") if body == "unet" else ("intro.", "head.")
    inside = [name for name in known.enhancement.state_dict() if not name.startswith(ends)]
    assert len(inside) > 20
    taken = {f"enhancement.body.{name}": known.enhancement.state_dict()[name] for name in inside}
    assert line == f"copied {len(taken)} of {len(before)} tensors"
    for name, value in net.state_dict().items():
        assert torch.equal(value, taken.get(name, before[name])), name


@pytest.mark.parametrize(
    "others",
    [{"filters": 6}, {"levels": 2}, {"levels": 4}, {"blocks": 1}, {"blocks": 3}, {"body": "unet", "blocks": 1}],
)
def test_a_flatnet_of_another_size_is_refused(
    tiny_capture: CaptureModel, clip_capture: CaptureModel, others: dict[str, Any]
) -> None:
    net = network(clip_capture, **INNER)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    known = build_network(tiny_capture, "flatnet2d", "tiny", **INNER | others)
    with pytest.raises(InputError, match=r"^flatnet\.safetensors: "):
        net.take(known, "flatnet.safetensors")
    assert all(torch.equal(value, before[name]) for name, value in net.state_dict().items())


def test_a_repeated_refinement_is_a_further_one_of_the_same_weights(
    clip_capture: CaptureModel, measurement: Tensor
) -> None:
    fewer = shaken(network(clip_capture, refinements=2))
    repeated, further = network(clip_capture, refinements=2, repeats=1), network(clip_capture, refinements=3)
    weights = fewer.state_dict()
    again = {
        name.replace(".1.", ".2.", 1): value for name, value in weights.items() if name.startswith("refinements.1.")
    }
    repeated.load_state_dict(weights)
    further.load_state_dict(weights | again)
    with torch.no_grad():
        once, twice, never = (net(measurement).image for net in (repeated, further, fewer))
    assert torch.equal(once, twice)
    assert float((once - never).abs().mean()) > 0.01


def test_takes_another_videonet_whose_refinements_may_be_fewer(clip_capture: CaptureModel, measurement: Tensor) -> None:
    known = shaken(network(clip_capture, seed=1))
    net = network(clip_capture, refinements=2)
    net.take(known, "video.safetensors")
    with torch.no_grad():  # the second refinement begins with nothing
        torch.testing.assert_close(net(measurement).image, known(measurement).image, rtol=1e-5, atol=1e-5)
    for others in ({"filters": 6}, {"refinements": 3}, {"dimensions": 3}):
        with pytest.raises(InputError, match=r"^video\.safetensors: "):
            net.take(network(clip_capture, **others), "video.safetensors")


def test_another_shutter_is_another_network(spread: CaptureModel, measurement: Tensor) -> None:
    """The same weights: rows that see other frames give other frames."""
    down, up = (
        replace(spread, timing=Timing(RollingShutter(4e-3, 0.25e-3, way), np.arange(5) * 4e-3))
        for way in ("down", "up")
    )
    one, other = (shaken(network(each)) for each in (down, up))
    other.load_state_dict(one.state_dict())
    with torch.no_grad():
        first, second = one(measurement).image, other(measurement).image
    assert float((first - second).abs().mean()) > 0.01


def test_the_shipped_one_finds_what_moves() -> None:
    """A disc on black that crosses the image: unlike any scene of its training, through the camera of the file."""
    known = load_checkpoint(find_checkpoint("videonet"))
    capture = known.capture
    problem, (rows, columns) = ClipProblem(capture), capture.scene_shape
    y, x = np.mgrid[:rows, :columns]
    centres = np.linspace(0.25, 0.75, capture.frames) * columns
    discs = [np.clip(9.5 - np.hypot(y - rows / 2, x - centre), 0, 1) for centre in centres]
    radiance = np.stack(discs)[:, None] * np.array([0.7, 0.4, 0.2])[:, None, None]
    film = torch.from_numpy(np.einsum("ca,nahw->nchw", capture.scene_to_camera, radiance)).float()
    seen = problem.forward(problem.light(film[None, :, None])) / problem.scale + problem.offset
    noise = 10 ** (-40 / 20) * float(seen.max()) * torch.randn(seen.shape, generator=torch.Generator().manual_seed(0))
    wanted = linear_to_srgb(torch.from_numpy(radiance).float(), 1.0)
    moving = torch.from_numpy(radiance).std(dim=0).amax(dim=0) > 0.05

    def psnr_db(method: Method) -> np.ndarray:
        error = (method.reconstruct(seen + noise).image[0].clamp(0, 1) - wanted).square()
        return -10 * np.log10([float(error.mean()), float(error[..., moving].mean())])

    found = psnr_db(learned_method("VideoNet", known.network, capture))
    begun = psnr_db(build_method(capture, "joint", {"iterations": VIDEO_SIZES["compact"]["joint_iterations"]}))
    assert (found - begun > [6, 4]).all()  # dB, of all pixels and of moving ones: 9.3 and 5.8 where it was trained


def test_the_shipped_file_is_small_and_says_its_scenes() -> None:
    path = find_checkpoint("videonet")
    assert path.stat().st_size < 8e6
    known = load_checkpoint(path)
    assert known.record["scenes"]["train"] == ["high_speed, seed 7, train"]
    # Nothing follows from today's defaults, but for what is younger than the file.
    assert full_architecture(known.architecture) == known.architecture | {"joint_noise": 1.0, "joint_correlation": 0.0}
