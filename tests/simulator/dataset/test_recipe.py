"""The recipe of a sample against an independent recomputation from the files and the documented random streams."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from simulator.camera.surroundings import whole_frames
from simulator.config import load_config
from simulator.dataset import generate, open_dataset
from simulator.dataset.plan import make_plan
from simulator.dataset.recipe import scene_clip, start_worker
from simulator.errors import InputError
from simulator.plugins import import_file
from simulator.types import Clip, View

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

SEED, EXPOSURE_S, PITCH_M, DISTANCE_M = 11, 5e-3, 8 * 2.4e-6, 1.9e-3
Truth = Callable[..., np.ndarray]
SPLIT, PURPOSE = {"train": 0, "validation": 1, "test": 2, "pilot": 3}, {"scene": 0, "noise": 1}
CASES = [("train", 0), ("train", 2), ("validation", 0), ("test", 0)]


def stream(split: str, index: int, purpose: str) -> np.random.Generator:
    """The documented stream: SeedSequence(root, spawn_key=(split, index, purpose)) with fixed integers."""
    key = (SPLIT[split], index, PURPOSE[purpose])
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=key))


def redrawn(plugins: ModuleType, split: str, index: int) -> Clip:
    """The clip of a sample, drawn anew from the documented stream."""
    view = View((16, 20), PITCH_M, DISTANCE_M, 0.036, 0.2)
    return plugins.boxes(view).clip(index, stream(split, index, "scene"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> tuple[Path, ModuleType]:
    """A data set with automatic exposure, and the module that drew its scenes."""
    trial = make_trial(tmp_path_factory.mktemp("recipe"))
    root = trial.generate(camera={"exposure": {"full_scale": "auto"}})
    return root, import_file(trial.plugins, "plugins")


@pytest.mark.parametrize(("split", "index"), CASES)
def test_ground_truth_is_the_scene_of_the_documented_stream(made: Any, split: str, index: int) -> None:
    root, plugins = made
    sample, clip = open_dataset(root, split)[index], redrawn(plugins, split, index)
    assert np.array_equal(sample.rgb, clip.rgb)
    assert np.array_equal(sample.depth_m, clip.depth_m)
    assert np.array_equal(sample.valid, clip.valid)
    assert not sample.valid.all()
    assert sample.metadata["scene"] == clip.source
    assert (sample.metadata["split"], sample.metadata["index"], sample.seed) == (split, index, SEED)


@pytest.mark.parametrize(("split", "index"), CASES)
def test_noiseless_measurement_is_the_brute_force_convolution(
    made: Any, irradiance: Truth, split: str, index: int
) -> None:
    root, plugins = made
    sample, clip = open_dataset(root, split)[index], redrawn(plugins, split, index)
    full_scale = json.loads((root / "dataset.json").read_text())["exposure"]["full_scale"]
    expected = irradiance(root, clip.rgb[0], clip.depth_m[0]) * EXPOSURE_S / full_scale
    # float32 FFTs of a few thousand points: some 1e-7 of the maximum.
    assert np.abs(sample.noiseless - expected).max() < 2e-6 * expected.max()
    assert expected.max() > 0.1  # the exposure put the picture into the sensor's range


def test_a_margin_is_in_the_measurement_and_not_in_the_ground_truth(
    tmp_path: Path, make_trial: Callable, irradiance: Truth
) -> None:
    trial = make_trial(tmp_path)
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "margin": 4, "surroundings": "continue"}
    root = trial.generate(scene=scene)
    sample, clip = open_dataset(root, "test")[0], redrawn(import_file(trial.plugins, "plugins"), "test", 0)
    assert np.array_equal(sample.rgb, clip.rgb)
    # Beside the image it goes on as in mirrors, in pixels of 4 x 4.
    rgb, depth_m = (
        np.pad(v, ((4, 4), (4, 4), (0, 0))[: v.ndim], mode="symmetric") for v in (clip.rgb[0], clip.depth_m[0])
    )
    coarse = rgb.reshape(6, 4, 7, 4, 3).mean(axis=(1, 3))
    field, depths_m = (v.repeat(4, axis=0).repeat(4, axis=1) for v in (coarse, depth_m[2::4, 2::4]))
    field[4:-4, 4:-4], depths_m[4:-4, 4:-4] = clip.rgb[0], clip.depth_m[0]
    expected = irradiance(root, field, depths_m) * EXPOSURE_S / sample.metadata["full_scale"]
    assert np.abs(sample.noiseless - expected).max() < 2e-6 * expected.max()
    alone = irradiance(root, clip.rgb[0], clip.depth_m[0]) * EXPOSURE_S / sample.metadata["full_scale"]
    assert np.abs(sample.noiseless - alone).max() > 0.1 * expected.max()
    # What shone beside the image is stored with it: the scene can be simulated anew, by another camera too.
    around = sample.surroundings
    assert around is not None
    assert around.coarseness == 4
    np.testing.assert_array_equal(around.rgb[0], coarse)
    light, depth = next(whole_frames(sample.clip(), (24, 28)))
    assert np.array_equal(light, field)
    assert np.array_equal(depth, depths_m)
    recorded = json.loads((root / "dataset.json").read_text())["field_of_view"]
    assert recorded["margin"] == [4, 4]
    assert 0 < recorded["light_from_outside"] < 1


@pytest.mark.parametrize(("split", "index"), CASES)
def test_noise_is_that_of_the_documented_stream(made: Any, split: str, index: int) -> None:
    sample = open_dataset(made[0], split)[index]
    drawn = stream(split, index, "noise").standard_normal(sample.noiseless.shape, dtype=np.float32)
    std = float(sample.noiseless.max()) * 10 ** (-40 / 20)
    assert np.array_equal(sample.measurement, sample.noiseless + np.float32(std) * drawn)  # every bit
    assert sample.metadata["noise_std"] == pytest.approx(std, rel=1e-6)


def test_automatic_exposure_is_the_pilots_percentile(made: Any, irradiance: Truth) -> None:
    root, plugins = made
    clips = [redrawn(plugins, "pilot", i) for i in range(16)]
    pilots = [irradiance(root, clip.rgb[0], clip.depth_m[0]) * EXPOSURE_S for clip in clips]
    exposure = json.loads((root / "dataset.json").read_text())["exposure"]
    assert exposure["full_scale"] == pytest.approx(np.percentile(pilots, 99.9) / 0.8, rel=1e-5)


def test_metadata_count_what_carries_no_signal(trial) -> None:
    changes = {"noise": {"type": "none"}, "exposure": {"full_scale": 1e-6}, "sensor": {"binning": 8, "shape": [90, 60]}}
    sample = open_dataset(trial.generate(camera=changes, dataset={"train": 1}))[0]
    assert np.array_equal(sample.measurement, sample.noiseless)
    saturated = float(np.mean(sample.noiseless >= 1))
    assert 0 < saturated < 1
    assert sample.metadata["saturated_share"] == pytest.approx(saturated, abs=2 / sample.noiseless.size)
    black = float(np.mean(sample.noiseless < 0.5 / 4096))
    assert 0 < black < 1
    assert sample.metadata["black_share"] == pytest.approx(black, abs=2 / sample.noiseless.size)
    assert sample.metadata["below_noise_share"] == 0
    assert sample.metadata["signal_share"] == pytest.approx(1 - saturated - black, abs=4 / sample.noiseless.size)


def test_depths_beyond_the_stack_are_clamped_and_counted(trial, irradiance: Truth) -> None:
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "depth_m": 0.5}
    said: list[str] = []
    root = generate(trial.write(scene=scene, dataset={"train": 1}), ["forward.max_clamped=1"], say=said.append).path
    sample = open_dataset(root)[0]
    assert sample.metadata["clamped_depth_share"] == sample.metadata["clamped_light_share"] == 1
    assert any(line.startswith("note: psf: 100% of the light comes from depths outside") for line in said)
    assert np.all(sample.depth_m == 0.5)  # ground truth stays the truth
    expected = irradiance(root, sample.rgb[0], np.full_like(sample.depth_m[0], 0.2)) * EXPOSURE_S / 3e-6
    assert np.abs(sample.noiseless - expected).max() < 2e-6 * expected.max()


def test_physical_noise_is_quantised_and_drawn_from_its_stream(trial) -> None:
    camera = {"noise": {"type": "physical"}, "exposure": {"full_scale": "auto"}}
    sample = open_dataset(trial.generate(camera=camera, dataset={"train": 1}))[0]
    # A stored value is the mean of 16 red, 32 green or 16 blue pixels of 12 bits: multiples of 1/n DN.
    pixels = np.array([16, 32, 16])[:, None, None]
    numbers = sample.measurement * 4096 * pixels
    assert np.array_equal(numbers, np.round(numbers))
    assert sample.noiseless.min() >= 64 / 4096  # black level
    error = (sample.measurement - sample.noiseless)[:, :5] * 4096
    assert abs(error.mean()) < 0.3
    again = open_dataset(trial.generate(camera=camera, dataset={"train": 1, "output": "again"}))[0]
    assert np.array_equal(sample.measurement, again.measurement)


@pytest.mark.slow
def test_infinite_depths_are_stored_as_finite_ones(trial, irradiance: Truth) -> None:
    psf = {"depths_cm": [4, 20, float("inf")], "wavelengths_per_channel": 1, "accept_error": 1}
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "depth_m": float("inf")}
    sample = open_dataset(trial.generate(psf=psf, scene=scene, dataset={"train": 1}))[0]
    assert np.all(sample.depth_m == np.float32(1e6))
    assert sample.metadata["clamped_depth_share"] == 0
    infinite = np.full_like(sample.depth_m[0], np.inf)
    expected = irradiance(trial.folder / "out", sample.rgb[0], infinite) * EXPOSURE_S / 3e-6
    assert np.abs(sample.noiseless - expected).max() < 2e-6 * expected.max()


class Endless:
    """A source that takes ten things in turn, as the families take their classes."""

    inputs = ()

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        pixel = np.full((1, 1, 1), 0.1, np.float32)
        return Clip(np.zeros((1, 1, 1, 3), np.float32), pixel, pixel > 0, np.array([0.0, 1.0]), label=str(index % 10))


class Finite(Endless):
    def __len__(self) -> int:
        return 7


@pytest.mark.parametrize("split", ["train", "validation", "test"])
def test_every_split_of_an_endless_source_has_all_classes_in_equal_parts(split: str) -> None:
    labels = [scene_clip(Endless(), SEED, split, index).label for index in range(30)]
    assert sorted(labels) == sorted(3 * [str(number) for number in range(10)])


def test_splits_of_a_finite_source_count_from_its_ends() -> None:
    assert [scene_clip(Finite(), SEED, split, 1).label for split in ("train", "validation", "test")] == ["1", "4", "3"]


def test_a_worker_with_other_versions_makes_no_samples(trial) -> None:
    """A node of a cluster with another NumPy would make other bytes under the same fingerprint."""
    recipe = make_plan(load_config(trial.write()), False, lambda *_: None, lambda _: None).recipe
    assert recipe.versions["numpy"] == np.__version__
    for name, version in (("numpy", "1.0"), ("no-such-package", "2.0")):
        with pytest.raises(InputError, match=rf"^dataset\.engine: .*{name} .*not {version}"):
            start_worker(replace(recipe, versions={**recipe.versions, name: version}))
