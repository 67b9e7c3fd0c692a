"""Checkpoints: all comes back, and every file that cannot serve says why."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch
from safetensors import safe_open

from learning.checkpoint import (
    FOLDER,
    find_checkpoint,
    load_checkpoint,
    read_camera,
    save_checkpoint,
)
from learning.models import SIZES, VIDEO_SIZES, LearnedMethod, build_network
from learning.timing import Timing
from simulator.errors import InputError
from simulator.io.files import StorageError
from simulator.optics.stack import depth_planes

ARCHITECTURE = {"network": "flatnet3d", "size": "tiny", "filters": 6}
RECORD = {"command": "flatlight train x.yaml", "seconds": 12.5, "metrics": {"psnr": 20.1}}


@pytest.fixture
def network(tiny_capture):
    torch.manual_seed(3)
    network = build_network(tiny_capture, "flatnet3d", "tiny", filters=6)
    network(torch.rand(4, 3, 48, 48))  # moves the running means
    return network


@pytest.fixture
def path(tmp_path, network, tiny_capture):
    path = tmp_path / "flatnet.safetensors"
    save_checkpoint(path, network, architecture=ARCHITECTURE, capture=tiny_capture, record=RECORD)
    return path


def rewritten(path, change):
    """Change the JSON text of a checkpoint and return its path."""
    with safe_open(path, "pt") as file:
        content = json.loads(file.metadata()["flatlight"])
    change(content)
    metadata = {"flatlight": json.dumps(content)}
    safetensors.torch.save_file(safetensors.torch.load_file(path), path, metadata)
    return path


def test_everything_comes_back(path, network, tiny_capture):
    state = torch.get_rng_state()
    checkpoint = load_checkpoint(path)
    assert torch.equal(torch.get_rng_state(), state)
    assert checkpoint.record == RECORD
    assert checkpoint.architecture == SIZES["tiny"] | ARCHITECTURE
    back, mine = checkpoint.capture, tiny_capture
    for name in ("sensor_shape", "scene_shape", "gain", "white"):
        assert getattr(back, name) == getattr(mine, name)
    for name in ("offset", "irradiance", "scene_to_camera"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mine, name), strict=True)
    np.testing.assert_array_equal(back.stack.values, mine.stack.values, strict=True)
    np.testing.assert_array_equal(back.stack.depths_m, mine.stack.depths_m, strict=True)
    for name in ("pixel_pitch_m", "channels", "fingerprint", "provenance"):
        assert getattr(back.stack, name) == getattr(mine.stack, name)
    assert not checkpoint.network.training
    measurement = torch.rand(2, 3, 48, 48)
    with torch.no_grad():
        wanted = network.eval()(measurement)
    got = LearnedMethod("ours", checkpoint.network, checkpoint.capture).reconstruct(measurement)
    assert torch.equal(got.image, wanted.image)
    assert torch.equal(got.disparity, wanted.disparity)


def test_the_field_comes_back(path, tmp_path, tiny_capture):
    """Light from beside the image is what ADMM wants to know of; the network has nothing of it."""
    wide = np.random.default_rng(2).uniform(1e-4, 2e-4, (20, 22)).astype(np.float32)
    wide[2:-2, 3:-3] = tiny_capture.irradiance
    capture = replace(tiny_capture, irradiance=wide)
    network = load_checkpoint(path).network
    beside = tmp_path / "wide.safetensors"
    save_checkpoint(beside, network, architecture=ARCHITECTURE, capture=capture, record={})
    back = load_checkpoint(beside)
    assert back.capture.field_shape == (20, 22)
    np.testing.assert_array_equal(back.capture.irradiance, wide, strict=True)
    np.testing.assert_array_equal(back.capture.scene_irradiance, tiny_capture.irradiance)
    assert [part.shape for part in back.network(torch.rand(1, 3, 48, 48))] == [(1, 3, 16, 16), (1, 1, 16, 16)]


FIRST = Path(__file__).parent / "files" / "first_version.safetensors"
"""Of a tiny FlatNet3D, 4 filters on 2 levels with attention, as version 1 of the format wrote it."""


def test_the_first_version_gives_what_it_gave():
    """The estimate's means and deviations of each channel, and values here and there, as they were then."""
    checkpoint = load_checkpoint(FIRST)
    assert checkpoint.architecture == {
        **{"network": "flatnet3d", "size": "tiny", "body": "unet", "blocks": 1, "filters": 4, "levels": 2},
        **{
            "attention": True,
            "stem": 1,
            "noise_aware": False,
            "joint": False,
            "refinements": 0,
            "repeats": 0,
            "head": "linear",
        },
    }
    measurement = torch.from_numpy(np.random.default_rng(9).random((1, 3, 16, 16)).astype(np.float32))
    with torch.no_grad():
        found = torch.cat(checkpoint.network(measurement), dim=1)[0].double()
    # Single precision behind some ten layers: 1e-5; batch statistics or a lambda of another kind would be off by tenths.
    for got, wanted in (
        (found.mean(dim=(1, 2)), [0.850069, 0.444989, 0.192768, 0.958672]),
        (found.std(dim=(1, 2)), [0.417772, 0.241519, 0.345191, 0.243480]),
        (found[:, 1, 1], [1.028299, 0.432928, 0.153357, 1.000154]),
        (found[:, 3, 3], [0.972889, 0.843556, -0.180132, 1.134157]),
    ):
        assert got.tolist() == pytest.approx(wanted, abs=1e-4)


