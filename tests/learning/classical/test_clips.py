"""The classical methods of clips by name: what they are made of, what they give, what they refuse."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.checkpoint import load_checkpoint
from learning.classical.by_name import ALL_DEFAULTS, ALL_SEARCH, ALL_VOLUME_PARAMETERS, OF_CLIPS, build_method
from learning.classical.clips import CLIP_DEFAULTS, CLIP_SEARCH, ClipMethod, SliverInversion, StaticInversion
from learning.classical.fista import FistaTv
from learning.classical.method import ClassicalMethod, check_parameters
from learning.config import TuneConfig
from learning.layers.inversion import RegularisedInversion
from learning.layers.space_time import JOINT, JointLeastSquares
from learning.method import Clock, Method
from learning.models import learned_method
from learning.timing import Timing
from learning.tune.job import classical
from simulator.camera.shutter import RowShutter
from simulator.errors import InputError
from simulator.validation import renamed

STATIC: dict[str, Any] = {"regularisation_lambda": 0.3, "tikhonov": 0.7}
FEW: dict[str, dict[str, Any]] = {name: {"iterations": 3} for name in ("joint", "fista", "pnp_clips", "nstm")}
FEW["udn"] = {"iterations": 3, "filters": 8}


@pytest.fixture
def measurement() -> Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(size=(2, 3, 48, 48)).astype(np.float32))


@pytest.fixture(scope="module")
def uneven(clip_capture: CaptureModel) -> CaptureModel:
    """The camera with a shutter whose rows are open for 1 to 15 ms."""
    opens_s = np.random.default_rng(1).uniform(0, 1e-3, 48)
    table_s = np.stack([opens_s, opens_s + np.random.default_rng(2).uniform(1e-3, 15e-3, 48)], axis=-1)
    shutter = RowShutter(table_s)
    exposures = shutter.exposures_s(48)[::-1]
    timing = Timing(shutter, np.arange(5) * 4e-3)
    return replace(clip_capture, timing=timing, row_exposure=exposures / exposures.mean())


def film_of(volume: Tensor, capture: CaptureModel) -> np.ndarray:
    """Return sRGB codes of frames ``(B, N, C, h, w)`` in the camera's channels: the standard's curve in float64."""
    light = np.einsum("ac,bnchw->bnahw", np.linalg.inv(capture.scene_to_camera), volume.double().numpy())
    low = 12.92 * light
    return np.where(light <= 0.0031308, low, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize("name", CLIP_DEFAULTS)
def test_gives_frames_by_name(clip_capture: CaptureModel, measurement: Tensor, name: str) -> None:
    method = build_method(clip_capture, name, FEW.get(name))
    assert isinstance(method, ClipMethod)
    clock = Clock()
    estimate, volume = method.reconstruct(measurement, clock), method.volume(measurement)
    assert list(clock.seconds) == [name]
    assert method.capture is clip_capture
    assert estimate.image.shape == (2, 4, 3, 16, 16)
    assert estimate.disparity.shape == (2, 4, 1, 16, 16)
    assert not estimate.disparity.any()
    assert not estimate.image.requires_grad
    wanted = film_of(volume, clip_capture)
    # float32: 1e-7 of the greatest light, and the curve's slope of 12.92 where it is dark
    np.testing.assert_allclose(estimate.image.numpy(), wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize("name", CLIP_DEFAULTS)
def test_captures_of_a_batch_do_not_touch(clip_capture: CaptureModel, measurement: Tensor, name: str) -> None:
    method = build_method(clip_capture, name, FEW.get(name))
    both = method.volume(measurement)
    for scene in range(2):
        alone = method.volume(measurement[scene : scene + 1])[0]
        # FFTs of other batch sizes round differently
        torch.testing.assert_close(alone, both[scene], rtol=0, atol=1e-4 * float(both.abs().max()))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_a_gpu_gives_what_the_cpu_gives(clip_capture: CaptureModel, clip_checkpoint: Path, measurement: Tensor) -> None:
    network = load_checkpoint(clip_checkpoint, capture=clip_capture).network
    methods: list[Method] = [build_method(clip_capture, name, FEW.get(name)) for name in CLIP_DEFAULTS]
    for method in (*methods, learned_method("VideoNet", network, clip_capture)):
        wanted = method.reconstruct(measurement).image
        found = method.to("cuda").reconstruct(measurement.to("cuda")).image.cpu()
        # Sums in other orders, in float32; the fits' few steps of Adam make more of it
        torch.testing.assert_close(found, wanted, rtol=0, atol=1e-2 * float(wanted.abs().max()), msg=method.name)


def test_static_is_the_inversion_of_a_still_repeated(clip_capture: CaptureModel, measurement: Tensor) -> None:
    still = replace(clip_capture, timing=None)
    wanted = RegularisedInversion(still, learned=False, **STATIC)(measurement)
    found = build_method(clip_capture, "static", STATIC).volume(measurement)
    for frame in range(4):
        torch.testing.assert_close(found[:, frame], wanted[:, 0], rtol=0, atol=1e-5 * float(wanted.abs().max()))


@pytest.mark.parametrize("which", ["clip_capture", "uneven"])
def test_slivers_are_inverted_one_by_one(which: str, measurement: Tensor, request: pytest.FixtureRequest) -> None:
    """A row's light in a sliver is its share there, over the mean row's; closed rows are dark, at the offset."""
    capture: CaptureModel = request.getfixturevalue(which)
    assert capture.timing is not None
    inversion = RegularisedInversion(replace(capture, timing=None), learned=False, **STATIC)
    offset = torch.from_numpy(capture.offset).float()[:, None, None]
    found = SliverInversion(capture, **STATIC)(measurement)
    for frame, share in enumerate(capture.timing.row_shares(48)):
        weight = torch.from_numpy(share / share.mean()).float()[:, None]
        wanted = inversion((measurement - offset) * weight + offset)[:, 0]
        torch.testing.assert_close(found[:, frame], wanted, rtol=0, atol=1e-5 * float(wanted.abs().max()))
    assert float((found[:, 0] - found[:, 3]).abs().max()) > 0.01 * float(found.abs().max())


@pytest.mark.parametrize("which", ["clip_capture", "uneven"])
def test_one_sliver_is_the_static_inversion(which: str, measurement: Tensor, request: pytest.FixtureRequest) -> None:
    """However long each row is open: its light is divided by that, and all of it belongs to the one frame."""
    capture: CaptureModel = request.getfixturevalue(which)
    assert capture.timing is not None
    one = replace(capture, timing=replace(capture.timing, frame_edges_s=np.array([0.0, 16e-3])))
    static, slivers = (kind(one, **STATIC)(measurement) for kind in (StaticInversion, SliverInversion))
    torch.testing.assert_close(slivers, static, rtol=0, atol=1e-5 * float(static.abs().max()))


def test_joint_and_fista_are_their_modules_with_all_parameters(clip_capture: CaptureModel, measurement: Tensor) -> None:
    numbers: dict[str, Any] = {"static": 0.2, "moving": 0.3, "memory": 3.0, "sharpest": 0.1, "decay": 1.5}
    numbers |= {"noise": 2.0, "iterations": 4, "correlation": 0.5}
    wanted = JointLeastSquares(clip_capture, **numbers)(measurement)
    assert torch.equal(build_method(clip_capture, "joint", numbers).volume(measurement), wanted)
    tv: dict[str, Any] = {"tv": 0.03, "tv_over_time": 2.0, "iterations": 3, "prox": "haar", "inner": 2}
    for start, first in (("dark", None), ("joint", JointLeastSquares(clip_capture, **dict(JOINT)))):
        wanted = FistaTv(clip_capture, start=first, **tv)(measurement)
        found = build_method(clip_capture, "fista", tv | {"initial_estimate": start}).volume(measurement)
        assert torch.equal(found, wanted)


@pytest.mark.parametrize("name", ["fista", "pnp_clips"])
def test_begins_with_the_frames_of_a_network(
    clip_capture: CaptureModel, clip_checkpoint: Path, measurement: Tensor, name: str
) -> None:
    stack = replace(clip_capture.stack, values=np.flip(clip_capture.stack.values, -2).copy())
    capture = replace(clip_capture, stack=stack, white=0.3 * clip_capture.white, gain=0.8 * clip_capture.gain)
    method = build_method(capture, name, FEW[name] | {"initial_estimate": str(clip_checkpoint)})
    assert isinstance(method, ClipMethod)
    trained = replace(capture, stack=clip_capture.stack, white=clip_capture.white)  # what the network goes by
    network = learned_method("VideoNet", load_checkpoint(clip_checkpoint, capture=trained).network, trained)
    codes = network.reconstruct(measurement).image.double().numpy()
    light = np.where(codes <= 0.04045, codes / 12.92, ((np.maximum(codes, 0.04045) + 0.055) / 1.055) ** 2.4).clip(0, 4)
    wanted = np.einsum("ca,bnahw->bnchw", capture.scene_to_camera, light) / 0.3
    begun = method.solver._start  # pyright: ignore[reportAttributeAccessIssue]
    with torch.no_grad():
        found = begun.problem.film(begun.light(measurement))[:, :, 0]
    assert wanted.std(axis=1).max() > 0.01  # frames that differ: their order is tested, too
    np.testing.assert_allclose(found.numpy(), wanted, rtol=0, atol=1e-5 * wanted.max())
    joint = build_method(capture, name, FEW[name]).volume(measurement)
    assert float((method.volume(measurement) - joint).abs().max()) > 1e-3 * float(joint.abs().max())


def test_joint_least_squares_see_what_moves(clip_capture: CaptureModel) -> None:
    """A square that jumps from one side to the other: noise-free, by the camera's own operator, over the whole sensor.

    The static inversion knows no motion, and its mean of both sides is no frame's.
    """
    rng = np.random.default_rng(5)
    values = np.zeros((1, 3, 81, 81), np.float32)
    values[:, :, rng.integers(0, 81, 90), rng.integers(0, 81, 90)] = 1
    capture = clip_capture.with_stack(replace(clip_capture.stack, values=values))
    film = np.full((4, 3, 16, 16), 0.1)
    film[:2, :, 5:11, 2:6] = film[2:, :, 5:11, 10:14] = 0.8
    lit = film[:, None] * capture.irradiance * capture.white
    seen = capture.gain * capture.space_time(np.zeros(1)).forward(lit) + capture.offset[:, None, None]
    given = torch.from_numpy(seen[None]).float()
    errors = {}
    few = {"fista": {"iterations": 60}}
    for name in ("static", "slivers", "joint", "fista", "pnp_clips"):  # not those that take longer
        found = build_method(capture, name, few.get(name)).volume(given)[0]
        errors[name] = float((found - torch.from_numpy(film)).square().mean().sqrt())
    assert errors["joint"] < 0.8 * min(errors["static"], errors["slivers"])
    assert errors["fista"] < errors["joint"]
    assert errors["pnp_clips"] < errors["joint"]


def test_stills_and_clips_are_told_apart(tiny_capture: CaptureModel, clip_capture: CaptureModel) -> None:
    for name in CLIP_DEFAULTS:
        with pytest.raises(InputError, match=rf"^{name}: "):
            build_method(tiny_capture, name)
    for name in ALL_DEFAULTS.keys() - set(OF_CLIPS):
        with pytest.raises(InputError, match=rf"^{name}: "):
            build_method(clip_capture, name)
    assert isinstance(build_method(tiny_capture, "cls"), ClassicalMethod)


def test_several_planes_are_refused(tiny_capture: CaptureModel, clip_capture: CaptureModel) -> None:
    several = replace(tiny_capture, timing=clip_capture.timing)
    for name in CLIP_DEFAULTS:
        with pytest.raises(InputError, match=r"^stack: "):
            build_method(several, name)


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("median", {}, "^name: "),
        ("static", {"tv": 0.1}, "^parameters: .*tv"),
        ("joint", {"iterations": 2.5}, "^parameters: iterations"),
        ("joint", {"decay": 0.0}, "^decay: "),
        ("slivers", {"regularisation_lambda": -1.0}, "^regularisation_lambda: "),
        ("fista", {"prox": 3}, "^parameters: prox"),
        ("fista", {"prox": "soft"}, "^prox: "),
        ("fista", {"initial_estimate": "static"}, "^initial_estimate: .*static.*; or take joint or dark as"),
        ("pnp_clips", {"initial_estimate": "dark"}, "^initial_estimate: .*dark.*; or take joint as"),
        ("pnp_clips", {"initial_estimate": "flatnet2d"}, "flatnet2d.*: got a checkpoint of flatnet2d"),
        ("fista", {"initial_estimate": "videonet"}, "videonet.*: is for another camera: slivers: got 4"),
    ],
)
def test_what_makes_no_sense_is_refused(
    clip_capture: CaptureModel, name: str, given: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        build_method(clip_capture, name, given)


@pytest.mark.parametrize("name", sorted({*CLIP_DEFAULTS} - {"pnp_clips"}))  # whose denoiser is that of stills' tests
def test_tuning_accepts_its_own_candidates(clip_capture: CaptureModel, name: str) -> None:
    data = {"validation": Path("somewhere")}
    config = TuneConfig.model_validate({"output": Path("tuned.json"), "data": data, "methods": [name]})
    assert classical(clip_capture, name, config, torch.device("cpu")).space.keys() == CLIP_SEARCH[name].keys()


def test_tuning_knows_parameters_of_every_method() -> None:
    assert ALL_DEFAULTS.keys() == ALL_SEARCH.keys() == ALL_VOLUME_PARAMETERS.keys()
    assert renamed(ALL_DEFAULTS) == ALL_DEFAULTS  # what was tuned is read as it was written
    for name, search in CLIP_SEARCH.items():
        assert set(ALL_VOLUME_PARAMETERS[name]) == set(CLIP_DEFAULTS[name])  # of frames, nothing is cheaper to change
        for parameter, candidates in search.items():
            assert list(candidates) == sorted(set(candidates), key=lambda value: (isinstance(value, str), value))
            assert CLIP_DEFAULTS[name][parameter] in candidates
            for value in candidates:
                check_parameters({parameter: value}, CLIP_DEFAULTS[name], name)
