"""The galleries are whole and say what the designs and the scene families say of themselves."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from psf_library import load_mask
from simulator.plugins import available, import_file, resolve

DOCS = Path(__file__).resolve().parents[1] / "docs"
# Largest number of bytes, least and greatest width of an image.
IMAGES = {"designs": (150_000, 720, 720), "scenes": (250_000, 800, 1500)}


@pytest.fixture(scope="module")
def galleries() -> ModuleType:
    """The script that makes the galleries."""
    return import_file(DOCS / "galleries.py", "docs_galleries")


@pytest.mark.parametrize("name", IMAGES)
def test_every_plugin_is_shown(galleries, name: str) -> None:
    gallery = galleries.GALLERIES[name]
    assert set(gallery.examples) == set(available(gallery.kind))
    most_bytes, least, greatest = IMAGES[name]
    for shown in gallery.examples:
        path = DOCS / "images" / name / f"{shown}{gallery.suffix}"
        assert path.stat().st_size < most_bytes, shown
        with Image.open(path) as image:
            assert least <= image.width <= greatest
            assert np.ptp(np.asarray(image.convert("L"))) > 200


@pytest.mark.parametrize("name", IMAGES)
def test_the_lists_of_parameters_are_the_plugins_own(galleries, name: str) -> None:
    """Fails when a plugin's parameters changed since: run docs/galleries.py NAME --text, or let it draw them anew."""
    assert (DOCS / f"{name}.md").read_text(encoding="utf-8") == galleries.GALLERIES[name].text(name)


def test_the_designs_take_their_examples_parameters_and_files(galleries, tmp_path: Path) -> None:
    for design, shown in galleries.DESIGNS.items():
        resolve("mask", design).bind(shown.parameters)
        if shown.files is not galleries.no_files:
            shown.files(tmp_path)
            assert load_mask(design, tmp_path, **shown.parameters).shape == (300, 300)


def test_the_families_take_their_examples_parameters_files_and_view(galleries, tmp_path: Path) -> None:
    from simulator.render import Renderer

    for family, shown in galleries.FAMILIES.items():
        folder = tmp_path / family
        folder.mkdir()
        shown.files(folder)
        plugin = resolve("scene", family, folder)
        view = galleries.view_of(shown, folder)
        assert view.shape == (galleries.SIDE, galleries.SIDE)
        plugin.function(view, **plugin.bind(shown.parameters), renderer=Renderer("scalar_rgb"))
