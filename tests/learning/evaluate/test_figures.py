"""Figures: readable PNGs; the montage's colours are those of its one scale."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from PIL import Image

from learning.evaluate.curves import Curve
from learning.evaluate.figures import (
    Shown,
    _name_lines,
    curves_png,
    depth_png,
    method_colours,
    montage_png,
    noise_png,
    stacks_png,
    times_png,
)
from learning.evaluate.outcome import Outcome, summarise
from learning.evaluate.scoring import Times
from simulator.plots.drawing import UNSEEN, depth_colours

NAMES = ("FlatNet3D", "CLS + graph cut")
COLOURS = method_colours(NAMES)


def _outcome(name: str, noise_db: float | None = None, stack: str = "own", psnr: float = 20.0) -> Outcome:
    scores = {"psnr": summarise([[psnr, psnr + 1], [psnr, psnr]]), "depth_rmse_cm": summarise([[2.0, 3.0]])}
    return Outcome(name, "learned", stack, noise_db, scores, 2.5, (1.0, None, 2.0))


NAIVE = Outcome("constant", "naive", "own", None, {"depth_rmse_cm": summarise([[4.0, 4.4]])}, 4.2, (3.0, None, 5.0))


def _pixels(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def _has(pixels: np.ndarray, colour: str) -> bool:
    wanted = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
    return bool((np.abs(pixels - wanted).max(axis=-1) <= 2).sum() > 20)


def test_the_ablation_draws_every_method_and_the_naive_baselines() -> None:
    outcomes = [_outcome(name, level, psnr=at + level / 4) for at, name in enumerate(NAMES) for level in (20.0, 30.0)]
    pixels = _pixels(noise_png(outcomes, COLOURS, [NAIVE]))
    assert all(_has(pixels, colour) for colour in COLOURS.values())
    half = pixels.shape[1] // 2
    assert _has(pixels[:, half:], "#8a9299")  # the constant depth has no PSNR: only the right panel has its line
    assert not _has(pixels[:, :half], "#8a9299")


def test_lines_too_close_to_be_named_apart_share_a_text() -> None:
    axes = Figure(figsize=(5.5, 4.4)).subplots()
    axes.set_ylim(0, 100)
    ends = {"black": 5.0, "perfect long exposure": 80.0, "best still film": 83.0, "mean film": 40.0}
    _name_lines(axes, ends | {f"film {number}": 20 + 4.0 * number for number in range(3)})
    assert [(text.get_text(), text.xy[1]) for text in axes.texts if isinstance(text, Annotation)] == [
        ("black", 5.0),
        ("film 0, film 1", 24.0),
        ("film 2", 28.0),
        ("mean film", 40.0),
        ("perfect long exposure, best still film", 83.0),
    ]


def test_single_seeds_are_dots_in_the_ablation() -> None:
    together = _outcome("CLS", 20.0)
    spread = replace(together, singly=tuple(replace(_outcome("CLS", 20.0, psnr=psnr), seed=1) for psnr in (10.0, 30.0)))
    with_dots, without = (_pixels(noise_png([one], {"CLS": "#0072b2"}, [])) for one in (spread, together))
    rows = [
        np.abs(pixels[100:, :600] - [0x00, 0x72, 0xB2]).max(axis=-1).min(axis=1) < 60 for pixels in (with_dots, without)
    ]
    assert np.ptp(np.flatnonzero(rows[0])) > 5 * np.ptp(np.flatnonzero(rows[1]))


def test_every_training_is_a_line_in_each_panel() -> None:
    def curve(name: str, above: float) -> Curve:
        scores = {"psnr": (10 + above, 15 + above), "depth_rmse_cm": (3.0, 2.0 - above / 10)}
        return Curve(name, (100, 200), scores)

    alone = _pixels(curves_png([curve(NAMES[0], 0)], COLOURS))
    both = _pixels(curves_png([curve(NAMES[0], 0), curve(NAMES[0], 4)], COLOURS))
    other = _pixels(curves_png([curve(NAMES[0], 0), curve(NAMES[1], 4)], COLOURS))
    half = alone.shape[1] // 2
    lines = [0.8 * np.array([int(each[at : at + 2], 16) for at in (1, 3, 5)]) + 0.2 * 255 for each in COLOURS.values()]
    for panel in (slice(0, half), slice(half, None)):
        drawn = [
            [int((np.abs(pixels[:, panel] - line).max(axis=-1) < 30).sum()) for line in lines]
            for pixels in (alone, both, other)
        ]
        assert drawn[1][0] > 1.5 * drawn[0][0]
        assert drawn[0][1] < 0.2 * drawn[2][1]


def test_bins_stacks_and_times_draw_every_method() -> None:
    outcomes = [_outcome(name) for name in NAMES]
    compared = [_outcome(name, stack=stack) for name in NAMES for stack in ("nominal", "captured")]
    times = [Times(name, {"inversion": 0.01, "network": 0.1 * at + 0.1}, 0.3, 0.2) for at, name in enumerate(NAMES)]
    stacks = _pixels(stacks_png(compared, COLOURS, ("nominal", "captured"), [NAIVE]))
    half = stacks.shape[1] // 2
    assert _has(stacks[:, half:], "#8a9299")  # of the naive baseline
    assert not _has(stacks[:, :half], "#8a9299")
    for pixels in (stacks, _pixels(depth_png(outcomes, COLOURS, [NAIVE], (3.6, 5.0, 10.0, 20.0)))):
        assert all(_has(pixels, colour) for colour in COLOURS.values())
    assert _pixels(times_png(times, COLOURS, "a CPU, 1 of 2 threads")).std() > 10


def test_points_with_parameters_of_another_level_are_hollow() -> None:
    def blue(tuned_db: float) -> int:
        outcomes = [
            replace(_outcome("CLS", level, psnr=level / 4), tuned_db=level if level < 30 else tuned_db)
            for level in (20.0, 30.0)
        ]
        pixels = _pixels(noise_png(outcomes, {"CLS": "#0072b2"}, []))
        assert not _has(pixels, "#cc79a7")
        return int((np.abs(pixels - [0x00, 0x72, 0xB2]).max(axis=-1) <= 2).sum())

    assert blue(30.0) > blue(20.0) + 50  # two marks, one in each panel, lose their inside


def test_any_number_of_methods_have_colours_of_their_own() -> None:
    colours = [[int(c[at : at + 2], 16) for at in (1, 3, 5)] for c in method_colours([*map(str, range(20))]).values()]
    apart = [np.abs(np.subtract(a, b)).max() for at, a in enumerate(colours) for b in colours[:at]]
    assert min(apart) >= 16


def test_the_same_figure_has_the_same_bytes() -> None:
    one, other = (depth_png([_outcome(name) for name in NAMES], COLOURS, [], (1.0, 2.0, 3.0, 4.0)) for _ in range(2))
    assert one == other


@pytest.mark.parametrize("near_m", [0.01, 0.036])
def test_a_montage_shows_codes_and_depths_on_one_scale(near_m: float) -> None:
    rng = np.random.default_rng(0)
    rows = []
    for _ in range(2):
        valid = np.ones((16, 16), bool)
        valid[0, 0] = False
        truth = Shown(rng.random((16, 16, 3)), rng.uniform(near_m, 0.2, (16, 16)), "s0", valid)
        rows.append([truth, Shown(rng.random((16, 16, 3)) * 1.5, rng.uniform(near_m, 0.2, (16, 16)), "20 dB")])
    pixels = _pixels(montage_png(["truth", "CLS"], rows, "title", "line", near_m, 0.2))
    side, gap, top = 160, 10, 62 + 18
    for row, scene in enumerate(rows):
        for column, shown in enumerate(scene):
            y, x = top + row * (2 * side + 2 + 18 + gap), gap + column * (side + gap)
            tile = pixels[y : y + side, x : x + side][5::10, 5::10]
            np.testing.assert_array_equal(tile, np.round(np.clip(shown.image, 0, 1) * 255))
            depth = pixels[y + side + 2 : y + 2 * side + 2, x : x + side][5::10, 5::10]
            seen = np.ones((16, 16), bool) if shown.valid is None else shown.valid
            expected = depth_colours(shown.depth_m.astype(np.float32), seen, near_m, 0.2)
            np.testing.assert_array_equal(depth, expected)
            assert (tuple(depth[0, 0]) == UNSEEN) == (column == 0)
