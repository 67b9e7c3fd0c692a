"""The figures beside the table: noise, errors over depth and time, assumed PSFs, seconds, learning curves, a montage."""

from __future__ import annotations

import colorsys
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from learning.evaluate.curves import Curve
from learning.evaluate.outcome import Outcome
from learning.evaluate.scoring import Times
from simulator.plots.drawing import INK as SHEET_INK
from simulator.plots.drawing import (
    LEGEND_WIDTH,
    PAPER,
    depth_colours,
    draw_depth_legend,
    fitted,
    font,
    png_bytes,
    resized,
)
from simulator.plots.psf import FAINT, GRID, INK, NORMAL, SMALL, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 120
# Told apart by colour-blind eyes too (Okabe and Ito, 2008); grey is for naive baselines.
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_GOLDEN = (5**0.5 - 1) / 2  # steps of it round the circle of hues never meet again
_BEHIND = {"facecolor": "white", "alpha": 0.75, "linewidth": 0, "pad": 0.5}  # words, lest lines run through them
_APART = 0.05  # of a panel's height: what names of lines need to be read one by one
_MARKS, _NAIVE = "osD^vP", "#8a9299"
PANELS = {
    "psnr": "PSNR of images, dB",
    "moving_psnr": "PSNR of moving pixels, dB",
    "depth_rmse_cm": "depth RMSE, cm",
}


def method_colours(names: Sequence[str]) -> dict[str, str]:
    """Return a colour for each method, the same in every figure."""
    extra = range(max(0, len(names) - len(_COLOURS)))
    channels = (colorsys.hsv_to_rgb((0.78 + at * _GOLDEN) % 1, 0.75, 0.38 + 0.15 * (at % 2)) for at in extra)
    more = ("#" + "".join(f"{round(255 * channel):02x}" for channel in each) for each in channels)
    return dict(zip(names, [*_COLOURS, *more], strict=False))


def noise_png(outcomes: Sequence[Outcome], colours: Mapping[str, str], naive: Sequence[Outcome]) -> bytes:
    """Return PSNR and depth RMSE against the measurement's PSNR (thesis, figure 5.5); small dots are single seeds.

    Points are hollow where parameters are used that were tuned at another level.
    """

    def draw(axes: Axes, score: str) -> str:
        for at, (name, colour) in enumerate(colours.items()):
            of_it = [one for one in outcomes if one.method == name and score in one.scores]
            points = sorted((one.noise_db, at) for at, one in enumerate(of_it) if one.noise_db is not None)
            if points:
                levels, found = [level for level, _ in points], [of_it[at] for _, at in points]
                means = [one.scores[score].mean for one in found]
                axes.plot(levels, means, color=colour, lw=1.8)
                for one, level in zip(found, levels, strict=True):
                    for alone in one.singly:
                        axes.plot(level, alone.scores[score].mean, color=colour, marker="o", ms=3.5, alpha=0.7)
                mark = _MARKS[at % len(_MARKS)]
                axes.plot([], [], color=colour, marker=mark, lw=1.8, label=name)
                for one, level, mean in zip(found, levels, means, strict=True):
                    face = "white" if one.tuned_elsewhere else colour
                    axes.plot(level, mean, color=colour, marker=mark, mfc=face, mew=1.6)
        if any(one.tuned_elsewhere for one in outcomes):
            hollow = "hollow: parameters tuned at another level"
            axes.plot([], [], color=FAINT, marker="o", mfc="white", ls="", label=hollow)
        axes.set_xticks(sorted({one.noise_db for one in outcomes if one.noise_db is not None}))
        axes.grid(color=GRID)
        return "PSNR of measurements, dB"

    return _panels(5.5, [*outcomes, *naive], naive, draw)


def depth_png(
    outcomes: Sequence[Outcome], colours: Mapping[str, str], naive: Sequence[Outcome], edges_cm: Sequence[float]
) -> bytes:
    """Return depth RMSE against true depth, over all pixels of a bin."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for one in [*outcomes, *naive]:
            if one.bins_cm:
                values = [np.nan if value is None else value for value in one.bins_cm]
                grey = one.kind == "naive"
                colour, line = (_NAIVE, "--") if grey else (colours[one.method], "-")
                axes.stairs(values, edges_cm, baseline=None, color=colour, ls=line, lw=2.0, label=one.method)
        style(axes, "true depth, cm", "depth RMSE, cm")
        axes.set_ylim(bottom=0)
        axes.set_xscale("log")  # near bins are narrow, as a mask's depth of field is
        axes.set_xticks(edges_cm, [f"{edge:.3g}" for edge in edges_cm])
        axes.set_xticks([], minor=True)
        axes.grid(color=GRID)
        axes.set_axisbelow(True)
        _legend(figure)

    return _png(9, 4.8, draw)


def over_time_png(
    outcomes: Sequence[Outcome], colours: Mapping[str, str], naive: Sequence[Outcome], edges_s: NDArray[np.float64]
) -> bytes:
    """Return the scores of every frame against when it was, ``edges_s`` (N + 1,), from the capture's start."""
    every = [*outcomes, *naive]
    titles = {score: title for score, title in PANELS.items() if any(score in one.over_time for one in every)}
    times_ms = 500 * (edges_s[1:] + edges_s[:-1])

    def draw(figure: Figure) -> None:
        for axes, score in zip(figure.subplots(1, len(titles), squeeze=False)[0], titles, strict=True):
            ends = {}
            for at, one in enumerate(one for one in every if score in one.over_time):
                grey = one.kind not in ("learned", "classical")
                look: Any = {"color": _NAIVE, "ls": "--"} if grey else {"color": colours[one.method]}
                mark = "" if grey else _MARKS[at % len(_MARKS)]
                name = "" if grey else one.method  # those are named beside their lines
                axes.plot(times_ms, one.over_time[score], lw=1.8, marker=mark, label=name, **look)
                if grey:
                    ends[one.method] = one.over_time[score][-1]
            _name_lines(axes, ends)
            axes.grid(color=GRID)
            style(axes, "time, ms", titles[score])
        _legend(figure)

    return _png(5.5 * len(titles), 4.4, draw)


