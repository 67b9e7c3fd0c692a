"""Data sets of clips: what a moving shutter measures, the truth of each sliver, splits by video, what is left out."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from simulator.dataset import generate, open_dataset, verify
from simulator.dataset.manifest import load_manifest, load_skipped
from simulator.errors import InputError
from simulator.plugins import import_file
from simulator.types import Clip, View

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

SOURCE = Path(__file__).with_name("clip_source.py")
SEED, PITCH_M, DISTANCE_M, FULL_SCALE = 11, 8 * 2.4e-6, 1.9e-3, 3e-6
EXPOSURE_S, LINE_S, FRAME_S = 2e-3, 25e-6, 1e-3  # 384 physical rows, one after another: 11.575 ms; 12 frames are seen
CAMERA = {"shutter": {"type": "rolling", "exposure_ms": 2, "line_time_us": 25}, "noise": {"type": "none"}}
DATASET = {"train": 3, "validation": 2, "test": 1, "slivers": 4}
SPLITS = ("train", "validation", "test")


def scene(**params: object) -> dict[str, Any]:
    return {"source": "./clip_source.py:squares", "size": [16, 20], **params}


def write(trial: Any, dataset: dict[str, Any] | None = None, **params: object) -> Path:
    shutil.copy(SOURCE, trial.folder)
    return trial.write(camera=CAMERA, scene=scene(**params), dataset=DATASET | (dataset or {}))


def make(trial: Any, dataset: dict[str, Any] | None = None, **params: object) -> Path:
    result = generate(write(trial, dataset, **params))
    assert result.failed == ()
    return result.path


def redrawn(source: ModuleType, place: int, split: str, index: int, frames: int = 12) -> Clip:
    """A clip of the source, from the documented stream."""
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(SPLITS.index(split), index, 0)))
    view = View((16, 20), PITCH_M, DISTANCE_M, 0.036, 0.2)
    return source.squares(view, frames=frames).clip(place, rng)


def seconds_open(frames: int) -> np.ndarray:
    """For how long each of the stored rows sees each frame, ``(T, H)``, row by row from the definition."""
    seen = np.zeros((frames, 48))
    for physical in range(384):
        opens = physical * LINE_S  # from the top down; the stored image is rotated by 180 degrees
        stored = (383 - physical) // 8
        for frame in range(frames):
            begin, end = max(opens, frame * FRAME_S), min(opens + EXPOSURE_S, (frame + 1) * FRAME_S)
            seen[frame, stored] += max(end - begin, 0) / 8
    return seen


@pytest.fixture(scope="module")
def source() -> ModuleType:
    return import_file(SOURCE, "the test's source")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Path:
    """A data set of clips with global measurements; not to be changed."""
    return make(make_trial(tmp_path_factory.mktemp("clips")), {"global_measurements": True})


# Of 6 videos of 2 clips: training from the front, validation in the last one, test in the one before.
CASES = [("train", 0, 0), ("train", 2, 2), ("validation", 1, 11), ("test", 0, 8)]


@pytest.mark.parametrize(("split", "index", "place"), CASES)
def test_the_truth_of_a_sliver_is_the_mean_of_its_frames(
    made: Path, source: ModuleType, split: str, index: int, place: int
) -> None:
    sample, clip = open_dataset(made, split)[index], redrawn(source, place, split, index)
    for sliver in range(4):
        frames = [clip.rgb[3 * sliver + number].astype(np.float64) for number in range(3)]
        # The mean of three float32 numbers below 1.
        np.testing.assert_allclose(sample.rgb[sliver], sum(frames) / 3, rtol=0, atol=2e-7)
        assert np.array_equal(sample.depth_m[sliver], clip.depth_m[3 * sliver + 1])
        assert np.array_equal(sample.valid[sliver], clip.valid[3 * sliver + 1])
    assert sample.frame_edges_s is not None
    np.testing.assert_allclose(sample.frame_edges_s, [0, 3e-3, 6e-3, 9e-3, 12e-3], rtol=1e-12)
    assert sample.label == clip.label
    assert load_manifest(made).entries[split, f"s{index:08d}"].label == clip.label
    metadata = sample.metadata
    assert metadata["scene"] == clip.source
    assert (metadata["frames_seen"], metadata["slivers"]) == (12, 4)
    assert metadata["frame_durations_s"] == pytest.approx(1e-3)


@pytest.mark.parametrize(("split", "index", "place"), CASES[1:3])
def test_a_measurement_is_the_sum_over_frames_and_rows(
    made: Path, source: ModuleType, irradiance: Callable[..., np.ndarray], split: str, index: int, place: int
) -> None:
    sample, clip = open_dataset(made, split)[index], redrawn(source, place, split, index)
    frames = np.stack([irradiance(made, rgb, depth) for rgb, depth in zip(clip.rgb, clip.depth_m, strict=True)])
    seconds = seconds_open(12)
    expected = np.einsum("tchw,th->chw", frames, seconds) / FULL_SCALE
    # float32 FFTs of a few thousand points: some 1e-7 of the maximum.
    assert np.abs(sample.noiseless - expected).max() < 2e-6 * expected.max()
    assert np.array_equal(sample.measurement, sample.noiseless)
    assert expected.max() > 0.01
    every_row = np.einsum("tchw,t->chw", frames, seconds.mean(axis=1)) / FULL_SCALE
    assert np.abs(every_row - expected).max() > 0.05 * expected.max(), "here rows must differ in what they see"
    assert sample.global_measurements is not None
    for sliver in range(4):
        expected = frames[3 * sliver : 3 * sliver + 3].mean(axis=0) * EXPOSURE_S / FULL_SCALE
        assert np.abs(sample.global_measurements[sliver] - expected).max() < 2e-6 * expected.max()


def test_slivers_can_be_cut_out_of_what_is_on_disk(made: Path) -> None:
    """The shares of each row's exposure in which it saw each sliver: over all slivers, the whole exposure."""
    data = open_dataset(made, "test")
    assert data.info.time["slivers"] == 4
    assert data.info.time["ground_truth"] == "slivers"
    weights = data.sliver_weights(data[0])
    expected = seconds_open(12).reshape(4, 3, 48).sum(axis=1) / (3 * FRAME_S)
    np.testing.assert_allclose(weights, expected, rtol=0, atol=1e-12)


