"""Clips cut out of videos and fitted to the view, against known ramps, block means and the window's geometry; refusals."""

import pickle
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.errors import InputError
from simulator.importers.videos import (
    ClipPlan,
    FlatVideos,
    Window,
    choose_interpolator,
    fit,
    fit_frames,
    largest_window,
)
from simulator.plugins import ParameterError, resolve
from simulator.types import FARTHEST_M, SceneSource, View

VIEW = View(shape=(8, 8), pixel_pitch_m=19.2e-6, distance_m=1.9e-3, near_m=0.04, far_m=0.2)


@dataclass(frozen=True)
class Numbers:
    """A video whose frame ``i`` shines with ``i`` everywhere, plus its place in tenths along the columns."""

    name: str
    frames: int
    frames_per_second: float | None = 10.0
    label: str | None = None
    packages: ClassVar[tuple[str, ...]] = ("numbers-decoder",)

    @property
    def files(self):
        return (Path(self.name),)

    def __len__(self):
        return self.frames

    def read(self, start, stop):
        place = np.broadcast_to(np.arange(20, dtype=np.float32)[:, None] / 100, (8, 20, 3))
        return (place + np.float32(number) for number in range(start, stop))

    def record(self, start, stop):
        return {"codec": "numbers"}


@dataclass(frozen=True)
class Doubling:
    """An interpolator that repeats frames, so that it can be seen which ones came from where."""

    inputs: tuple[Path, ...] = (Path("weights"),)
    packages: ClassVar[tuple[str, ...]] = ("doubler",)

    def interpolate(self, frames, factor):
        return np.repeat(frames, factor, axis=0)[: (len(frames) - 1) * factor + 1]

    def record(self):
        return {"name": "doubling"}


def source(videos, plan, **options):
    return FlatVideos.of("numbers", VIEW, videos, replace(plan, plane_m=0.2), **options)


def first_frame(clip):
    return round(float(clip.rgb[0, 0, 0, 0]))


def test_clip_holds_consecutive_frames_at_one_depth_and_says_where_from():
    videos = [Numbers("a", 9, label="closing"), Numbers("b", 5)]
    clips = source(videos, ClipPlan(4, frames_per_second=100.0))
    assert isinstance(clips, SceneSource)
    clip = clips.clip(0, np.random.default_rng(1))
    start = clip.source["first_frame"]
    # The centre window of 8 x 20 pixels begins at column 6.
    np.testing.assert_allclose(clip.rgb[:, 3, 0, 2], start + np.arange(4) + 0.06, rtol=1e-6)
    np.testing.assert_allclose(clip.frame_edges_s, [0, 0.01, 0.02, 0.03, 0.04])
    assert np.all(clip.depth_m == np.float32(0.2))
    assert clip.valid.all()
    assert clip.label == "closing"
    assert clip.source == {
        "importer": "numbers",
        "video": "a",
        "codec": "numbers",
        "first_frame": start,
        "frames_read": 4,
        "own_frames_per_second": 10.0,
        "frames_per_second": 100.0,
        "crop": {"place": "centre", "corner_px": [0, 6], "size_px": [8, 8]},
        "plane_m": 0.2,
    }


def test_one_clip_per_video_begins_anywhere_and_the_same_state_gives_the_same_clip():
    clips = source([Numbers("a", 7)], ClipPlan(4, crop="random"))
    starts = {first_frame(clips.clip(0, np.random.default_rng(seed))) for seed in range(60)}
    assert starts == {0, 1, 2, 3}
    first, second = (clips.clip(0, np.random.default_rng(5)) for _ in range(2))
    np.testing.assert_array_equal(first.rgb, second.rgb)
    assert first.source == second.source
    assert len({clips.clip(0, np.random.default_rng(seed)).source["crop"]["corner_px"][1] for seed in range(60)}) == 13


def test_several_clips_per_video_are_evenly_spread_and_grouped():
    clips = source([Numbers("a", 10), Numbers("b", 6), Numbers("c", 12)], ClipPlan(4, clips_per_video=3))
    assert len(clips) == 9
    assert clips.groups == (0, 0, 0, 1, 1, 1, 2, 2, 2)
    made = [clips.clip(index, np.random.default_rng(index)) for index in range(9)]
    assert [clip.source["video"] for clip in made] == list("aaabbbccc")
    np.testing.assert_allclose(np.diff(made[0].frame_edges_s), 0.1)  # as long as in the film
    assert [first_frame(clip) for clip in made] == [0, 3, 6, 0, 1, 2, 0, 4, 8]
    assert clips.clip(10, np.random.default_rng(0)).source == made[1].source  # modulo their number


