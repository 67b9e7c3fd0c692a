"""``scenes`` by name and as a picture."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

# Three panes before a far wall, red, green and blue light by index: nothing to render, one value to know.
PANES = '''
"""Panes of light."""

from dataclasses import dataclass

import numpy as np

from simulator.errors import InputError
from simulator.types import Clip


@dataclass(frozen=True)
class Panes:
    view: object
    frames: int
    inputs: tuple = ()

    def clip(self, index, rng):
        rgb = np.zeros((self.frames, *self.view.shape, 3), np.float32)
        rgb[self.frames // 2, :, :, index % 3] = 1
        depth = np.full(rgb.shape[:3], self.view.near_m, np.float32)
        edges = np.arange(self.frames + 1.0)
        return Clip(rgb, depth, np.ones(depth.shape, bool), edges, label=f"pane {index}")


def panes(view, *, frames: int = 3, renderer=None):
    """Panes.

    Args:
        frames: how many; only the middle one is lit.
    """
    return Panes(view, frames)


def deep(view, *, renderer=None):
    raise InputError("far_m", "got 0.2, expected 1; go farther")


def from_file(view, *, picture: str, renderer=None):
    return Panes(view, 1)
'''
LEFT, TOP = 12, 76


@pytest.fixture
def panes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("simulator.render.backend.choose_backend", lambda *_: _Scalar)
    (tmp_path / "panes.py").write_text(PANES, encoding="utf-8")
    return tmp_path


class _Scalar:
    """What tests render with in their own process."""

    variant = "scalar_rgb"


def test_names_are_listed_alone(flatlight, one_error) -> None:
    code, out, _ = flatlight("scenes", "flying_things")
    assert code == 0
    assert out.startswith("scene.family:\n  flying_things: ")
    assert "scene.source" not in out
    code, out, _ = flatlight("scenes", "flyingthings3d")
    assert out.startswith("scene.source:\n  flyingthings3d: ")
    assert "scene.family" not in out
    one_error(flatlight("scenes", "flying_thing"), "'flying_thing'", "'flying_things'")
    code, out, _ = flatlight("masks", "pinhole")
    assert "  pinhole: A pinhole" in out
    assert "phlatcam" not in out
    one_error(flatlight("masks", "pinhol"), "'pinhol'", "'pinhole'")


def test_thumbnails(flatlight, panes: Path) -> None:
    names = [f"./panes.py:{name}" for name in ("panes", "deep", "from_file")]
    code, out, err = flatlight("scenes", *names, "flyingthings3d", "--thumbnails", "t.png")
    assert code == 0, err
    left_out = next(line for line in out.splitlines() if line.startswith("not drawn: "))
    assert "./panes.py:deep (" in left_out
    assert "far_m: got 0.2, expected 1; go farther" in left_out
    assert "./panes.py:from_file (needs picture)" in left_out
    assert "flyingthings3d (needs path)" in left_out
    assert out.endswith("look at t.png\n")
    assert "frames: 3" in out
    sheet = np.asarray(Image.open("t.png").convert("RGB"))
    for number in range(6):  # tiles of 96 pixels, 2 apart
        tile = sheet[TOP : TOP + 96, LEFT + 98 * number : LEFT + 98 * number + 96]
        expected = np.zeros(3)
        expected[number % 3] = 255
        assert np.all(tile == expected)


def test_nothing_to_draw(flatlight, one_error, panes: Path) -> None:
    result = flatlight("scenes", "./panes.py:from_file", "--thumbnails", "t.png")
    one_error(result, "./panes.py:from_file")
    one_error(flatlight("scenes", "--thumbnails", "t.jpg"), "--thumbnails: ")
    assert not list(panes.glob("t.*"))


def test_scenes(flatlight) -> None:
    code, out, _ = flatlight("scenes")
    assert code == 0
    family, source = out.split("scene.source:")
    assert "  flying_things: " in family
    assert "samples_per_pixel: 16" in family
    assert "  flyingthings3d: " in source
    assert "path: required" in source
    assert "backend" not in out