def stacks_png(
    outcomes: Sequence[Outcome], colours: Mapping[str, str], stacks: Sequence[str], naive: Sequence[Outcome]
) -> bytes:
    """Return PSNR and depth RMSE of every method with each of several PSFs; whiskers are the spread over seeds."""

    def draw(axes: Axes, score: str) -> str:
        width = 0.8 / len(stacks)
        for at, stack in enumerate(stacks):
            places, means, errors, fills = [], [], [], []
            for place, (name, colour) in enumerate(colours.items()):
                of_it = [one for one in outcomes if one.method == name and one.stack == stack]
                if of_it and score in of_it[0].scores:
                    places.append(place + (at - (len(stacks) - 1) / 2) * width)
                    means.append(of_it[0].scores[score].mean)
                    errors.append(of_it[0].scores[score].over_seeds or np.nan)
                    fills.append(colour)
            alpha = 1 - 0.6 * at / max(1, len(stacks) - 1)
            bars = axes.bar(places, means, width * 0.94, color=fills, alpha=alpha, yerr=errors, capsize=3)
            axes.bar_label(bars, [f"{mean:.3g}" for mean in means], fontsize=SMALL, color=INK, padding=2)
            axes.bar(0, 0, color=INK, alpha=alpha, label=stack)
        axes.set_xlim(-0.6, len(colours) + 0.9)  # room at the right for the words of the lines
        axes.set_xticks(range(len(colours)), [_broken(name) for name in colours])
        axes.margins(y=0.12)
        return ""

    return _panels(1.2 * max(4, len(colours)), [*outcomes, *naive], naive, draw)


