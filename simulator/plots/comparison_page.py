"""The comparison of cameras as a page: figures and tables."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.optics.metrics import autocorrelation, radial_mtf
from simulator.plots.comparison import COLUMNS, NOTES, TITLE, Candidate, cameras_in_words
from simulator.plots.drawing import figure_png, new_figure
from simulator.plots.psf import FAINT, GRID, INK, NORMAL, SMALL, draw_psfs, head, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase

WIDTH_INCH, DPI = 15.0, 100
_HEADING = 14.0  # points
_DESIGN_INCH, _CURVES_INCH, _LINE_INCH = 5.6, 4.4, 0.4
_PANEL_INCH = (7.0, 7.0)  # of the page, which shows them two abreast, or one below the other where it is narrow
# Told apart by colour-blind eyes too (Okabe and Ito, 2008); black is left to the text.
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_STROKES = ("-", "--", ":", "-.")


def design_pngs(candidate: Candidate) -> list[tuple[bytes, str]]:
    """Return the images of one candidate, each with its description: its PSFs near and far, and how alike its depths are."""
    figures = [new_figure(_PANEL_INCH, DPI) for _ in range(len(candidate.views) + 1)]
    scale = draw_psfs([figure.subplots() for figure in figures[:-1]], candidate.views, candidate.pixel_pitch_m)
    for figure in figures[:-1]:
        figure.supxlabel(scale, x=0.01, ha="left", fontsize=SMALL, color=FAINT)
    _draw_correlations(figures[-1].subplots(), candidate)
    lowest = candidate.correlations.min()
    described = [f"PSF of {candidate.name} at {view.name}" for view in candidate.views]
    described += [f"correlation of the depths of {candidate.name}, {lowest:.2f} at the least"]
    return [(figure_png(figure), words) for figure, words in zip(figures, described, strict=True)]


def curves_png(candidates: Sequence[Candidate]) -> bytes:
    """Return the image of all MTFs and autocorrelations, at the nearest and the farthest depth."""
    return _png(_CURVES_INCH, lambda figure: _draw_curves(figure, candidates))


def comparison_png(candidates: Sequence[Candidate]) -> bytes:
    """Return the whole comparison as one image: the table of figures, the curves, and a row per candidate."""
    heights = [_LINE_INCH * (3 + len(candidates)), _CURVES_INCH, *[_DESIGN_INCH] * len(candidates)]

    def draw(figure: Figure) -> None:
        grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
        parts = [figure.add_subfigure(grid[row]) for row in range(len(heights))]
        _draw_table(parts[0], candidates)
        _draw_curves(parts[1], candidates)
        for part, candidate in zip(parts[2:], candidates, strict=True):
            part.suptitle(candidate.name, x=0.01, ha="left", fontsize=_HEADING, fontweight="bold", color=INK)
            _draw_design(part, candidate)

    return _png(sum(heights), draw)


def _png(height_inch: float, draw: Callable[[Figure], None]) -> bytes:
    figure = new_figure((WIDTH_INCH, height_inch), DPI)
    draw(figure)
    return figure_png(figure)


def _draw_design(figure: FigureBase, candidate: Candidate) -> None:
    panels = figure.subplots(1, len(candidate.views) + 1)
    scale = draw_psfs(list(panels[:-1]), candidate.views, candidate.pixel_pitch_m)
    figure.supxlabel(scale, x=0.01, ha="left", fontsize=SMALL, color=FAINT)
    _draw_correlations(panels[-1], candidate)


def _draw_correlations(axes: Axes, candidate: Candidate) -> None:
    image = axes.imshow(candidate.correlations, vmin=0, vmax=1, cmap="viridis")
    head(axes, "Correlation of depths")
    style(axes, "depth, near to far", "")
    ends = sorted({0, len(candidate.correlations) - 1})
    names = [view.name for view in candidate.views]
    axes.set_xticks(ends, names)
    axes.set_yticks(ends, names)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.8)
    bar.ax.tick_params(labelsize=SMALL, colors=INK)
    bar.outline.set_visible(False)


def _draw_curves(figure: FigureBase, candidates: Sequence[Candidate]) -> None:
    panels = figure.subplots(1, 4)
    for number, candidate in enumerate(candidates):
        colour = _COLOURS[number % len(_COLOURS)]
        stroke = _STROKES[number // len(_COLOURS) % len(_STROKES)]
        line = {"color": colour, "linestyle": stroke, "linewidth": 1.6}
        for end, (mtf_axes, shift_axes) in zip((0, -1), panels.reshape(2, 2).T, strict=True):
            grey = candidate.views[end].grey
            frequency, mtf = radial_mtf(grey, candidate.pixel_pitch_m)
            mtf_axes.plot(frequency / 1e3, mtf, label=candidate.name, **line)
            shifts, height = _ring_mean(autocorrelation(grey))
            shift_axes.plot(shifts * candidate.pixel_pitch_m * 1e6, height, **line)
    for axes, depth in zip(panels, ("nearest", "farthest") * 2, strict=True):
        axes.grid(color=GRID, linewidth=0.6)
        mtf = axes in panels[:2]
        head(axes, f"{'MTF' if mtf else 'Autocorrelation'}, {depth} depth")
        style(axes, "cycles per mm on the sensor" if mtf else "shift (µm), mean over directions", "")
        axes.set_ylim(*((1e-3, 1.3) if mtf else (0, 1.02)))
        axes.set_yscale("log" if mtf else "linear")
        axes.set_xscale("linear" if mtf else "log")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, frameon=False)


def _ring_mean(image: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return radii from one pixel on, and the mean over each ring of pixels that lies whole inside the image."""
    rows, columns = (np.arange(n) - n // 2 for n in image.shape)
    radius = np.hypot(rows[:, None], columns[None, :])
    ring = np.rint(radius).astype(np.int64)
    count = np.bincount(ring.ravel())
    mean, radii = (np.bincount(ring.ravel(), part.ravel()) / count for part in (image, radius))
    inside = slice(1, max(min(image.shape) // 2, 2))
    return radii[inside], mean[inside]


def _draw_table(figure: FigureBase, candidates: Sequence[Candidate]) -> None:
    from matplotlib.transforms import Bbox

    figure.suptitle(TITLE, x=0.01, ha="left", fontsize=_HEADING, fontweight="bold", color=INK)
    words = f"{cameras_in_words(candidates)}\n{NOTES}"
    figure.supxlabel(words, x=0.01, ha="left", fontsize=NORMAL, color=FAINT)
    axes: Axes = figure.subplots()
    axes.set_axis_off()
    heads = ["Design", *(column.title for column in COLUMNS)]
    rows = [[candidate.name, *(column.cell(candidate) for column in COLUMNS)] for candidate in candidates]
    widths = np.array([3 + max(map(len, column)) for column in zip(heads, *rows, strict=True)])
    table = axes.table(
        rows,
        colLabels=heads,
        colWidths=list(widths / widths.sum()),
        cellLoc="center",
        bbox=Bbox.unit(),
        edges="horizontal",
    )
    table.auto_set_font_size(False)
    table.set_fontsize(NORMAL)
    for cell in table.get_celld().values():
        cell.set_edgecolor(GRID)
        cell.get_text().set_color(INK)


_STYLE = """
:root { color-scheme: light dark; --ink: #1c2226; --faint: #5a636a; --line: #d5dadd; --ground: #fff; --raised: #f4f6f7; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8ecee; --faint: #a3adb4; --line: #3a4248; --ground: #14181b; --raised: #1e2428; }
}
body { margin: 0 auto; max-width: 78rem; padding: 1.5rem; background: var(--ground); color: var(--ink);
  font: 1rem/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 0.5rem; }
p, caption, dd { color: var(--faint); }
.note { color: var(--ink); border-left: 4px solid #d55e00; padding-left: 0.8rem; }
.wide { overflow-x: auto; }
.wide:focus-visible { outline: 2px solid #0072b2; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding-bottom: 0.5rem; }
th, td { padding: 0.4rem 0.55rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap; }
thead th { vertical-align: bottom; white-space: normal; }
thead th:first-child, tbody th, .facts td { text-align: left; white-space: normal; }
tbody tr:hover { background: var(--raised); }
img { display: block; width: 100%; height: auto; background: #fff; border-radius: 6px; }
figure, details { margin: 0.5rem 0; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); gap: 1rem; }
.panels figure { margin: 0; max-width: 40rem; }
summary { cursor: pointer; }
dt { font-weight: 600; margin-top: 0.6rem; }
dd { margin-left: 0; max-width: 60rem; }
"""


def comparison_html(candidates: Sequence[Candidate]) -> str:
    """Return the page, with one row and one section per candidate."""
    curves = _image(
        curves_png(candidates), "MTF and autocorrelation of all designs; the table above has their figures."
    )
    sections = "".join(_section(candidate) for candidate in candidates)
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(TITLE)}</title>
<style>{_STYLE}</style>
</head>
<body>
<main>
<h1>{escape(TITLE)}</h1>
{_cameras(candidates)}
<h2 id="figures">Figures of merit</h2>
{_table(candidates)}
<h2>Contrast and sharpness</h2>
<figure>{curves}</figure>
{sections}
<h2>How the figures are defined</h2>
<p>I is the mean of the channels' PSFs at one depth; H is radiometric: sensor irradiance per irradiance at the mask.</p>
<dl>{"".join(f"<dt>{escape(c.title)}</dt><dd>{escape(c.definition)}</dd>" for c in COLUMNS)}</dl>
</main>
</body>
</html>
"""


def _cameras(candidates: Sequence[Candidate]) -> str:
    if len({candidate.camera for candidate in candidates}) == 1:
        return f"<p>{escape(cameras_in_words(candidates))}</p>"
    items = "".join(f"<li><strong>{escape(c.name)}</strong>: {escape(c.camera)}</li>" for c in candidates)
    return f'<p class="note">{escape(cameras_in_words(candidates))}</p><ul>{items}</ul>'


def _table(candidates: Sequence[Candidate]) -> str:
    heads = "".join(f'<th scope="col">{escape(column.title)}</th>' for column in COLUMNS)
    rows = "".join(
        f'<tr><th scope="row">{escape(candidate.name)}</th>'
        + "".join(f"<td>{escape(column.cell(candidate))}</td>" for column in COLUMNS)
        + "</tr>"
        for candidate in candidates
    )
    return (
        '<div class="wide" role="region" aria-labelledby="figures" tabindex="0"><table>'
        f"<caption>{escape(NOTES)}</caption>"
        f'<thead><tr><th scope="col">Design</th>{heads}</tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _section(candidate: Candidate) -> str:
    panels = "".join(f"<figure>{_image(png, described)}</figure>" for png, described in design_pngs(candidate))
    facts = "".join(
        f'<tr><th scope="row">{escape(what)}</th><td>{escape(value)}</td></tr>' for what, value in candidate.facts
    )
    return (
        f'<h2>{escape(candidate.name)}</h2><div class="panels">{panels}</div>'
        f'<details><summary>What is known of its PSFs</summary><table class="facts">{facts}</table></details>'
    )


def _image(png: bytes, described: str) -> str:
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode()}" alt="{escape(described)}">'
