"""The command as users meet it: what it prints, its exit codes, and one clear line for every mistake."""

import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import yaml
from PIL import Image

from simulator.config import default_config_text
from simulator.dataset import verify

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

MAIN = "from simulator.cli import main; main()"
BOXES = {"family": "./plugins.py:boxes", "size": [16, 20]}


def command(*arguments: object, code: str = MAIN, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    words = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False, **options)


def one_error(result: tuple[int, str, str], *words: str, code: int = 2) -> None:
    """Assert that a run ended with one clear message that has all these words."""
    found, out, err = result
    assert found == code, err
    assert "Traceback" not in out + err
    messages = err[err.index("error: ") :]
    assert err.count("error: ") == 1
    for word in words:
        assert word in messages, messages


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Path:
    """A finished data set; not to be changed."""
    return make_trial(tmp_path_factory.mktemp("finished")).generate()


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "copy")


class TestStart:
    def test_help_is_quick(self) -> None:
        heavy = ["numpy", "pydantic", "mitsuba", "drjit", "torch", "colour", "matplotlib", "scipy", "OpenEXR", "yaml"]
        code = f"""
            import atexit, sys
            atexit.register(lambda: print([name for name in {heavy} if name in sys.modules]))
            {MAIN}
        """
        done = command("--help", code=textwrap.dedent(code))
        assert done.returncode == 0
        for name in ("init", "generate", "psf", "masks", "scenes", "verify", "schema", "doctor"):
            assert f" {name} " in done.stdout
        assert done.stdout.splitlines()[-1] == "[]"

    def test_version(self, flatlight) -> None:
        from importlib.metadata import version

        assert flatlight("--version") == (0, f"flatlight {version('flatlight')}\n", "")

    @pytest.mark.parametrize("arguments", [["genrate"], ["generate"], ["generate", "a.yaml", "--sed", "3"], []])
    def test_usage_errors(self, flatlight, arguments: list[str]) -> None:
        code, out, err = flatlight(*arguments)
        assert code == 2
        assert "Usage: " in out + err
        assert "Traceback" not in out + err

    def test_a_command_of_another_package(self, tmp_path: Path) -> None:
        (tmp_path / "others.py").write_text("def greet(name: str):\n    '''Say hello.'''\n    print('hello', name)\n")
        _install(tmp_path, "others", "greet = others:greet")
        environment = os.environ | {"PYTHONPATH": str(tmp_path)}
        assert "Say hello." in command("--help", env=environment).stdout
        done = command("greet", "Ada", env=environment)
        assert (done.returncode, done.stdout) == (0, "hello Ada\n")

    def test_a_command_that_does_not_import_stops_no_other(self, tmp_path: Path) -> None:
        _install(tmp_path, "broken", "greet = broken_module:greet")
        done = command("masks", env=os.environ | {"PYTHONPATH": str(tmp_path)})
        assert done.returncode == 0
        assert "pinhole" in done.stdout
        assert "warning: the command 'greet' (broken_module:greet) cannot be loaded: ModuleNotFoundError" in done.stderr
        assert "Traceback" not in done.stderr

    def test_a_fault_of_ours_says_so(self, flatlight, monkeypatch: pytest.MonkeyPatch) -> None:
        def broken() -> str:
            raise ZeroDivisionError("by surprise")

        monkeypatch.setattr("simulator.config.json_schema", broken)
        code, out, err = flatlight("schema")
        assert (code, out) == (1, "")
        assert "internal error: ZeroDivisionError: by surprise" in err
        assert "FLATLIGHT_TRACEBACK" in err
        assert "Traceback" not in err

    def test_the_traceback_on_request(self) -> None:
        code = "import simulator.config\nsimulator.config.json_schema = lambda: 1 / 0\n" + MAIN
        done = command("schema", code=code, env=os.environ | {"FLATLIGHT_TRACEBACK": "1"})
        assert done.returncode == 1
        assert "Traceback" in done.stderr


