"""What a learner gets of clips: their times, the shutter, and the weights that take a measurement apart into slivers."""

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.camera.shutter import (
    DualRollingShutter,
    GlobalShutter,
    RollingShutter,
    RowShutter,
    Shutter,
    shutter_record,
)
from simulator.camera.slivers import split_measurement
from simulator.dataset.reader import Dataset, open_dataset
from simulator.dataset.verification import verify
from simulator.errors import InputError

ROWS = 24  # of samples.SENSOR
INTERLACED = np.array([[row % 2 * 1e-3, row % 2 * 1e-3 + 2e-3] for row in range(48)])
SHUTTERS: dict[str, Shutter] = {
    "global": GlobalShutter(0.01),
    "rolling": RollingShutter(1.3e-3, 1e-4, "down", binning=2),
    "rolling up": RollingShutter(1e-4, 3e-4, "up"),
    "dual": DualRollingShutter(1.7e-3, 2e-4, "outside_in", binning=3),
    "dual centre": DualRollingShutter(2e-5, 1e-5, "centre_out"),
    "windows": RowShutter(INTERLACED, binning=2),
}


def opened(root: Path, samples: ModuleType, shutter: Shutter, edges_s: np.ndarray) -> tuple:
    def make(index: int):
        return samples.make_clip_sample(index, frames=len(edges_s) - 1, frame_edges_s=edges_s)

    time = {"shutter": shutter_record(shutter), "slivers": len(edges_s) - 1}
    dataset = open_dataset(samples.make_dataset(root, make, time=time))
    return dataset, dataset[1]


@pytest.mark.parametrize("kind", SHUTTERS)
@pytest.mark.parametrize(("slivers", "length", "longer"), [(10, 6, 1.0), (3, 7, 1.03), (1, 5, 1.2), (4, 1, 1.0)])
def test_weights_from_the_edges_of_slivers_are_means_over_the_finer_frames(
    samples: ModuleType, kind: str, slivers: int, length: int, longer: float
) -> None:
    shutter = SHUTTERS[kind]
    frame_edges_s = np.linspace(0, shutter.duration_s(ROWS) * longer, slivers * length + 1)
    dataset = Dataset(Path("nowhere"), "train", (), samples.make_info(time={"shutter": shutter_record(shutter)}))
    sample = samples.make_clip_sample(0, slivers, frame_edges_s=frame_edges_s[::length])
    found = dataset.sliver_weights(sample)
    of_frames = shutter.weights(ROWS, frame_edges_s)  # for the physical sensor: image row 0 is its last
    means = of_frames.reshape(slivers, length, -1).mean(axis=1)
    np.testing.assert_allclose(found, means[:, ::-1], rtol=0, atol=1e-12)  # float64
    seconds = np.diff(sample.frame_edges_s) @ found  # sum_n dt_n S_n is what each row was exposed for
    np.testing.assert_allclose(seconds, shutter.exposures_s(ROWS)[::-1], rtol=1e-12)


def test_slivers_of_a_measurement(samples: ModuleType, tmp_path: Path) -> None:
    """A rolling shutter from the top down that opens one row after the other: the stored image's last rows come first."""
    shutter = RollingShutter(exposure_s=1e-3, line_time_s=1e-3)
    dataset, sample = opened(tmp_path / "set", samples, shutter, np.linspace(0, 24e-3, 4))  # 8 rows a sliver
    slivers = split_measurement(sample.measurement, dataset.sliver_weights(sample))
    np.testing.assert_allclose(slivers[0, :, 16:], sample.measurement[:, 16:] / 8, rtol=1e-6)  # float32; 1 of 8 ms
    assert np.abs(slivers[0, :, :16]).max() < 1e-12  # 24 ms in thirds are not exact
    np.testing.assert_allclose(slivers[2, :, :8], sample.measurement[:, :8] / 8, rtol=1e-6)


def test_stills_are_one_sliver(dataset: Path) -> None:
    train = open_dataset(dataset)
    assert train.shutter is None
    weights = train.sliver_weights(train[0])
    np.testing.assert_array_equal(weights, np.ones((1, ROWS)))
    np.testing.assert_array_equal(split_measurement(train[0].measurement, weights)[0], train[0].measurement)


def test_the_shutter_and_the_times_are_said(samples: ModuleType, tmp_path: Path) -> None:
    for kind, shutter in SHUTTERS.items():
        root = tmp_path / kind
        dataset, sample = opened(root, samples, shutter, np.linspace(0, shutter.duration_s(ROWS), 4))
        assert verify(root).ok
        assert type(dataset.shutter) is type(shutter)
        assert dataset.shutter.windows_s(ROWS).tobytes() == shutter.windows_s(ROWS).tobytes()
        np.testing.assert_array_equal(dataset.sliver_weights(dataset.stored(1)), dataset.sliver_weights(sample))
        assert dataset.metadata["time"] == {"shutter": shutter_record(shutter), "slivers": 3}
        assert sample.frame_edges_s.shape == (4,)


def test_clips_are_read_in_part(clips: Path) -> None:
    train = open_dataset(clips)
    for path in clips.glob("train/*/*/frames/*.exr"):
        path.unlink()
    labels = [train.stored(position).label for position in range(3)]
    assert labels == ["class 0", "class 1", "class 2"]
    assert train.stored(-1).measurement()[0].shape == (3, 24, 36)
    with pytest.raises(InputError, match=r"frames/ground_truth\.0000\.exr"):
        train[0]


def test_clear_refusals(clips: Path, samples: ModuleType, tmp_path: Path) -> None:
    train = open_dataset(clips)
    with pytest.raises(InputError, match=r"dataset\.json .*shutter"):
        train.sliver_weights(train[0])
    short, sample = opened(tmp_path / "short", samples, GlobalShutter(0.02), np.linspace(0, 0.01, 4))
    with pytest.raises(InputError, match=r"0 to 0\.01 s"):
        short.sliver_weights(sample)
    content = json.loads((clips / "dataset.json").read_text())
    for time, words in (({"shutter": {"type": "curtain"}}, "time.shutter: .*'curtain'"), ([], "time must be a dict")):
        (clips / "dataset.json").write_text(json.dumps(content | {"time": time}))
        assert any("dataset.json" in line and "time" in line for line in verify(clips).problems)
        with pytest.raises(InputError, match=rf"dataset\.json.*{words}"):
            _ = open_dataset(clips).shutter
