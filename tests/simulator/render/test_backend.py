"""The choice of backend: proof, fallback and refusals; processes of their own wherever Mitsuba would be imported."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.errors import InputError
from simulator.render import choose_backend
from simulator.render.backend import _how_to_get_llvm, _judge

Python = Callable[..., subprocess.CompletedProcess[str]]
NO_LLVM = {"DRJIT_LIBLLVM_PATH": "/nonexistent/libLLVM.so"}


def test_scalar_is_chosen_without_looking_for_llvm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: pytest.fail("no process is needed"))
    backend = choose_backend("scalar")
    assert (backend.variant, backend.llvm_version, backend.advice) == ("scalar_rgb", None, "")


def test_unknown_words_are_refused() -> None:
    with pytest.raises(InputError, match=r"^render\.backend: "):
        choose_backend("cuda")


@pytest.mark.usefixtures("needs_llvm")
def test_llvm_is_chosen_where_it_works() -> None:
    backend = choose_backend("auto")
    assert backend.variant == "llvm_ad_rgb"
    assert backend == choose_backend("llvm")
    assert backend.llvm_version is not None
    assert backend.llvm_version in backend.message
    assert 15 <= int(backend.llvm_version.split(".")[0]) <= 22


def test_without_llvm_auto_falls_back_and_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", NO_LLVM["DRJIT_LIBLLVM_PATH"])
    backend = choose_backend("auto")
    assert (backend.variant, backend.llvm_version) == ("scalar_rgb", None)
    assert "no usable libLLVM was found" in backend.message
    assert "/nonexistent/libLLVM.so" in backend.advice
    assert "unset" in backend.advice
    with pytest.raises(InputError, match=r"^render\.backend: "):
        choose_backend("llvm")
    assert _how_to_get_llvm(None).startswith("install")  # where the variable is not set, unsetting it is no cure


@pytest.mark.parametrize(
    ("returncode", "stdout", "stderr", "version", "problem"),
    [
        (0, '{"found": true, "version": [15, 0, 6]}\n{"mean": 0.49}\n', "", "15.0.6", ""),
        (-6, '{"found": true, "version": [16, 0, 6]}\n', "LLVM ERROR: no\n", "16.0.6", "SIGABRT (LLVM ERROR: no)"),
        (0, '{"found": true, "version": [19, 1, 0]}\n{"mean": 0.0}\n', "", "19.1.0", "came out wrong"),
        (0, '{"found": true, "version": [23, 0, 0]}\n', "", "23.0.0", "is not one of 15 to 22"),
        (1, '{"found": false, "version": [-1, -1, -1]}\n', "LLVM version (14) is too old.", None, "too old"),
        (-6, "", "terminate called\n", None, "terminate called"),
    ],
)
def test_the_proof_tells_how_llvm_failed(
    returncode: int, stdout: str, stderr: str, version: str | None, problem: str
) -> None:
    found = _judge(subprocess.CompletedProcess([], returncode, stdout, stderr))
    assert found[0] == version
    assert problem in found[1]
    assert bool(found[1]) == bool(problem)


def test_activation_is_quiet_without_llvm_and_refuses_a_second_variant(python: Python) -> None:
    code = (
        "from simulator.render import activate\n"
        "activate('scalar_rgb', 1); activate('scalar_rgb', 2); activate('scalar_rgb')\n"
        "try: activate('llvm_ad_rgb')\n"
        "except RuntimeError as error: print(error)\n"
        "import drjit; print(drjit.thread_count())\n"
    )
    done = python("-c", code, **NO_LLVM)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    refusal, threads = done.stdout.splitlines()
    assert "already renders with scalar_rgb and refuses llvm_ad_rgb" in refusal
    assert threads == "2"


@pytest.mark.parametrize(
    ("variant", "threads", "named"),
    [("cuda_ad_rgb", 1, "variant"), ("scalar_rgb", 0, "threads"), ("llvm_ad_rgb", 1, "variant")],
)
def test_bad_arguments_and_llvm_where_there_is_none_are_the_users_mistake(
    python: Python, variant: str, threads: int, named: str
) -> None:
    done = python("-c", f"from simulator.render import activate; activate({variant!r}, {threads})", **NO_LLVM)
    assert f"simulator.errors.InputError: {named}: " in done.stderr


# What Dr.Jit 1.4 says on a Debian without libatomic1.
LACKS_LIBRARY = """
    from . import _drjit_ext as _drjit_ext