def test_no_video_is_in_two_splits(made: Path) -> None:
    videos = {split: {s.metadata["scene"]["video"] for s in open_dataset(made, split)} for split in SPLITS}
    assert videos == {"train": {"video_0", "video_1"}, "validation": {"video_5"}, "test": {"video_4"}}


ONE = {"train": 1, "validation": 0, "test": 0}


def test_numbers_about_colour_look_at_all_frames_seen(trial: Any) -> None:
    """Saturated colours are clipped in frames 1 to 11 only; those after the shutter has closed do not count."""
    text = SOURCE.read_text().replace("colour = rng.random(3)", "colour = [1, 0, 0]")
    text = text.replace("        valid = np", "        rgb[0] = 0.05\n        rgb[12:] = 9\n        valid = np")
    write(trial, ONE, frames=15)
    (trial.folder / SOURCE.name).write_text(text)
    root = generate(trial.path).path
    sample = open_dataset(root)[0]
    assert sample.rgb.max() == 1
    matrix = np.array(json.loads((root / "dataset.json").read_text())["scene_to_camera"]["matrix"])
    assert (matrix[:, 0] < 0).sum() == 1, "the camera's green or blue must see less than nothing of pure red"
    assert sample.metadata["clipped_colour_share"] == pytest.approx(11 * 20 / (12 * 16 * 20 * 3))
    assert sample.metadata["frames_seen"] == 12


def test_depths_of_all_frames_count(trial: Any) -> None:
    """Half of the last frame's depths lie before the nearest plane, those of the first within: 20 of 12 x 320 pixels."""
    nearer = "        depth[11, :2, :10] = self.view.near_m / 2\n        valid = np"
    text = SOURCE.read_text().replace("        valid = np", nearer)
    write(trial, ONE)
    (trial.folder / SOURCE.name).write_text(text)
    (sample,) = open_dataset(generate(trial.path, ["forward.max_clamped=1"]).path)
    valid = 12 * (16 * 20 - 1)
    assert sample.metadata["clamped_depth_share"] == pytest.approx(20 / valid, rel=1e-6)


def test_a_capture_of_one_sliver_keeps_its_times_and_its_global_measurement_is_noiseless(trial: Any) -> None:
    chosen = ONE | {"slivers": 1, "global_measurements": True}
    root = generate(write(trial, chosen), ["camera.noise={type: gaussian, std: 0.02}"]).path
    data = open_dataset(root)
    sample = data[0]
    assert sample.frame_edges_s is not None
    np.testing.assert_allclose(sample.frame_edges_s, [0, 12e-3], rtol=1e-12)
    expected = seconds_open(12).sum(axis=0) / 12e-3
    np.testing.assert_allclose(data.sliver_weights(sample)[0], expected, atol=1e-12)
    assert sample.global_measurements is not None
    assert sample.global_measurements.shape == (1, 3, 48, 60)
    assert np.std(sample.measurement - sample.noiseless) == pytest.approx(0.02, rel=0.05)
    far_from_the_light = sample.global_measurements[0][..., -4:]
    assert np.abs(np.diff(far_from_the_light)).max() < 0.002, "smooth if noiseless"


