"""The doctor answers on any computer: what is missing is a finding, never an error."""

import importlib.metadata
import importlib.util
import json
import subprocess
import sys
from types import SimpleNamespace

import pytest

from simulator import doctor
from simulator.doctor import Check, diagnose, memory_bytes
from simulator.errors import InputError
from simulator.render.backend import Backend

LLVM = Backend("llvm_ad_rgb", "15.0.6", "llvm_ad_rgb, proven with libLLVM 15.0.6")
SCALAR = Backend("scalar_rgb", None, "scalar_rgb, because no usable libLLVM was found", "To render faster: install it")


@pytest.fixture
def computer(monkeypatch, tmp_path):
    """A computer whose slow parts answer at once: LLVM works, torch sees only the CPU, there is disk and memory."""

    def answer(*_, **__):
        facts = {"version": "2.9.0", "device": "cpu", "name": "", "threads": 4, "cuda": None}
        return subprocess.CompletedProcess([], 0, json.dumps(facts) + "\n", "")

    monkeypatch.setattr(doctor, "choose_backend", lambda _: LLVM)
    monkeypatch.setattr(doctor.subprocess, "run", answer)
    monkeypatch.setattr(doctor, "available_cpus", lambda: 4)
    monkeypatch.setattr(doctor, "memory_bytes", lambda: (16 * 2**30, 8 * 2**30))
    monkeypatch.setattr(doctor, "cache_folder", lambda: tmp_path / "not" / "yet")
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: SimpleNamespace(free=10**12))
    monkeypatch.setattr(doctor.shutil, "which", lambda _: None)
    monkeypatch.chdir(tmp_path)
    return monkeypatch


def _found(name: str) -> Check:
    return next(check for check in diagnose() if check.name == name)


def test_a_good_computer_has_nothing_to_note(computer):
    checks = diagnose()
    assert [check.name for check in checks] == [
        "flatlight", "rendering", "processors", "memory", "torch", "disk, here", "disk, cache", "extras",
    ]  # fmt: skip
    assert {check.status for check in checks} == {"ok"}
    assert "15.0.6" in _found("rendering").what
    assert all("\n" not in check.what + check.advice for check in checks)


def test_rendering_and_torch_where_something_is_missing(computer):
    computer.setattr(doctor, "choose_backend", lambda _: SCALAR)
    check = _found("rendering")
    assert (check.status, check.advice) == ("note", "To render faster: install it")
    assert "no usable libLLVM" in check.what

    def never(*_, timeout, **__):
        raise subprocess.TimeoutExpired("python", timeout)

    computer.setattr(doctor.subprocess, "run", never)
    assert "not imported within 10 s" in _found("torch").what
    missing, find_spec = ("mitsuba", "torch"), importlib.util.find_spec
    computer.setattr(doctor.importlib.util, "find_spec", lambda name: None if name in missing else find_spec(name))
    assert _found("rendering").status == "problem"
    assert _found("rendering").what.startswith("mitsuba missing")
    check = _found("torch")  # nothing is started
    assert check.status == "note"
    assert "flatlight[learn]" in check.advice


def test_a_mitsuba_that_cannot_be_imported_is_a_problem(computer):
    def refuse(_):
        raise InputError("mitsuba", "cannot be imported: libatomic.so.1")

    computer.setattr(doctor, "choose_backend", refuse)
    check = _found("rendering")
    assert check.status == "problem"
    assert check.what.startswith("mitsuba: ")


@pytest.mark.parametrize(
    ("facts", "gpu_driver", "status", "words"),
    [
        ({"device": "cuda", "name": "NVIDIA H200", "cuda": "13.2"}, True, "ok", "device cuda (NVIDIA H200)"),
        ({"device": "mps", "name": "", "cuda": None}, False, "ok", "device mps"),
        ({"device": "cpu", "name": "", "cuda": None}, True, "note", "built for CPUs only"),
        ({"device": "cpu", "name": "", "cuda": "13.2"}, True, "note", "does not fit the driver"),
    ],
)
def test_torch_devices(computer, facts, gpu_driver, status, words):
    said = json.dumps({"version": "2.9.0", "threads": 4} | facts)
    computer.setattr(
        doctor.subprocess, "run", lambda *_, **__: subprocess.CompletedProcess([], 0, f"a word\n{said}\n", "")
    )
    computer.setattr(doctor.shutil, "which", lambda _: "/bin/nvidia-smi" if gpu_driver else None)
    check = _found("torch")
    assert check.status == status
    assert words in check.what


def test_a_broken_torch_is_a_problem(computer):
    done = subprocess.CompletedProcess([], -4, "", "Traceback\nOSError: libcudart.so.13: cannot open\n")
    computer.setattr(doctor.subprocess, "run", lambda *_, **__: done)
    check = _found("torch")
    assert check.status == "problem"
    assert "libcudart.so.13" in check.what


