"""Fixtures of the render tests: pictures of both variants, each rendered in a process of its own.

Tests that render inside the test process use ``scalar_rgb`` only: it works everywhere, and one process has one variant.
"""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.render import choose_backend

ROOT = Path(__file__).resolve().parents[3]
VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
Pictures = Mapping[str, NDArray[Any]]


def run_python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the checkout with additional environment variables."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="session")
def python() -> Callable[..., subprocess.CompletedProcess[str]]:
    return run_python


@pytest.fixture(scope="session")
def needs_llvm() -> None:
    backend = choose_backend("auto")
    if backend.llvm_version is None:
        pytest.skip(f"{backend.message}. {backend.advice}")


@pytest.fixture(scope="session")
def render_cases(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, int], Pictures]:
    """The arrays of worker.py for a variant and a number of threads, rendered once per session."""
    folder = tmp_path_factory.mktemp("render")

    @functools.cache
    def render(variant: str, threads: int) -> Pictures:
        out = folder / f"{variant}_{threads}.npz"
        done = run_python(str(Path(__file__).with_name("worker.py")), variant, str(threads), str(out))
        assert done.returncode == 0, done.stderr
        with np.load(out, allow_pickle=False) as arrays:
            return dict(arrays)

    return render


@pytest.fixture(params=VARIANTS)
def pictures(request: pytest.FixtureRequest, render_cases: Callable[[str, int], Pictures]) -> Pictures:
    """The rendered cases, once for each variant."""
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("needs_llvm")
    return render_cases(request.param, 1)