def test_every_frame_may_be_the_truth(trial: Any, source: ModuleType) -> None:
    """The frames that the shutter sees; those after it has closed are dropped."""
    root = make(trial, ONE | {"ground_truth": "frames"}, frames=20)
    sample, clip = open_dataset(root)[0], redrawn(source, 0, "train", 0, 20)
    assert sample.rgb.shape == (12, 16, 20, 3)
    assert np.array_equal(sample.rgb, clip.rgb[:12])
    assert np.array_equal(sample.depth_m, clip.depth_m[:12])
    assert np.array_equal(sample.frame_edges_s, clip.frame_edges_s[:13])
    assert sample.metadata["slivers"] == 4


def test_without_a_number_of_slivers_every_frame_is_one(trial: Any, source: ModuleType) -> None:
    sample = open_dataset(make(trial, ONE | {"slivers": None, "global_measurements": True}))[0]
    assert np.array_equal(sample.rgb, redrawn(source, 0, "train", 0).rgb)
    assert sample.metadata["slivers"] == 12
    assert sample.global_measurements is not None
    assert len(sample.global_measurements) == 12


def files(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.suffix in (".exr", ".json")
    }


class TestSkipping:
    """``--skip-bad``: what cannot be used is left out and listed, and nothing else changes."""

    def test_bad_samples_are_left_out_for_good(self, trial: Any, made: Path) -> None:
        marker = trial.folder / "asked"
        path = write(trial, {"global_measurements": True}, bad=[0, 5], marker=str(marker))
        result = generate(path, skip_bad=True)
        assert (result.made, result.kept, result.failed) == (2, 0, ())
        skipped = [f"{split}/s0000000{index}" for split in ("train", "validation") for index in (0, 1)]
        assert [line.partition(": ")[0] for line in result.skipped] == skipped
        assert "video_0.webm: " in result.skipped[0]
        assert "video_5.webm: " in load_skipped(result.path)["validation", "s00000001"]
        own = files(result.path)
        for name in ("train/0000/s00000002/measurement.exr", "test/0000/s00000000/sample.json"):
            assert own[name] == files(made)[name], "a sample that is left out moves no other"
        marker.with_name("asked.log").unlink()
        again = generate(path, ["dataset.train=4"])  # not even asked for again, with or without --skip-bad
        assert (again.made, again.kept, len(again.skipped)) == (1, 2, 4)
        assert set(marker.with_name("asked.log").read_text().split()) <= {"3"}
        assert verify(again.path).ok

    def test_pilots_that_cannot_be_made(self, trial: Any) -> None:
        path = write(trial, bad=[1])
        automatic = ["camera.exposure.full_scale=auto"]
        with pytest.raises(InputError, match=r"video_1\.webm: "):
            generate(path, automatic)
        said: list[str] = []
        root = generate(path, automatic, skip_bad=True, say=said.append).path
        assert json.loads((root / "dataset.json").read_text())["exposure"]["pilots"] == 12  # of 16: clips 2, 3, 14, 15
        assert any("4 of 16 exposure pilots" in line for line in said)
        write(trial, bad=[0, 1, 2, 3, 4, 5])
        with pytest.raises(InputError, match=r"video_0\.webm: "):
            generate(path, [*automatic, f"dataset.output={trial.folder / 'dark'}"], skip_bad=True)

    def test_problems_of_the_source(self, trial: Any) -> None:
        problems = [f"clip_{number}.webm: has no frames" for number in range(23)]
        path = write(trial, problems=problems)
        with pytest.raises(InputError) as caught:
            generate(path)
        message = str(caught.value)
        assert "its source has 23 problems" in message
        assert all(line in message for line in problems[:20])
        assert problems[20] not in message
        assert "and 3 more" in message
        assert "--skip-bad" in message
        assert not (trial.folder / "out").exists()
        said: list[str] = []
        result = generate(path, skip_bad=True, say=said.append)
        assert (result.made, result.problems) == (6, tuple(problems))
        assert (result.path / "source_problems.txt").read_text().splitlines() == problems
        assert any(problems[0] in line and "and 3 more" in line for line in said)
        assert verify(result.path).ok


