"""Fixtures of the render tests: pictures of both variants, each rendered in a process of its own.

Tests that render inside the test process use ``scalar_rgb`` only: it works everywhere, and one process has one variant.
"""

from __future__ import annotations

import functools
import importlib.util
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

# Scripts that other processes run, with their own folder on the path; doctest need not import them.
collect_ignore_glob = ["*worker.py"]

VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
Pictures = Mapping[str, NDArray[Any]]


@pytest.fixture(scope="session")
def rendered(
    tmp_path_factory: pytest.TempPathFactory, python: Callable[..., subprocess.CompletedProcess[str]]
) -> Callable[..., Pictures]:
    """The function from a script beside the tests and its arguments to the arrays that it stores, once per session."""
    folder = tmp_path_factory.mktemp("rendered")

    @functools.cache
    def render(script: str, *arguments: str) -> Pictures:
        out = folder / f"{'_'.join((script, *arguments))}.npz"
        done = python(str(Path(__file__).with_name(script)), *arguments, str(out))
        assert done.returncode == 0, done.stderr
        with np.load(out, allow_pickle=False) as arrays:
            return dict(arrays)

    return render


@pytest.fixture(params=VARIANTS)
def pictures(request: pytest.FixtureRequest, rendered: Callable[..., Pictures]) -> Pictures:
    """The arrays of worker.py, once for each variant."""
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("needs_llvm")
    return rendered("worker.py", request.param, "1")


def _load(name: str) -> Any:
    """Import a module that stands beside the tests: pytest's import mode puts no folder of tests on the path."""
    spec = importlib.util.spec_from_file_location(f"render_tests_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def analytic() -> Any:
    """The module analytic.py: rays against surfaces in closed form."""
    return _load("analytic")


@pytest.fixture(scope="session")
def geometry() -> Any:
    """The module geometry_cases.py: the scenes that worker.py renders."""
    return _load("geometry_cases")
