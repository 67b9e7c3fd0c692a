"""What ``generate`` refuses: one clear line, exit code 2, and nothing half-written, whatever the mistake."""

import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

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

    def test_unknown_keys(self, refused) -> None:
        refused("camera.mask.arms: unknown key", "did you mean 'arm'", set_="camera.mask.arms=3")
        refused("trial.yaml:", "camera.senser", "did you mean 'sensor'", camera={"senser": {}})
        refused("dataset.trian", "did you mean 'train'", set_="dataset.trian=3")

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
