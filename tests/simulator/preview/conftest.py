"""Fixtures of the previews' tests."""

from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.plugins import import_file
from simulator.types import Clip


@pytest.fixture(scope="session")
def known_clip() -> Callable[..., Clip]:
    """The function of clips.py."""
    return import_file(Path(__file__).with_name("clips.py"), "clips").known_clip
