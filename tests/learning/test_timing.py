"""When rows see frames, against loops over rows and frames; and that captures, slivers and their scenes agree."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import fftconvolve

from learning.camera import CaptureModel, capture_model
from learning.simulate import SceneCamera
from learning.timing import Timing, recorded_timing, sample_timing, with_slivers
from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, RowShutter, Shutter
from simulator.dataset import open_dataset
from simulator.dataset.manifest import MANIFEST
from simulator.errors import InputError

ROWS = 14
SHUTTERS: dict[str, Shutter] = {
    "global": GlobalShutter(1.9e-3),
    "rolling": RollingShutter(0.4e-3, 1.1e-4),
    "rolling up, binned": RollingShutter(0.3e-3, 0.5e-4, "up", binning=2),
    "dual": DualRollingShutter(0.5e-3, 2e-4),
    "dual centre out, binned": DualRollingShutter(0.5e-3, 0.7e-4, "centre_out", binning=3),
    "rows": RowShutter(np.sort(np.random.default_rng(3).uniform(0, 2e-3, (2 * ROWS, 2)), axis=1), binning=2),
}
EDGES_S = np.array([0, 0.3, 0.35, 0.9, 1.6, 2.2]) * 1e-3  # of unequal frames, which cover every shutter


def overlaps_s(shutter: Shutter) -> np.ndarray:
    """Return how long each stored row is open in each frame, the mean of its physical rows: row by row, frame by frame."""
    found = np.zeros((len(EDGES_S) - 1, ROWS))
    windows = shutter.physical_windows_s(ROWS * shutter.binning)
    for frame, (begin, end) in enumerate(pairwise(EDGES_S)):
        for physical, (opening, closing) in enumerate(windows):
            stored = ROWS - 1 - physical // shutter.binning  # the stored image is rotated by 180 degrees
            found[frame, stored] += max(0.0, min(end, closing) - max(begin, opening)) / shutter.binning
    return found


@pytest.mark.parametrize("shutter", SHUTTERS.values(), ids=SHUTTERS.keys())
def test_weights_and_shares_are_those_of_a_loop(shutter: Shutter) -> None:
    timing, seconds = Timing(shutter, EDGES_S), overlaps_s(shutter)
    assert timing.frames == 5
    # Times are sums and differences of a few milliseconds in float64.
    np.testing.assert_allclose(timing.sliver_weights(ROWS), seconds / np.diff(EDGES_S)[:, None], rtol=0, atol=1e-12)
    shares = timing.row_shares(ROWS)
    np.testing.assert_allclose(shares, seconds / seconds.sum(axis=0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(shares.sum(axis=0), 1, rtol=1e-14)


def test_rows_are_those_of_the_stored_image() -> None:
    """Physical rows open from the top downwards, so the stored image's last rows see the first frame."""
    shares = Timing(RollingShutter(1e-3, 1e-3), np.array([0.0, 3e-3, 6e-3])).row_shares(6)
    assert shares[0].tolist() == pytest.approx([0, 0, 0, 1, 1, 1], abs=1e-12)


@pytest.mark.parametrize("shutter", SHUTTERS.values(), ids=SHUTTERS.keys())
def test_a_record_comes_back_through_json(shutter: Shutter) -> None:
    timing = Timing(shutter, EDGES_S)
    back = Timing.from_record(json.loads(json.dumps(timing.record())))
    assert type(back.shutter) is type(shutter)
    np.testing.assert_array_equal(back.frame_edges_s, EDGES_S, strict=True)
    np.testing.assert_array_equal(back.shutter.windows_s(ROWS), shutter.windows_s(ROWS), strict=True)
    back.check_same(timing, ROWS)


@pytest.mark.parametrize(
    "edges",
    [
        [],
        [0.0],
        [0, 2e-3, 1e-3],
        [0, 1e-3, 1e-3],
        [[0, 1e-3]],
        [0, float("nan")],
        [float("-inf"), 0],
        [0, float("inf")],
        "ab",
    ],
)
def test_a_record_without_increasing_times_is_refused(edges: Any) -> None:
    record = {"shutter": {"type": "global", "exposure_s": 0.01, "binning": 1}, "frame_edges_s": edges}
    with pytest.raises(InputError, match=r"^frame_edges_s: "):
        Timing.from_record(record)


