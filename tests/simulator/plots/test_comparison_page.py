"""The page and the image: complete, self-contained, readable by machines, and true to the figures."""

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from simulator.plots.comparison import COLUMNS
from simulator.plots.comparison_page import DPI, WIDTH_INCH, comparison_html, comparison_png, curves_png, design_pngs


class Reader(HTMLParser):
    """Collects what the tests ask for, and refuses tags that do not nest."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.rows: list[list[str]] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("th", "td"):
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def candidates(gaussian_candidate):
    return [gaussian_candidate("narrow & <sharp>", (2.0, 3.0)), gaussian_candidate("wide", (5.0,))]


@pytest.fixture(scope="module")
def page(candidates) -> str:
    return comparison_html(candidates)


def test_the_table_holds_every_figure(page: str, candidates) -> None:
    rows = Reader(page).rows
    assert rows[0] == ["Design", *(column.title for column in COLUMNS)]
    for row, candidate in zip(rows[1:3], candidates, strict=True):
        assert row == [candidate.name, *(column.cell(candidate) for column in COLUMNS)]
    assert ["model", "a <drawn> Gaussian"] in rows  # what the stack records, escaped and back


def test_the_page_needs_nothing_else(page: str) -> None:
    """No script, no style sheet, no address: every image lies in the page, whole, and says in words what it shows."""
    tags = Reader(page).tags
    assert {"script", "link", "iframe"}.isdisjoint(tag for tag, _ in tags)
    assert not re.search(r"https?:|url\(|@import", re.sub(r"base64,[\w+/=]+", "", page))
    images = [attributes for tag, attributes in tags if tag == "img"]
    assert len(images) == 6  # the curves; three of the design with two depths, two of the other
    for attributes in images:
        kind, data = str(attributes["src"]).split(",")
        assert kind == "data:image/png;base64"
        with Image.open(io.BytesIO(base64.b64decode(data))) as image:
            image.load()
        assert len(str(attributes["alt"])) > 15


def test_the_page_is_accessible(page: str) -> None:
    tags = Reader(page).tags
    assert ("html", {"lang": "en"}) in tags
    assert all("scope" in attributes for tag, attributes in tags if tag == "th")
    assert sum(tag == "caption" for tag, _ in tags) == 1
    assert "prefers-color-scheme: dark" in page


def test_every_figure_is_defined(page: str) -> None:
    assert page.count("<dt>") == page.count("<dd>") == len(COLUMNS)


@pytest.mark.slow
def test_the_image_has_a_row_per_candidate(candidates) -> None:
    heights = []
    for chosen in (candidates[:1], candidates):
        with Image.open(io.BytesIO(comparison_png(chosen))) as image:
            assert image.width == WIDTH_INCH * DPI
            heights.append(image.height)
            assert np.asarray(image.convert("L")).std() > 20
    assert heights[1] - heights[0] > WIDTH_INCH * DPI / 3  # as high as three panels abreast are wide


def test_the_page_shows_psfs_large(candidates) -> None:
    """Each PSF has an image of its own, which stays large on a phone, of more pixels than a page shows of it."""
    images = design_pngs(candidates[0])
    assert len(images) == len(candidates[0].views) + 1
    for png, _ in images:
        with Image.open(io.BytesIO(png)) as image:
            dark = np.asarray(image.convert("L")) < 128
            assert dark.any(axis=0).sum() > 400
            assert image.width >= 640  # the widest that the page's style allows


def test_no_text_of_the_image_is_cut_off(candidates, written) -> None:
    """Everything that is written lies inside the image, whose right-hand edge the widest table reaches."""
    comparison_png(candidates)
    assert written
    for text, box in written.items():
        across, down = text.figure.get_figure(root=True).bbox.size
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= across and box.y1 <= down, text  # noqa: PT018


def test_curves_tell_many_designs_apart(gaussian_candidate, monkeypatch: pytest.MonkeyPatch) -> None:
    """A dozen designs (all that are shipped) get a dozen combinations of colour and stroke."""
    from matplotlib.axes import Axes

    drawn = []
    plot = Axes.plot

    def record(self, *data, **options):
        if "label" in options:
            drawn.append((options["label"], options["color"], options["linestyle"]))
        return plot(self, *data, **options)

    monkeypatch.setattr(Axes, "plot", record)
    curves_png([gaussian_candidate(f"design {number}") for number in range(12)])
    assert len({look[1:] for look in drawn}) == 12
