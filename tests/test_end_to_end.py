"""Whole data sets: rendered scenes, plugins of all kinds, and the real samples; read back by us and by another program."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from psf_library import load_psf_stack
from simulator.dataset import open_dataset, verify

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

PHLATCAM = {"design": "phlatcam", "width_mm": 0.3, "iterations": 2}
RENDERED = {"family": "flying_things", "size": [16, 20], "samples_per_pixel": 1, "objects": 5}
PACKAGE = '''
"""A package of somebody else's plugins."""

import numpy as np

from simulator.optics.mask import Mask
from simulator.types import Clip


def slit(*, width_um: float = 40.0) -> Mask:
    """One long slit."""
    amplitude = np.zeros((101, 101), np.float32)
    half = round(width_um / 8)
    amplitude[:, 50 - half : 50 + half + 1] = 1
    return Mask(np.zeros_like(amplitude), amplitude, 4e-6, name="slit")


class Noise:
    """Grey noise at one depth, as a class."""

    inputs = ()

    def __init__(self, view, *, depth_cm: float = 5.0) -> None:
        self.view, self.depth_m = view, depth_cm / 100

    def clip(self, index, rng):
        shape = (1, *self.view.shape)
        rgb = np.repeat(rng.random((*shape, 1), dtype=np.float32), 3, axis=-1)
        return Clip(rgb, np.full(shape, self.depth_m, np.float32), np.ones(shape, bool), np.array([0.0, 1.0]))
