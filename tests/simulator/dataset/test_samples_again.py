"""Scenes of a data set seen by another camera: against the convolution with that camera's own PSFs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.surroundings import whole_frames
from simulator.config import load_config
from simulator.dataset import generate, open_dataset
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

MARGIN = {"margin": 4, "surroundings": "continue"}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Any:
    trial = make_trial(tmp_path_factory.mktemp("again"))
    trial.root = trial.generate(scene={"family": "./plugins.py:boxes", "size": [16, 20], **MARGIN})
    return trial


def again(root: Path, **changes: Any) -> dict[str, Any]:
    scene = {"source": "samples", "path": str(root), "size": [16, 20], "margin": 4, "surroundings": "own"}
    return scene | changes


@pytest.mark.slow
def test_another_mask_sees_the_same_scenes(first: Any, irradiance: Callable) -> None:
    camera = {"mask": {"design": "pinhole", "diameter_um": 200}, "noise": {"type": "none"}}
    root = generate(
        first.write(camera=camera, scene=again(first.root), dataset={"output": "other", "train": 3, "validation": 1})
    ).path
    one, other = open_dataset(first.root), open_dataset(root)
    for known, sample in zip(one, other, strict=True):
        for name in ("rgb", "depth_m", "valid"):
            np.testing.assert_array_equal(getattr(sample, name), getattr(known, name))
        (light, depth_m), *_ = whole_frames(known.clip(), (24, 28))
        expected = irradiance(root, light, depth_m) * 5e-3 / sample.metadata["full_scale"]
        assert np.abs(sample.noiseless - expected).max() < 2e-6 * expected.max()
        assert np.abs(sample.noiseless - known.noiseless).max() > 0.1 * expected.max()
    assert [sample.metadata["scene"]["sample"] for sample in other] == [f"train/s0000000{n}" for n in range(3)]
    # No split shares a scene with another: validation begins at the other end.
    (held_out,) = open_dataset(root, "validation")
    assert not any(np.array_equal(held_out.rgb, sample.rgb) for sample in other)


def test_splits_are_seen_again_as_they_are(first: Any, tmp_path: Path) -> None:
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], **MARGIN}
    counts = {"train": 2, "validation": 3, "test": 1}
    root = first.generate(scene=scene, dataset={"output": str(tmp_path / "known"), **counts})
    other = {"output": str(tmp_path / "other"), "train": 1, "validation": 2, "test": 1}
    again_root = generate(first.write(scene=again(root), dataset=other)).path
    for split, count in (("train", 1), ("validation", 2), ("test", 1)):
        known, seen = open_dataset(root, split), open_dataset(again_root, split)
        assert len(seen) == count
        for one, sample in zip(known, seen, strict=False):
            np.testing.assert_array_equal(sample.rgb, one.rgb)
        assert seen[0].metadata["scene"]["made by"] == {"family": "./plugins.py:boxes"}


@pytest.mark.parametrize(
    ("scene", "camera", "key"),
    [
        ({"size": [18, 20]}, {}, "path"),
        ({}, {"mask_to_sensor_mm": 3.0}, "path"),
        ({"path": "nowhere"}, {}, "nowhere"),
        ({"margin": 8}, {}, "margin"),
    ],
)
def test_what_another_camera_cannot_see(first: Any, scene: dict, camera: dict, key: str) -> None:
    path = first.write(scene=again(first.root, **scene), camera=camera, dataset={"output": "refused", "train": 1})
    with pytest.raises(InputError, match=key):
        generate(path)


MOVING = '''

@dataclass(frozen=True)
class Moving:
    view: object
    inputs: tuple[Path, ...] = ()

    def clip(self, index, rng):
        shape = (5, *self.view.shape)
        rgb, depth = rng.random((*shape, 3), np.float32), rng.uniform(self.view.near_m, self.view.far_m, shape)
        return Clip(rgb, depth.astype(np.float32), rng.random(shape) < 0.8, np.arange(6) * 1e-3)


def moving(view):
    """Five frames of 1 ms, each of its own random numbers."""
    return Moving(view)
'''


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Any:
    trial = make_trial(tmp_path_factory.mktemp("clips"))
    trial.plugins.write_text(trial.plugins.read_text(encoding="utf-8") + MOVING, encoding="utf-8")
    dataset = {"train": 1, "validation": 0, "test": 0, "slivers": 5}
    scene = {"family": "./plugins.py:moving", "size": [16, 20], **MARGIN}
    roots = {
        stored: trial.generate(scene=scene, dataset=dataset | {"ground_truth": stored, "output": stored})
        for stored in ("frames", "slivers")
    }
    return trial, roots


def seen_again(trial: Any, root: Path, **changes: bool) -> Any:
    scene = again(root, **changes)
    return Assembly(load_config(trial.write(scene=scene))).source.clip(0, np.random.default_rng(0))


def test_time_runs_backwards_or_stands_still(clips: Any) -> None:
    """Light, depth and what is seen, of the image and around it: in the other order, or of the middle frame throughout."""
    trial, roots = clips
    known, backwards, still = (
        seen_again(trial, roots["frames"], **changes) for changes in ({}, {"backwards": True}, {"still": True})
    )
    assert len(np.unique(known.rgb[:, 0, 0, 0])) == 5
    for name in ("rgb", "depth_m", "valid"):
        own = getattr(known, name)
        np.testing.assert_array_equal(getattr(backwards, name), own[::-1])
        np.testing.assert_array_equal(getattr(still, name), np.broadcast_to(own[2], getattr(still, name).shape))
    for name in ("rgb", "depth_m"):
        own = getattr(known.surroundings, name)
        assert len(own) == 5
        np.testing.assert_array_equal(getattr(backwards.surroundings, name), own[::-1])
        found = getattr(still.surroundings, name)
        np.testing.assert_array_equal(found, np.broadcast_to(own[2], found.shape))
    for clip in (backwards, still):
        assert (clip.frame_edges_s[0], clip.frame_edges_s[-1]) == (0, pytest.approx(5e-3))


@pytest.mark.parametrize("name", ["backwards", "still"])
def test_only_stored_frames_run_backwards_or_stand_still(first: Any, clips: Any, name: str) -> None:
    trial, roots = clips
    for other, root in ((trial, roots["slivers"]), (first, first.root)):
        with pytest.raises(InputError, match=f"{name}: got true, but .* stores no frames of clips"):
            seen_again(other, root, **{name: True})
    with pytest.raises(InputError, match="backwards: got true with still: true"):
        seen_again(trial, roots["frames"], backwards=True, still=True)