def test_the_first_version_is_saved_as_the_newest_and_stays_the_same_network(tmp_path):
    first = load_checkpoint(FIRST)
    path = tmp_path / "again.safetensors"
    save_checkpoint(path, first.network, architecture=first.architecture, capture=first.capture, record=first.record)
    again = load_checkpoint(path)
    assert (again.architecture, again.record) == (first.architecture, {"name": "first version"})
    measurement = torch.rand(1, 3, 16, 16)
    assert torch.equal(again.network(measurement).image, first.network(measurement).image)


def test_same_content_is_the_same_file(path, tmp_path, network, tiny_capture):
    again = tmp_path / "again.safetensors"
    network = network.to(memory_format=torch.channels_last)
    record = dict(reversed(RECORD.items()))
    save_checkpoint(again, network, architecture=ARCHITECTURE, capture=tiny_capture, record=record)
    assert again.read_bytes() == path.read_bytes()


def test_planes_at_infinity(tmp_path, tiny_capture):
    stack = replace(tiny_capture.stack, depths_m=depth_planes(0.05, float("inf"), 3))
    far = tiny_capture.with_stack(stack)
    path = tmp_path / "far.safetensors"
    network = build_network(far, "flatnet2d", "tiny")
    save_checkpoint(path, network, architecture={"network": "flatnet2d", "size": "tiny"}, capture=far, record={})
    assert load_checkpoint(path, capture=far).capture is far
    assert load_checkpoint(path).capture.far_m == float("inf")


def test_half_precision_rounds_filters_and_psfs_only(path, network, tiny_capture, tmp_path):
    half = tmp_path / "half.safetensors"
    precision = torch.float16
    with torch.no_grad():
        network.inversion.log_lambda.add_(1 / 3)
    save_checkpoint(half, network, architecture=ARCHITECTURE, capture=tiny_capture, record={}, precision=precision)
    saved = path.stat().st_size - half.stat().st_size
    halved = sum(p.numel() for p in network.parameters()) + tiny_capture.stack.values.size
    assert saved == pytest.approx(2 * halved, rel=0.05)
    checkpoint = load_checkpoint(half)
    psfs = checkpoint.capture.stack.values
    assert psfs.dtype == np.float32
    np.testing.assert_allclose(psfs, tiny_capture.stack.values, rtol=2**-11, atol=2**-24)
    for key, value in checkpoint.network.state_dict().items():
        mine = network.state_dict()[key]
        assert value.dtype == mine.dtype
        if mine.ndim == 4:
            torch.testing.assert_close(value, mine, rtol=2**-11, atol=2**-24)  # the rounding of float16
        else:
            assert torch.equal(value, mine), key


