"""Fixtures that all tests share."""

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


def _folder(name: str) -> Path:
    folder = SHARED / name
    if not folder.is_dir():
        pytest.skip(f"the real samples are not here: no folder {name!r} in {SHARED.name}/ beside the checkout")
    return folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of small real samples beside the checkout; skips where it is absent."""
    return _folder("data")


@pytest.fixture(scope="session")
def shared_oracle() -> Path:
    """Folder of independently computed reference numbers beside the checkout; skips where it is absent."""
    return _folder("oracle")