'''


def sample_hashes(root: Path) -> dict[str, str]:
    files = [path for path in sorted(root.rglob("*")) if path.suffix in (".exr", ".png") or path.name == "sample.json"]
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.slow
def test_a_data_set_of_rendered_scenes(trial) -> None:
    changes = {"camera": {"mask": PHLATCAM, "exposure": {"full_scale": "auto"}}, "scene": RENDERED}
    root = trial.generate(**changes)
    assert verify(root).ok
    train = open_dataset(root)
    for sample in train:
        assert sample.rgb.std() > 0.01  # something is to be seen
        assert sample.metadata["scene"]["variant"] == "scalar_rgb"
        assert sample.metadata["clamped_depth_share"] <= 0.01
        assert 0.036 * 0.99 <= sample.depth_m.min() < sample.depth_m.max() <= 0.2 * 1.01
        # The nearest and the farthest PSF pass the same light, so a measurement keeps the colour that the camera sees.
        matrix = np.array(train.info.scene_to_camera["matrix"])
        scene = np.maximum(sample.rgb @ matrix.T, 0).mean(axis=(0, 1, 2))
        seen = sample.noiseless.sum(axis=(1, 2))
        assert seen / seen.sum() == pytest.approx(scene / scene.sum(), abs=0.01)
    assert json.loads((root / "dataset.json").read_text())["backend"] == "scalar_rgb"
    peaks = [sample.noiseless.max() for sample in train]
    assert 0.3 < max(peaks) < 2  # automatic exposure: near the top, whatever the mask
    # In workers of their own: the same bytes.
    local = {"engine": "local", "workers": 1, "output": "local"}
    assert sample_hashes(trial.generate(**changes, dataset=local)) == sample_hashes(root)


@pytest.mark.slow
def test_plugins_of_an_installed_package(trial, monkeypatch: pytest.MonkeyPatch) -> None:
    package = trial.folder / "site" / "lensless_plugins"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "plugins.py").write_text(PACKAGE)
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    module = "lensless_plugins.plugins"
    root = trial.generate(
        camera={"mask": {"design": f"{module}:slit", "width_um": 32}},
        scene={"source": f"{module}:Noise", "size": [16, 20], "depth_cm": 7},
        dataset={"engine": "local", "workers": 1, "train": 1, "validation": 0, "test": 0},
    )
    assert verify(root).ok
    sample = open_dataset(root)[0]
    assert np.all(sample.depth_m == np.float32(0.07))
    psf = load_psf_stack(root).values[0, 1]
    y, x = (np.arange(n) - n // 2 for n in psf.shape)
    height, width = (np.sum(psf * square) / psf.sum() for square in (y[:, None] ** 2, x[None] ** 2))
    assert height > 4 * width  # the slit stands upright: 100 of its pixels tall, 9 wide
    config, inputs = open_dataset(root).config, open_dataset(root).info.fingerprint_parts["inputs"]
    assert len(inputs) == 2  # the code of mask and scenes: edited, it would make another data set
    assert set(inputs.values()) == {hashlib.sha256(PACKAGE.encode()).hexdigest()}
    assert config["camera"]["mask"] == {"design": f"{module}:slit", "width_um": 32}
    assert config["scene"]["depth_cm"] == 7


@pytest.mark.slow
def test_generating_needs_no_torch(trial) -> None:
    code = """
import sys

class NoTorch:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("torch", "av", "cv2", "safetensors"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NoTorch())
from simulator.dataset import generate
assert generate(sys.argv[1]).made == 1
assert "torch" not in sys.modules
"""
    path = trial.write(camera={"mask": PHLATCAM}, dataset={"train": 1, "validation": 0, "test": 0})
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert verify(trial.folder / "out").ok


@pytest.mark.slow
@pytest.mark.shared
def test_eight_samples_of_the_real_frame_through_phlatcam(trial, shared_data: Path) -> None:
    """Crops of the real FlyingThings3D frame: the picture's own pixels, linearised, at the camera's depths."""
    from PIL import Image

    from simulator.importers.disparity import read_pfm

    folder = shared_data / "flyingthings3d/SCENE_FLOW"
    changes: dict[str, Any] = {
        "camera": {"mask": PHLATCAM, "sensor": {"binning": 8, "shape": [96, 128]}, "exposure": {"full_scale": "auto"}},
        "scene": {"source": "flyingthings3d", "path": str(folder), "size": [48, 64], "downscale": 4},
        "dataset": {"train": 6, "share_videos": True},
    }
    root = trial.generate(**changes)
    assert verify(root).ok
    picture = np.asarray(Image.open(folder / "RGB_cleanpass/left/A-0032-0006.png"))[..., :3] / 255
    linear = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)
    disparity = np.abs(read_pfm(folder / "disparity/left/A-0032-0006.pfm"))
    scale = (1 / 0.036 - 1 / 0.2) / (disparity.max() - disparity.min())
    corners = set()
    for sample in open_dataset(root):
        row, column = sample.metadata["scene"]["corner_px"]
        corners.add((row, column))
        window = np.s_[row : row + 192, column : column + 256]
        blocks = linear[window].reshape(48, 4, 64, 4, 3).mean(axis=(1, 3))
        assert np.abs(sample.rgb[0] - blocks).max() < 1e-6
        nearness = 1 / 0.2 + scale * (disparity[window][2::4, 2::4].astype(float) - disparity.min())
        assert 1 / sample.depth_m[0] == pytest.approx(nearness, rel=1e-5)
    assert len(corners) == 6  # each sample another crop


def check_measured(root: Path, raw: NDArray[Any], sensor: tuple[int, int], size: tuple[int, int]) -> None:
    """The first measurement is the scene convolved with the image of the PSF rotated by 180 degrees, worked out anew."""
    from scipy.signal import fftconvolve

    stack = load_psf_stack(root)
    assert stack.energy_m2() == pytest.approx(20e-6)
    # The border's median off, mean over 4 x 4, turned about the middle.
    frame, rows, columns = min(raw.shape) // 50, *sensor
    inner = np.zeros(raw.shape, bool)
    inner[frame:-frame, frame:-frame] = True
    light = np.clip(raw - np.median(raw[~inner]), 0, None).reshape(rows, 4, columns, 4).mean(axis=(1, 3))
    turned = light[::-1, ::-1][:-1, :-1]
    assert np.corrcoef(turned.ravel(), stack.values[0, 1].ravel())[0, 1] > 0.999
    described = json.loads((root / "dataset.json").read_text())
    full_scale, green = described["exposure"]["full_scale"], np.array(described["scene_to_camera"]["matrix"][1])
    sample = open_dataset(root)[0]
    y, x = ((np.arange(n) - (n - 1) / 2) * 19.2e-6 / 9e-3 for n in size)
    irradiance = (19.2e-6 / 9e-3) ** 2 / (1 + y[:, None] ** 2 + x**2) ** 2
    radiance = np.maximum(sample.rgb[0].astype(float) @ green, 0)
    full = fftconvolve(radiance * irradiance, stack.values[0, 1].astype(float))
    top, left = rows // 2 - 1 - (rows - size[0]) // 2, columns // 2 - 1 - (columns - size[1]) // 2
    expected = full[top : top + rows, left : left + columns] * 5e-3 / full_scale
    assert np.abs(sample.noiseless[1] - expected).max() < 2e-6 * expected.max()


MEASURED: dict[str, Any] = {
    "camera": {
        "mask": None,
        "mask_to_sensor_mm": 9,
        "sensor": {"binning": 8, "shape": [40, 50]},
        "exposure": {"full_scale": "auto"},
    },
    "psf": {
        "measured": ["psf.tif"],
        "depths_cm": [float("inf")],
        "frame": "physical",
        "binning": 4,
        "background": "border",
        "throughput_mm2": 20.0,
    },
}


def test_a_data_set_through_a_measured_psf(trial) -> None:
    import tifffile

    raw = np.full((160, 200), 7, np.uint16)
    for row, column in np.random.default_rng(2).integers(20, 130, (9, 2)):
        raw[row : row + 8, column : column + 14] += 900
    tifffile.imwrite(trial.folder / "psf.tif", raw)
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "near_cm": 10, "far_cm": 30}
    dataset = {"train": 1, "validation": 0, "test": 0}
    root = trial.generate(**MEASURED, scene=scene, dataset=dataset)
    assert verify(root).ok
    check_measured(root, raw.astype(float), (40, 50), (16, 20))