def test_filters_beyond_half_precision_are_refused_before_anything_is_written(path, network, tiny_capture):
    before = path.read_bytes()
    with torch.no_grad():
        network.enhancement.head.weight[0, 0] = 7e4
    half = {"record": {}, "precision": torch.float16}
    with pytest.raises(InputError, match=r"^precision: "):
        save_checkpoint(path, network, architecture=ARCHITECTURE, capture=tiny_capture, **half)
    assert path.read_bytes() == before


def test_another_camera_of_the_same_planes(path, tiny_capture):
    """Other PSFs, exposure and white: the weights are the same, the inversion is the new camera's."""
    other = replace(tiny_capture, gain=3 * tiny_capture.gain, sensor_shape=(64, 52))
    flipped = np.asarray(other.stack.values)[..., ::-1, :].copy()
    other = other.with_stack(replace(other.stack, values=flipped, fingerprint="f" * 64))
    checkpoint = load_checkpoint(path, capture=other, network="flatnet3d")
    assert checkpoint.capture is other
    assert checkpoint.fingerprint == tiny_capture.stack.fingerprint
    own = load_checkpoint(path).network
    for (key, value), mine in zip(checkpoint.network.state_dict().items(), own.state_dict().values(), strict=True):
        assert torch.equal(value, mine), key
    for name in ("inversion", "joint"):
        inverses = [next(iter(getattr(each, name).inverses()))[..., :9, :9] for each in (checkpoint.network, own)]
        assert not torch.allclose(*inverses)


@pytest.mark.parametrize(
    "depths_m", [depth_planes(0.01, 0.2, 4), depth_planes(0.02, 0.2, 3), np.array([0.01, 0.03, 0.2])]
)
def test_refuses_a_stack_of_other_planes_pixels_or_channels(path, tiny_capture, depths_m):
    values = np.resize(np.asarray(tiny_capture.stack.values), (len(depths_m), *tiny_capture.stack.values.shape[1:]))
    pitch_m, grey = tiny_capture.stack.pixel_pitch_m, np.asarray(tiny_capture.stack.values)[:, :1]
    others = [
        {"stack": replace(tiny_capture.stack, values=values, depths_m=depths_m)},
        {"stack": replace(tiny_capture.stack, pixel_pitch_m=1.1 * pitch_m)},
        {"stack": replace(tiny_capture.stack, pixel_pitch_m=0.9 * pitch_m)},
        {"stack": replace(tiny_capture.stack, values=grey, channels=("Y",)), "offset": np.zeros(1)},
    ]
    others[-1]["scene_to_camera"] = np.ones((1, 3))
    for changes in others:
        with pytest.raises(InputError, match=r"flatnet\.safetensors: its network"):
            load_checkpoint(path, capture=replace(tiny_capture, **changes))


