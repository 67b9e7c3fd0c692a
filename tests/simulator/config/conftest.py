"""A small valid configuration with plugins of its own, which the tests break one line at a time."""

from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.config import load_config
from simulator.errors import InputError

PLUGINS = """
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field


def mask(*, width_mm: Annotated[float, Field(gt=0, le=20)] = 3.0, charge: int = 1, kind: Literal["a", "b"] = "a"):
    return width_mm, charge, kind


def room(view, *, path: Path | None = None, reach: float = 1.0, objects: int = 3, renderer: object):
    return view


def film(view, *, path: Path, crop: tuple[int, int] = (8, 8)):
    return path
"""

CONFIG = """\
name: trial
seed: 3
camera:
  mask: {design: "./plugins.py:mask", width_mm: 2}
  mask_to_sensor_mm: 1.9
  sensor: {shape: [64, 96], binning: 4}
  shutter: {exposure_ms: 5}
  exposure: {full_scale: auto}
  noise: {type: gaussian, psnr_db: 40}
psf:
  near_cm: 3.6
  far_cm: 20
  depths: 5
scene: {family: "./plugins.py:room", size: [32, 32], path: room.ply}
dataset: {output: out, train: 2}
"""

Write = Callable[..., Path]
Refused = Callable[[str, str, str, list[str]], None]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a function that writes the configuration, one piece of it replaced, and gives the file's path."""
    (tmp_path / "plugins.py").write_text(PLUGINS, encoding="utf-8")

    def write_config(old: str = "", new: str = "") -> Path:
        assert CONFIG.count(old) == 1 or not old, f"{old!r} is not a unique piece of the configuration"
        path = tmp_path / "trial.yaml"
        path.write_text(CONFIG.replace(old, new) if old else CONFIG, encoding="utf-8")
        return path

    return write_config


@pytest.fixture
def refused(write: Write) -> Refused:
    """Return a function that expects one fault, in one line, for a piece of the configuration put in another's place.

    A ^ in the new piece marks the place at which the message must point, else ``place`` says line:column.
    """

    def expect(old: str, new: str, place: str, words: list[str]) -> None:
        path = write(old, new.replace("^", ""))
        if "^" in new:
            before = path.read_text("utf-8").partition(new.replace("^", ""))[0] + new.partition("^")[0]
            place = f"{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
        with pytest.raises(InputError) as caught:
            load_config(path)
        message = str(caught.value)
        assert "\n" not in message, "one fault, one line"
        assert message.startswith(f"{path}:{place}: "), message
        assert all(word in message for word in words), message

    return expect
