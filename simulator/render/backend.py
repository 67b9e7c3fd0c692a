"""Which Mitsuba variant renders: compiled through a proven libLLVM, or the scalar one that works everywhere.

The parent process chooses once (`choose_backend`); every process that renders then calls `activate`.
"""

from __future__ import annotations

import functools
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from simulator.errors import InputError

Request = Literal["auto", "llvm", "scalar"]
LLVM_VARIANT = "llvm_ad_rgb"
SCALAR_VARIANT = "scalar_rgb"
LLVM_SPECTRAL = "llvm_ad_spectral"
SCALAR_SPECTRAL = "scalar_spectral"
VARIANTS = (LLVM_VARIANT, SCALAR_VARIANT, LLVM_SPECTRAL, SCALAR_SPECTRAL)

# Versions that Mitsuba 3.9.0 with Dr.Jit 1.4.0 renders with; 14 and older lack opaque pointers.
_LLVM_VERSIONS = range(15, 23)
# Run in a process of its own, because an unsuitable libLLVM does not raise but aborts: reports the version that Dr.Jit
# finds, then the mean of an image of a half-white wall in uniform light, one JSON line each.
_PROOF = """
import json
import drjit as dr

facts = {"found": bool(dr.has_backend(dr.JitBackend.LLVM)), "version": list(dr.detail.llvm_version())}
print(json.dumps(facts), flush=True)
import mitsuba as mi
import numpy as np

mi.set_variant("llvm_ad_rgb")
towards = mi.ScalarTransform4f().translate([0, 0, 1]).rotate([1, 0, 0], 180).scale(10)
film = {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}}
scene = {
    "type": "scene",
    "integrator": {"type": "path", "max_depth": 3},
    "sensor": {"type": "perspective", "film": film},
    "light": {"type": "constant", "radiance": 1.0},
    "wall": {"type": "rectangle", "to_world": towards, "bsdf": {"type": "diffuse", "reflectance": 0.5}},
}
print(json.dumps({"mean": float(np.mean(np.asarray(mi.render(mi.load_dict(scene), spp=16))))}), flush=True)
"""
# Importing Mitsuba from a cold network disk takes most of this; the proof itself takes about a second.
_PROOF_TIMEOUT_S = 120.0
_activated: tuple[int, str] | None = None  # the process id and the variant it renders with


@dataclass(frozen=True)
class Backend:
    """The Mitsuba variant that a data set is rendered with.

    Attributes:
        variant: ``llvm_ad_rgb`` or ``scalar_rgb``.
        llvm_version: for example ``15.0.6``; None for the scalar variant.
        message: why this variant, one line.
        advice: what to install to render faster; empty when nothing is missing.
    """

    variant: str
    llvm_version: str | None
    message: str
    advice: str = ""


# What trying LLVM says: its version if one was found, and what is wrong with it (empty when it works).
_Proof = tuple[str | None, str]


def choose_backend(requested: Request = "auto", spectral: bool = False) -> Backend:
    """Choose the Mitsuba variant, proving LLVM once per process by a small render in a subprocess.

    Args:
        requested: ``auto`` takes LLVM when it is proven and the scalar variant otherwise; ``llvm`` insists on LLVM;
            ``scalar`` does not even look for it.
        spectral: whether wavelengths are rendered instead of RGB. LLVM is proven in RGB all the same: what may fail is the
            library, not the kind of colour.

    Raises:
        InputError: when ``requested`` is not one of these, or is ``llvm`` and LLVM cannot be proven, or when Mitsuba
            cannot be imported.

    Example:
        >>> choose_backend("scalar").variant
        'scalar_rgb'
    """
    if requested not in get_args(Request):
        raise InputError("render.backend", f"got {requested!r}, expected one of auto, llvm, scalar")
    llvm, scalar = (LLVM_SPECTRAL, SCALAR_SPECTRAL) if spectral else (LLVM_VARIANT, SCALAR_VARIANT)
    if requested == "scalar":
        return Backend(scalar, None, f"{scalar}, as asked")
    library = os.environ.get("DRJIT_LIBLLVM_PATH")
    version, problem = _prove_llvm(library)
    if not problem:
        return Backend(llvm, version, f"{llvm}, proven with libLLVM {version}")
    advice = _how_to_get_llvm(library)
    if requested == "llvm":
        raise InputError("render.backend", f"got llvm, but {problem}; {advice}, or set it to auto or scalar")
    return Backend(scalar, None, f"{scalar}, because {problem}", f"To render faster: {advice}")


def activate(variant: str, threads: int | None = None) -> None:
    """Make this process render with ``variant``; repeated calls with the same one are harmless.

    Args:
        variant: a `Backend.variant`.
        threads: CPU threads for rendering, at least 1; None leaves them as they are. See `Renderer.clip` for
            what of the image depends on it: jobs have one for each worker.

    Raises:
        InputError: when the variant is unknown, the threads are below 1, LLVM has gone since it was proven, or Mitsuba
            cannot be imported.
        RuntimeError: when this process already renders with another variant, or was forked from one that renders:
            its render threads did not survive the fork.
    """
    global _activated
    if variant not in VARIANTS:
        raise InputError("variant", f"got {variant!r}, expected one of {', '.join(VARIANTS)} (see choose_backend)")
    if threads is not None and threads < 1:
        raise InputError("threads", f"got {threads}, expected at least 1")
    try:
        with home_for_kernels(), _quiet_stderr():
            import drjit as dr
            import mitsuba as mi
    except (ImportError, NameError) as error:  # the latter by Dr.Jit's own handler, where its library cannot be loaded
        raise _not_importable(str(error.__context__ or error)) from error

    current = mi.variant()
    if _activated is not None and _activated[0] != os.getpid():
        msg = "this process was forked from one that renders, and render threads do not survive a fork: use 'spawn'"
        raise RuntimeError(msg)
    if current is not None and current != variant:
        msg = f"this process already renders with {current} and refuses {variant}: one process, one Mitsuba variant"
        raise RuntimeError(msg)
    if current is None:
        dr.set_log_level(dr.LogLevel.Error)
        try:
            mi.set_variant(variant)
        except ImportError as error:
            advice = _how_to_get_llvm(os.environ.get("DRJIT_LIBLLVM_PATH"))
            reason = f"{variant} does not start in this process ({error}); {advice}, or use {SCALAR_VARIANT}"
            raise InputError("variant", reason) from error
        mi.set_log_level(mi.LogLevel.Error)
        if threads is None:
            threads = 1
    _activated = (os.getpid(), variant)
    if threads is not None:
        dr.set_thread_count(threads)