ImportError: libatomic.so.1: cannot open shared object file: No such file or directory

During handling of the above exception, another exception occurred:

NameError: name '_drjit_ext' is not defined
"""


def test_a_mitsuba_that_cannot_be_imported_is_named_with_what_it_lacks(python: Python) -> None:
    with pytest.raises(InputError, match=r"^mitsuba: .*libatomic\.so\.1"):
        _judge(subprocess.CompletedProcess([], 1, "", LACKS_LIBRARY))
    code = "import sys; sys.modules['drjit'] = None; from simulator.render import activate; activate('scalar_rgb')"
    assert "simulator.errors.InputError: mitsuba: " in python("-c", code).stderr


@pytest.mark.skipif(os.name == "nt", reason="Dr.Jit keeps its cache elsewhere on Windows")
def test_a_home_that_cannot_hold_the_kernel_cache_does_not_abort(python: Python, tmp_path: Path) -> None:
    home = str(tmp_path / "missing")
    code = "from simulator.render import activate; activate('scalar_rgb'); import os; print(os.environ['HOME'])"
    done = python("-c", code, HOME=home)
    assert (done.returncode, done.stdout.strip(), done.stderr) == (0, home, "")
    # Without the cure the same import aborts; when it no longer does, the cure can go.
    assert python("-c", "import drjit", HOME=home).returncode < 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_worker_is_refused(python: Python) -> None:
    code = (
        "import os, sys\n"
        "from simulator.render import activate\n"
        "activate('scalar_rgb')\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    try: activate('scalar_rgb')\n"
        "    except RuntimeError as error: print(error, flush=True)\n"
        "    os._exit(0)\n"
        "os.waitpid(child, 0)\n"
    )
    assert "do not survive a fork: use 'spawn'" in python("-c", code).stdout


def test_importing_the_package_stays_light(python: Python) -> None:
    code = (
        "import sys, simulator.render.denoise, scenes.flying_things; simulator.render.Renderer('scalar_rgb'); "
        "print({'mitsuba', 'drjit', 'pyoidn', 'torch'} & set(sys.modules))"
    )
    assert python("-c", code).stdout.strip() == "set()"


@pytest.mark.usefixtures("needs_llvm")
@pytest.mark.parametrize(
    ("family", "keys", "outputs", "clips"),
    [
        ("flying_things", {}, (), 4),
        # Where NumPy's memory happens to be aligned once in a while, another kernel would be compiled by then.
        pytest.param("flying_things", {}, ("shape_id", "albedo"), 25, marks=pytest.mark.slow),
        pytest.param("endoscopy", {}, (), 25, marks=pytest.mark.slow),
        pytest.param("high_speed", {"frames": 2, "background": "mixed"}, (), 25, marks=pytest.mark.slow),
        pytest.param("high_speed", {"frames": 2}, ("motion", "hidden"), 25, marks=pytest.mark.slow),
        pytest.param("activity", {"frames": 2}, (), 25, marks=pytest.mark.slow),
    ],
)
def test_no_kernel_is_compiled_after_the_first_scene(
    python: Python, tmp_path: Path, family: str, keys: dict, outputs: tuple[str, ...], clips: int
) -> None:
    near_and_far = (0.005, 0.1) if family == "endoscopy" else (0.036, 0.2)
    code = (
        "import numpy as np\n"
        f"from scenes.{family} import {family}\n"
        "from simulator.types import View\n"
        "from simulator.render import Renderer, activate\n"
        "activate('llvm_ad_rgb', 1)\n"
        "import drjit as dr\n"
        "dr.set_flag(dr.JitFlag.KernelHistory, True)\n"
        f"view = View((8, 8), 3e-4, 1.9e-3, *{near_and_far})\n"
        f"renderer = Renderer('llvm_ad_rgb', {outputs})\n"
        f"source = {family}(view, samples_per_pixel=1, renderer=renderer, **{keys})\n"
        f"for index in range({clips}):\n"
        "    source.clip(index, np.random.default_rng(index))\n"
        "    print(sum(not kernel.get('cache_hit', True) for kernel in dr.kernel_history()))\n"
    )
    # A home of its own: kernels that earlier runs left in ~/.drjit would hide a compilation.
    done = python("-c", code, HOME=str(tmp_path))
    counts = [int(line) for line in done.stdout.split()]
    assert len(counts) == clips, done.stderr
    assert counts[0] > 0
    assert sum(counts[1:]) == 0, counts
