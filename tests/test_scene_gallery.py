"""The gallery of scene families is whole and says what the families say of themselves."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from simulator.plugins import available, resolve

DOCS = Path(__file__).resolve().parents[1] / "docs"
LARGEST_BYTES = 250_000  # of one picture


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    """The script that makes the gallery."""
    spec = importlib.util.spec_from_file_location("scene_gallery", DOCS / "scene_gallery.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their own module up by name.
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, spec.name, module)
        spec.loader.exec_module(module)
    return module


def test_every_family_is_shown(gallery) -> None:
    assert set(gallery.EXAMPLES) == set(available("scene"))
    for family in gallery.EXAMPLES:
        picture = DOCS / "images" / "scenes" / f"{family}.webp"
        assert picture.stat().st_size < LARGEST_BYTES, family
        with Image.open(picture) as image:
            assert 800 < image.width < 1500
            assert np.ptp(np.asarray(image.convert("L"))) > 200


def test_the_lists_of_parameters_are_the_families_own(gallery) -> None:
    """Fails when a family's parameters changed since: run docs/scene_gallery.py --text, or let it draw them anew."""
    assert (DOCS / "scenes.md").read_text(encoding="utf-8") == gallery.gallery()


def test_the_examples_can_be_made(gallery, tmp_path: Path) -> None:
    """The family takes the example's parameters and files, and its preset's view."""
    from simulator.render import Renderer

    for family, shown in gallery.EXAMPLES.items():
        folder = tmp_path / family
        folder.mkdir()
        shown.files(folder)
        plugin = resolve("scene", family, folder)
        view = gallery.view_of(shown, folder)
        assert view.shape == (gallery.SIDE, gallery.SIDE)
        plugin.function(view, **plugin.bind(shown.parameters), renderer=Renderer("scalar_rgb"))