CHANGES = {
    "newer": lambda content: content.update(version=3),
    "unknown": lambda content: content["architecture"].update(network="flatnet9"),
    "weights": lambda content: content["architecture"].update(filters=7),
    "camera": lambda content: content.pop("camera"),
    "architecture": lambda content: content.pop("architecture"),
    "record": lambda content: content.pop("record"),
    "other": lambda content: content.update(format="pt"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_refuses_what_it_cannot_build(path, change):
    with pytest.raises(InputError, match=r"flatnet\.safetensors: "):
        load_checkpoint(path, network="flatnet2d")
    with pytest.raises(InputError, match=r"flatnet\.safetensors: "):
        load_checkpoint(rewritten(path, CHANGES[change]))


def test_refuses_weights_that_are_not_finite(path, network, tiny_capture):
    with torch.no_grad():
        network.enhancement.head.weight[0, 0] = float("nan")
    save_checkpoint(path, network, architecture=ARCHITECTURE, capture=tiny_capture, record={})
    with pytest.raises(InputError, match=r"flatnet\.safetensors: "):
        load_checkpoint(path)


@pytest.mark.parametrize("kept", [0, 5, 200, -1])
def test_refuses_truncated_files(path, kept):
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"flatnet\.safetensors: "):
        load_checkpoint(path)


def test_refuses_pickles_without_opening_them(tmp_path):
    class Trap:
        def __reduce__(self):
            return (tmp_path.joinpath("sprung").touch, ())

    path = tmp_path / "trap.pt"
    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(InputError, match=r"trap\.pt: "):
        load_checkpoint(path)
    torch.save({"network": Trap()}, path)
    with pytest.raises(InputError, match=r"trap\.pt: "):
        load_checkpoint(path)
    assert not (tmp_path / "sprung").exists()


def test_refuses_a_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"none\.safetensors: "):
        load_checkpoint(tmp_path / "none.safetensors")
    with pytest.raises(InputError, match=f"{tmp_path.name}: "):
        load_checkpoint(tmp_path)