@pytest.mark.parametrize("record", ["a", 3, [1.0], {}, {"frame_edges_s": [0, 1]}, {"shutter": {"type": "global"}}])
def test_what_is_no_record_is_refused(record: Any) -> None:
    with pytest.raises(InputError):
        Timing.from_record(record)


def test_a_method_for_other_times_is_refused_by_what_differs() -> None:
    shutter = SHUTTERS["dual"]
    known = Timing(shutter, EDGES_S)
    known.check_same(known, ROWS)
    # Written with seven digits; and the same windows in a table
    Timing(RowShutter(shutter.physical_windows_s(ROWS)), EDGES_S * (1 + 4e-7)).check_same(known, ROWS)
    for key, other in (
        ("slivers", Timing(shutter, EDGES_S[:-1])),
        ("slivers", Timing(shutter, np.append(EDGES_S, 3e-3))),
        ("frame_edges_s", Timing(shutter, EDGES_S * 1.001)),
        ("frame_edges_s", Timing(shutter, np.linspace(0, EDGES_S[-1], 6))),
        ("shutter", Timing(DualRollingShutter(0.5e-3, 2e-4, "centre_out"), EDGES_S)),
        ("shutter", Timing(DualRollingShutter(0.501e-3, 2e-4), EDGES_S)),
        ("shutter", Timing(DualRollingShutter(0.5e-3, 1e-4, binning=2), EDGES_S)),
        ("shutter", Timing(SHUTTERS["global"], EDGES_S)),
    ):
        for one, two in ((other, known), (known, other)):
            with pytest.raises(InputError, match=rf"^{key}: "):
                one.check_same(two, ROWS)
    with pytest.raises(InputError, match=r"got 0\.44 ms for edge 1 of 0 to 5, the method was made for 0\.3 ms; set "):
        Timing(shutter, np.linspace(0, EDGES_S[-1], 6)).check_same(known, ROWS)


def test_a_capture_is_taken_apart_as_another_of_its_length() -> None:
    known = Timing(SHUTTERS["dual"], EDGES_S)
    other = Timing(SHUTTERS["dual"], EDGES_S[[0, 2, -1]])
    other.with_slivers_of(known).check_same(known, ROWS)
    assert known.with_slivers_of(other).frames == 2
    longer = Timing(SHUTTERS["dual"], EDGES_S * 1.001)
    assert longer.with_slivers_of(other) is longer


def test_a_data_set_says_its_times(clip_dataset: Path) -> None:
    """8 frames of 2 ms in 4 slivers; a capture of 48 x 8 rows in pairs, 4 ms each, 60 us apart."""
    for split in ("train", "validation"):
        timing = recorded_timing(open_dataset(clip_dataset, split))
        assert timing is not None
        np.testing.assert_allclose(timing.frame_edges_s, np.arange(5) * 4e-3, rtol=1e-12)
        opens_s = np.minimum(np.arange(384), np.arange(384)[::-1]) * 60e-6
        windows = np.stack([opens_s, opens_s + 4e-3], axis=-1).reshape(48, 8, 2)
        np.testing.assert_allclose(timing.shutter.windows_s(48), windows, rtol=1e-12)