@pytest.mark.parametrize(("free", "status"), [(10**10, "ok"), (10**9, "note"), (10**7, "problem")])
def test_disk_space(computer, free, status):
    computer.setattr(doctor.shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    assert _found("disk, here").status == status
    assert _found("disk, cache").status == ("note" if status == "problem" else status)  # the cache is a convenience


def test_no_place_for_the_cache_little_memory_and_one_processor_are_noted(computer, tmp_path):
    (tmp_path / "file").write_text("not a folder")
    computer.setattr(doctor, "cache_folder", lambda: tmp_path / "file" / "cache")
    computer.setattr(doctor, "memory_bytes", lambda: (16 * 2**30, 2**30))
    computer.setattr(doctor, "available_cpus", lambda: 1)
    assert "FLATLIGHT_CACHE_DIR" in _found("disk, cache").advice
    assert "dataset.workers=1" in _found("memory").advice
    assert {_found(name).status for name in ("disk, cache", "memory", "processors")} == {"note"}


def test_extras_are_read_from_the_packages_own_metadata(computer):
    versions = {"torch": "2.9", "safetensors": "0.5", "flatlight": "0.1.0"}

    def version(name):
        if name in versions:
            return versions[name]
        raise importlib.metadata.PackageNotFoundError(name)

    required = ["numpy>=2.0", "torch>=2.5; extra == 'learn'", 'safetensors>=0.5 ; extra == "learn"']
    required.append("ray>=2.54; extra=='cluster'")
    computer.setattr(doctor.importlib.metadata, "version", version)
    computer.setattr(doctor.importlib.metadata, "requires", lambda _: required)
    check = _found("extras")
    assert check.what == "installed: learn; not: cluster (ray missing)"
    assert check.status == "ok"
    assert "flatlight[NAME]" in check.advice


def test_it_works_from_files_that_are_not_installed(computer):
    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    computer.setattr(doctor.importlib.metadata, "version", absent)
    computer.setattr(doctor.importlib.metadata, "requires", absent)
    assert _found("flatlight").status == "note"
    assert _found("extras").status == "note"


def test_whatever_breaks_is_a_finding(computer):
    def explode(*_, **__):
        raise RuntimeError("no such thing here")

    for name in ("choose_backend", "available_cpus", "memory_bytes", "cache_folder"):
        computer.setattr(doctor, name, explode)
    computer.setattr(doctor.subprocess, "run", explode)
    computer.setattr(doctor.shutil, "disk_usage", explode)
    computer.setattr(doctor.importlib.metadata, "requires", explode)
    checks = diagnose()
    broken = [check for check in checks if "no such thing here" in check.what]
    assert len(checks) == 8
    assert {check.status for check in broken} == {"problem"}
    assert len(broken) == 7  # all but the versions


MEMINFO = "MemTotal:       8000000 kB\nMemFree: 1 kB\nMemAvailable:   6000000 kB\nHugePages_Total:  0\n"
OF_PROC = 8_192_000_000, 6_144_000_000


@pytest.mark.parametrize(
    ("groups", "total", "free"),
    [
        ({}, *OF_PROC),
        ({"memory.max": "max", "memory.current": "5"}, *OF_PROC),
        ({"memory.max": "4000000000", "memory.current": "1000000000"}, 4 * 10**9, 3 * 10**9),
        ({"memory/memory.limit_in_bytes": "3000", "memory/memory.usage_in_bytes": "1000"}, 3000, 2000),
        ({"memory/memory.limit_in_bytes": f"{2**63 - 4096}", "memory/memory.usage_in_bytes": "1000"}, *OF_PROC),
    ],
)
def test_memory_is_what_the_container_may_use(tmp_path, groups, total, free):
    texts = {"proc/meminfo": MEMINFO} | {f"sys/fs/cgroup/{name}": text for name, text in groups.items()}
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert memory_bytes(tmp_path) == (total, free)


def test_memory_without_proc_is_the_physical_one(tmp_path):
    total, free = memory_bytes(tmp_path)
    assert free is None
    assert total is None or total > 2**20


def test_looking_imports_neither_mitsuba_nor_torch_here():
    """The parent must stay able to choose a backend and to start in half a second."""
    script = "import sys, simulator.doctor; assert not {'torch', 'mitsuba', 'matplotlib', 'scipy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_this_computer_is_examined():
    """The real thing, torch and a test render included."""
    checks = {check.name: check for check in diagnose()}
    assert not [check for check in checks.values() if "could not be examined" in check.what]
    assert checks["rendering"].what.split()[1].rstrip(",") in ("llvm_ad_rgb", "scalar_rgb")
    assert (checks["torch"].what.startswith("not installed")) == (importlib.util.find_spec("torch") is None)
