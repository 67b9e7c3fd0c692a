"""Fixtures that all tests share."""

import fcntl
import functools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]

# Where Python may not keep compiled modules (as in many containers), each of some hundred processes would compile all
# packages again: several seconds of most commands. They are kept out of the packages' folders.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = str(ROOT / ".pytest_cache" / "bytecode")
    sys.dont_write_bytecode = False
# Before the libraries are loaded: several processes test at once, and threads that outnumber the cores only wait.
os.environ |= {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
# What the shell that starts the tests may have set, and what would change what commands print.
for name in ("COLUMNS", "FORCE_COLOR", "NO_COLOR", "FLATLIGHT_TRACEBACK"):
    os.environ.pop(name, None)

hypothesis.settings.register_profile("flatlight", deadline=None)  # how long an example takes depends on the machine
hypothesis.settings.load_profile("flatlight")

SHARED = ROOT.parent / "shared"


def run_python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the checkout with additional environment variables."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="session")
def python() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run Python in a process of its own: one process renders with one Mitsuba variant."""
    return run_python


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """Let Ctrl-C and SIGHUP reach this process and the children that the test starts.

    A shell starts its background jobs with SIGINT ignored, nohup with SIGHUP ignored; children inherit that, and Python then
    installs no handler.
    """
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(scope="session")
def needs_llvm() -> None:
    from simulator.render import choose_backend

    backend = choose_backend("auto")
    if backend.llvm_version is None:
        pytest.skip(f"{backend.message}. {backend.advice}")


# What a tiny configuration may name: a mask without symmetry, and scenes that cost no rendering. Scenes count what they
# are asked for in a file, and misbehave on request.
PLUGINS = '''
"""Plugins of the tests."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulator.optics.mask import Mask
from simulator.types import Clip


def corners(*, arm: int = 30, seed: int = 3) -> Mask:
    """Open squares at random places and one long arm: no flip or turn leaves it as it is."""
    amplitude = np.zeros((100, 100), np.float32)
    for row, column in np.random.default_rng(seed).integers(5, 90, (6, 2)):
        amplitude[row : row + 6, column : column + 6] = 1
    amplitude[10:14, 10 : 10 + arm] = 1
    return Mask(np.zeros_like(amplitude), amplitude, 4e-6, name="corners")


@dataclass(frozen=True)
class Boxes:
    view: object
    boxes: int
    depth_m: float | None
    fail_at: int | None
    kill_at: int | None
    marker: Path | None
    seconds: float
    inputs: tuple[Path, ...] = ()

    def clip(self, index, rng):
        if self.marker is not None:
            with open(f"{self.marker}.log", "a") as log:
                log.write(f"{index}\\n")
        time.sleep(self.seconds)
        if index == self.fail_at and not (self.marker and self.marker.exists()):
            raise ZeroDivisionError(f"no clip {index} today")
        if index == self.kill_at and not self.marker.exists():
            self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        near, far = self.view.near_m, min(self.view.far_m, 10.0)
        rgb = np.full((1, *self.view.shape, 3), 0.1, np.float32)
        disparity = np.full((1, *self.view.shape), 1 / far, np.float32)
        for _ in range(self.boxes):
            row, column = rng.integers(0, self.view.shape)
            window = np.s_[0, row : row + 5, column : column + 7]
            rgb[window] = rng.random(3)
            disparity[window] = rng.uniform(1 / far, 1 / near)
        depth = (1 / disparity).clip(near, far) if self.depth_m is None else np.full_like(disparity, self.depth_m)
        valid = np.ones(depth.shape, bool)
        valid[0, 0, 0] = False
        return Clip(rgb, depth.astype(np.float32), valid, np.array([0.0, 1.0]), source={"drawn": index})


def boxes(
    view,
    *,
    boxes: int = 4,
    depth_m: float | None = None,
    fail_at: int | None = None,
    kill_at: int | None = None,
    marker: Path | None = None,
    seconds: float = 0.0,
):
    """Flat coloured boxes before a grey wall."""
    return Boxes(view, boxes, depth_m, fail_at, kill_at, marker, seconds)
'''

TINY: dict[str, dict[str, Any]] = {
    "camera": {
        "mask": {"design": "./plugins.py:corners"},
        "mask_to_sensor_mm": 1.9,
        "sensor": {"binning": 8, "shape": [48, 60]},
        "shutter": {"exposure_ms": 5},
        "exposure": {"full_scale": 3e-6},
        "noise": {"type": "gaussian", "psnr_db": 40},
    },
    "psf": {"near_cm": 3.6, "far_cm": 20, "depths": 3, "wavelengths_per_channel": 1, "accept_error": 1},
    "scene": {"family": "./plugins.py:boxes", "size": [16, 20]},
    "dataset": {"output": "out", "train": 3, "validation": 1, "test": 1, "engine": "inline"},
    "render": {"backend": "scalar"},
}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of tests/regression; here, because pytest must know them before it collects."""
    group = parser.getgroup("pinned PSFs")
    group.addoption("--regen-psf", action="store_true", help="accept changed PSFs: write their references again")
    group.addoption("--psf-references", type=Path, metavar="FOLDER", help="use these references, not the shipped ones")


class Trial:
    """A tiny configuration in a folder of its own, the plugins that it names beside it."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.path, self.plugins = folder, folder / "trial.yaml", folder / "plugins.py"
        self.plugins.write_text(PLUGINS, encoding="utf-8")

    def write(self, **changes: dict[str, Any]) -> Path:
        """Write the YAML file: keys of camera and dataset are changed one by one, the other sections as a whole."""
        config: dict[str, Any] = {"name": "trial", "seed": 11}
        for section, values in TINY.items():
            new = changes.get(section, {})
            whole = section not in ("camera", "dataset") and section in changes
            merged = new if whole else values | new
            config[section] = {key: value for key, value in merged.items() if value is not None}
        config["dataset"]["output"] = str(self.folder / config["dataset"]["output"])
        self.path.write_text(yaml.safe_dump(config), encoding="utf-8")
        return self.path

    def generate(self, *overrides: str, **changes: dict[str, Any]) -> Path:
        """Make the data set and return its folder."""
        from simulator.dataset import generate

        result = generate(self.write(**changes), overrides)
        assert result.failed == ()
        return result.path


_KEPT = ("resource_tracker", "forkserver", "/ray/", "moto.server")  # by Python; servers that a module's tests share


def _children() -> dict[int, str]:
    """The running children of this process with their commands, without those that are kept for the next test."""
    pids: list[str] = []
    for listing in Path("/proc/self/task").glob("*/children"):
        with suppress(OSError):  # a thread that has just ended
            pids += listing.read_text().split()
    found = {}
    for pid in pids:
        with suppress(OSError):  # a process that has
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
            command = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if state != "Z" and not any(name in command for name in _KEPT):
                found[int(pid)] = command
    return found


@pytest.fixture(autouse=True)
def no_process_outlives_a_test() -> Iterator[None]:
    """Fail a test that leaves a process running: it would slow the next tests down and outlive the run."""
    before = _children()
    yield
    end = time.monotonic() + 10
    while left := _children().keys() - before.keys():
        if time.monotonic() > end:
            pytest.fail(f"still running: {[_children().get(pid) for pid in left]}")
        time.sleep(0.02)


@pytest.fixture(scope="session")
def shared_tmp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A temporary folder that all processes of this run share."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def rendered(
    shared_tmp: Path, python: Callable[..., subprocess.CompletedProcess[str]]
) -> Callable[..., dict[str, Any]]:
    """The function from a script below tests/ and its arguments to the arrays that it stores, once per run."""
    import numpy as np

    @functools.cache
    def render(script: str, *arguments: str) -> dict[str, Any]:
        out = shared_tmp / f"{'_'.join((Path(script).stem, *arguments))}.npz"
        with out.with_suffix(".lock").open("w") as lock:  # another process of this run may be rendering the same
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not out.exists():
                part = out.with_suffix(".part.npz")
                done = python(str(ROOT / "tests" / script), *arguments, str(part))
                assert done.returncode == 0, done.stderr
                part.rename(out)
        with np.load(out, allow_pickle=False) as arrays:
            return dict(arrays)

    return render


@pytest.fixture(scope="session", autouse=True)
def private_cache(shared_tmp: Path) -> Iterator[Path]:
    """Keep what the tests design and compute out of the user's cache, and share it among them."""
    folder = shared_tmp / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLATLIGHT_CACHE_DIR", str(folder))
        yield folder


@pytest.fixture(scope="session", autouse=True)
def few_directions() -> Iterator[None]:
    """Let tests judge the field by 2 x 2 directions: every stack of every test would pay for more."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("simulator.optics.error_budget.field.PATCHES", 2)
        yield


@pytest.fixture(scope="session", autouse=True)
def no_power_cut() -> Iterator[None]:
    """Let files reach the disk when the system likes: thousands of tests would wait for it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture
def trial(tmp_path: Path) -> Trial:
    """A tiny configuration in ``tmp_path``."""
    return Trial(tmp_path)


@pytest.fixture(scope="session")
def make_trial() -> Callable[[Path], Trial]:
    """Return the function that puts a tiny configuration into a folder."""
    return Trial


@pytest.fixture
def flatlight(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs the command in this process and gives exit code, stdout and stderr."""

    def run(*arguments: object) -> tuple[int, str, str]:
        from simulator.cli import main

        monkeypatch.setattr(sys, "argv", ["flatlight", *map(str, arguments)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capfd.readouterr()
        code = end.value.code
        assert isinstance(code, int)
        return code, out, err

    return run


def _folder(name: str) -> Path:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"the real samples are not here: no folder {name!r} in {SHARED.name}/ beside the checkout")
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of small real samples beside the checkout; skips where it is absent."""
    return _folder("data")


@pytest.fixture(scope="session")
def shared_oracle() -> Path:
    """Folder of independently computed reference numbers beside the checkout; skips where it is absent."""
    return _folder("oracle")
