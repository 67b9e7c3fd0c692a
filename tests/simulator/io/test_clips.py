"""Extras become float32 channels and come back with their type, shape and every value."""

from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from simulator.errors import InputError
from simulator.io.clips import (
    TRUTH,
    describe_extras,
    extra_channels,
    frame_channels,
    frame_extras,
    layout_channels,
    write_linear,
)
from simulator.io.exr import read_exr
from simulator.types import Clip

SHAPE = (4, 5)


def frame(values: np.ndarray) -> dict[str, np.ndarray]:
    return frame_channels(
        np.zeros((*SHAPE, 3), np.float32), np.ones(SHAPE, np.float32), np.ones(SHAPE, bool), {"own": values}
    )


@pytest.mark.parametrize(
    ("name", "components", "channels"),
    [
        ("shape_id", None, ["id"]),
        ("normal", 3, ["N.X", "N.Y", "N.Z"]),
        ("albedo", 3, ["albedo.R", "albedo.G", "albedo.B"]),
        ("motion", 3, ["motion.X", "motion.Y", "motion.Z"]),
        ("motion_valid", None, ["motion.valid"]),
        ("hidden1_rgb", 3, ["hidden1.R", "hidden1.G", "hidden1.B"]),
        ("hidden12_depth_m", None, ["hidden12.Z"]),
        ("hidden2_valid", None, ["hidden2.valid"]),
        ("bands", 12, [f"band{number:03d}" for number in range(12)]),
        ("bands", 1, ["band000"]),
        ("temperature", None, ["temperature"]),
        ("normal", 2, ["N.0", "N.1"]),
        ("hidden_rgb", 3, ["hidden_rgb.0", "hidden_rgb.1", "hidden_rgb.2"]),
        ("hidden1_shade", None, ["hidden1_shade"]),
    ],
)
def test_names(name: str, components: int | None, channels: list[str]) -> None:
    assert extra_channels(name, components) == channels


@pytest.mark.parametrize(
    "values",
    [
        np.arange(-1, 19, dtype=np.int32).reshape(1, *SHAPE) * 800_000,
        np.arange(20, dtype=np.uint16).reshape(1, *SHAPE) * 3000,
        np.random.default_rng(0).random((1, *SHAPE, 3), np.float32) * np.float32(1e-7),
        np.random.default_rng(1).random((1, *SHAPE, 1), np.float32),
        np.random.default_rng(2).random((1, *SHAPE)).astype(np.float16),
        np.random.default_rng(3).random((1, *SHAPE)) > 0.5,
    ],
    ids=lambda values: f"{values.dtype}{values.shape}",
)
def test_type_and_shape_come_back(values: np.ndarray) -> None:
    layout = describe_extras({"own": values})
    channels = frame(values[0])
    assert sorted(channels) == sorted([*TRUTH, *layout_channels(layout)])
    assert {plane.dtype for plane in channels.values()} == {np.dtype(np.float32)}
    back = frame_extras(channels, layout)["own"]
    assert back.dtype == values.dtype
    np.testing.assert_array_equal(back, values[0])


@pytest.mark.parametrize(
    ("extras", "words"),
    [
        ({"a": np.zeros((1, *SHAPE))}, r"^extras\['a'\]: "),
        ({"a": np.full((1, *SHAPE), 2**24 + 1, np.int32)}, r"^extras\['a'\]: "),
        ({"Z": np.zeros((1, *SHAPE), np.float32)}, r"^extras\['Z'\]: "),
        ({"shape_id": np.zeros((1, *SHAPE), bool), "id": np.zeros((1, *SHAPE), bool)}, r"^extras\['id'\]: "),
    ],
)
def test_what_channels_cannot_hold(extras: dict[str, np.ndarray], words: str) -> None:
    with pytest.raises(InputError, match=words):
        describe_extras(extras)


@pytest.mark.parametrize(
    "layout",
    [
        [],
        {"a": None},
        {"a": {"channels": ["a"], "components": None}},
        {"a": {"channels": ["b"], "components": None, "dtype": "bool"}},
        {"a": {"channels": ["a"], "components": None, "dtype": "object"}},
        {"a": {"channels": ["a"], "components": True, "dtype": "bool"}},
        {"a": {"channels": ["a"], "components": 10**12, "dtype": "bool"}},
        {
            "id": {"channels": ["id"], "components": None, "dtype": "bool"},
            "shape_id": {"channels": ["id"], "components": None, "dtype": "int32"},
        },
    ],
)
def test_foreign_layouts_are_refused(layout: object) -> None:
    with pytest.raises(InputError, match=r"^extras: "):
        layout_channels(layout)


# The linear values of a clip as OpenEXR, read back by us and by OpenImageIO.


def random_clip(frames: int) -> Clip:
    rng = np.random.default_rng(frames)
    shape = (frames, 6, 7)
    depth = rng.uniform(0.03, 0.2, shape).astype(np.float32)
    depth[:, 0, 0] = np.inf
    extras = {"shape_id": rng.integers(-1, 9, shape, np.int32), "normal": rng.normal(size=(*shape, 3)).astype("f4")}
    rgb = rng.random((*shape, 3), np.float32)
    return Clip(rgb, depth, depth < 1, np.arange(frames + 1) * 1e-3, "waving", {"family": "own"}, extras)


def test_another_program_reads_the_same(tmp_path: Path) -> None:
    clip = random_clip(3)
    paths = write_linear(tmp_path / "a.exr", clip)
    assert [path.name for path in paths] == ["a.0000.exr", "a.0001.exr", "a.0002.exr"]
    assert write_linear(tmp_path / "b.exr", random_clip(1)) == [tmp_path / "b.exr"]
    channels, metadata = read_exr(tmp_path / "b.exr")
    assert channels["Z"][0, 0] == 1e6  # what stands for infinity on disk
    assert (metadata["label"], metadata["frames"], metadata["source"]) == ("waving", 1, {"family": "own"})
    picture = OpenImageIO.ImageBuf(str(paths[2]))
    names = list(picture.spec().channelnames)
    pixels = picture.get_pixels(OpenImageIO.FLOAT)
    np.testing.assert_array_equal(pixels[..., [names.index(name) for name in "RGB"]], clip.rgb[2])
    np.testing.assert_array_equal(pixels[..., names.index("N.Z")], clip.extras["normal"][2, ..., 2])
    np.testing.assert_array_equal(pixels[..., names.index("valid")], clip.valid[2])
    assert read_exr(paths[2])[1]["frame_edges_s"] == clip.frame_edges_s[2:4].tolist()


def test_frames_of_a_longer_clip_are_not_left_beside(tmp_path: Path) -> None:
    write_linear(tmp_path / "a.exr", random_clip(3))
    write_linear(tmp_path / "a.exr", random_clip(3))  # the same again is no matter
    with pytest.raises(InputError, match=r"^--output: "):
        write_linear(tmp_path / "a.exr", random_clip(2))
    write_linear(tmp_path / "ab.exr", random_clip(2))
