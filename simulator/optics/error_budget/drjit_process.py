"""Runs a Dr.Jit kernel (LLVM) in a process of its own and says when there is no working LLVM.

An unsuitable libLLVM does not raise but aborts its process, and Dr.Jit's threads and log level are shared by everything
in it: beside a chosen Mitsuba variant it has no place. The price is about half a second per call.
"""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

_JOB, _RESULT = "job.npz", "result.npy"


def run_kernel(module: str, **inputs: Any) -> np.ndarray | None:
    """Run ``kernel(dr, **inputs)`` of a module in a fresh process.

    Args:
        module: full name of the module that holds the function ``kernel``.
        inputs: NumPy arrays and numbers.

    Returns:
        What the kernel returned; None where Dr.Jit has no working LLVM, and then NumPy must do.
    """
    if not llvm_works():
        return None
    result, said = _run(module, inputs)
    if result is None:
        msg = f"{module}: the kernel failed in a process of its own, though LLVM works here: {said}"
        raise RuntimeError(msg)
    return result


@functools.cache
def llvm_works() -> bool:
    """Whether Dr.Jit can compile and run a kernel here; tried once per process, in another one."""
    answer, _ = _run(__name__, {"numbers": np.arange(1.0, 100.0)})
    return answer is not None and np.allclose(answer, np.sin(np.arange(1.0, 100.0)), rtol=1e-12, atol=1e-12)


def kernel(dr: Any, numbers: np.ndarray) -> np.ndarray:
    """Return the sines of some numbers: the trial that ``llvm_works`` makes."""
    from drjit.llvm import Float64

    return np.array(dr.sin(Float64(numbers)))


def _run(module: str, inputs: dict[str, Any]) -> tuple[np.ndarray | None, str]:
    """Return the kernel's result, None where there is none, and the last line that the process wrote to stderr."""
    with tempfile.TemporaryDirectory(prefix="flatlight-kernel-") as folder:
        np.savez(Path(folder) / _JOB, **inputs)
        home = Path.home()
        # Dr.Jit aborts where it cannot keep its compiled kernels.
        lent = {} if (home / ".drjit").is_dir() or os.access(home, os.W_OK | os.X_OK) else {"HOME": folder}
        try:
            done = subprocess.run(
                [sys.executable, "-P", "-m", __name__, module, folder],
                env=os.environ | lent,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
            )
        except OSError as error:
            return None, str(error)
        said = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        result = Path(folder) / _RESULT
        return (np.load(result, allow_pickle=False) if done.returncode == 0 and result.is_file() else None), said


def _main(module: str, folder: str) -> None:
    import drjit as dr

    if not dr.has_backend(dr.JitBackend.LLVM):
        sys.exit(1)
    dr.set_log_level(dr.LogLevel.Error)
    dr.set_thread_count(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)
    with np.load(Path(folder) / _JOB, allow_pickle=False) as job:
        inputs = {name: job[name] if job[name].ndim else job[name].item() for name in job.files}
    np.save(Path(folder) / _RESULT, importlib.import_module(module).kernel(dr, **inputs))


if __name__ == "__main__":
    _main(*sys.argv[1:])