def times_png(times: Sequence[Times], colours: Mapping[str, str], where: str) -> bytes:
    """Return seconds per scene and stage of every method, on a logarithmic scale because they differ by orders."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        stages = list(dict.fromkeys(stage for one in times for stage in one.stages))
        for place, one in enumerate(times):
            colour = colours[one.method]
            axes.plot([min(one.stages.values()), one.total], [place, place], color=GRID, lw=1.5, zorder=1)
            for stage, seconds in one.stages.items():
                mark = _MARKS[stages.index(stage) % len(_MARKS)]
                axes.scatter(seconds, place, marker=mark, s=70, color=colour, alpha=0.65, zorder=2)
            axes.scatter(one.total, place, marker="|", s=700, color=INK, zorder=3)
            shown = f"{one.total:.3g} s" if one.total >= 1 else f"{one.total * 1e3:.3g} ms"
            axes.annotate(shown, (one.total, place), (8, 8), textcoords="offset points", fontsize=NORMAL, color=INK)
        for at, stage in enumerate(stages):
            axes.scatter([], [], marker=_MARKS[at % len(_MARKS)], s=70, color=FAINT, label=stage)
        axes.scatter([], [], marker="|", s=300, color=INK, label="all")
        axes.set_xscale("log")
        axes.set_yticks(range(len(times)), [one.method for one in times])
        axes.set_ylim(len(times) - 0.4, -0.6)
        axes.grid(axis="x", color=GRID)
        axes.set_axisbelow(True)
        style(axes, f"seconds per scene, one at a time ({where})", "")
        axes.margins(x=0.12)
        _legend(figure)

    return _png(9, 1.8 + 0.6 * len(times), draw)


def curves_png(curves: Sequence[Curve], colours: Mapping[str, str]) -> bytes:
    """Return the scores of every training on its validation scenes, against steps."""

    def draw(axes: Axes, score: str) -> str:
        for name, colour in colours.items():
            of_it = [one for one in curves if one.method == name and score in one.scores]
            for at, one in enumerate(of_it):
                axes.plot(one.steps, one.scores[score], color=colour, lw=1.8, alpha=0.8, label="" if at else name)
        axes.grid(color=GRID)
        return "steps"

    return _panels(5.5, curves, [], draw)


def _panels(
    width_inch: float, measured: Sequence[Outcome | Curve], naive: Sequence[Outcome], draw: Callable[[Axes, str], str]
) -> bytes:
    """Return a panel for each score of `PANELS` that was measured, with the naive baselines as lines.

    ``draw`` gives the label of x; ``width_inch`` is of each panel.
    """
    titles = {score: title for score, title in PANELS.items() if any(score in one.scores for one in measured)}

    def every(figure: Figure) -> None:
        for axes, score in zip(figure.subplots(1, len(titles), squeeze=False)[0], titles, strict=True):
            x_label = draw(axes, score)
            means = {one.method: one.scores[score].mean for one in naive if score in one.scores}
            for mean in means.values():
                axes.axhline(mean, color=_NAIVE, ls="--", lw=1.2)
            _name_lines(axes, means)
            style(axes, x_label, titles[score])
        _legend(figure)

    return _png(width_inch * len(titles), 4.4, every)


def _name_lines(axes: Axes, ends: Mapping[str, float]) -> None:
    """Name lines at their right ends; lines that are too close to be named one by one share a text."""
    low, high = axes.get_ylim()
    groups: list[dict[str, float]] = []
    for name, end in sorted(ends.items(), key=lambda item: item[1]):
        if groups and end - min(groups[-1].values()) < _APART * (high - low):
            groups[-1][name] = end
        else:
            groups.append({name: end})
    where: Any = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "ha": "right"}
    for group in groups:
        top = (1.0, max(group.values()))
        axes.annotate(", ".join(group), top, (-2, 3), **where, fontsize=SMALL, color=FAINT, bbox=_BEHIND)


def _broken(name: str) -> str:
    """Return a name on two lines where it has words enough."""
    words = name.split()
    half = len(words) // 2
    return name if len(words) < 2 else " ".join(words[:half]) + "\n" + " ".join(words[half:])


def _legend(figure: Figure) -> None:
    handles, labels = figure.axes[0].get_legend_handles_labels()
    # As many side by side as there is room for: a letter takes about a tenth of an inch, a stroke six letters.
    columns = int(figure.get_figwidth() / (0.1 * (max(map(len, labels)) + 6)))
    figure.legend(handles, labels, loc="outside upper center", ncols=max(1, columns), frameon=False, fontsize=NORMAL)


def _png(width_inch: float, height_inch: float, draw: Callable[[Figure], None]) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_inch, height_inch), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": "flatlight"})
    return stream.getvalue()


_TILE, _GAP, _WORDS, _HEAD, _LEGEND = 160, 10, 18, 62, 180  # pixels


@dataclass(frozen=True, eq=False)
class Shown:
    """A scene as one method, or the truth, has it: image ``(h, w, 3)`` in sRGB codes 0..1, depth ``(h, w)``, a few words.

    ``valid`` ``(h, w)`` is False where there was no surface; None where all count.
    """

    image: NDArray[np.floating]
    depth_m: NDArray[np.floating]
    words: str = ""
    valid: NDArray[np.bool_] | None = None


def montage_png(
    columns: Sequence[str], scenes: Sequence[Sequence[Shown]], title: str, line: str, near_m: float, far_m: float
) -> bytes:
    """Return the montage as PNG: a row per scene, whose entries have the heads ``columns``, the truth first.

    ``title`` and ``line`` stand above; ``near_m`` and ``far_m`` are the depths of the first and the last colour.
    """
    from PIL import Image, ImageDraw

    rows, wide = scenes[0][0].image.shape[:2]
    height = min(max(_TILE // rows, 1) * rows, 256)
    width = max(1, round(wide * height / rows))
    high = 2 * height + 2 + _WORDS + _GAP
    across = _GAP + len(columns) * (width + _GAP) + LEGEND_WIDTH
    across = max(across, round(max(font(15).getlength(title), font(12).getlength(line))) + 2 * _GAP)
    sheet = Image.new("RGB", (across, _HEAD + _WORDS + max(len(scenes) * high, _LEGEND + 40)), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((_GAP, 8), title, fill=SHEET_INK, font=font(15))
    draw.text((_GAP, 32), line, fill=SHEET_INK, font=font(12))
    for column, name in enumerate(columns):
        x = _GAP + column * (width + _GAP)
        draw.text((x, _HEAD), fitted(name, 12, width), fill=SHEET_INK, font=font(12))
        for row, scene in enumerate(scenes):
            y = _HEAD + _WORDS + row * high
            shown = scene[column]
            codes = np.round(np.clip(shown.image, 0, 1) * 255).astype(np.uint8)
            depth = shown.depth_m.astype(np.float32)
            valid = np.ones_like(depth, dtype=bool) if shown.valid is None else shown.valid
            colours = depth_colours(depth, valid, near_m, far_m)
            sheet.paste(resized(codes, height), (x, y))
            sheet.paste(resized(colours, height), (x, y + height + 2))
            draw.text((x, y + 2 * height + 4), fitted(shown.words, 11, width), fill=SHEET_INK, font=font(11))
    legend = _GAP + len(columns) * (width + _GAP)
    draw_depth_legend(draw, legend, _HEAD + _WORDS + 8, _LEGEND - 40, near_m, far_m)
    return png_bytes(sheet)