def test_a_video_in_which_clips_would_repeat_is_listed_with_how_many_fit():
    clips = source([Numbers("a", 5), Numbers("b", 6)], ClipPlan(4, clips_per_video=3))
    assert [video.name for video in clips.videos] == ["b"]
    (problem,) = clips.problems
    assert problem.startswith("a: has 5 frames, in which no more than 2 ")
    with pytest.raises(InputError, match=r"^frames: "):
        ClipPlan(4, clips_per_video=3).start(5, 0, np.random.default_rng(0))


def test_a_video_without_a_rate_needs_one():
    clips = source([Numbers("a", 5, None)], ClipPlan(4))
    with pytest.raises(InputError, match=r"^frames_per_second: "):
        clips.clip(0, np.random.default_rng(0))
    clip = source([Numbers("a", 5, None)], ClipPlan(4, frames_per_second=10)).clip(0, np.random.default_rng(0))
    assert "own_frames_per_second" not in clip.source


def test_interpolated_clips_take_fewer_frames_and_run_faster():
    clips = source([Numbers("a", 4)], ClipPlan(6, interpolate_by=2, interpolator=Doubling()))
    clip = clips.clip(0, np.random.default_rng(0))
    # 6 frames, 2 from each: of 4 frames 0 0 1 1 2 2 3 the first 6.
    np.testing.assert_array_equal(np.floor(clip.rgb[:, 0, 0, 0]), [0, 0, 1, 1, 2, 2])
    np.testing.assert_allclose(np.diff(clip.frame_edges_s), 1 / 20)
    assert clip.source["interpolation"] == {"interpolate_by": 2, "name": "doubling"}
    assert clip.source["frames_read"] == 4
    assert clips.inputs == [Path("a"), Path("weights")]
    assert clips.packages == ("doubler", "numbers-decoder", "opencv-python-headless")


def test_short_videos_are_listed_and_left_out():
    options = {"problems": ["c: broken"], "other_inputs": [Path("labels")]}
    clips = source([Numbers("a", 3), Numbers("b", 4)], ClipPlan(4), **options)
    broken, short = clips.problems
    assert broken == "c: broken"
    assert short.startswith("a: has 3 frames, ")
    assert [video.name for video in clips.videos] == ["b"]
    assert clips.inputs == [Path("b"), Path("labels")]


def test_no_usable_video_and_one_that_gives_fewer_frames_than_promised_are_errors():
    with pytest.raises(InputError, match=r"^source: "):
        source([Numbers(f"v{number}", 1) for number in range(12)], ClipPlan(4))

    class Lying(Numbers):
        def read(self, start, stop):
            return list(super().read(start, stop))[:-1]

    with pytest.raises(InputError, match=r"^a: "):
        source([Lying("a", 4)], ClipPlan(4)).clip(0, np.random.default_rng(0))


def test_plane_lies_far_away_unless_it_is_said_where():
    def plane_m(view, plane_cm):
        return ClipPlan.of(view, 4, None, 1, "centre", plane_cm, 1, "optical_flow", None).plane_m

    assert plane_m(VIEW, None) == 0.2
    assert plane_m(VIEW, 5) == 0.05
    assert plane_m(replace(VIEW, far_m=float("inf")), None) == FARTHEST_M
    with pytest.raises(InputError, match=r"^plane_cm: "):
        plane_m(VIEW, 21)


