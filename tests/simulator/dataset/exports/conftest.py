"""What the tests of exports share: every byte of a folder."""

from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.io.files import sha256_file


def _hashes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): sha256_file(path) for path in sorted(folder.rglob("*")) if path.is_file()
    }


@pytest.fixture(scope="session")
def hashes() -> Callable[[Path], dict[str, str]]:
    """Return the function from a folder to the SHA-256 of every file in it."""
    return _hashes
