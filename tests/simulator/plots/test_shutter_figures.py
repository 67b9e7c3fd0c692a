"""The figures: whole, legible, and of the shutter that was configured."""

from itertools import combinations

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.plots.shutter_bench import Bench
from simulator.plots.shutter_figures import across_figure, figures_of, tinted, white_of

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

SHUTTERS = [
    {"exposure_ms": 5},
    {"type": "rolling", "exposure_ms": 1, "line_time_us": 11, "direction": "up"},
    {"type": "dual_rolling", "exposure_ms": 1, "line_time_us": 17},
    {"type": "windows", "file": "rows.csv"},
]


def _bench(trial, shutter) -> Bench:
    rows = np.arange(48 * 8)
    table = np.stack([rows % 3 * 1e-3, rows % 3 * 1e-3 + 1e-3], axis=1)
    np.savetxt(trial.folder / "rows.csv", table, delimiter=",")
    return Bench(Assembly(load_config(trial.write(camera={"shutter": shutter}))))


@pytest.mark.parametrize(
    "shutter", [*(pytest.param(one, marks=pytest.mark.slow) for one in SHUTTERS[:-1]), SHUTTERS[-1]], ids=str
)
def test_no_words_lie_on_others_or_leave_the_sheet(trial, shutter):
    bench = _bench(trial, shutter)
    for name, draw in figures_of(bench).items():
        figure = draw(bench)
        figure.canvas.draw()
        sheet = figure.bbox
        texts = [text for part in [figure, *figure.subfigs] for text in part.texts]  # the title is among them
        for axes in figure.axes:
            titles = [axes.title, axes._left_title, axes._right_title]
            legend = axes.get_legend()
            texts += [*titles, axes.xaxis.label, axes.yaxis.label, *axes.texts, *(legend.get_texts() if legend else [])]
        boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_text().strip()]
        assert len(boxes) > 4
        for words, box in boxes:
            assert box.x0 >= sheet.x0 - 1, (name, words)
            assert box.x1 <= sheet.x1 + 1, (name, words)
        for (words, box), (others, other) in combinations(boxes, 2):
            wide = min(box.x1, other.x1) - max(box.x0, other.x0)
            high = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(wide, high) <= 1, (name, words, others)


def test_a_global_shutter_stands_beside_no_other(trial):
    def titles(shutter):
        return [axes.get_title(loc="left") for axes in across_figure(_bench(trial, shutter)).axes]

    measured = [title for title in titles(SHUTTERS[0]) if title.startswith("Measured")]
    assert measured == ["Measured: this global shutter", "Measured: lens, this shutter"]
    measured = [title for title in titles(SHUTTERS[1]) if title.startswith("Measured")]
    assert measured[0] == "Measured: global shutter, open for all of the capture"
    assert measured[1] == "Measured: this rolling shutter"


def test_a_lens_catches_one_flash_and_misses_the_other(trial):
    bench = _bench(trial, SHUTTERS[1])
    images = [
        axes for axes in across_figure(bench).axes if axes.get_title(loc="left") == "Measured: lens, this shutter"
    ]
    shown = np.asarray(images[0].images[0].get_array())
    left, right = shown[:, :10].max(), shown[:, 10:].max()
    assert sorted([left > 0.5, right > 0.5]) == [False, True]


def test_light_adds_up_in_its_colours():
    one, two = np.array([[1.0, 0.0]]), np.array([[1.0, 0.5]])
    image = tinted([(one, (1, 0, 0)), (two, (0, 0, 1))], 1.0)
    assert image[0, 0] == pytest.approx([1, 0, 1])
    assert image[0, 1] == pytest.approx([0, 0, 0.735], abs=1e-3)  # sRGB of 0.5


def test_white_leaves_out_a_hundredth_of_the_light():
    values = np.concatenate([np.full(990, 1.0), [5.0, 5.0]])
    assert white_of([values]) == 5
    assert white_of([np.concatenate([np.full(2000, 1.0), [5.0, 5.0]])]) == 1
    assert white_of([np.zeros(4)]) == 1
