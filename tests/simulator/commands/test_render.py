"""``render`` as users meet it: what it writes is what `generate` would see."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simulator.io.exr import read_exr
from simulator.plugins import import_file
from simulator.types import View

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

# A ball that rolls to the right before a wall, as a family in a file of its own.
ROLLING = '''
"""A rolling ball."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.render import Box, Environment, Material, Renderer, Scene, Sphere


@dataclass(frozen=True)
class Rolling:
    view: object
    frames: int
    renderer: Renderer
    inputs: tuple = ()

    def clip(self, index, rng):
        grey = Material(np.full((2, 2, 3), 0.5))
        start = rng.uniform(-0.004, 0)
        wall = Box(np.array([0, 0, 0.19]), np.array([0.5, 0.5, 0.01]), grey, np.eye(3))
        light = (Environment(np.ones(3)),)

        def scene(frame):
            ball = Sphere(np.array([start + 0.002 * frame, 0, 0.1]), 0.003, grey, np.eye(3))
            return Scene((wall, ball), light)

        scenes = [scene(frame) for frame in range(self.frames)]
        options = {"samples_per_pixel": 1, "seed": int(rng.integers(2**32)), "source": {"family": "rolling"}}
        if self.frames == 1:
            return self.renderer.still(scenes[0], self.view, **options)
        return self.renderer.clip(scenes, self.view, frames_per_second=1000, label="rolling", **options)


def rolling(view, *, frames: Annotated[int, Field(ge=1)] = 3, renderer: Renderer):
    return Rolling(view, frames, renderer)
'''


@pytest.fixture
def rolling(trial) -> Path:
    """A configuration whose scenes roll."""
    (trial.folder / "rolling.py").write_text(ROLLING, encoding="utf-8")
    return trial.write(scene={"family": "./rolling.py:rolling", "size": [16, 20]})


def test_a_sheet_of_clips(flatlight, rolling: Path, tmp_path: Path) -> None:
    code, out, err = flatlight("render", rolling, "--samples", 2, "--output", tmp_path / "s.png")
    assert (code, out) == (0, f"look at {tmp_path / 's.png'}\n")
    assert "rendering with scalar_rgb" in err
    assert "samples rendered: 2 of 2" in err
    sheet = np.asarray(Image.open(tmp_path / "s.png").convert("RGB")).astype(int)
    # Tiles of 128 x 160: three frames, depth and, as nobody said otherwise, motion.
    motion = sheet[76 : 76 + 128, 12 + 4 * 162 : 12 + 4 * 162 + 160]
    found = {tuple(colour) for colour in motion.reshape(-1, 3)}
    assert (255, 255, 255) in found  # the wall rests
    assert any(red > 200 > 100 > green and blue == green for red, green, blue in found)  # the ball moves to the right


def test_an_animation(flatlight, rolling: Path, tmp_path: Path) -> None:
    for name in ("a.gif", "a.webp"):
        code, out, _ = flatlight("render", rolling, "--samples", 1, "--output", tmp_path / name)
        assert (code, out) == (0, f"look at {tmp_path / name}\n")
        with Image.open(tmp_path / name) as image:
            assert getattr(image, "n_frames", 1) == 3
            assert image.size[1] == 58 + 18 + 128 + 20 + 12


def test_the_frames_of_a_clip_as_exr(flatlight, rolling: Path, tmp_path: Path) -> None:
    code, out, _ = flatlight("render", rolling, "--outputs", "motion,ids", "--output", tmp_path / "a.exr")
    assert (code, out) == (0, f"look at {tmp_path / 'a.0000.exr'} to a.0002.exr\n")
    channels, metadata = read_exr(tmp_path / "a.0000.exr")
    ball = channels["id"] == 1
    assert 20 < ball.sum() < 40  # a disc of 6 pixels: 6 mm from 10 cm through 1.9 mm onto 19.2 um
    # 2 mm are 1.98 pixels 10 cm away, at the ball's rim, and 2.04 at its front, 3 mm nearer.
    assert 1.97 < channels["motion.X"][ball].min() < channels["motion.X"][ball].max() < 2.05
    assert np.abs(channels["motion.X"][~ball]).max() < 1e-4
    assert (metadata["label"], metadata["frames"]) == ("rolling", 3)


@pytest.mark.parametrize(("split", "index", "key"), [("train", 2, 0), ("test", 1, 2)])
def test_it_is_the_scene_of_the_data_set(flatlight, trial, split: str, index: int, key: int) -> None:
    """The documented stream and index, to which tests/simulator/dataset/test_recipe.py holds the data set's own scenes."""
    path = trial.folder / "a.exr"
    assert flatlight("render", trial.write(), "--split", split, "--index", index, "--output", path)[0] == 0
    rng = np.random.default_rng(np.random.SeedSequence(11, spawn_key=(key, index, 0)))
    view = View((16, 20), 8 * 2.4e-6, 1.9e-3, 0.036, 0.2)
    clip = import_file(trial.plugins, "plugins").boxes(view).clip(index, rng)
    channels, metadata = read_exr(path)
    np.testing.assert_array_equal(np.stack([channels[name] for name in "RGB"], -1), clip.rgb[0])
    np.testing.assert_array_equal(channels["Z"], clip.depth_m[0])
    np.testing.assert_array_equal(channels["valid"], clip.valid[0])
    assert metadata["source"] == {"drawn": index}


def test_a_name_of_its_own_and_everything_that_can_be_shown(
    flatlight, rolling: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ("--set", "scene.frames=1", "--samples", 1, "--split", "validation")
    code, out, _ = flatlight("render", rolling, *arguments, "--outputs", "hidden, albedo,normals,ids,ids")
    assert (code, out) == (0, "look at trial_validation.png\n")
    plain, _ = Image.open(tmp_path / "trial_validation.png").size
    assert flatlight("render", rolling, *arguments)[0] == 0
    assert plain - Image.open(tmp_path / "trial_validation.png").size[0] >= 5 * 162 - 200


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--output", "a.jpg"], ["--output"]),
        (["--output", "no/a.png"], ["--output"]),
        (["--split", "trian"], ["--split: ", "'train'"]),
        (["--outputs", "id,motion"], ["--outputs: ", "'ids'"]),
        (["--samples", "2", "--output", "a.exr"], ["--samples: ", "--index"]),
        (["--set", "scene.frame=2"], ["scene.frame", "'frames'"]),
        (["--set", "scene.frames=1", "--outputs", "motion"], ["motion"]),
        (["--set", "scene.frames=1", "--output", "a.gif"], [".png"]),
    ],
)
def test_mistakes(flatlight, one_error, rolling: Path, monkeypatch, arguments: list[str], words: list[str]) -> None:
    monkeypatch.chdir(rolling.parent)
    before = set(rolling.parent.iterdir())
    one_error(flatlight("render", rolling, *arguments), *words)
    assert {path for path in rolling.parent.iterdir() if path.name != "__pycache__"} <= before


FINITE = '''
"""Three grey pictures."""

