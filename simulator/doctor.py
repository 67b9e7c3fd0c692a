"""What this computer offers and what would make Flatlight faster here: plain findings, printed by ``flatlight doctor``.

Every check answers; one that fails is a finding itself. The slow ones (Mitsuba, torch) run in processes of their own.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from simulator.dataset.engines import available_cpus
from simulator.errors import InputError
from simulator.io.cache import cache_folder
from simulator.render.backend import LLVM_VARIANT, choose_backend

Status = Literal["ok", "note", "problem"]

_TORCH_TIMEOUT_S = 10.0
_LITTLE_MEMORY = 2 * 2**30  # a PSF of full size takes a few hundred MB per thread
_LITTLE_DISK, _NO_DISK = 5 * 10**9, 2 * 10**8  # a sample takes some MB
# A fresh process: importing torch takes seconds and memory, and a broken build may kill its process.
_TORCH_SCRIPT = """
import json, torch
device, name = "cpu", ""
if torch.cuda.is_available():
    device, name = "cuda", torch.cuda.get_device_name(0)
elif torch.backends.mps.is_available():
    device = "mps"
print(json.dumps({"version": torch.__version__, "device": device, "name": name, "threads": torch.get_num_threads(),
    "cuda": torch.version.cuda}))
"""


@dataclass(frozen=True)
class Check:
    """One finding.

    Attributes:
        name: what was looked at.
        status: ``ok``; ``note``: works, but could be better; ``problem``: something will fail.
        what: what was found, one line.
        advice: what to do about it; empty when there is nothing to do.
    """

    name: str
    status: Status
    what: str
    advice: str = ""


def diagnose() -> list[Check]:
    """Look at versions, renderer, CPU, memory, torch, disk and extras; never raises.

    Takes about as long as the slower of importing Mitsuba and importing torch, once, in other processes.
    """
    checks: list[tuple[str, Callable[[], Check]]] = [
        ("flatlight", _versions),
        ("rendering", _rendering),
        ("processors", _processors),
        ("memory", _memory),
        ("torch", _torch),
        ("disk, here", lambda: _disk("disk, here", Path.cwd(), "change to another folder, or set dataset.output")),
        ("disk, cache", _cache),
        ("extras", _extras),
    ]
    with ThreadPoolExecutor(len(checks)) as pool:
        return list(pool.map(lambda item: _guarded(*item), checks))


def _guarded(name: str, check: Callable[[], Check]) -> Check:
    try:
        return check()
    # Whatever is broken on a strange computer, the other findings are still wanted.
    except Exception as error:
        what = f"could not be examined ({type(error).__name__}: {error})"
        return Check(name, "problem", what, "please report this with the other lines of flatlight doctor")


def _versions() -> Check:
    system = f"Python {platform.python_version()} on {platform.system()} {platform.machine()}"
    try:
        version = importlib.metadata.version("flatlight")
    except importlib.metadata.PackageNotFoundError:
        return Check("flatlight", "note", f"not installed, run from its files; {system}", "install it: pip install .")
    return Check("flatlight", "ok", f"{version}, {system}")


def _rendering() -> Check:
    missing = [name for name in ("mitsuba", "drjit") if importlib.util.find_spec(name) is None]
    if missing:
        advice = "install flatlight with its dependencies: pip install flatlight"
        return Check("rendering", "problem", f"{' and '.join(missing)} missing: scenes cannot be rendered", advice)
    try:
        backend = choose_backend("auto")
    except InputError as error:
        return Check("rendering", "problem", str(error))
    fast = backend.variant == LLVM_VARIANT
    return Check("rendering", "ok" if fast else "note", f"Mitsuba {backend.message}", backend.advice)


def _processors() -> Check:
    usable, present = available_cpus(), os.cpu_count() or 1
    what = f"{usable} of {present} usable: as many workers" if usable < present else f"{usable}: as many workers"
    if usable == 1:
        return Check("processors", "note", what, "more processors make a data set sooner: workers share the samples")
    return Check("processors", "ok", what)


def _memory() -> Check:
    total, free = memory_bytes()
    if total is None:
        return Check("memory", "ok", "unknown on this system")
    what = f"{total / 2**30:.1f} GB" + ("" if free is None else f", {free / 2**30:.1f} GB free")
    if (total if free is None else free) < _LITTLE_MEMORY:
        return Check("memory", "note", what, "close other programs, or use fewer workers: --set dataset.workers=1")
    return Check("memory", "ok", what)


def memory_bytes(root: Path = Path("/")) -> tuple[int | None, int | None]:
    """Return the memory that this process may use and what of it is free, bytes; None where the system does not say.

    Args:
        root: where ``proc`` and ``sys`` are found.
    """
    total = free = None
    try:
        lines = (root / "proc/meminfo").read_text(encoding="ascii").splitlines()
        sizes = {line.split(":")[0]: int(line.split()[1]) * 1024 for line in lines if line.endswith("kB")}
        total, free = sizes.get("MemTotal"), sizes.get("MemAvailable")
    except (OSError, ValueError, IndexError):
        if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
            total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for limit_name, used_name in (
        ("memory.max", "memory.current"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes"),
    ):
        try:
            limit = int((root / "sys/fs/cgroup" / limit_name).read_text())
            used = int((root / "sys/fs/cgroup" / used_name).read_text())
        except (OSError, ValueError):  # absent, or "max"
            continue
        if total is None or limit < total:  # version 1 writes a huge number for "no limit"
            total, free = limit, min(limit - used, limit if free is None else free)
    return total, free


def _torch() -> Check:
    advice = "only learning and GPU optics need it: pip install 'flatlight[learn]'"
    if importlib.util.find_spec("torch") is None:
        return Check("torch", "note", "not installed; generating data does not need it", advice)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _TORCH_SCRIPT],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TORCH_TIMEOUT_S,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    except subprocess.TimeoutExpired:
        what = f"installed, but not imported within {_TORCH_TIMEOUT_S:.0f} s"
        return Check("torch", "note", what, "try again: a disk warms up")
    if done.returncode != 0:
        words = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1][:200]
        return Check("torch", "problem", f"installed, but it does not start ({words})", "install torch again")
    facts = json.loads(done.stdout.strip().splitlines()[-1])
    device = facts["device"] + (f" ({facts['name']})" if facts["name"] else f", {facts['threads']} threads")
    what = f"{facts['version']}, device {device}"
    if facts["device"] == "cpu" and shutil.which("nvidia-smi"):
        build = "its CUDA build does not fit the driver" if facts["cuda"] else "it was built for CPUs only"
        what += f", although there is an NVIDIA GPU: {build}"
        return Check("torch", "note", what, "install a torch for your CUDA driver")
    return Check("torch", "ok", what)


def _cache() -> Check:
    found = _disk(
        "disk, cache", cache_folder(), "set FLATLIGHT_CACHE_DIR to a folder with space that may be written to"
    )
    # Without the cache everything works, only slower.
    return Check(found.name, "note" if found.status == "problem" else found.status, found.what, found.advice)


def _disk(name: str, folder: Path, advice: str) -> Check:
    existing = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    free = shutil.disk_usage(existing).free
    what = f"{_size(free)} free in {folder}"
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        return Check(name, "problem", f"{folder} cannot be written to", advice)
    if free < _NO_DISK:
        return Check(name, "problem", what, f"free some space, or {advice}")
    if free < _LITTLE_DISK:
        return Check(name, "note", what, f"a sample takes some MB: free some space, or {advice}")
    return Check(name, "ok", what)


def _size(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"


def _extras() -> Check:
    try:
        required = importlib.metadata.requires("flatlight") or []
    except importlib.metadata.PackageNotFoundError:
        return Check("extras", "note", "unknown: flatlight itself is not installed", "install it: pip install .")
    packages: dict[str, list[str]] = {}
    for line in required:
        marked = re.search(r"""extra\s*==\s*['"]([\w-]+)""", line)
        if marked:
            packages.setdefault(marked[1], []).append(re.split(r"[\s<>=!~;\[(]", line)[0])
    missing = {extra: [name for name in names if not _installed(name)] for extra, names in packages.items()}
    present = [extra for extra, names in missing.items() if not names]
    absent = [f"{extra} ({', '.join(names)} missing)" for extra, names in missing.items() if names]
    what = "; ".join([f"installed: {', '.join(present) or 'none'}", *([f"not: {', '.join(absent)}"] if absent else [])])
    advice = "add one when you need it: pip install 'flatlight[NAME]'" if absent else ""
    return Check("extras", "ok", what, advice)


def _installed(package: str) -> bool:
    try:
        importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True
