"""What a data set job costs beside its samples, how it scales, and what resuming a large one takes.

    uv run --extra cluster python benchmarks/jobs.py [--samples N] [--rounds N] [--records N] [--no-ray]

Samples are real ones of a small camera, measured, written and hashed; their scene burns CPU time up to 0.3 CPU-s a sample.
Every figure is a difference between a long and a short job, so that starting cancels out, in turn with the bare recipe, which
makes the same samples in one process. CPU seconds are those of the job's whole process tree, but of Ray, whose processes are
no children of the job; wall times are what a user waits, and mean something on an idle machine only.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from statistics import median

CPU_S = 0.3
SHORT = 4  # samples of the short job: as many as there are exposure pilots in the long one

PLUGINS = '''
"""A mask, and scenes that take as much CPU time as is asked for."""

import time
from dataclasses import dataclass

import numpy as np

from simulator.optics.mask import Mask
from simulator.types import Clip


def squares() -> Mask:
    """Return random open squares."""
    amplitude = np.random.default_rng(0).integers(0, 2, (100, 100)).astype(np.float32)
    return Mask(np.zeros_like(amplitude), amplitude, 4e-6, name="squares")


@dataclass(frozen=True)
class Noise:
    view: object
    cpu_s: float
    inputs: tuple = ()

    def clip(self, index, rng):
        begin = time.process_time()
        rgb = rng.random((1, *self.view.shape, 3), np.float32)
        depth = np.full((1, *self.view.shape), 0.1, np.float32)
        while time.process_time() - begin < self.cpu_s:
            rng.random(1000)
        return Clip(rgb, depth, np.ones(depth.shape, bool), np.array([0.0, 1.0]), source={"drawn": index})


def noise(view, *, cpu_s: float = 0.0):
    """Return noise that takes its time."""
    return Noise(view, cpu_s)
'''

CONFIG = """
name: jobs
seed: 1
camera:
  mask: {{design: "./plugins.py:squares"}}
  mask_to_sensor_mm: 1.9
  sensor: {{binning: 8, shape: [228, 342]}}
  shutter: {{exposure_ms: 5}}
  exposure: {{full_scale: 3.0e-6}}
  noise: {{type: gaussian, psnr_db: 40}}
psf: {{near_cm: 5, far_cm: 20, depths: 4, wavelengths_per_channel: 1, accept_error: 1}}
scene: {{family: "./plugins.py:noise", size: [64, 64], cpu_s: {cpu_s}}}
dataset: {{output: {output}, train: {train}, engine: {engine}, workers: {workers}}}
"""

BARE = """
import sys, time
from dataclasses import replace
from pathlib import Path
from simulator.config import load_config
from simulator.dataset.plan import make_plan
from simulator.dataset.recipe import make_sample, start_worker
plan = make_plan(load_config(sys.argv[1]), False, lambda *_: None, lambda _: None)
start_worker(replace(plan.recipe, full_scale=3e-6, psf_folder=Path(sys.argv[3])))
for index in range(int(sys.argv[2])):
    make_sample((plan.root, "train", index))
"""

JOB = "import sys; from simulator.dataset import generate; generate(sys.argv[1])"
RESUME = """
import sys, time, resource
from simulator.dataset import generate
begin = time.perf_counter()
seen = []
result = generate(sys.argv[1], progress=lambda stage, done, total: seen.append((time.perf_counter() - begin, stage)))
first = next(at for at, stage in seen if stage == "samples")
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
print(first, time.perf_counter() - begin, peak, result.kept, result.made)
"""
PARSE = """
import sys, time, json
begin = time.perf_counter()
with open(sys.argv[1], "rb") as file:
    for line in file:
        json.loads(line)