@pytest.mark.parametrize(
    ("by", "way", "checkpoint", "key"),
    [
        (1, "superslomo", "w.ckpt", "^superslomo_checkpoint: "),
        (1, "superslomo", None, "^interpolate_with: "),
        (2, "optical_flow", "w.ckpt", "^superslomo_checkpoint: "),
        (2, "superslomo", None, "^superslomo_checkpoint: "),
        (2, "superslomo", "nowhere.ckpt", "^superslomo_checkpoint: "),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(by, way, checkpoint, key):
    with pytest.raises(InputError, match=key):
        choose_interpolator(by, way, checkpoint and Path(checkpoint))


@pytest.mark.parametrize(
    ("way", "package", "extra"), [("optical_flow", "cv2", "import"), ("superslomo", "torch", "learn")]
)
def test_missing_packages_are_named_with_their_extra(monkeypatch, way, package, extra):
    monkeypatch.delitem(sys.modules, f"simulator.importers.{way}", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf"flatlight\[{extra}\]"):
        choose_interpolator(2, way, None if way == "optical_flow" else Path("w.ckpt"))


def test_what_interpolates_is_chosen_by_name():
    assert choose_interpolator(1, "optical_flow", None) is None
    interpolator = choose_interpolator(2, "optical_flow", None)
    assert interpolator is not None
    assert pickle.loads(pickle.dumps(interpolator)).record()["name"] == "optical_flow"
    assert interpolator.inputs == ()


def test_thirty_thousand_videos_travel_to_a_worker_in_little_time():
    from simulator.importers.film_files import Film

    names = (f"clips/{number}.webm" for number in range(30_000))
    clips = source([Film(Path("/data/20bn"), name, 50, 12.0, "BT.601", label="Closing") for name in names], ClipPlan(4))
    packed = pickle.dumps(clips)
    assert len(packed) < 4_000_000  # about 100 bytes each, and no frame
    assert pickle.loads(packed) == clips


# OpenCV adds up to a few hundred float32 numbers per pixel: some roundings of 2**-24 each.
ROUNDING = {"rtol": 2e-6, "atol": 0}


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_whole_factors_give_block_means(rng, factor):
    image = rng.random((8 * factor, 6 * factor, 3), dtype=np.float32)
    expected = image.astype(np.float64).reshape(8, factor, 6, factor, 3).mean(axis=(1, 3))
    result = fit(image, Window(0, 0, 8 * factor, 6 * factor), (8, 6))
    np.testing.assert_allclose(result, expected, **ROUNDING)


def test_shrinking_keeps_the_mean_light_for_any_factor(rng):
    # One bright pixel: wherever it falls, its light is shared out whole, which neither gamma nor point sampling would do.
    for place in rng.integers(0, (240, 427), (20, 2)):
        image = np.zeros((240, 427, 3), np.float32)
        image[tuple(place)] = 1000
        result = fit(image, Window(0, 0, 240, 427), (160, 150))
        np.testing.assert_allclose(result.mean((0, 1), np.float64), image.mean((0, 1), np.float64), rtol=1e-5)


def test_enlarging_interpolates_between_neighbours_and_never_beyond(rng):
    ramp = np.broadcast_to(np.arange(10, dtype=np.float32)[:, None, None], (10, 10, 3))
    large = fit(ramp, Window(0, 0, 10, 10), (40, 40))
    # Centres of the new pixels in the old one's coordinates; the edge pixels reach outwards.
    expected = np.clip((np.arange(40) + 0.5) / 4 - 0.5, 0, 9)
    np.testing.assert_allclose(large[:, 7, 1], expected, atol=1e-6)
    result = fit(large, Window(0, 0, 40, 40), (40, 40))
    assert np.array_equal(result, large)
    assert not np.shares_memory(result, large)
    noise = rng.random((9, 9, 3), dtype=np.float32)
    large = fit(noise, Window(0, 0, 9, 9), (31, 31))
    assert large.min() >= noise.min()
    assert large.max() <= noise.max()


sizes = st.tuples(st.integers(4, 2000), st.integers(4, 2000))


@given(size=sizes, shape=sizes, crop=st.sampled_from(["centre", "random"]), seed=st.integers(0, 9))
def test_window_lies_inside_is_as_large_as_can_be_and_keeps_proportions(size, shape, crop, seed):
    window = largest_window(size, shape, crop, np.random.default_rng(seed))
    assert window.row >= 0
    assert window.column >= 0
    assert window.row + window.rows <= size[0]
    assert window.column + window.columns <= size[1]
    assert window.rows == size[0] or window.columns == size[1]
    scale = min(size[0] / shape[0], size[1] / shape[1])
    # To the nearest whole pixel, and at least one.
    assert abs(window.rows - max(1, scale * shape[0])) <= 0.5 + 1e-9
    assert abs(window.columns - max(1, scale * shape[1])) <= 0.5 + 1e-9
    if crop == "centre":
        assert abs(size[0] - window.rows - 2 * window.row) <= 1
        assert abs(size[1] - window.columns - 2 * window.column) <= 1


def test_all_frames_of_a_clip_go_through_one_window(rng):
    image = rng.random((10, 30, 3), dtype=np.float32)
    frames, window = fit_frames((image + i for i in range(4)), "film", (10, 10), "random", rng)
    expected = image[:, window.column : window.column + 10]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame, expected + np.float32(number))


def test_changing_size_and_no_frames_are_refused(rng):
    with pytest.raises(InputError, match=r"^my\.mp4: "):
        fit_frames([np.zeros((8, 8, 3), np.float32), np.zeros((8, 9, 3), np.float32)], "my.mp4", (4, 4), "centre", rng)
    with pytest.raises(InputError, match=r"^my\.mp4: "):
        fit_frames([], "my.mp4", (4, 4), "centre", rng)


@pytest.mark.parametrize("source", ["davis", "film", "something_something_v2", "youtube_vos"])
@pytest.mark.parametrize(("old", "new"), [("raise_by", "interpolate_by"), ("raise_with", "interpolate_with")])
def test_earlier_names_of_parameters_are_refused_with_the_new_ones(source, old, new):
    with pytest.raises(ParameterError, match=f"{old}: .*{new}"):
        resolve("source", source).bind({"path": "x", "frames": 3, old: 2})
