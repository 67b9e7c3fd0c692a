"""Fixtures of the render tests: pictures of both variants, each rendered in a process of its own.

Tests that render inside the test process use ``scalar_rgb`` only: it works everywhere, and one process has one variant.
"""

from __future__ import annotations

import functools
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
Pictures = Mapping[str, NDArray[Any]]


@pytest.fixture(scope="session")
def render_cases(
    tmp_path_factory: pytest.TempPathFactory, python: Callable[..., subprocess.CompletedProcess[str]]
) -> Callable[[str, int], Pictures]:
    """The arrays of worker.py for a variant and a number of threads, rendered once per session."""
    folder = tmp_path_factory.mktemp("render")

    @functools.cache
    def render(variant: str, threads: int) -> Pictures:
        out = folder / f"{variant}_{threads}.npz"
        done = python(str(Path(__file__).with_name("worker.py")), variant, str(threads), str(out))
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
