"""What the first commands cost that a newcomer types, in CPU seconds of the whole process, and the files that they write.

``python benchmarks/first_touch.py [--rounds 3]``; Python's bytecode is already written.
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
from pathlib import Path

import numpy as np
from common import versions

from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack

SENSOR, DEPTHS_M = (128, 128), (0.05, 0.1, 0.2)
COMMANDS = {  # of flatlight
    "--help": "--help",
    "reconstruct, one plane": "reconstruct capture.npy --stack psf.npy --frame physical --method admm --set iterations=1",
    "reconstruct, depth": "reconstruct capture.npy --stack stack --frame physical --method cls",
}
COMPARE = "compare phlatcam diffusercam flatcam --output compare.html"


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
    shutil.copy(Path(__file__).parents[1] / "sim_config.yaml", folder)


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3, help="after one that writes the bytecode and is not counted")
    rounds = parser.parse_args().rounds
    print(versions("numpy", "torch", "mitsuba"))
    with tempfile.TemporaryDirectory() as folder:
        prepare(Path(folder))
        for name, arguments in COMMANDS.items():
            seconds = [seconds_of(arguments, Path(folder)) for _ in range(rounds + 1)][1:]
            print(f"{name:30} {statistics.median(seconds):6.2f} CPU s", flush=True)
        for name in ("compare, nothing computed yet", "compare, again"):
            print(f"{name:30} {seconds_of(COMPARE, Path(folder)):6.2f} CPU s", flush=True)
        # As after the README's first command.
        shutil.rmtree(Path(folder) / "cache")
        for name, arguments in (("psf, the default camera", "psf sim_config.yaml"), ("compare, after it", COMPARE)):
            print(f"{name:30} {seconds_of(arguments, Path(folder)):6.2f} CPU s", flush=True)


if __name__ == "__main__":
    main()