def test_an_empty_split_has_the_times_of_the_others(clip_dataset: Path, tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(clip_dataset, root)
    lines = (root / MANIFEST).read_text().splitlines(keepends=True)
    (root / MANIFEST).write_text("".join(line for line in lines if json.loads(line)["split"] == "test"))
    timing, whole = (recorded_timing(open_dataset(each, "train")) for each in (root, clip_dataset))
    assert len(open_dataset(root, "train")) == 0
    assert timing is not None
    assert whole is not None
    timing.check_same(whole, 48)
    (root / MANIFEST).write_text("")
    with pytest.raises(InputError, match="copy: "):
        recorded_timing(open_dataset(root, "train"))


def test_stills_have_no_times(learning_trial: Any) -> None:
    """Nor has a data set of stills of which no sample is there yet."""
    counts = {"train": 1, "validation": 0, "test": 0}
    stills = open_dataset(learning_trial.generate(dataset=counts, psf={"as_captured": None}), "train")
    assert recorded_timing(stills) is None
    assert sample_timing(stills, stills.stored(0)) is None
    with pytest.raises(InputError, match=r"^slivers: got 2, .* holds stills"):
        with_slivers(stills, 2)
    (stills.root / MANIFEST).write_text("")
    assert recorded_timing(open_dataset(stills.root, "train")) is None


def seen(capture: CaptureModel, film: np.ndarray) -> np.ndarray:
    """Return the light ``(C, H, W)`` of frames ``(T, 3, h, w)``, linear sRGB: by SciPy, frame by frame, row by row."""
    shares = capture.row_weights
    total = np.zeros((len(capture.offset), *capture.sensor_shape))
    rows, columns = ((a - b) // 2 for a, b in zip(capture.sensor_shape, capture.scene_shape, strict=True))
    for frame, share in zip(film.astype(np.float64), shares, strict=True):
        light = np.einsum("ca,ahw->chw", capture.scene_to_camera, frame) * capture.irradiance
        for channel, psf in enumerate(np.asarray(capture.stack.values[0], np.float64)):
            placed = np.zeros(capture.sensor_shape)
            placed[rows : rows + light.shape[1], columns : columns + light.shape[2]] = light[channel]
            # A PSF's origin is its sample n // 2.
            top, left = (size // 2 for size in psf.shape)
            blurred = fftconvolve(placed, psf)[top : top + len(placed), left : left + placed.shape[1]]
            total[channel] += share[:, None] * blurred
    return total


def test_a_stored_capture_is_its_frames_seen_by_rows(clip_dataset: Path) -> None:
    """All eight frames, which move, by SciPy and by the camera's own operator, against what the simulator stored."""
    dataset = open_dataset(clip_dataset, "train")
    capture, stored = capture_model(dataset), dataset[2]
    assert dataset.shutter is not None
    capture = replace(capture, timing=Timing(dataset.shutter, stored.frame_edges_s))
    film = np.moveaxis(stored.rgb, -1, 1)
    assert np.ptp(film, axis=0).max() > 0.1
    by_scipy = capture.offset[:, None, None] + capture.gain * seen(capture, film)
    peak = stored.noiseless.max()
    np.testing.assert_allclose(stored.noiseless, by_scipy, rtol=0, atol=1e-6 * peak)  # float32, and its transforms
    colours = np.einsum("ca,tahw->tchw", capture.scene_to_camera, film) * capture.irradiance
    exact = replace(capture, stack=replace(capture.stack, values=capture.stack.values.astype(np.float64)))
    own = exact.space_time(np.zeros(1)).forward(colours[:, None])
    np.testing.assert_allclose(capture.gain * own, capture.gain * seen(capture, film), rtol=0, atol=1e-12 * peak)


def test_slivers_targets_and_capture_agree(clip_dataset: Path) -> None:
    """Of frames that stand still within a sliver: each global measurement, times its share of each row, adds up to it."""
    dataset = open_dataset(clip_dataset, "train")
    capture, camera = capture_model(dataset), SceneCamera(dataset)
    timing = capture.timing
    assert timing is not None
    stored = dataset[1].clip()
    clip = replace(stored, rgb=np.repeat(stored.rgb[::2], 2, axis=0))
    measurement = camera.sensor.noiseless(camera.exposure(clip)).astype(np.float64)
    targets = camera.global_measurements(clip, 4).astype(np.float64)
    offset = capture.offset[:, None, None]
    parts = timing.row_shares(48)[:, None, :, None] * (targets - offset)
    peak = measurement.max()
    np.testing.assert_allclose(parts.sum(axis=0), measurement - offset, rtol=0, atol=1e-6 * peak)  # float32
    by_scipy = offset + capture.gain * seen(capture, np.moveaxis(clip.rgb[::2], -1, 1))
    np.testing.assert_allclose(measurement, by_scipy, rtol=0, atol=1e-6 * peak)
