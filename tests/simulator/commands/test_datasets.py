"""``init``, ``generate`` and ``verify`` as users meet them: what they print, make and end with."""

import json
import os
import pty
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from simulator.config import default_config_text
from simulator.dataset import verify
from simulator.dataset.checksums import CHECKSUMS
from simulator.io.files import StorageError
from simulator.presets import preset_names, preset_text

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

MAIN = "from simulator.cli import main; main()"
BOXES = {"family": "./plugins.py:boxes", "size": [16, 20]}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Path:
    """A finished data set; not to be changed."""
    return make_trial(tmp_path_factory.mktemp("finished")).generate()


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "copy")


class TestInit:
    def test_writes_the_shipped_configuration(self, flatlight, tmp_path: Path) -> None:
        code, out, _ = flatlight("init", tmp_path / "mine.yaml")
        assert code == 0
        assert f"flatlight generate {tmp_path / 'mine.yaml'}" in out
        assert (tmp_path / "mine.yaml").read_text() == default_config_text()

    def test_does_not_overwrite(self, one_error, flatlight, tmp_path: Path) -> None:
        path = tmp_path / "mine.yaml"
        path.write_text("years: of work")
        one_error(flatlight("init", path), "mine.yaml", "--force")
        assert path.read_text() == "years: of work"
        assert flatlight("init", path, "--force")[0] == 0
        assert path.read_text() == default_config_text()

    def test_presets(self, flatlight, one_error, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        assert flatlight("init")[0] == 0
        assert (tmp_path / "sim_config.yaml").read_text() == default_config_text()
        one_error(flatlight("init", tmp_path / "a" / "b.yaml"), "b.yaml")
        code, out, _ = flatlight("init", "--preset", "flying_things_64")
        assert code == 0
        assert "flatlight render flying_things_64.yaml" in out
        assert "flatlight generate flying_things_64.yaml" in out
        assert (tmp_path / "flying_things_64.yaml").read_text() == preset_text("flying_things_64")
        code, out, _ = flatlight("init", "--preset", "flatnet3d_64")
        assert "flatlight train flatnet3d_64.yaml" in out
        assert (tmp_path / "flatnet3d_64.yaml").read_text() == preset_text("flatnet3d_64")
        code, out, _ = flatlight("init", "--preset", "flying_things", "mine.yaml")
        assert (tmp_path / "mine.yaml").read_text() == default_config_text()
        one_error(flatlight("init", "--preset", "endoscopi"), "'endoscopi'", "'endoscopy'")
        _, out, _ = flatlight("init", "--preset", "help")
        assert [line.split()[0] for line in out.splitlines()] == preset_names(others=True)


def test_verify(one_error, flatlight, finished: Path, copy: Path, tmp_path: Path) -> None:
    code, out, _ = flatlight("verify", finished)
    assert code == 0
    assert "train: 3 of 3 intact" in out
    assert "all is well" in out
    (copy / CHECKSUMS).unlink()
    code, out, _ = flatlight("verify", copy)
    assert code == 2
    assert "--seal" in out
    assert flatlight("verify", copy, "--seal")[0] == 0
    one_error(flatlight("verify", tmp_path / "nowhere"), "nowhere")
    file = copy / "train/0000/s00000001/measurement.exr"
    file.write_bytes(file.read_bytes()[:30_000])
    code, out, err = flatlight("verify", copy)
    assert code == 2
    assert "train/s00000001: measurement.exr" in out
    assert "train: 2 of 3 intact" in out
    assert "Traceback" not in out + err


class TestGenerate:
    def test_says_what_it_did_and_where_to_look(self, flatlight, trial) -> None:
        path = trial.write()
        code, out, err = flatlight("generate", path, "--set", "dataset.train=2")
        assert code == 0, err
        assert "4 samples made in " in out
        assert f": {trial.folder / 'out'}" in out
        assert f"look at {trial.folder / 'out' / 'report.html'}" in out
        assert verify(trial.folder / "out").ok
        assert "samples: 4 of 4" in err  # plain lines, since this is no terminal
        assert "error budget, worst first" in err
        code, out, _ = flatlight("generate", path)
        assert code == 0
        assert "1 samples made in " in out
        assert "4 were there before" in out

    def test_at_a_terminal_the_result_goes_to_stdout(self, trial) -> None:
        """Whole and last: in a narrow terminal the bar would break paths, and take stdout's lines for its own."""
        path = trial.write(dataset={"output": f"out/{'long_' * 20}name"})
        theirs, ours = pty.openpty()
        words = [sys.executable, "-c", MAIN, "generate", str(path)]
        environment = os.environ | {"TERM": "xterm", "COLUMNS": "60"}
        done = subprocess.run(
            words, stdout=subprocess.PIPE, stderr=ours, text=True, env=environment, cwd=trial.folder, check=True
        )
        os.close(ours)
        shown = b""
        with suppress(OSError):  # how Linux says that nobody has the other end
            while part := os.read(theirs, 1 << 16):
                shown += part
        os.close(theirs)
        made, look = done.stdout.splitlines()
        assert made.startswith("5 samples made in ")
        assert made.endswith("name")
        assert look.startswith("look at ")
        assert look.endswith("name/report.html")
        assert b"samples" in shown
        assert b"look at" not in shown

    def test_a_log_of_json_lines(self, flatlight, trial) -> None:
        path = trial.write(scene=BOXES | {"fail_at": 1})
        code, out, err = flatlight("generate", path, "--log-json")
        assert code == 1
        assert err == ""
        *others, end = [json.loads(line) for line in out.splitlines()]
        assert {one["event"] for one in others} == {"progress", "message"}
        assert (end["event"], end["made"], end["path"]) == ("end", 4, str(trial.folder / "out"))
        assert end["failed"][0].startswith("train/s00000001: ")
        code, out, err = flatlight("generate", path, "--log-json", "--set", "camera.noise.psnr_db=30")
        assert code == 2
        (error,) = (one for line in out.splitlines() if (one := json.loads(line))["event"] == "error")
        assert "psnr_db" in error["text"]
        assert error["text"].splitlines()[0] in err

    @pytest.mark.parametrize(
        ("raised", "event", "text"),
        [
            (KeyboardInterrupt(), "stopped", "KeyboardInterrupt"),
            (SystemExit(143), "stopped", "SystemExit: 143"),
            (StorageError("out", "the disk is full"), "error", "out: the disk is full"),
            (ZeroDivisionError("ours"), "error", "ZeroDivisionError: ours"),
        ],
    )
    def test_the_last_line_of_json_says_how_it_ended(
        self, flatlight, trial, monkeypatch, raised: BaseException, event: str, text: str
    ) -> None:
        def ended(*_: object, **__: object) -> None:
            raise raised

        monkeypatch.setattr("simulator.dataset.job.generate", ended)
        code, out, _ = flatlight("generate", trial.write(), "--log-json")
        assert code != 0
        (line,) = map(json.loads, out.splitlines())
        assert (line["event"], line["text"]) == (event, text)

    def test_failed_samples_end_with_1(self, flatlight, trial) -> None:
        path = trial.write(scene=BOXES | {"fail_at": 1, "marker": "mended"})
        code, out, err = flatlight("generate", path)
        assert code == 1
        assert "4 samples made" in out
        assert "failed: train/s00000001: " in err
        assert "plugins.py:" in err
        assert "no clip 1 today" in err
        assert "1 samples failed, " in err
        (trial.folder / "mended").touch()
        assert flatlight("generate", path)[0] == 0
        assert verify(trial.folder / "out").ok

    @pytest.mark.parametrize(
        ("engine", "timeout_s"), [("inline", 3600), pytest.param("local", 2, marks=pytest.mark.slow)]
    )
    def test_whatever_a_plugin_does_the_others_are_finished(
        self, flatlight, trial, engine: str, timeout_s: float
    ) -> None:
        source = """
import sys

class Leaving(Boxes):
    def clip(self, index, rng):
        if not Path(__file__).with_name("mended").exists():
            if index == 1:
                sys.exit(0)
            if index == 2:
                raise KeyboardInterrupt
            if index == 3:
                raise GeneratorExit
            if index == 4:
                os._exit(0)
            if index == 5:
                time.sleep(1000)
        return super().clip(index, rng)

def leaving(view):
    return Leaving(view, 4, None, None, None, None, 0.0)
"""
        (trial.folder / "leaving.py").write_text(trial.plugins.read_text() + source)
        count = 7 if engine == "local" else 4
        dataset = {"train": count, "engine": engine, "workers": 2, "timeout_s": timeout_s}
        path = trial.write(scene={"family": "./leaving.py:leaving", "size": [16, 20]}, dataset=dataset)
        code, out, err = flatlight("generate", path)
        assert code == 1
        assert f"{3 if engine == 'inline' else 4} samples made" in out
        causes = ["SystemExit: 0", "KeyboardInterrupt", "GeneratorExit", "exit code 0", "not finished after 2 s"]
        listed = [json.loads(line) for line in (trial.folder / "out/failed.jsonl").read_text().splitlines()]
        for index, cause in enumerate(causes[: count - 1 - (engine == "local")], start=1):
            name = f"s0000000{index}"
            (line,) = (line for line in err.splitlines() if line.startswith(f"failed: train/{name}: "))
            assert cause in line
            assert "tried 3 times" in line
            (entry,) = (entry for entry in listed if entry["id"] == name)
            assert entry["attempts"] == 3
            assert entry["reason"] in line
            assert ("in clip\n" in entry["traceback"]) == (index < 4)
        assert f"{len(listed)} samples failed" in err
        (trial.folder / "mended").touch()
        code, out, err = flatlight("generate", path)
        assert code == 0, err
        assert f"{len(listed)} samples made" in out
        assert not (trial.folder / "out/failed.jsonl").exists()
        assert verify(trial.folder / "out").ok

    def test_an_exposure_without_signal_is_made_on_purpose_only(self, one_error, flatlight, trial) -> None:
        path = trial.write(camera={"exposure": {"full_scale": 1e15}})
        one_error(flatlight("generate", path), "camera.exposure.full_scale: ", "--accept-exposure")
        code, out, err = flatlight("generate", path, "--accept-exposure")
        assert code == 0, err
        assert "5 samples made" in out
        assert "100.00% black" in err

    def test_skip_bad_lists_what_it_leaves_out(self, one_error, flatlight, trial) -> None:
        source = """
from simulator.errors import InputError

class Films(Boxes):
    problems = ("9.webm: has no frames",)

    def __len__(self):
        return 9

    def clip(self, index, rng):
        if index == 1:
            raise InputError("1.webm", "truncated")
        return super().clip(index, rng)

def films(view):
    return Films(view, 4, None, None, None, None, 0.0)
"""
        (trial.folder / "films.py").write_text(trial.plugins.read_text() + source)
        path = trial.write(scene={"source": "./films.py:films", "size": [16, 20]})
        one_error(flatlight("generate", path), "9.webm", "--skip-bad")
        code, out, err = flatlight("generate", path, "--skip-bad")
        assert code == 0, err
        assert "4 samples made" in out
        assert f"of the source was left out what {trial.folder / 'out' / 'source_problems.txt'} lists: 1 in all" in out
        assert f"1 samples were left out: {trial.folder / 'out' / 'skipped.jsonl'}" in err
        assert "train/s00000001: " in err
        assert "1.webm: " in err

    @pytest.mark.slow
    def test_the_swap_of_the_mask_by_one_line(self, one_error, flatlight, trial) -> None:
        path = trial.write(camera={"mask": {"design": "phlatcam", "width_mm": 0.6, "iterations": 2}})
        swap = ("--set", "camera.mask={design: pinhole, pixel_um: 4}")
        assert flatlight("generate", path)[0] == 0
        one_error(
            flatlight("generate", path, *swap), "camera.mask.design: phlatcam -> pinhole", "choose another folder"
        )
        output = ("--set", f"dataset.output={trial.folder / 'pinhole'}")
        code, _, err = flatlight("generate", path, *swap, *output)
        assert code == 0, err
        described = json.loads((trial.folder / "pinhole/psf/psf.json").read_text())
        assert described["provenance"]["mask"]["name"] == "pinhole"
        # The old design's parameters are not the new one's: the message names them, with the place of each.
        result = flatlight("generate", path, "--set", "camera.mask.design=pinhole")
        one_error(result, "trial.yaml:", "camera.mask.width_mm: ", "camera.mask.iterations", "diameter_um")

    @pytest.mark.usefixtures("ctrl_c")
    def test_ctrl_c_says_what_is_kept(self, trial) -> None:
        path = trial.write(scene=BOXES | {"seconds": 0.2}, dataset={"train": 100})
        process = subprocess.Popen(
            [sys.executable, "-c", MAIN, "generate", str(path)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        end = time.monotonic() + 60
        while not (trial.folder / "out/train").exists():
            assert time.monotonic() < end
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
        assert process.returncode == 130
        assert "what is finished is kept" in err
        assert "Traceback" not in err


def test_a_disk_that_is_full_before_the_first_sample(command, one_error, trial) -> None:
    """Not even the PSF stack can be written: nothing stays behind, and the same command works once there is room."""
    done = command("generate", trial.write(), preexec_fn=lambda: _limit_files(2048))
    one_error((done.returncode, done.stdout, done.stderr), "psf", "depth_0000.exr: ")
    assert not (trial.folder / "out").exists()
    assert verify(trial.generate()).ok


def test_a_disk_that_is_full_between_two_samples(command, one_error, trial) -> None:
    """A data set that grows until the disk is full keeps what it has, and grows on once there is room."""
    root = trial.generate()
    before = _contents(root)
    size = (root / "train/0000/s00000000/measurement.exr").stat().st_size
    done = command("generate", trial.write(dataset={"train": 5}), preexec_fn=lambda: _limit_files(size // 2))
    one_error((done.returncode, done.stdout, done.stderr), "cannot be written")
    assert _contents(root) == before
    assert trial.generate(dataset={"train": 5}) == root
    assert verify(root).ok


def _contents(root: Path) -> dict[str, bytes]:
    files = (path for path in root.rglob("*") if path.is_file() and path.name not in ("dataset.json", CHECKSUMS))
    return {str(path.relative_to(root)): path.read_bytes() for path in files}


def _limit_files(size: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