def test_a_refused_checkpoint_leaves_the_old_one(path, network, tiny_capture):
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"^architecture: "):
        save_checkpoint(path, network, architecture=ARCHITECTURE | {"filters": 4}, capture=tiny_capture, record={})
    with pytest.raises(InputError, match=r"^value\.record\.psnr: "):
        save_checkpoint(path, network, architecture=ARCHITECTURE, capture=tiny_capture, record={"psnr": float("nan")})
    assert path.read_bytes() == before
    nowhere = path.parent / "no" / "x.safetensors"
    with pytest.raises(StorageError, match=r"x\.safetensors: "):
        save_checkpoint(nowhere, network, architecture=ARCHITECTURE, capture=tiny_capture, record={})
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_a_bare_name_is_a_shipped_checkpoint_and_a_path_a_file(path, tmp_path, monkeypatch):
    """Whatever lies in the current folder under the bare name."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "flatnet3d").write_bytes(path.read_bytes())
    monkeypatch.chdir(folder)
    assert find_checkpoint("flatnet3d") == FOLDER / "flatnet3d.safetensors"
    assert find_checkpoint("./flatnet3d").resolve() == folder / "flatnet3d"
    assert find_checkpoint(path.name, resolve=lambda text: tmp_path / text) == path
    with pytest.raises(InputError, match=r"^network\.init_from: .*flatnet\.safetensors"):
        find_checkpoint(path.name, "network.init_from")


VIDEO = {"network": "videonet", "size": "tiny", "filters": 4, "joint_iterations": 3}


@pytest.fixture
def video_path(tmp_path, clip_capture):
    """A VideoNet for a camera whose rows differ in exposure."""
    exposure = np.linspace(0.5, 1.5, 48)
    capture = replace(clip_capture, row_exposure=exposure)
    torch.manual_seed(3)
    network = build_network(capture, "videonet", "tiny", filters=4, joint_iterations=3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
    path = tmp_path / "video.safetensors"
    save_checkpoint(path, network.eval(), architecture=VIDEO, capture=capture, record=RECORD)
    return path, network, capture


def test_a_videonet_comes_back_with_its_times(video_path):
    path, network, capture = video_path
    checkpoint = load_checkpoint(path, network="videonet")
    assert checkpoint.architecture == VIDEO_SIZES["tiny"] | VIDEO
    back = checkpoint.capture
    assert back.timing.shutter == capture.timing.shutter
    np.testing.assert_array_equal(back.timing.frame_edges_s, capture.timing.frame_edges_s, strict=True)
    np.testing.assert_array_equal(back.row_exposure, capture.row_exposure, strict=True)
    np.testing.assert_array_equal(back.row_weights, capture.row_weights, strict=True)
    np.testing.assert_array_equal(read_camera(path).row_weights, capture.row_weights, strict=True)
    assert not checkpoint.network.training
    measurement = torch.rand(2, 3, 48, 48)
    with torch.no_grad():
        wanted, got = network(measurement), checkpoint.network(measurement)
    assert torch.equal(got.image, wanted.image)
    assert torch.equal(got.measured, wanted.measured)


def test_stills_have_no_times(path):
    back = load_checkpoint(path).capture
    assert back.timing is None
    assert back.row_exposure is None


def test_a_videonet_for_another_camera_of_the_same_times(video_path, clip_capture):
    path, network, _ = video_path
    other = replace(clip_capture, gain=7.0, timing=Timing.from_record(clip_capture.timing.record()))
    checkpoint = load_checkpoint(path, capture=other)
    assert checkpoint.capture is other
    for (key, value), mine in zip(checkpoint.network.state_dict().items(), network.state_dict().values(), strict=True):
        assert torch.equal(value, mine), key


def test_a_videonet_for_other_times_is_refused_by_file_and_key(video_path, tiny_capture, clip_capture):
    path, _, capture = video_path
    known = capture.timing
    others = {
        "slivers": Timing(known.shutter, np.linspace(0, 16e-3, 9)),
        "frame_edges_s": Timing(known.shutter, known.frame_edges_s * 1.01),
        "shutter": Timing(replace(known.shutter, order="centre_out"), known.frame_edges_s),
    }
    for key, timing in others.items():
        with pytest.raises(InputError, match=rf"video\.safetensors: {key}: "):
            load_checkpoint(path, capture=replace(clip_capture, timing=timing))
    with pytest.raises(InputError, match=r"video\.safetensors: .*clips.*stills"):
        load_checkpoint(path, capture=replace(clip_capture, timing=None))
    with pytest.raises(InputError, match=r"video\.safetensors: "):
        load_checkpoint(path, network="flatnet3d")


def test_a_flatnet_for_clips_is_refused(path, tiny_capture, clip_capture):
    with pytest.raises(InputError, match=r"flatnet\.safetensors: .*stills.*clips"):
        load_checkpoint(path, capture=replace(tiny_capture, timing=clip_capture.timing))


@pytest.mark.parametrize(
    "timing",
    [
        "soon",
        [],
        {},
        {"frame_edges_s": [0, 1]},
        {"shutter": {"type": "dual_rolling"}, "frame_edges_s": [0, 0.004, 0.008, 0.012, 0.016]},
        {"shutter": {"type": "global", "exposure_s": 0.01, "binning": 1}, "frame_edges_s": [0.02, 0.01]},
        {"shutter": {"type": "global", "exposure_s": 0.01, "binning": 1}, "frame_edges_s": {"a": 1}},
        # Frames that end before the shutter closes
        {"shutter": {"type": "global", "exposure_s": 0.01, "binning": 1}, "frame_edges_s": [0, 1e-3, 2e-3, 3e-3, 4e-3]},
        {"shutter": {"type": "windows", "table_s": [[0, 1]], "binning": 1}, "frame_edges_s": [0, 1, 2, 3, 4]},
    ],
)
def test_damaged_times_are_refused(video_path, timing):
    path, *_ = video_path
    with pytest.raises(InputError, match=r"video\.safetensors: "):
        load_checkpoint(rewritten(path, lambda content: content["camera"].update(timing=timing)))


def test_a_videonet_without_times_is_refused(video_path):
    path, *_ = video_path
    with pytest.raises(InputError, match=r"video\.safetensors: "):
        load_checkpoint(rewritten(path, lambda content: content["camera"].pop("timing")))


def test_a_videonet_of_another_architecture_is_refused_before_it_is_written(video_path, tmp_path):
    path, network, capture = video_path
    before = path.read_bytes()
    for architecture, key in (
        (VIDEO | {"filters": 8}, "architecture"),
        (VIDEO | {"size": "huge"}, "size"),
        ({"network": "flatnet3d", "size": "tiny"}, "capture"),
    ):
        with pytest.raises(InputError, match=rf"^{key}: "):
            save_checkpoint(path, network, architecture=architecture, capture=capture, record={})
    assert path.read_bytes() == before
