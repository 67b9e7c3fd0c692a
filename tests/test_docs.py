"""The gallery of designs is whole and says what the designs say of themselves."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from psf_library import load_mask
from simulator.plugins import available, resolve

DOCS = Path(__file__).resolve().parents[1] / "docs"
LARGEST_BYTES = 150_000  # of one picture: the repository holds a dozen


@pytest.fixture(scope="module")
def gallery() -> ModuleType:
    """The script that makes the gallery."""
    spec = importlib.util.spec_from_file_location("docs_designs", DOCS / "designs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their own module up by name.
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, spec.name, module)
        spec.loader.exec_module(module)
    return module


def test_every_design_is_shown(gallery) -> None:
    assert set(gallery.EXAMPLES) == set(available("mask"))
    for design in available("mask"):
        picture = DOCS / "images" / "designs" / f"{design}.png"
        assert picture.stat().st_size < LARGEST_BYTES, design
        with Image.open(picture) as image:
            assert image.size == (720, 270)
            assert np.ptp(np.asarray(image.convert("L"))) > 200


def test_the_lists_of_parameters_are_the_designs_own(gallery) -> None:
    """Fails when a design's parameters changed since: run docs/designs.py --text, or let it draw them anew."""
    assert (DOCS / "designs.md").read_text() == gallery.gallery()


@pytest.mark.parametrize("design", ["amplitude_image", "height_map"])
def test_the_files_of_the_examples_are_read(gallery, tmp_path: Path, design: str) -> None:
    gallery.own_files(tmp_path)
    mask = load_mask(design, tmp_path, **gallery.EXAMPLES[design].parameters)
    assert mask.shape == (300, 300)


def test_the_examples_parameters_are_valid(gallery) -> None:
    for design, shown in gallery.EXAMPLES.items():
        resolve("mask", design).bind(shown.parameters)