class TestInit:
    def test_writes_the_shipped_configuration(self, flatlight, tmp_path: Path) -> None:
        code, out, _ = flatlight("init", tmp_path / "mine.yaml")
        assert code == 0
        assert f"flatlight generate {tmp_path / 'mine.yaml'}" in out
        assert (tmp_path / "mine.yaml").read_text() == default_config_text()

    def test_by_default_into_the_current_folder(
        self, flatlight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        assert flatlight("init")[0] == 0
        assert (tmp_path / "sim_config.yaml").read_text() == default_config_text()

    def test_does_not_overwrite(self, flatlight, tmp_path: Path) -> None:
        path = tmp_path / "mine.yaml"
        path.write_text("years: of work")
        one_error(flatlight("init", path), "mine.yaml exists already", "--force")
        assert path.read_text() == "years: of work"
        assert flatlight("init", path, "--force")[0] == 0
        assert path.read_text() == default_config_text()

    def test_where_there_is_no_folder(self, flatlight, tmp_path: Path) -> None:
        one_error(flatlight("init", tmp_path / "a" / "b.yaml"), "its folder does not exist")
        assert list(tmp_path.iterdir()) == []


class TestLists:
    def test_schema_describes_the_shipped_configuration(self, flatlight) -> None:
        schema = json.loads(flatlight("schema")[1])
        validator = jsonschema.validators.validator_for(schema)
        validator.check_schema(schema)
        config = yaml.safe_load(default_config_text())
        validator(schema).validate(config)
        config["camera"]["sensr"] = {}
        assert not validator(schema).is_valid(config)

    def test_schema_is_json_and_knows_every_key_of_the_shipped_configuration(self, flatlight) -> None:
        code, out, _ = flatlight("schema")
        assert code == 0
        schema = json.loads(out)
        for section, values in yaml.safe_load(default_config_text()).items():
            described = json.dumps(schema["properties"][section])
            models = [schema["$defs"][name] for name in re.findall(r"#/\$defs/(\w+)", described)]
            known = {key for model in models for key in model["properties"]}
            for key in values if isinstance(values, dict) else ():
                open_ended = section == "scene" and any(model.get("additionalProperties", True) for model in models)
                assert key in known or open_ended, f"{section}.{key}"

    def test_masks(self, flatlight) -> None:
        code, out, _ = flatlight("masks")
        assert code == 0
        assert out.startswith("camera.mask.design:")
        for words in ("  phlatcam: ", "  pinhole: ", "  diffusercam: ", "      width_mm: 7.01"):
            assert words in out

    def test_scenes(self, flatlight) -> None:
        code, out, _ = flatlight("scenes")
        assert code == 0
        family, source = out.split("scene.source:")
        assert "  flying_things: " in family
        assert "samples_per_pixel: 16" in family
        assert "  flyingthings3d: " in source
        assert "path: required" in source
        assert "backend" not in out


class TestPsf:
    def test_writes_and_describes_the_stack(self, flatlight, trial, tmp_path: Path) -> None:
        from simulator.assemble import build_psf_stack
        from simulator.config import load_config
        from simulator.dataset.psf_files import read_psf_stack

        path = trial.write()
        code, out, err = flatlight("psf", path, "--output", tmp_path / "stack")
        assert code == 0, err
        assert "3, 3.6 cm to 20 cm" in out
        assert "sampling error" in out
        stack = build_psf_stack(load_config(path))
        assert np.array_equal(read_psf_stack(tmp_path / "stack").values, stack.values)
        assert flatlight("psf", path, "--output", tmp_path / "stack")[0] == 0  # an older stack is replaced

    def test_replaces_nothing_else(self, flatlight, trial, tmp_path: Path) -> None:
        one_error(flatlight("psf", trial.write(), "--output", tmp_path), "plugins.py", "choose another name")
        assert trial.plugins.exists()


class TestVerify:
    def test_a_sound_data_set(self, flatlight, finished: Path) -> None:
        code, out, _ = flatlight("verify", finished)
        assert code == 0
        assert "train: 3 of 3 intact" in out
        assert "all is well" in out

    def test_no_data_set(self, flatlight, tmp_path: Path) -> None:
        one_error(flatlight("verify", tmp_path / "nowhere"), "no such folder")
        code, out, _ = flatlight("verify", tmp_path)
        assert code == 2
        assert "dataset.json" in out

    def test_a_truncated_exr(self, flatlight, copy: Path) -> None:
        from simulator.dataset import open_dataset
        from simulator.errors import InputError

        file = copy / "train/0000/s00000001/measurement.exr"
        file.write_bytes(file.read_bytes()[:30_000])
        code, out, err = flatlight("verify", copy)
        assert code == 2
        assert "train/s00000001: measurement.exr has other content" in out
        assert "train: 2 of 3 intact" in out
        assert "Traceback" not in out + err
        with pytest.raises(InputError, match=r"s00000001/measurement\.exr is truncated or corrupt"):
            open_dataset(copy)[1]
        open_dataset(copy)[0]


class TestGenerate:
    def test_says_what_it_did_and_where_to_look(self, flatlight, trial) -> None:
        path = trial.write()
        code, out, err = flatlight("generate", path, "--set", "dataset.train=2")
        assert code == 0, err
        assert "4 samples made in " in out
        assert f": {trial.folder / 'out'}" in out
        assert f"look at {trial.folder / 'out' / 'contact_sheet.png'}" in out
        assert "samples: 4 of 4" in err  # plain lines, since this is no terminal
        assert "sampling error" in err
        code, out, _ = flatlight("generate", path)
        assert code == 0
        assert "1 samples made in " in out
        assert "4 were there before" in out

    def test_failed_samples_end_with_1(self, flatlight, trial) -> None:
        path = trial.write(scene=BOXES | {"fail_at": 1, "marker": "mended"})
        code, out, err = flatlight("generate", path)
        assert code == 1
        assert "4 samples made" in out
        assert "failed: train/s00000001: " in err
        assert "plugins.py:" in err
        assert "no clip 1 today" in err
        assert "1 samples failed; run the same command again" in err
        (trial.folder / "mended").touch()
        assert flatlight("generate", path)[0] == 0
        assert verify(trial.folder / "out").ok

    def test_the_swap_of_the_mask_by_one_line(self, flatlight, trial) -> None:
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
        one_error(result, "trial.yaml:", "camera.mask.width_mm: unknown key", "camera.mask.iterations", "diameter_um")

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


class TestBadInput:
    """One clear line, exit code 2, and nothing written."""

    @pytest.fixture
    def refused(self, flatlight, trial) -> Callable[..., None]:
        def run(*words: str, set_: str = "", **changes: Any) -> None:
            path = trial.write(**changes)
            before = {file: file.stat().st_mtime_ns for file in trial.folder.rglob("*")}
            result = flatlight("generate", path, *(("--set", set_) if set_ else ()))
            one_error(result, *words)
            assert {file: file.stat().st_mtime_ns for file in trial.folder.rglob("*")} == before

        return run

    def test_no_such_file(self, flatlight, tmp_path: Path) -> None:
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
        refused("f.pfm", scene=scene, camera={"exposure": {"full_scale": "auto"}})

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
    def test_before_the_first_sample(self, trial) -> None:
        """Not even the PSF stack can be written: nothing stays behind, and the same command works once there is room."""
        path = trial.write()
        done = command("generate", path, preexec_fn=lambda: _limit_files(2048))
        one_error((done.returncode, done.stdout, done.stderr), "cannot write", "bigger than allowed")
        assert not (trial.folder / "out").exists()
        assert verify(trial.generate()).ok

    def test_between_two_samples(self, trial) -> None:
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


def _install(folder: Path, name: str, entry: str) -> None:
    """Let a folder on the path look like an installed package that adds a command."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[flatlight.commands]\n{entry}\n")
