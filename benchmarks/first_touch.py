"""What the first commands cost that a newcomer types, in CPU seconds of the whole process, and the files that they write.

``python benchmarks/first_touch.py [--rounds 3] [--compare]``; Python's bytecode is already written. ``--compare`` says what
``flatlight compare`` spends on each design, in one thread, and how many depths are distinct by its seven depths and by all.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from common import single_threaded, versions

from simulator.assembly import Assembly
from simulator.optics.error_budget import budget
from simulator.optics.metrics import depth_correlations, distinct_depths
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack
from simulator.plots.comparison import DEPTHS, load_configs

SENSOR, DEPTHS_M = (128, 128), (0.05, 0.1, 0.2)
COMMANDS = {  # of flatlight
    "--help": "--help",
    "reconstruct, one plane": "reconstruct capture.npy --stack psf.npy --frame physical --method admm --set iterations=1",
    "reconstruct, depth": "reconstruct capture.npy --stack stack --frame physical --method cls",
}
DESIGNS = ("phlatcam", "diffusercam", "flatcam")
COMPARE = f"compare {' '.join(DESIGNS)} --output compare.html"
CONFIG = Path(__file__).parents[1] / "sim_config.yaml"


def prepare(folder: Path) -> None:
    """Write a capture of a random scene through random sparse PSFs, one as a file, all as a stack, and a configuration."""
    rng = np.random.default_rng(0)
    psfs = np.where(rng.random((len(DEPTHS_M), 3, 63, 63)) < 0.05, rng.random((len(DEPTHS_M), 3, 63, 63)), 0)
    scene = rng.random((3, *SENSOR)) ** 8
    capture = np.fft.irfft2(np.fft.rfft2(scene) * np.fft.rfft2(psfs[1], SENSOR), SENSOR)
    for name, channels in (("capture", capture / capture.max()), ("psf", psfs[1])):
        np.save(folder / f"{name}.npy", np.moveaxis(channels, 0, -1).astype(np.float32))
    stack = PsfStack(psfs, np.array(DEPTHS_M), 19.2e-6, ("R", "G", "B"), "random", {"kind": "measured"})
    write_psf_stack(folder / "stack", stack)
    shutil.copy(CONFIG, folder)


def seconds_of(arguments: str, folder: Path) -> float:
    """Run flatlight in a folder and return the CPU seconds of it and its children."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment["FLATLIGHT_CACHE_DIR"] = str(folder / "cache")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [str(Path(sys.executable).with_name("flatlight")), *arguments.split()]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(f"flatlight {arguments}: {done.stdout}{done.stderr}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def compared(folder: Path) -> None:
    """Print the CPU seconds of each design's parts in a comparison, and its distinct depths by seven depths and by all."""
    os.environ["FLATLIGHT_CACHE_DIR"] = str(folder / "compare")
    spent: dict[str, float] = {}

    def timed(name: str) -> Callable[..., Any]:
        function = getattr(budget, name)

        def call(*args: Any, **options: Any) -> Any:
            begin = time.process_time()
            result = function(*args, **options)
            spent[name] = time.process_time() - begin
            return result

        return call

    for name in ("prove_sampling", "compute_psf_stack", "quick_errors"):
        setattr(budget, name, timed(name))
    print(f"{'':12} {'mask':>6} {'sampling':>9} {'PSFs':>6} {'errors':>7}   distinct depths by {DEPTHS} and by all")
    for name, config in load_configs(DESIGNS, CONFIG).items():
        assembly, begin = Assembly(config), time.process_time()
        _ = assembly.mask
        mask_s = time.process_time() - begin
        some = assembly.some_depths(DEPTHS)
        parts = f"{spent['prove_sampling']:9.1f} {spent['compute_psf_stack']:6.1f} {spent['quick_errors']:7.1f}"
        stacks = (some, assembly.psf_stack)
        distinct = [distinct_depths(depth_correlations(stack), stack.depths_m) for stack in stacks]
        print(f"{name:12} {mask_s:6.1f} {parts}   {distinct[0]:.3f} {distinct[1]:.3f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="after one that writes the bytecode and is not counted")
    parser.add_argument("--compare", action="store_true", help="the parts of a comparison instead")
    args = parser.parse_args()
    rounds = args.rounds
    print(versions("numpy", "torch", "mitsuba"))
    with tempfile.TemporaryDirectory() as folder:
        if args.compare:
            single_threaded()
            warnings.simplefilter("ignore")  # sampling errors above 1 %
            compared(Path(folder))
            return
        prepare(Path(folder))
        for name, arguments in COMMANDS.items():
            seconds = [seconds_of(arguments, Path(folder)) for _ in range(rounds + 1)][1:]
            print(f"{name:30} {statistics.median(seconds):6.2f} CPU s", flush=True)
        for name in ("compare, nothing computed yet", "compare, again"):
            print(f"{name:30} {seconds_of(COMPARE, Path(folder)):6.2f} CPU s", flush=True)
        # The README's first command computes the same PSFs.
        shutil.rmtree(Path(folder) / "cache")
        for name, arguments in (("psf, the default camera", "psf sim_config.yaml"), ("compare, after it", COMPARE)):
            print(f"{name:30} {seconds_of(arguments, Path(folder)):6.2f} CPU s", flush=True)


if __name__ == "__main__":
    main()
