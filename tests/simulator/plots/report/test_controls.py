"""The page in a browser: its controls moved by keyboard and pointer, and what is seen then."""

import base64
import io
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from simulator.camera.field import field_from_record
from simulator.camera.forward import ForwardModel
from simulator.dataset.dataset_info import read_info
from simulator.optics.stack_files import read_psf_stack
from simulator.plots.psf import psf_white
from simulator.plots.report.page import write_report
from simulator.types import View

pytestmark = pytest.mark.slow

WIDTHS = (400, 768, 1280)


@pytest.fixture(scope="module")
def stills(make_trial: Callable, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = make_trial(tmp_path_factory.mktemp("trial")).generate()
    write_report(root)
    return root


@pytest.fixture
def clips_page(samples: ModuleType, tmp_path: Path) -> Path:
    return write_report(samples.make_dataset(tmp_path / "set", lambda index: samples.make_clip_sample(index, frames=6)))


def canvas(browser) -> np.ndarray:
    """The pixels that the canvas shows, ``(H, W, 3)``, 0 to 255."""
    data = browser("find('.explorer canvas').toDataURL()").split(",")[1]
    with Image.open(io.BytesIO(base64.b64decode(data))) as image:
        return np.asarray(image.convert("RGB")).astype(float)


def expected(root: Path, depth: int, row: int, column: int, *, own: bool = False) -> np.ndarray:
    """The same from the forward model: a point source on the scene pixel (row, column)."""
    info, stack = read_info(root), read_psf_stack(root / "psf")
    view = View(info.scene_shape, stack.pixel_pitch_m, stack.provenance["mask_to_sensor_m"], 0.036, 0.2)
    light = field_from_record(info.field_of_view).irradiance(view)
    volume = np.zeros((1, len(stack.depths_m), 3, *view.shape), np.float32)
    volume[0, depth, :, row, column] = light[row, column] / light.max()
    measured = ForwardModel(stack, info.sensor_shape, view.shape).forward(volume)
    white = max(psf_white([psf]) for psf in (stack.values[[depth]] if own else stack.values))
    return np.moveaxis(255 * np.sqrt(np.clip(measured / white, 0, 1)), 0, -1)


def test_a_point_source_is_moved(browser, stills: Path) -> None:
    """Towards a corner by keys and by pointer: the canvas shows what the forward model gives."""
    browser.open(stills / "report.html")
    shown = canvas(browser)
    np.testing.assert_allclose(shown, expected(stills, 0, 8, 10), atol=12)  # shares of the brightest, compressed
    assert np.abs(shown - expected(stills, 0, 8, 10)).mean() < 1
    for name, key, code, times in (
        ("depth", "ArrowRight", 39, 1),
        ("column", "ArrowRight", 39, 6),
        ("row", "Home", 36, 1),
    ):
        browser(f"find('.controls [name={name}]').focus()")
        for _ in range(times):
            browser.press(key, code)
    moved = canvas(browser)
    assert np.abs(moved - shown).mean() > 10
    places = [(1, 0, 16), (1, 0, 15), (1, 1, 16), (0, 0, 16), (2, 0, 16)]
    away = [np.abs(moved - expected(stills, *place)).mean() for place in places]
    assert away[0] < 1  # and the neighbours are other images
    assert min(away[1:3]) > 3 * away[0]
    assert min(away[3:]) > 1.5 * away[0]
    told = browser("[...document.querySelectorAll('.controls b')].map((found) => found.textContent)")
    assert told[0] == "5.7 cm" or told[0].startswith("6")
    assert "right, column 17 of 20" in told[1]
    assert "above, row 1 of 16" in told[2]
    browser("find('[name=own]').click()")
    assert np.abs(canvas(browser) - expected(stills, 1, 0, 16, own=True)).mean() < 1.5
    assert "own scale" in browser("find('.controls output').value")
    place = browser(
        "(() => { const b = find('.explorer canvas').getBoundingClientRect(); return [b.x, b.y, b.width]; })()"
    )
    pixel = place[2] / 60
    to = {"x": place[0] + (20 + 3 + 0.5) * pixel, "y": place[1] + (16 + 12 + 0.5) * pixel}  # scene pixel (12, 3)
    for kind in ("mousePressed", "mouseReleased"):
        browser.call("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **to)
    assert np.abs(canvas(browser) - expected(stills, 1, 12, 3, own=True)).mean() < 1.5
    assert browser.complaints() == []


SEEN = "[...find('.cards .card').querySelectorAll('.truth img')].findIndex((image) => image.offsetHeight > 0)"


def test_frames_are_stepped_through_and_played(browser, clips_page: Path) -> None:
    browser.open(clips_page)
    assert browser(SEEN) == 0
    browser("find('.cards .frames input').focus()")
    for _ in range(2):
        browser.press("ArrowRight", 39)
    assert browser(SEEN) == 2
    assert browser("find('.cards .frames output').value") == "frame 3 of 6, 3.333 to 5 ms"
    browser("find('.cards .play').click()")
    changed = f"new Promise((done) => {{ setInterval(() => {{ if ({SEEN} !== 2) done({SEEN}); }}, 20); }})"
    assert browser(changed) == 3
    assert browser("find('.cards .frames output').getAttribute('aria-live')") == "off"
    browser("find('[data-every]').click()")  # something moves: it stops
    assert browser("[...playing].length") == 0
    browser("find('[data-every]').click()")  # plays all
    assert browser("[...playing].length") == 4
    assert browser("find('[data-every]').textContent") == "Pause all clips"
    for number in range(4):
        browser(f"cards[{number}].querySelector('.play').click()")
    assert browser("find('[data-every]').textContent") == "Play all clips"
    browser("find('.cards .play').click()")
    browser("find('[data-every]').click()")
    assert browser("[...playing].length") == 0
    browser.open(clips_page, prefers_reduced_motion="reduce")
    assert browser("getComputedStyle(find('.cards .play')).display") == "none"
    assert browser.complaints() == []


def test_a_sample_is_seen_large(browser, clips_page: Path) -> None:
    name = "find('#large h3').firstChild.textContent"
    browser.open(clips_page)
    names = browser("cards.map((card) => card.getAttribute('aria-label'))")
    browser("cards[1].querySelector('.open').focus()")
    browser.press("Enter", 13)
    browser("find('.open:focus')?.click()")  # where the key alone does not press a button
    assert browser("find('#large').open")
    assert browser(name) == "train/s00000001"
    browser("find('#large [data-step]').focus()")
    browser.press("ArrowRight", 39)
    assert browser(name) == "train/s00000002"
    browser("find('#large .frames input').focus()")
    browser.press("ArrowRight", 39)
    assert browser(name) == "train/s00000002"
    assert browser("find('#large .frames output').value").startswith("frame 2 of 6")
    browser("find('#large .play').focus()")
    for number in (3, 4):  # the button that has the focus goes with its sample
        browser.press("ArrowRight", 39)
        assert browser("document.activeElement.matches('#large .play')")
        assert browser(name) == names[number % 4]
        assert browser("find('#large').getAttribute('aria-label')") == f"{names[number % 4]}, large"
        assert browser("find('#large [aria-live]').value") == names[number % 4]
    assert browser("find('#large img').offsetWidth") > 300
    browser.press("Escape", 27)
    assert not browser("find('#large').open")
    assert browser("document.activeElement.getAttribute('aria-label')") == "Show train/s00000001 large"
    assert browser.complaints() == []


def test_another_image_is_shown_large(browser, stills: Path) -> None:
    browser.open(stills / "report.html")
    width = "[...find('.card').querySelectorAll('img')].map((image) => image.offsetWidth)"
    before = browser(width)
    assert before[1] > 1.9 * before[0]
    browser("find('[value=measurement]').click()")
    after = browser(width)
    assert after[0] > 1.9 * after[1]


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_too_wide(browser, stills: Path, clips_page: Path, width: int, scheme: str) -> None:
    for page in (stills / "report.html", clips_page):
        browser.open(page, width, prefers_color_scheme=scheme)
        assert browser("document.documentElement.scrollWidth") <= width
        red, green, blue = browser("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
        assert (red + green + blue > 600) == (scheme == "light")
        assert browser.complaints() == []


def test_what_is_chosen_is_seen_without_colours(browser, clips_page: Path) -> None:
    """In forced colours, where shadows are gone and all borders are alike."""
    browser.open(clips_page, forced_colors="active")
    outlines = browser("all('.choice label').map((label) => getComputedStyle(label).outlineStyle)")
    assert outlines == ["none", "solid", "none"]


def test_a_caption_is_read_without_scrolling(browser, stills: Path) -> None:
    browser.open(stills / "report.html", 360)
    ends = browser("all('caption').map((caption) => caption.getBoundingClientRect().right)")
    assert ends
    assert max(ends) <= 360
    assert browser("Math.max(...all('.wide').map((wide) => wide.scrollWidth))") > 360  # a table that is scrolled


def test_without_javascript_images_and_tables_are_there(browser, clips_page: Path) -> None:
    browser.open(clips_page, scripts=False)

    def drawn(selector: str) -> list[bool]:
        return browser(
            f"[...document.querySelectorAll('{selector}')].map((found) => found.getClientRects().length > 0)"
        )

    for kind, count in (("measurement", 1), ("truth", 6), ("depth", 6)):
        assert drawn(f".card .{kind} img") == [True, *[False] * (count - 1)] * 4
    for selector in (".strip img", ".histogram svg", "#splits table", "#made pre"):
        shown = drawn(selector)
        assert shown
        assert all(shown)
    for selector in ("canvas", "button", ".frames input"):
        assert not any(drawn(selector))
