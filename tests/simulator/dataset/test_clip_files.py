"""The linear values of a clip as OpenEXR, read back by us and by OpenImageIO."""

from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from simulator.errors import InputError
from simulator.io.clips import write_linear
from simulator.io.exr import read_exr
from simulator.types import Clip


def random_clip(frames: int) -> Clip:
    rng = np.random.default_rng(frames)
    shape = (frames, 6, 7)
    depth = rng.uniform(0.03, 0.2, shape).astype(np.float32)
    depth[:, 0, 0] = np.inf
    extras = {"shape_id": rng.integers(-1, 9, shape, np.int32), "normal": rng.normal(size=(*shape, 3)).astype("f4")}
    rgb = rng.random((*shape, 3), np.float32)
    return Clip(rgb, depth, depth < 1, np.arange(frames + 1) * 1e-3, "waving", {"family": "own"}, extras)


def test_a_still_is_one_file(tmp_path: Path) -> None:
    clip = random_clip(1)
    assert write_linear(tmp_path / "a.exr", clip) == [tmp_path / "a.exr"]
    channels, metadata = read_exr(tmp_path / "a.exr")
    assert sorted(channels) == sorted(["R", "G", "B", "Z", "valid", "id", "N.X", "N.Y", "N.Z"])
    np.testing.assert_array_equal(channels["G"], clip.rgb[0, ..., 1])
    np.testing.assert_array_equal(channels["id"], clip.extras["shape_id"][0])
    assert channels["Z"][0, 0] == 1e6  # what stands for infinity on disk
    assert (metadata["label"], metadata["frames"], metadata["source"]) == ("waving", 1, {"family": "own"})


def test_another_program_reads_the_same(tmp_path: Path) -> None:
    clip = random_clip(3)
    paths = write_linear(tmp_path / "a.exr", clip)
    assert [path.name for path in paths] == ["a.0000.exr", "a.0001.exr", "a.0002.exr"]
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
    with pytest.raises(InputError, match=r"a\.0002\.exr"):
        write_linear(tmp_path / "a.exr", random_clip(2))
    write_linear(tmp_path / "ab.exr", random_clip(2))
