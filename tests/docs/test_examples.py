"""The scripts of docs/examples run, and draw the pictures that the site shows of them."""

import functools
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from learning.camera import capture_model
from learning.checkpoint import find_checkpoint, load_checkpoint
from learning.labels import class_numbers
from learning.models.activitynet import ActivityMethod, ActivityNet
from simulator.dataset import open_dataset

DOCS = Path(__file__).resolve().parents[2] / "docs"
sys.path.insert(0, str(DOCS))

import pictures  # noqa: E402  how the site's pictures are made

PAGES = {page.name: page.read_text(encoding="utf-8") for page in DOCS.glob("*.md")}


def test_every_picture_is_made_by_something_and_shown() -> None:
    made = {pictures.example_picture(name).relative_to(pictures.IMAGES).as_posix() for name in pictures.EXAMPLES}
    made |= set(pictures.FRONT) | set(pictures.OTHERS)
    for name, gallery in pictures.GALLERIES.items():
        made |= {f"{name}/{shown}{gallery.suffix}" for shown in gallery.examples}
    assert {path.relative_to(pictures.IMAGES).as_posix() for path in pictures.IMAGES.rglob("*.*")} == made
    words = "".join([*PAGES.values(), (DOCS.parent / "README.md").read_text(encoding="utf-8")])
    assert made - set(re.findall(r"images/([\w/.]+)\)", words)) == set()


def test_every_script_is_run_and_shown() -> None:
    scripts = {path.name: path.read_text(encoding="utf-8") for path in pictures.SCRIPTS.iterdir() if path.is_file()}
    called = {name for name in scripts if any(name in scripts[other] for other in pictures.EXAMPLES)}
    assert scripts.keys() == called | set(pictures.EXAMPLES)
    shown = {name for page in PAGES.values() for name in re.findall(r"\{literalinclude\} examples/(\S+)", page)}
    assert shown == scripts.keys()


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The function from an example to the folder where it has run, once."""

    @functools.cache
    def run(name: str) -> Path:
        folder = tmp_path_factory.mktemp(Path(name).stem)
        pictures.run(name, folder)
        return folder

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", pictures.EXAMPLES)
def test_an_example_runs_and_draws_its_picture(name: str, ran: Callable[[str], Path]) -> None:
    """Another backend's noise and WebP's loss change a picture by a few codes of 255, another picture by tens."""
    drawn = np.asarray(pictures.drawn(name, ran(name)), np.float64)
    with Image.open(pictures.example_picture(name)) as image:
        shown = np.asarray(image.convert("RGB"), np.float64)
    assert drawn.shape == shown.shape
    assert np.abs(drawn - shown).mean() < 6


@pytest.mark.slow
def test_the_included_activitynet_recognises_the_clips_of_its_example(ran: Callable[[str], Path]) -> None:
    """Of 14 clips that it has not seen: 9 or more would be right by chance once in a million times."""
    test = open_dataset(ran("activity.sh") / "out/activity_64", "test")
    network = load_checkpoint(find_checkpoint("activitynet"), capture=capture_model(test)).network
    assert isinstance(network, ActivityNet)
    captures = torch.stack([torch.from_numpy(stored["measurement"]) for stored in test])
    assert len(captures) == 14
    _, chances = ActivityMethod("ActivityNet", network, capture_model(test)).recognise(captures)
    right = chances.argmax(dim=1).numpy() == class_numbers(test, network.classes)
    assert right.sum() >= 9  # 11 are expected
