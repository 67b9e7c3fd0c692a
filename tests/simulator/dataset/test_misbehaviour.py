"""User code that ends its process, hangs or exhausts the memory: told with its cause, and everything else is made."""

import json
import re
from collections.abc import Callable
from typing import Any

import pytest

from simulator.dataset.manifest import load_failed, load_manifest

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

BADLY = '''
import os, resource, signal, sys, time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plugins

GOOD = 20


def allocate():
    """Ask for memory until there is none, in a process that may have little, so that the machine is not harmed."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + (256 << 20), before[1]))
    try:
        kept = []
        while True:
            kept.append(np.ones(1 << 20))
    finally:
        kept = None
        resource.setrlimit(resource.RLIMIT_AS, before)


def interrupt():
    raise KeyboardInterrupt


WAYS = {
    "abort": os.abort,
    "segfault": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "exit_0": lambda: os._exit(0),
    "exit_3": lambda: os._exit(3),
    "leave": lambda: sys.exit(0),
    "hang": lambda: time.sleep(600),
    "allocate": allocate,
    "killed": lambda: os.kill(os.getpid(), signal.SIGKILL),  # what the system does where memory runs out
    "interrupt": interrupt,
}


def mask(*, way: str):
    """A mask that is never made."""
    WAYS[way]()


@dataclass(frozen=True)
class Badly:
    boxes: object
    inputs: tuple[Path, ...] = ()

    def clip(self, index, rng):
        if index >= GOOD:
            list(WAYS.values())[index - GOOD]()
        return self.boxes.clip(index, rng)


def scenes(view):
    """Good ones, and after them one of each that behaves badly."""
    return Badly(plugins.boxes(view))
'''
CAUSES = {
    "abort": r"SIGABRT",
    "segfault": r"SIGSEGV",
    "exit_0": r"exit code 0",
    "exit_3": r"exit code 3",
    "leave": r"SystemExit: 0",
    "hang": r"not finished after [12] s",
    "allocate": r"MemoryError|memory",
    "killed": r"SIGKILL, .*memory",
    "interrupt": r"KeyboardInterrupt",
}
GOOD = 20


def badly(trial: Any) -> None:
    (trial.folder / "badly.py").write_text(f"import sys; sys.path.insert(0, {str(trial.folder)!r})\n{BADLY}")


@pytest.mark.slow
def test_bad_samples_are_told_after_three_tries_and_all_others_are_made(trial, flatlight: Callable) -> None:
    """By the engine `local`, whose processes a Ray worker tries its tasks in, too; see test_engines."""
    badly(trial)
    chosen = {"train": GOOD + len(CAUSES), "validation": 0, "test": 0, "engine": "local", "workers": 2, "timeout_s": 2}
    path = trial.write(dataset=chosen, scene={"family": "./badly.py:scenes", "size": [16, 20]})
    code, _, err = flatlight("generate", path)
    root = trial.folder / "out"
    assert code == 1, err
    assert len(load_manifest(root).entries) == GOOD
    assert f"{len(CAUSES)} samples failed" in err
    assert "Traceback" not in err
    failed = load_failed(root)
    assert list(failed) == [("train", f"s{GOOD + number:08d}") for number in range(len(CAUSES))]
    lines = [json.loads(line) for line in (root / "failed.jsonl").read_text().splitlines()]
    assert sorted(line["id"] for line in lines) == [name for _, name in failed]
    told, page = flatlight("status", root)[1], (root / "report.html").read_text()
    for (_, name), cause in zip(failed, CAUSES.values(), strict=True):
        assert failed["train", name].attempts == 3
        assert re.search(cause, failed["train", name].reason), failed["train", name]
        assert re.search(f"train/{name}: .*({cause})", told)
        assert re.search(f"failed: train/{name}: .*({cause})", err)
        assert re.search(f"{name}.*({cause})", page, re.DOTALL)
    assert f"left: {len(CAUSES)}" in told


@pytest.mark.parametrize(
    ("way", "engine", "margin"), [("exit_0", "local", 0), ("hang", "local", "auto"), ("killed", "ray", 0)]
)
@pytest.mark.slow
def test_a_bad_mask_ends_the_run_in_one_line(trial, flatlight: Callable, way: str, engine: str, margin) -> None:
    """Told as a bad sample is, whose test names all causes. An automatic margin asks for the mask before all else does."""
    badly(trial)
    camera = {"mask": {"design": "./badly.py:mask", "way": way}}
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "margin": margin}
    dataset = {"engine": engine, "workers": 1, "timeout_s": 1}
    code, out, err = flatlight("generate", trial.write(camera=camera, scene=scene, dataset=dataset))
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert re.fullmatch(rf"error: .*mask.*'\./badly\.py:mask'.*({CAUSES[way]}).*", line)
    assert not (trial.folder / "out").exists()
