"""Fixtures of the learning tests: a tiny data set without rendering, and a camera without any file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.checkpoint import save_checkpoint
from learning.config import TrainConfig
from learning.models import build_network
from learning.timing import Timing
from simulator.camera.shutter import DualRollingShutter
from simulator.dataset import open_dataset
from simulator.optics.stack import PsfStack, depth_planes

# Every surface has a texture, without which a depth shows nowhere; and its own depth, so that depth cannot be guessed.
PATCHES = '''

@dataclass(frozen=True)
class Patches:
    view: object
    flat: bool = False
    black: bool = False
    frames: int = 1
    speed: int = 0
    labelled: bool = False
    inputs: tuple[Path, ...] = ()

    def clip(self, index, rng):
        near, far = self.view.near_m, self.view.far_m
        shape = self.view.shape
        rgb, disparity = np.zeros((*shape, 3)), np.zeros(shape)
        windows = [np.s_[:, :]]
        for row, column in rng.integers(0, np.array(shape) - 6, (3, 2)):
            windows.append(np.s_[row : row + 8, column : column + 9])
        for window in windows:
            size = disparity[window].shape
            rgb[window] = rng.random(3) * rng.choice([0.1, 1.0], (*size, 1))
            disparity[window] = rng.uniform(1 / far, 1 / near)
        if self.flat:
            disparity[:] = 1 / far
        if self.black:
            rgb[:] = 0
        disparity[0, 0] = 1 / far
        valid = np.ones(shape, bool)
        valid[0, 0] = False
        depth_m = (1 / disparity).clip(near, far)
        way = -1 if self.labelled and index % 2 else 1
        label = ("leftwards" if way < 0 else "rightwards") if self.labelled else None
        moved = [
            np.stack([np.roll(values, way * self.speed * t, axis=1) for t in range(self.frames)])
            for values in (rgb, depth_m, valid)
        ]
        frames = moved[0].astype(np.float32), moved[1].astype(np.float32), moved[2]
        return Clip(*frames, np.arange(self.frames + 1) * 2e-3, label, source={"parity": index % 2})


def patches(
    view, *, flat: bool = False, black: bool = False, frames: int = 1, speed: int = 0, labelled: bool = False
):
    """Textured rectangles, each at a random depth, before a textured wall; all move by ``speed`` columns per frame.

    ``labelled``: every other clip moves to the left, and labels say which way.
    """
    return Patches(view, flat, black, frames, speed, labelled)
'''

# A camera of its own light and colours: the named ones come through colour-science, whose import takes seconds.
RESPONSE = "nm,R,G,B\n420,0,0.1,0.9\n470,0,0.3,1\n530,0.2,1,0.2\n590,0.7,0.5,0\n640,1,0.1,0\n"

LEARNING: dict[str, dict[str, Any]] = {
    "camera": {
        "sensor": {"binning": 8, "shape": [48, 48], "spectral_response": "response.csv"},
        "illuminant": [{"led_nm": 625, "fwhm_nm": 10}, {"led_nm": 525, "fwhm_nm": 12}, {"led_nm": 465, "fwhm_nm": 10}],
        "scene_to_camera": [[0.9, 0.2, 0.0], [0.1, 0.8, 0.2], [0.0, 0.1, 0.7]],
        "noise": {"type": "gaussian", "psnr_db": 40, "clip": True, "quantise": True},
    },
    "psf": {"near_cm": 1, "far_cm": 20, "depths": 3, "wavelengths_per_channel": 1, "accept_error": 1}
    | {"as_captured": {"illuminant": "camera"}},
    "scene": {"family": "./plugins.py:patches", "size": [16, 16]},
    "dataset": {"train": 4, "validation": 2, "test": 2},
}


class LearningTrial:
    """A tiny configuration for learning, in a folder of its own; see `tests/conftest.py`."""

    def __init__(self, trial: Any) -> None:
        self.trial = trial
        (trial.folder / "response.csv").write_text(RESPONSE, encoding="utf-8")
        trial.plugins.write_text(trial.plugins.read_text(encoding="utf-8") + PATCHES, encoding="utf-8")

    def generate(self, *overrides: str, **changes: dict[str, Any]) -> Path:
        """Make the data set and return its folder; keys of a section replace those of `LEARNING` one by one."""
        return self.trial.generate(*overrides, **self._merged(changes))

    def write(self, **changes: dict[str, Any]) -> Path:
        """Write the configuration alone."""
        return self.trial.write(**self._merged(changes))

    def _merged(self, changes: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        return changes | {section: values | changes.get(section, {}) for section, values in LEARNING.items()}


@pytest.fixture(scope="session")
def make_learning_trial(make_trial: Callable[[Path], Any]) -> Callable[[Path], LearningTrial]:
    """Return the function that puts a configuration into a folder; 4 train, 2 validation and 2 test samples."""
    return lambda folder: LearningTrial(make_trial(folder))


@pytest.fixture
def learning_trial(tmp_path: Path, make_learning_trial: Callable[[Path], LearningTrial]) -> LearningTrial:
    """A configuration that a test may change, in ``tmp_path``."""
    return make_learning_trial(tmp_path)


@pytest.fixture(scope="session")
def tiny_dataset(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable[[Path], Any]) -> Path:
    """A data set's folder: 32 train, 8 validation, 8 test stills of 16 x 16 scenes, 48 x 48 sensor, 3 depths, both stacks.

    Noise of 40 dB, clipped and quantised. Do not write into it.
    """
    trial = LearningTrial(make_trial(tmp_path_factory.mktemp("tiny")))
    return trial.generate(dataset={"train": 32, "validation": 8, "test": 8})


@pytest.fixture(scope="session")
def wide_dataset(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable[[Path], Any]) -> Path:
    """A data set like the tiny one, 4 train and 2 validation stills, whose scenes go on 20 pixels around the image.

    The field, 56 x 56, is larger than the sensor. Do not write into it.
    """
    trial = LearningTrial(make_trial(tmp_path_factory.mktemp("wide")))
    counts = {"train": 4, "validation": 2, "test": 0}
    return trial.generate(dataset=counts, scene={"margin": 20, "surroundings": "continue"}, psf={"as_captured": None})


CLIPS: dict[str, dict[str, Any]] = {
    "camera": {"shutter": {"type": "dual_rolling", "exposure_ms": 4, "line_time_us": 60}},
    "psf": {"near_cm": None, "far_cm": None, "depths": None, "depths_cm": [5], "as_captured": None},
    "scene": {"near_cm": 4, "far_cm": 6, "frames": 8, "speed": 1},
    "dataset": {"slivers": 4, "ground_truth": "frames"},
}
"""Of a camera whose capture lasts 4 + 191 x 0.06 = 15.5 ms: 8 frames of 2 ms, 4 slivers of 2."""


@pytest.fixture
def clip_settings() -> dict[str, dict[str, Any]]:
    """What makes the tiny data set one of clips."""
    return CLIPS


@pytest.fixture(scope="session")
def clip_dataset(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable[[Path], Any]) -> Path:
    """A data set's folder: 8 train, 2 validation, 2 test clips of 8 frames, 4 slivers; one PSF, dual rolling shutter.

    Do not write into it.
    """
    trial = LearningTrial(make_trial(tmp_path_factory.mktemp("clips")))
    counts = {"train": 8, "validation": 2, "test": 2}
    return trial.generate(**CLIPS | {"dataset": CLIPS["dataset"] | counts})


@pytest.fixture(scope="session")
def labelled_dataset(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable[[Path], Any]) -> Path:
    """The clips of `clip_dataset` moving to the left or to the right by two columns a frame, as their labels say.

    16 train, 4 validation, 8 test clips. Do not write into it.
    """
    trial = LearningTrial(make_trial(tmp_path_factory.mktemp("labelled")))
    counts = {"train": 16, "validation": 4, "test": 8}
    scene = CLIPS["scene"] | {"labelled": True, "speed": 2}
    return trial.generate(**CLIPS | {"dataset": CLIPS["dataset"] | counts, "scene": scene})


@pytest.fixture(scope="session")
def labelled_stills(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable[[Path], Any]) -> Path:
    """4 train, 2 validation and 2 test stills with the labels of `labelled_dataset`. Do not write into it."""
    trial = LearningTrial(make_trial(tmp_path_factory.mktemp("stills")))
    return trial.generate(psf=CLIPS["psf"], scene=CLIPS["scene"] | {"labelled": True, "frames": 1})


@pytest.fixture(scope="session")
def moving_dataset(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable[[Path], Any]) -> Path:
    """The clips of `clip_dataset` with the planes of `tiny_dataset`: 8 train, 2 validation, 2 test. Do not write into it."""
    trial = LearningTrial(make_trial(tmp_path_factory.mktemp("moving")))
    counts = {"train": 8, "validation": 2, "test": 2}
    scene = {"frames": 8, "speed": 1}
    return trial.generate(camera=CLIPS["camera"], scene=scene, dataset=CLIPS["dataset"] | counts)


@pytest.fixture(scope="session")
def tiny_capture() -> CaptureModel:
    """A camera of random PSFs, 3 depths, 3 channels that differ, 48 x 48 sensor, 16 x 16 scene; nothing in it is 0 or 1."""
    rng = np.random.default_rng(1)
    values = np.zeros((3, 3, 33, 33), np.float32)
    for row, column in rng.uniform(-8, 8, (12, 2)):
        for plane, magnification in enumerate((1.6, 1.25, 1.0)):  # nearer planes are larger, as a mask's shadow is
            y, x = np.round(np.array([row, column]) * magnification).astype(int) + 16
            values[plane, :, y : y + 2, x : x + 2] += rng.uniform(0.5, 1.0, (3, 1, 1))
    y, x = (np.arange(16) - 7.5)[:, None] / 40, (np.arange(16) - 7.5) / 40
    stack = PsfStack(values, depth_planes(0.01, 0.2, 3), 20e-6, ("R", "G", "B"), "0" * 64, {"kind": "random"})
    return CaptureModel(
        stack=stack,
        sensor_shape=(48, 48),
        scene_shape=(16, 16),
        gain=40.0,
        offset=np.array([0.01, 0.02, 0.03]),
        irradiance=(1e-4 / (1 + y**2 + x**2) ** 2).astype(np.float32),
        scene_to_camera=np.array([[0.8, 0.2, 0.0], [0.1, 0.8, 0.1], [0.0, 0.3, 0.7]]),
        white=0.9,
    )


@pytest.fixture(scope="session")
def clip_capture(tiny_capture: CaptureModel) -> CaptureModel:
    """The tiny camera with its middle plane alone, and a dual rolling shutter that tells 4 frames of 4 ms apart."""
    stack = tiny_capture.stack
    one = replace(stack, values=stack.values[1:2], depths_m=stack.depths_m[1:2])
    shutter = DualRollingShutter(4e-3, 0.5e-3)  # the last of 24 pairs of rows closes after 15.5 ms
    return replace(tiny_capture, stack=one, timing=Timing(shutter, np.arange(5) * 4e-3))


@pytest.fixture(scope="session")
def moving_capture(tiny_capture: CaptureModel, clip_capture: CaptureModel) -> CaptureModel:
    """The tiny camera with all three planes and the shutter of `clip_capture`."""
    return replace(tiny_capture, timing=clip_capture.timing)


@pytest.fixture(scope="session")
def clip_checkpoint(clip_capture: CaptureModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a tiny VideoNet for that camera, with weights at random."""
    torch.manual_seed(3)
    network = build_network(clip_capture, "videonet", "tiny", joint_iterations=3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.02 * torch.randn_like(parameter)
    path = tmp_path_factory.mktemp("clips") / "video.safetensors"
    architecture = {"network": "videonet", "size": "tiny", "joint_iterations": 3}
    save_checkpoint(path, network, architecture=architecture, capture=clip_capture, record={"scenes": {"train": ["a"]}})
    return path


@pytest.fixture(scope="session")
def dotted_camera() -> Callable[..., CaptureModel]:
    """Make a camera of clips in any size, for tests that need no optics; see `_dotted`."""
    return _dotted


def _dotted(
    sensor: tuple[int, int],
    scene: tuple[int, int],
    psf: int,
    frames: int,
    dots: int = 25,
    channels: int = 2,
    margin: int = 1,
) -> CaptureModel:
    """Return a camera with dots as wide apart as its sensor, light from around the image, and a dual rolling shutter.

    The shutter closes with the last frame, after 10 ms.
    """
    rng = np.random.default_rng(3)
    values = np.zeros((1, channels, psf, psf))
    for row, column in rng.integers(0, psf, (dots, 2)):
        values[0, :, row, column] = rng.uniform(0.5, 1.0, channels)
    shutter = DualRollingShutter(10e-3 / frames, 10e-3 * (1 - 1 / frames) / ((sensor[0] - 1) // 2))
    return CaptureModel(
        stack=PsfStack(values, np.array([0.1]), 1e-5, ("R", "G", "B")[:channels], "dots"),
        sensor_shape=sensor,
        scene_shape=scene,
        gain=3.0,
        offset=np.full(channels, 0.02),
        irradiance=rng.uniform(0.6, 0.9, tuple(side + 2 * margin for side in scene)).astype(np.float32),
        scene_to_camera=np.eye(channels, 3),
        white=0.7,
        timing=Timing(shutter, np.linspace(0, 10e-3, frames + 1)),
    )


@pytest.fixture
def settings(tiny_dataset: Path, tmp_path: Path) -> Callable[..., TrainConfig]:
    """Return a function that makes a small training; sections are changed key by key."""

    def make(output: str = "out", **changes: Any) -> TrainConfig:
        data = {"train": str(tiny_dataset), "noise_db": (30.0, 40.0), "cache": False, "workers": 0}
        plain: dict[str, Any] = {"name": "tiny", "output": str(tmp_path / output), "seed": 3, "data": data}
        plain |= {"network": {"name": "flatnet3d", "size": "tiny"}, "device": "cpu"}
        plain |= {"steps": 9, "batch": 5, "validate_every": 4, "log_every": 3}
        for key, value in changes.items():
            plain[key] = plain[key] | value if isinstance(value, dict) and key in plain else value
        return TrainConfig.model_validate(plain)

    return make


@pytest.fixture(scope="session")
def tiny_camera(tiny_dataset: Path) -> CaptureModel:
    """The camera of the tiny data set, as training knows it."""
    train = open_dataset(tiny_dataset, "train")
    return capture_model(train, white=measure_reference_white(train))


@pytest.fixture(scope="session")
def checkpoints(tmp_path_factory: pytest.TempPathFactory, tiny_camera: CaptureModel) -> list[Path]:
    """Two seeds of an untrained FlatNet3D and one FlatNet2D."""
    folder = tmp_path_factory.mktemp("checkpoints")
    made = []
    for name, seed in (("flatnet3d", 0), ("flatnet3d", 1), ("flatnet2d", 0)):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = build_network(tiny_camera, name, "tiny").eval()
        path = folder / f"{name}_{seed}.safetensors"
        architecture = {"network": name, "size": "tiny"}
        save_checkpoint(path, network, architecture=architecture, capture=tiny_camera, record={"seed": seed})
        made.append(path)
    return made


@pytest.fixture
def double() -> Iterator[None]:
    """Layers made in this test are of float64."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(before)
