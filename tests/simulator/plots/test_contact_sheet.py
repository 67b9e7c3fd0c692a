"""The contact sheet shows the right values: checked pixel by pixel where the answer is known."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.dataset.dataset_info import write_info
from simulator.dataset.manifest import ManifestWriter
from simulator.dataset.sample import Sample, write_sample
from simulator.errors import InputError
from simulator.io.files import StorageError
from simulator.plots.contact_sheet import contact_sheet

SENSOR, SCENE = (192, 288), (192, 192)  # the size of the tiles: nothing is resampled
MEASUREMENT_LEFT, SCENE_LEFT, DEPTH_LEFT, TOP = 12, 312, 516, 64


def write(root: Path, samples: ModuleType, split: str, kept: dict[int, Sample], **info) -> Path:
    root.mkdir()
    write_info(root, samples.make_info(**info))
    with ManifestWriter(root) as manifest:
        for index, sample in kept.items():
            manifest.append(write_sample(root, split, index, sample), 0.1)
    return root


def known_dataset(root: Path, samples: ModuleType) -> Path:
    measurement = np.zeros((3, *SENSOR), np.float32)
    measurement[0, :96] = 0.5  # half of full scale, upper half, red
    rgb = np.full((1, *SCENE, 3), 0.25, np.float32)
    rgb[:, :, 96:, 1] = 4.0  # the brightest green becomes white's green
    depth = np.full((1, *SCENE), 0.2, np.float32)
    depth[:, :96] = 0.04
    valid = np.ones((1, *SCENE), bool)
    valid[:, 96:, 96:] = False
    changes = {"measurement": measurement, "noiseless": measurement, "rgb": rgb, "depth_m": depth, "valid": valid}
    kept = {3: samples.make_sample(0, SENSOR, SCENE, **changes)}
    return write(root, samples, "test", kept, sensor_shape=SENSOR, scene_shape=SCENE, counts={"train": 0, "test": 1})


def test_values_and_orientation(tmp_path: Path, samples: ModuleType) -> None:
    from PIL import Image

    path = contact_sheet(known_dataset(tmp_path / "set", samples), tmp_path / "sheet.png")
    sheet = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert sheet[TOP + 10, MEASUREMENT_LEFT + 10].tolist() == [188, 0, 0]  # sRGB of 0.5 is 187.5
    assert sheet[TOP + 180, MEASUREMENT_LEFT + 10].tolist() == [0, 0, 0]
    quarter = 71  # sRGB of 0.25 / 4: 1.055 * 0.0625^(1 / 2.4) - 0.055 = 0.277
    assert sheet[TOP + 10, SCENE_LEFT + 10].tolist() == [quarter] * 3
    assert sheet[TOP + 10, SCENE_LEFT + 180].tolist() == [quarter, 255, quarter]
    assert sheet[TOP + 10, DEPTH_LEFT + 10].tolist() == [253, 231, 37]  # near
    assert sheet[TOP + 180, DEPTH_LEFT + 10].tolist() == [68, 1, 84]  # far
    assert sheet[TOP + 180, DEPTH_LEFT + 180].tolist() == [120, 120, 120]  # nothing seen


def test_same_data_same_image(dataset: Path, tmp_path: Path) -> None:
    images = [contact_sheet(dataset, tmp_path / f"{name}.png").read_bytes() for name in "ab"]
    assert images[0] == images[1]


def test_rows(dataset: Path, tmp_path: Path) -> None:
    from PIL import Image

    heights = [Image.open(contact_sheet(dataset, tmp_path / "s.png", count)).height for count in (1, 2, 3, 8)]
    assert np.diff(heights).tolist() == [226, 226, 0]  # three samples exist


def test_other_channel_counts_and_unseen_scenes(tmp_path: Path, samples: ModuleType) -> None:
    kept = {}
    for index, count in enumerate((1, 2, 4)):
        planes = np.full((count, *samples.SENSOR), 0.5, np.float32)
        names = tuple(f"c{number}" for number in range(count))
        changes = {"measurement": planes, "noiseless": planes, "channels": names}
        changes |= {"valid": np.zeros((1, *samples.SCENE), bool), "rgb": np.zeros((1, *samples.SCENE, 3), np.float32)}
        kept[index] = samples.make_sample(index, **changes)
    root = write(tmp_path / "set", samples, "train", kept)
    assert contact_sheet(root, tmp_path / "s.png").stat().st_size > 1000


def test_frames_of_a_clip_over_time(tmp_path: Path, samples: ModuleType) -> None:
    """Frame t has the grey of t / 10 and the depth 4 + t cm; beside the clip there is a still, of one frame only."""
    from PIL import Image

    frames = 11
    steps = np.arange(frames, dtype=np.float32)[:, None, None]
    depth_m = np.broadcast_to(0.04 + steps / 100, (frames, *SCENE)).astype(np.float32)
    rgb = np.broadcast_to(steps[..., None] / 10, (frames, *SCENE, 3))
    clip = {"rgb": rgb, "depth_m": depth_m, "valid": np.ones(depth_m.shape, bool)}
    clip["frame_edges_s"] = np.linspace(0, 0.011, frames + 1)
    still = {name: values[:1] for name, values in clip.items() if name != "frame_edges_s"}
    kept = {index: samples.make_sample(index, SENSOR, SCENE, **changes) for index, changes in enumerate((clip, still))}
    root = write(tmp_path / "set", samples, "train", kept, sensor_shape=SENSOR, scene_shape=SCENE, counts={"train": 2})
    sheet = np.asarray(Image.open(contact_sheet(root, tmp_path / "sheet.png")).convert("RGB")).astype(int)
    step, second = DEPTH_LEFT - SCENE_LEFT, TOP + 192 + 22 + 16 + 12  # clips have a line more, for their times
    shown = [sheet[TOP + 90, SCENE_LEFT + column * step + 90, 0] / 255 for column in range(5)]
    expected = [0, 2, 5, 8, 10]  # five of eleven, evenly: 0, 2.5, 5, 7.5, 10
    decoded = [10 * (value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4) for value in shown]
    np.testing.assert_allclose(decoded, expected, rtol=0, atol=0.05)  # eight bits of sRGB
    assert sheet[second + 90, SCENE_LEFT + 90].tolist() == [0, 0, 0]
    assert sheet[second + 90, SCENE_LEFT + step + 90].tolist() == [250, 250, 250]  # the still has no second frame
    far = [68, 1, 84]  # of the depths shown, the clip's frame 5 is the farthest, the still the nearest
    assert sheet[TOP + 90, SCENE_LEFT + 5 * step + 90].tolist() == far
    assert sheet[second + 90, SCENE_LEFT + 5 * step + 90].tolist() == [253, 231, 37]


def test_only_the_frames_shown_are_read(clips: Path, tmp_path: Path, samples: ModuleType) -> None:
    with ManifestWriter(clips) as manifest:
        sample = samples.make_clip_sample(0, frames=11)
        manifest.append(write_sample(clips, "validation", 0, sample), 0.1)
    for frame in (1, 3, 4, 6, 7, 9):
        (clips / f"validation/0000/s00000000/frames/ground_truth.{frame:04d}.exr").unlink()
    assert contact_sheet(clips, tmp_path / "sheet.png", split="validation").stat().st_size > 1000


def test_refusals(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="set: "):
        contact_sheet(dataset, tmp_path / "s.png", split="test")
    with pytest.raises(InputError, match=r"^count: "):
        contact_sheet(dataset, tmp_path / "s.png", count=0)
    with pytest.raises(StorageError, match="does not exist"):
        contact_sheet(dataset, tmp_path / "no" / "s.png")