from dataclasses import dataclass

import numpy as np

from simulator.types import Clip


@dataclass(frozen=True)
class Greys:
    view: object
    problems: tuple
    inputs: tuple = ()

    def __len__(self):
        return 3

    def clip(self, index, rng):
        shape = (1, *self.view.shape)
        rgb, depth_m = np.full((*shape, 3), 0.2, np.float32), np.full(shape, 0.1, np.float32)
        return Clip(rgb, depth_m, np.ones(shape, bool), np.array([0.0, 1.0]))


def greys(view, *, bad: int = 0):
    return Greys(view, tuple(f"{number}.png: torn" for number in range(bad)))
'''


def test_a_source_with_an_end_is_shown_once_and_says_what_it_leaves_out(flatlight, one_error, trial) -> None:
    one_error(flatlight("render", trial.write(), "--outputs", "ids"), "render.outputs: ")
    (trial.folder / "greys.py").write_text(FINITE, encoding="utf-8")
    path = trial.write(scene={"source": "./greys.py:greys", "size": [16, 20]})
    _, _, err = flatlight("render", path, "--output", trial.folder / "a.png")
    assert "samples rendered: 3 of 3" in err
    assert "note" not in err
    _, _, err = flatlight("render", path, "--samples", 2, "--set", "scene.bad=7", "--output", trial.folder / "a.png")
    assert "samples rendered: 2 of 2" in err
    assert "note: 7 files or videos cannot be used, and are left out:\n  0.png: torn\n" in err
    assert "4.png: torn\n  and 2 more" in err
    assert "5.png" not in err
