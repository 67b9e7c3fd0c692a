"""Fixtures of the render tests: pictures of both variants, each rendered in a process of its own.

Tests that render inside the test process use ``scalar_rgb`` only: it works everywhere, and one process has one variant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from numpy.typing import NDArray

from simulator.plugins import import_file

# A script that other processes run; doctest need not import it.
collect_ignore_glob = ["worker.py"]

HERE = Path(__file__).parent
VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
Pictures = Mapping[str, NDArray[Any]]


@pytest.fixture(params=VARIANTS)
def pictures(request: pytest.FixtureRequest, rendered: Callable[..., Pictures]) -> Pictures:
    """The stills of worker.py, once for each variant."""
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("needs_llvm")
    return rendered("simulator/render/worker.py", "stills", request.param, "1")


@pytest.fixture(scope="session")
def analytic() -> Any:
    """The module analytic.py: rays against surfaces in closed form."""
    return import_file(HERE / "analytic.py", "analytic")


@pytest.fixture(scope="session")
def geometry() -> Any:
    """The module worker.py: the scenes that it renders in processes of their own."""
    return import_file(HERE / "worker.py", "worker")
