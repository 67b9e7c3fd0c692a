"""``compare`` as users meet it."""

import inspect
from pathlib import Path

import pytest
from PIL import Image

from simulator.commands.compare import compare
from simulator.plots.comparison import DEPTHS

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

HOLE = "{design: pinhole, diameter_um: 100, pixel_um: 4}"


@pytest.mark.slow
def test_a_page_and_a_picture(flatlight, trial, tmp_path: Path) -> None:
    path = trial.write()
    for name in ("both.html", "both.png"):
        code, out, err = flatlight("compare", HOLE, path, "--config", path, "--output", tmp_path / name)
        assert code == 0, err
        assert out == f"look at {tmp_path / name}\n"
        assert "drawing the images" in err
    page = (tmp_path / "both.html").read_text()
    for words in ("pinhole, diameter_um 100", ">trial<", "One camera for all: 48 x 60 pixels of 19.2 µm"):
        assert words in page
    with Image.open(tmp_path / "both.png") as picture:
        assert picture.format == "PNG"


def test_the_default_number_of_depths_is_that_of_the_comparison() -> None:
    assert inspect.signature(compare).parameters["depths"].default == DEPTHS


def test_mistakes(flatlight, one_error, trial, tmp_path: Path) -> None:
    path, page = trial.write(), tmp_path / "page.html"
    one_error(flatlight("compare", "pinhole", "--output", "page.pdf"), "--output: ")
    one_error(flatlight("compare", "pinhole", "--output", tmp_path / "a" / "b.html"), f"{tmp_path / 'a'}")
    one_error(flatlight("compare", "pinhle", "--config", path, "--output", page), "'pinhle'", "'pinhole'")
    one_error(flatlight("compare", "pinhole", "--config", tmp_path / "no.yaml", "--output", page), "no.yaml")
    assert not page.exists()
    page.mkdir()
    one_error(flatlight("compare", HOLE, "--config", path, "--output", page), "page.html")