class TestTimes:
    """Clips that do not suit the shutter are refused before there is a folder."""

    def refused(self, trial: Any, path: Path, *overrides: str) -> str:
        with pytest.raises(InputError) as caught:
            generate(path, overrides)
        assert not (trial.folder / "out").exists()
        return str(caught.value)

    def test_known_from_the_configuration(self, trial: Any) -> None:
        family = {"family": "high_speed", "size": [16, 20], "frames": 20, "frames_per_second": 2000}
        path = trial.write(camera=CAMERA, scene=family, dataset=DATASET)
        message = self.refused(trial, path)
        assert message.startswith("scene.frames: ")
        assert "11.575 ms" in message
        assert "at least 24" in message
        # The 24th frame begins at 11.5 ms, before the last row closes: 24 are seen, of which 5 slivers cannot be made.
        message = self.refused(trial, path, "scene.frames=30", "dataset.slivers=5")
        assert message.startswith("dataset.slivers: ")
        assert "24 of the 30 frames" in message
        assert "1, 2, 3, 4, 6, 8, 12, 24" in message
        assert self.refused(trial, path, "scene.frames=1").startswith("dataset.slivers: ")

    def test_known_from_a_clip_only(self, trial: Any) -> None:
        message = self.refused(trial, write(trial, frames=11))
        assert "take 12 frames" in message
        assert "'video': 'video_0'" in message
        assert "all 12 frames" in self.refused(trial, write(trial), "dataset.slivers=5")
        assert "a clip of 11 frames" in self.refused(trial, write(trial, frames=11), "camera.exposure.full_scale=auto")

    def test_stills_suit_every_shutter(self, trial: Any) -> None:
        sample = open_dataset(make(trial, {"slivers": None, "global_measurements": True}, frames=1))[0]
        assert sample.rgb.shape[0] == 1
        assert not {"frames_seen", "slivers", "frame_durations_s"} & sample.metadata.keys()
        assert sample.global_measurements is not None
        # A scene that stands still: each row sees it for as long as every other one.
        np.testing.assert_allclose(sample.global_measurements[0], sample.noiseless, rtol=0, atol=1e-7)

    def test_splits_that_would_share_a_video(self, trial: Any) -> None:
        path = write(trial, {"train": 9})
        message = self.refused(trial, path)
        assert "but of 6 videos (12 clips) train" in message
        assert "train takes 5 for 9 samples" in message
        alone = ["dataset.train=13", "dataset.validation=0", "dataset.test=0"]
        root = generate(path, alone).path
        scenes = [sample.metadata["scene"]["clip"] for sample in open_dataset(root)]
        assert scenes == [*range(12), 0]
        with pytest.raises(InputError, match=r"^dataset: "):
            generate(path, [*alone, "dataset.test=1"])
        said: list[str] = []
        generate(path, ["dataset.share_videos=true", f"dataset.output={trial.folder / 'shared'}"], say=said.append)
        assert any("splits share source videos" in line for line in said)


@pytest.mark.parametrize("how", ["backwards", "still"])
def test_clips_of_a_data_set_run_otherwise_for_another_camera(
    tmp_path: Path, make_trial: Callable, irradiance: Callable, how: str
) -> None:
    """Frames in the other order, or the middle one all the time, before the same shutter; the label stays."""
    trial = make_trial(tmp_path)
    known = make(trial, {"ground_truth": "frames", "train": 1, "validation": 0, "test": 0})
    again = {"source": "samples", "path": str(known), "size": [16, 20], how: True}
    counts = {
        "train": 1,
        "validation": 0,
        "test": 0,
        "ground_truth": "frames",
        "slivers": 4,
        "output": str(tmp_path / "again"),
    }
    root = generate(trial.write(camera=CAMERA, scene=again, dataset=counts)).path
    (one,), (other,) = open_dataset(known), open_dataset(root)
    frames = len(one.rgb)
    order = [*range(frames)][::-1] if how == "backwards" else [frames // 2] * frames
    for name in ("rgb", "depth_m", "valid"):
        np.testing.assert_array_equal(getattr(other, name), getattr(one, name)[order])
    assert other.label == one.label
    with pytest.raises(InputError, match=r"backwards: got true with still: true, .*; leave one of them out"):
        generate(trial.write(camera=CAMERA, scene=again | {"backwards": True, "still": True}, dataset=counts))
    assert {key: other.metadata["scene"].get(key) for key in ("backwards", "still")} == {how: True} | dict.fromkeys(
        {"backwards", "still"} - {how}
    )
    seen = (irradiance(root, *frame) for frame in zip(one.rgb[order], one.depth_m[order], strict=True))
    expected = (
        sum(light * seconds[:, None] for light, seconds in zip(seen, seconds_open(len(one.rgb)), strict=True))
        / other.metadata["full_scale"]
    )
    assert np.abs(other.noiseless - expected).max() < 2e-6 * expected.max()
