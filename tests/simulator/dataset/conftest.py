"""Fixtures of the data set tests."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

HERE = Path(__file__).parent


@pytest.fixture
def samples(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The helpers in samples.py."""
    monkeypatch.syspath_prepend(str(HERE))
    import samples  # type: ignore[import-not-found]

    yield samples
    sys.modules.pop("samples")


@pytest.fixture
def dataset(samples: ModuleType, tmp_path: Path) -> Path:
    """A small whole data set on disk."""
    return samples.make_dataset(tmp_path / "set")


@pytest.fixture
def clips(samples: ModuleType, tmp_path: Path) -> Path:
    """The same of clips: samples of three frames with global measurements."""
    return samples.make_dataset(tmp_path / "clips", samples.make_clip_sample)