print(time.perf_counter() - begin)
"""
MERGE = """
import sys, time, resource
from pathlib import Path
from simulator.dataset.manifest import merge_lists
begin = time.perf_counter()
merge_lists(Path(sys.argv[1]))
print(time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
"""


@dataclass(frozen=True)
class Times:
    """What a process tree took, seconds."""

    wall: float
    cpu: float

    def __sub__(self, other: Times) -> Times:
        return Times(self.wall - other.wall, self.cpu - other.cpu)


def timed(code: str, *arguments: object) -> Times:
    """Run Python code in a process of its own."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    words = [sys.executable, "-c", code, *map(str, arguments)]
    subprocess.run(words, check=True, capture_output=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return Times(wall, sum(getattr(after, name) - getattr(before, name) for name in ("ru_utime", "ru_stime")))


def printed(code: str, *arguments: object) -> list[str]:
    """Run Python code in a process of its own and return the words that it printed."""
    words = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()


class Bench:
    """A folder of configurations and their data sets."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.number = folder, 0
        (folder / "plugins.py").write_text(PLUGINS)
        self.psf = folder / "psf_of_all"
        root = self.folder / "first"
        timed(JOB, self.config(1, "inline", 1, root))
        (root / "psf").rename(self.psf)

    def config(self, train: int, engine: str, workers: int, output: Path | None = None, cpu_s: float = CPU_S) -> Path:
        """Write a configuration of a new data set."""
        self.number += 1
        path = self.folder / f"{self.number}.yaml"
        output = output or self.folder / f"out{self.number}"
        path.write_text(
            CONFIG.format(output=output, train=train, engine=engine, workers=workers, cpu_s=cpu_s), encoding="utf-8"
        )
        return path

    def bare(self, samples: int) -> Times:
        """Return what each sample takes in one process without machinery."""
        long, short = (timed(BARE, self.config(n, "inline", 1), n, self.psf) for n in (samples + SHORT, SHORT))
        return Times((long - short).wall / samples, (long - short).cpu / samples)

    def job(self, samples: int, engine: str, workers: int) -> Times:
        """Return what each sample takes in a job."""
        short = SHORT * workers
        long, begun = (timed(JOB, self.config(n, engine, workers)) for n in (samples + short, short))
        return Times((long - begun).wall / samples, (long - begun).cpu / samples)


def overheads(bench: Bench, samples: int, rounds: int, ray: bool) -> None:
    """Print what jobs cost over the bare recipe, and how they scale."""
    contenders = {
        "bare recipe": bench.bare,
        "local, 1 worker": lambda n: bench.job(n, "local", 1),
        "local, 2 workers": lambda n: bench.job(n, "local", 2),
    }
    if ray:
        contenders["ray, 1 worker"] = lambda n: bench.job(n, "ray", 1)
        contenders["ray, 2 workers"] = lambda n: bench.job(n, "ray", 2)
    found: dict[str, list[Times]] = {name: [] for name in contenders}
    for number in range(rounds):
        for name, run in contenders.items():
            found[name].append(run(samples))
            print(f"round {number + 1}, {name}: {found[name][-1]}", file=sys.stderr)
    bare = found["bare recipe"]
    print(f"{samples} samples of {CPU_S} CPU-s and more, {rounds} rounds, medians\n")
    print(f"{'':20}{'CPU s':>8}{'over bare':>11}{'wall s':>9}{'samples/s over one worker':>28}")
    for name, times in found.items():
        engine = name.split(",")[0]
        over = median(one.cpu / ours.cpu - 1 for one, ours in zip(times, bare, strict=True))
        alone = found.get(f"{engine}, 1 worker")
        scale = "" if alone is None else f"{median(a.wall / b.wall for a, b in zip(alone, times, strict=True)):.2f}"
        cpu, wall = median(one.cpu for one in times), median(one.wall for one in times)
        costs = f"{'':19}" if engine == "ray" else f"{cpu:8.3f}{over:+11.1%}"
        print(f"{name:20}{costs}{wall:9.3f}{scale:>28}")


def resume(bench: Bench, records: int) -> None:
    """Print what it takes to find that nothing is left to do of so many samples, from their records alone."""
    root = bench.folder / "large"
    path = bench.config(SHORT, "inline", 1, root, cpu_s=0.0)
    timed(JOB, path)
    (root / "checksums.json").unlink()
    with (root / "manifest.jsonl").open("a", encoding="utf-8") as file:
        file.writelines(record(index) for index in range(SHORT, records))
    (parsed,) = printed(PARSE, root / "manifest.jsonl")
    print(f"lines of {records:,} records parsed by json.loads, and no more, in {float(parsed):.1f} s")
    config = bench.config(records, "inline", 1, root, cpu_s=0.0)
    for run in ("first", "second"):
        first, whole, peak, kept, made = printed(RESUME, config)
        print(
            f"{run} resume of {records:,} records: nothing left to do known after {float(first):.1f} s, sealed after "
            f"{float(whole):.1f} s, peak memory {float(peak):.0f} MB, kept {kept}, made {made}"
        )


def merge(bench: Bench, records: int) -> None:
    """Print what it takes to merge the lists of a hundred shards of so many samples, from their records alone."""
    root = bench.folder / "merged"
    for number in range(100):
        own = root / "writers" / f"{number}-of-100-00000000"
        own.mkdir(parents=True)
        with (own / "manifest.jsonl").open("w", encoding="utf-8") as file:
            file.writelines(record(index) for index in range(number, records, 100))
    whole, peak = printed(MERGE, root)
    print(
        f"lists of 100 shards with {records:,} records merged in {float(whole):.1f} s, peak memory {float(peak):.0f} MB"
    )


def record(index: int) -> str:
    """Return a line of a manifest."""
    digest = sha256(str(index).encode()).hexdigest()
    line = {"id": f"s{index:08d}", "split": "train", "digest": digest, "seed": 1, "label": None}
    return json.dumps(line | {"seconds": 0.3141, "stages": [0.2, 0.1, 0.01]}, separators=(",", ":")) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--samples", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--records", type=int, default=1_000_000)
    parser.add_argument("--no-ray", action="store_true")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        if chosen.samples:
            overheads(bench, chosen.samples, chosen.rounds, not chosen.no_ray)
        if chosen.records:
            resume(bench, chosen.records)
            merge(bench, chosen.records)


if __name__ == "__main__":
    main()