def mitsuba() -> Any:
    """Return the module ``mitsuba``, untyped (its stubs do not know a variant's types); heavy, so imported where used."""
    return importlib.import_module("mitsuba")


def drjit() -> Any:
    """Return the module ``drjit``, likewise."""
    return importlib.import_module("drjit")


@functools.cache
def _prove_llvm(library: str | None) -> _Proof:
    """Render with LLVM in a subprocess; ``library`` (DRJIT_LIBLLVM_PATH) only tells the cached results apart."""
    del library
    try:
        with home_for_kernels():
            done = subprocess.run(
                [sys.executable, "-P", "-c", _PROOF],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_PROOF_TIMEOUT_S,
                stdin=subprocess.DEVNULL,
                check=False,
            )
    except subprocess.TimeoutExpired:
        return None, f"a test render with LLVM did not end within {_PROOF_TIMEOUT_S:.0f} s"
    except OSError as error:
        return None, f"the test render with LLVM could not be started ({error})"
    return _judge(done)


def _judge(done: subprocess.CompletedProcess[str]) -> _Proof:
    """Read what the proof script reported, and how it ended."""
    facts: dict[str, object] = {}
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            facts |= json.loads(line)
    last_words = _last_line(done.stderr)
    numbers = facts.get("version")
    found = bool(facts.get("found"))
    version = ".".join(map(str, numbers)) if found and isinstance(numbers, list) else None
    mean = facts.get("mean")
    if "found" not in facts:
        for line in done.stderr.splitlines():
            if line.startswith(("ImportError: ", "ModuleNotFoundError: ")):
                raise _not_importable(line.partition(": ")[2])
        return None, f"Mitsuba could not be imported in a fresh process ({last_words})"
    if not found:
        return None, "too old a libLLVM was found" if "too old" in done.stderr else "no usable libLLVM was found"
    if isinstance(numbers, list) and numbers[0] not in _LLVM_VERSIONS:
        return version, f"libLLVM {version} is not one of {_LLVM_VERSIONS.start} to {_LLVM_VERSIONS.stop - 1}"
    if done.returncode != 0:
        end = f"was killed by {signal.Signals(-done.returncode).name}" if done.returncode < 0 else "failed"
        return version, f"a test render with libLLVM {version} {end} ({last_words})"
    # 16 pixels x 16 paths of a wall of 0.5 leave noise of about 0.01: this tells a working backend from a broken one.
    if not isinstance(mean, float) or abs(mean - 0.5) > 0.1:
        return version, f"a test render with libLLVM {version} came out wrong (mean {mean}, expected 0.5)"
    return version, ""


def _not_importable(reason: str) -> InputError:
    cure = "install what it lacks (minimal systems lack libatomic.so.1, of the package libatomic1 or libatomic)"
    return InputError("mitsuba", f"cannot be imported: {reason}; {cure}")


def _how_to_get_llvm(library: str | None) -> str:
    """Return the cure as one clause; ``library`` is DRJIT_LIBLLVM_PATH, beside which Dr.Jit looks nowhere."""
    versions = f"any version from {_LLVM_VERSIONS.start} to {_LLVM_VERSIONS.stop - 1} will do"
    if library:
        return f"DRJIT_LIBLLVM_PATH names {library!r}: unset it, or let it name a libLLVM ({versions})"
    return f"install the package libLLVM ({versions}), or set DRJIT_LIBLLVM_PATH to its library"


def _last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else "it said nothing"


@contextmanager
def _quiet_stderr() -> Iterator[None]:
    """Keep what native code writes to stderr off the terminal: Dr.Jit reports a missing libLLVM when it is imported."""
    if "drjit" in sys.modules:
        yield
        return
    try:
        saved = os.dup(2)
    except OSError:  # no stderr at all
        yield
        return
    sink = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


@contextmanager
def home_for_kernels() -> Iterator[None]:
    """Lend Dr.Jit a home while it starts, if the real one cannot hold its kernel cache ``~/.drjit``.

    Dr.Jit 1.4 aborts the process on import when it cannot create that folder (containers, read-only homes) and knows no
    other setting. The borrowed folder is private and is removed at exit: cached kernels are code that will be run.
    """

    def can_hold_cache(folder: Path) -> bool:
        return (folder / ".drjit").is_dir() or (folder.is_dir() and os.access(folder, os.W_OK | os.X_OK))

    home = os.environ.get("HOME")
    if os.name == "nt" or "drjit" in sys.modules or (home is not None and can_hold_cache(Path(home))):
        yield
        return
    os.environ["HOME"] = _borrowed_home().name
    try:
        yield
    finally:
        if home is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = home


@functools.cache
def _borrowed_home() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="flatlight-home-", ignore_cleanup_errors=True)
