"""Fixtures of the simulator's tests."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

MAIN = "from simulator.cli import main; main()"


@pytest.fixture(scope="session")
def command() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Return a function that runs the command ``flatlight`` in a process of its own."""

    def run(*arguments: object, before: str = "", **options: Any) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, "-c", f"{before}\n{MAIN}", *map(str, arguments)]
        return subprocess.run(words, capture_output=True, text=True, timeout=120, check=False, **options)

    return run
