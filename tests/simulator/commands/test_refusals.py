"""What ``generate`` refuses: one clear line, exit code 2, and nothing half-written, whatever the mistake."""

import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from simulator.dataset import verify

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

BOXES = {"family": "./plugins.py:boxes", "size": [16, 20]}


class TestBadInput:
    """One clear line, exit code 2, and nothing written."""

    @pytest.fixture
    def refused(self, one_error, flatlight, trial) -> Callable[..., None]:
        def run(*words: str, set_: str = "", **changes: Any) -> None:
            path = trial.write(**changes)
            before = {file: file.stat().st_mtime_ns for file in trial.folder.rglob("*")}
            result = flatlight("generate", path, *(("--set", set_) if set_ else ()))
            one_error(result, *words)
            assert {file: file.stat().st_mtime_ns for file in trial.folder.rglob("*")} == before

        return run

    def test_no_such_file(self, one_error, flatlight, tmp_path: Path) -> None:
        one_error(flatlight("generate", tmp_path / "none.yaml"), "none.yaml")

    def test_unknown_mask(self, refused) -> None:
        refused(
            "trial.yaml:", "unknown mask design, got 'phlatcm'", "did you mean 'phlatcam'",
            camera={"mask": {"design": "phlatcm"}},
        )  # fmt: skip

    def test_unknown_keys(self, refused) -> None:
        refused("camera.mask.arms: unknown key", "did you mean 'arm'", set_="camera.mask.arms=3")
        refused("trial.yaml:", "camera.senser", "did you mean 'sensor'", camera={"senser": {}})
        refused("dataset.trian", "did you mean 'train'", set_="dataset.trian=3")

    def test_negative_depth(self, refused) -> None:
        refused("psf.near_cm: got -3.6", "positive", set_="psf.near_cm=-3.6")
        refused("psf.depths_cm", "-4", psf={"depths_cm": [-4, 5]})

    @pytest.mark.parametrize(
        ("body", "words"),
        [
            ("Mask(np.zeros((100, 90)), np.ones((90, 100)), 4e-6)", "(100, 90) and (90, 100)"),
            ("Mask(np.full((90, 90), np.nan), np.ones((90, 90)), 4e-6)", "NaN"),
            ("Mask(np.zeros((90, 90)), np.zeros((90, 90)), 4e-6)", "no light passes"),
        ],
    )
    def test_broken_masks(self, refused, trial, body: str, words: str) -> None:
        text = trial.plugins.read_text().split("@dataclass")
        mask = f"def corners():\n    return {body}\n\n\n@dataclass"
        trial.plugins.write_text(text[0][: text[0].index("def corners")] + mask + text[1])
        refused("./plugins.py:corners", words)

    def test_black_measured_psf(self, refused, trial) -> None:
        Image.fromarray(np.full((30, 40), 9, np.uint8)).save(trial.folder / "psf.png")
        psf = {"measured": ["psf.png"], "depths_cm": [10], "frame": "physical", "throughput_mm2": 1.0}
        refused("psf.png", "is zero everywhere", camera={"mask": None}, psf=psf)

    @pytest.mark.parametrize(
        "content", [b"Pf\n32 32\n-1.0\n" + bytes(100), b"P6\n32 32\n255\n", b"", b"Pf\n32 32\nx\n"]
    )
    def test_broken_pfm(self, refused, trial, content: bytes) -> None:
        for name in ("RGB_cleanpass", "disparity"):
            (trial.folder / "frames" / name / "left").mkdir(parents=True)
        Image.fromarray(np.zeros((32, 32, 3), np.uint8)).save(trial.folder / "frames/RGB_cleanpass/left/f.png")
        (trial.folder / "frames/disparity/left/f.pfm").write_bytes(content)
        scene = {"source": "flyingthings3d", "path": "frames", "size": [16, 20]}
        one = {"train": 1, "validation": 0, "test": 0}
        refused("f.pfm", scene=scene, camera={"exposure": {"full_scale": "auto"}}, dataset=one)

    def test_scenes_beyond_the_planes(self, refused) -> None:
        auto = {"exposure": {"full_scale": "auto"}}
        refused("0.036 to 0.2 m", "psf.far_cm", scene=BOXES | {"depth_m": 3.0}, camera=auto)

    def test_places_that_cannot_be_written(self, refused, trial) -> None:
        refused("cannot write /proc/flatlight", set_="dataset.output=/proc/flatlight")
        refused("is a file", set_=f"dataset.output={trial.plugins}")

    def test_another_data_set_in_the_folder(self, refused, trial) -> None:
        trial.generate()
        refused("camera.mask_to_sensor_mm: 1.9 -> 2.1", set_="camera.mask_to_sensor_mm=2.1")
        refused("dataset.train: got 1", "can grow later, not shrink", set_="dataset.train=1")

    def test_foreign_files_in_the_folder(self, refused, trial) -> None:
        refused("is not empty and holds no data set", set_=f"dataset.output={trial.folder}")

    def test_failures_in_workers_are_the_same(self, refused) -> None:
        dataset = {"engine": "local", "workers": 1}
        auto = {"exposure": {"full_scale": "auto"}}
        refused("plugins.py:", "no clip 2 today", scene=BOXES | {"fail_at": 2}, camera=auto, dataset=dataset)


class TestFullDisk:
    def test_before_the_first_sample(self, command, one_error, trial) -> None:
        """Not even the PSF stack can be written: nothing stays behind, and the same command works once there is room."""
        path = trial.write()
        done = command("generate", path, preexec_fn=lambda: _limit_files(2048))
        one_error((done.returncode, done.stdout, done.stderr), "cannot write", "bigger than allowed")
        assert not (trial.folder / "out").exists()
        assert verify(trial.generate()).ok

    def test_between_two_samples(self, command, one_error, trial) -> None:
        """A data set that grows until the disk is full keeps what it has, and grows on once there is room."""
        root = trial.generate()
        before = _contents(root)
        size = (root / "train/0000/s00000000/measurement.exr").stat().st_size
        path = trial.write(dataset={"train": 5})
        done = command("generate", path, preexec_fn=lambda: _limit_files(size // 2))
        one_error((done.returncode, done.stdout, done.stderr), "cannot write", "bigger than allowed")
        after = _contents(root)
        assert [name for name in after if ".tmp-" in name] == []
        assert {name: data for name, data in after.items() if name != "dataset.json"} == {
            name: data for name, data in before.items() if name != "dataset.json"
        }
        assert trial.generate(dataset={"train": 5}) == root
        assert verify(root).ok


def _contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def _limit_files(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
