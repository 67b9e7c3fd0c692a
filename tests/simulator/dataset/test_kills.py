"""SIGKILL at any moment, of workers, parents and shards: the next run ends with the bytes of an undisturbed one."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest

from simulator.dataset import generate, verify
from simulator.dataset.manifest import load_manifest
from simulator.dataset.shards import Shard

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:the PSF's sampling error")]

# What a scene is told lies in files: the environment of a Ray worker is that of its cluster.
SLOWLY = """
import os, sys, time
from dataclasses import dataclass
from pathlib import Path

import plugins

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Slow:
    boxes: object
    inputs: tuple[Path, ...] = ()

    def clip(self, index, rng):
        with open(HERE / "log", "a") as log:
            log.write(f"{os.getpid()} {index}\\n")
        time.sleep(float((HERE / "seconds").read_text()))
        return self.boxes.clip(index, rng)


def scenes(view):
    return Slow(plugins.boxes(view))
"""
COUNT = 36
HELPERS = {"ray::DashboardA", "ray::RuntimeEnv"}
COMMAND = [sys.executable, "-c", "from simulator.cli import main; main()", "generate"]


class Slowly:
    """A configuration whose samples take as long as a file says, and tell in another who makes them."""

    def __init__(self, trial: Any, decided: Callable) -> None:
        self.folder, self._decided = trial.folder, decided
        (self.folder / "slowly.py").write_text(f"import sys; sys.path.insert(0, {str(self.folder)!r})\n{SLOWLY}")
        counts = {"train": COUNT, "validation": 0, "test": 0}
        scene = {"family": "./slowly.py:scenes", "size": [16, 20]}
        self.path = trial.write(dataset=counts | {"workers": 2}, scene=scene)
        self.paced(0.0)
        self.undisturbed = self.decided(self.finish("undisturbed"))

    def paced(self, seconds: float) -> None:
        (self.folder / "seconds").write_text(str(seconds))
        (self.folder / "log").write_text("")

    @property
    def begun(self) -> list[tuple[int, int]]:
        """Process and number of each sample that was begun, pilots included, in order."""
        lines = (self.folder / "log").read_text().splitlines()
        return [(int(pid), int(index)) for pid, index in map(str.split, lines)]

    def start(self, name: str, engine: str, *more: str, **environment: str) -> subprocess.Popen:
        words = ["--set", f"dataset.output={self.folder / name}", "--set", f"dataset.engine={engine}", *more]
        sink = (self.folder / f"{name}.txt").open("ab")
        with sink:
            return subprocess.Popen(
                [*COMMAND, str(self.path), *words], stdout=sink, stderr=sink, env=os.environ | environment
            )

    def finish(self, name: str, **options: Any) -> Path:
        """Resume without any disturbance."""
        result = generate(self.path, [f"dataset.output={self.folder / name}", "dataset.engine=inline"], **options)
        assert result.failed == ()
        return result.path

    def decided(self, root: Path) -> dict[str, str]:
        return {name: value for name, value in self._decided(root).items() if name != "contact_sheet.png"}

    def check(self, name: str) -> None:
        """Everything is there as if nothing had happened, and one more run does nothing."""
        root = self.finish(name)
        assert verify(root).ok, str(verify(root))
        assert self.decided(root) == self.undisturbed
        before = _stamps(root)
        assert generate(self.path, [f"dataset.output={root}", "dataset.engine=inline"]).made == 0
        assert _stamps(root) == before
        assert verify(root).ok


def _stamps(root: Path) -> dict[Path, tuple[int, bytes]]:
    return {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in root.rglob("*.*") if path.parent != root}


@pytest.fixture(scope="module")
def slowly(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable, decided: Callable) -> Slowly:
    return Slowly(make_trial(tmp_path_factory.mktemp("slowly")), decided)


@pytest.fixture
def engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of an engine; commands find the Ray cluster of this module by the environment."""
    if request.param == "ray":
        request.getfixturevalue("ray_cluster")
        import ray

        monkeypatch.setenv("RAY_ADDRESS", ray.get_runtime_context().gcs_address)
    return request.param


def alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def marked(marker: str) -> dict[int, str]:
    """The processes whose environment holds a marker, all descendants of a command, with their names."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            if marker.encode() in (folder / "environ").read_bytes() and alive(int(folder.name)):
                found[int(folder.name)] = (folder / "comm").read_text().strip()
    return found


def ended(left: Callable[[], object], within_s: float = 15) -> bool:
    end = time.monotonic() + within_s
    while left():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


class Killer(threading.Thread):
    """Kills workers, or the Ray workers above them, at random moments of their samples, no sample twice."""

    def __init__(self, slowly: Slowly, kills: int, above: bool) -> None:
        super().__init__(daemon=True)
        self.slowly, self.kills, self.above = slowly, kills, above
        self.done = False

    def run(self) -> None:
        rng, costs = np.random.default_rng(8), Counter[int]()
        seen = 0
        while not self.done and self.kills:
            begun = self.slowly.begun
            if len(begun) == seen:
                time.sleep(0.005)
                continue
            seen, pid = len(begun), begun[-1][0]
            time.sleep(rng.uniform(0, 0.2))
            index = [number for own, number in self.slowly.begun if own == pid][-1]  # by now
            if not costs[index]:
                with suppress(OSError):
                    os.kill(parent_of(pid) if self.above else pid, signal.SIGKILL)
                    self.kills -= 1
                    costs[index] += 1


@pytest.mark.parametrize(("engine", "kills"), [("local", 20), ("ray", 10)], indirect=["engine"])
def test_workers_killed_many_times(slowly: Slowly, engine: str, kills: int) -> None:
    """On Ray the Ray workers: the process below one, which makes the samples, is a worker of `local`; see test_engines."""
    slowly.paced(0.15)
    killer = Killer(slowly, kills, above=engine == "ray")
    killer.start()
    result = generate(slowly.path, [f"dataset.output={slowly.folder / engine}", f"dataset.engine={engine}"])
    killer.done = True
    killer.join()
    slowly_begun = len(slowly.begun)
    slowly.paced(0.0)
    assert killer.kills == 0
    assert slowly_begun >= COUNT + 0.75 * kills
    assert result.failed == ()
    assert slowly.decided(result.path) == slowly.undisturbed
    slowly.check(engine)


def killed(slowly: Slowly, name: str, engine: str, wait: Callable[[subprocess.Popen], object]) -> int:
    """Kill a run after a wait; nothing stays behind and it can be finished. Return what it had, -1 without a description."""
    slowly.paced(0.1)
    marker = uuid4().hex
    process = slowly.start(name, engine, FLATLIGHT_TEST_RUN=marker)
    wait(process)
    process.kill()
    process.wait()
    assert ended(lambda: marked(marker)), marked(marker)
    assert ended(lambda: [pid for pid, _ in slowly.begun if alive(pid)])
    root = slowly.folder / name
    finished = len(load_manifest(root).entries) if (root / "dataset.json").exists() else -1
    slowly.paced(0.0)
    slowly.check(name)
    return finished


def test_parent_killed_at_10_moments(slowly: Slowly) -> None:
    slowly.paced(0.1)
    begin = time.monotonic()
    assert slowly.start("whole", "local").wait() == 0
    lasts_s = time.monotonic() - begin
    slowly.check("whole")
    moments = lasts_s * (np.arange(10) + np.random.default_rng(9).random(10)) / 10  # one in each tenth
    finished = []
    for number, moment in enumerate(moments):
        finished.append(killed(slowly, f"local-{number}", "local", lambda _, after=moment: time.sleep(after)))
    assert finished[0] == -1  # not even a description
    assert any(0 <= count < COUNT for count in finished)


@pytest.mark.parametrize("engine", ["ray"], indirect=True)
@pytest.mark.parametrize("begun", [1, 12, 30])  # 4 of them pilots
def test_parent_killed_while_a_cluster_makes_samples(slowly: Slowly, engine: str, begun: int) -> None:
    """The workers are not its children; until there are tasks for them, the engine plays no part."""
    finished = killed(
        slowly,
        f"{engine}-{begun}",
        engine,
        lambda process: ended(lambda: len(slowly.begun) < begun and process.poll() is None, 120),
    )
    assert (finished >= 0) >= (begun > 4)
    assert finished < COUNT


@pytest.mark.parametrize("in_the_middle", [False, True])
def test_a_killed_parent_takes_its_own_cluster_along(slowly: Slowly, in_the_middle: bool, monkeypatch) -> None:
    """Its raylet, its GCS and all workers, also where it dies while the cluster starts.

    Two helpers of Ray end a minute later, by themselves: so long they try to tell the GCS that the raylet is gone.
    """
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    marker, name = uuid4().hex, f"own-{in_the_middle}"
    slowly.paced(0.2)
    process, seen = slowly.start(name, "ray", FLATLIGHT_TEST_RUN=marker), dict[int, str]()

    def begun() -> bool:
        seen.update(marked(marker))
        return len(load_manifest(slowly.folder / name).entries) > 2 if in_the_middle else "raylet" in seen.values()

    assert ended(lambda: not begun() and process.poll() is None, 120)
    assert process.poll() is None, (slowly.folder / f"{name}.txt").read_text()
    process.kill()
    process.wait()
    assert {"gcs_server", "raylet"} <= set(seen.values())
    assert ended(lambda: set(marked(marker).values()) - HELPERS), marked(marker)
    for pid in marked(marker):
        os.kill(pid, signal.SIGKILL)
    slowly.paced(0.0)
    slowly.check(name)


def test_a_shard_and_a_ray_worker_killed_in_the_middle(slowly: Slowly, ray_cluster: None, monkeypatch) -> None:
    import ray

    monkeypatch.setenv("RAY_ADDRESS", ray.get_runtime_context().gcs_address)
    slowly.paced(0.2)
    root = slowly.folder / "shards"
    first, second = (slowly.start("shards", "ray", "--shard", f"{index}/2") for index in range(2))
    try:
        assert ended(lambda: not (root / "dataset.json").exists() or len(load_manifest(root).entries) < 3, 120)
        first.kill()
        pid, _ = slowly.begun[-1]
        with suppress(OSError):
            os.kill(parent_of(pid), signal.SIGKILL)
        assert second.wait(120) == 0, (slowly.folder / "shards.txt").read_text()
    finally:
        first.kill()
        second.kill()
        first.wait()
        second.wait()
    slowly.paced(0.0)
    there = load_manifest(root).entries
    assert {name for _, name in there} >= {f"s{n:08d}" for n in range(COUNT) if Shard(1, 2).holds("train", f"s{n:08d}")}
    assert len(there) < COUNT
    assert slowly.finish("shards", shard=Shard(0, 2)) == root
    slowly.check("shards")
