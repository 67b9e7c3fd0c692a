"""What a calibration found, in words for the terminal and as a page: geometry, path, light, and what to measure again."""

from __future__ import annotations

import base64
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np

from simulator.arrays import to_numpy
from simulator.calibrate.calibration import DARK_PEAK, Calibration, Plane
from simulator.calibrate.geometry import Distance
from simulator.plots.drawing import figure_png, new_figure
from simulator.plots.psf import FAINT, GRID, INK, SMALL, DepthView, draw_psfs, head, shown_depths, style
from simulator.plots.report.markup import Html, facts, joined, paragraph, section, shown, table
from simulator.text import counted, length, share

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_BIAS = 0.01
"""Relative error of d by a mask's mean power 1 / f, which is d / f and does not show in images. Simulated PhlatCams of 3, 2
and 1.4 mm have 0.4, 0.9 and 2.2 %, DiffuserCams of 5 and 2.5 mm 0.6 and 2.1 %."""
_SIGNIFICANT = 3.0  # standard errors
_PANEL_INCH, _DPI = (5.2, 4.4), 130  # a phone shows one below the other
_GOOD, _BAD = "#0072b2", "#d55e00"  # told apart by colour-blind eyes too (Okabe and Ito, 2008)


def key_facts(calibration: Calibration) -> list[tuple[str, str]]:
    """Return (what, value) lines on the geometry, and on what the pictures do not tell."""
    g, depths = calibration.geometry, [plane.depth_m for plane in calibration.planes]
    if len(depths) == 1:
        alone = "one distance does not tell them; two give the mask's distance, three the path, four the scale's zero"
        return [("mask to sensor, shifts, exposures", alone)]
    if g.distance is None:
        return [("mask to sensor", "unknown: neighbouring planes do not look alike; are they of one mask and frame?")]
    facts = [("mask to sensor", f"{_with_error(g.distance)}, if distances are from the mask")]
    if g.with_offset is None:
        facts.append(("zero of the distances", "unknown: four distances or more tell it"))
    else:
        facts.append(("zero of the distances", _zero(g.with_offset, calibration.offset_m)))
    if np.isfinite(g.depth_std_m):
        about = f"{length(g.depth_std_m)} (standard deviation) about the fit"
        facts.append(("scatter of the distances", about if g.depth_std_m > 1e-6 else "below the measurement error"))
    if g.centre_px is not None:
        x, y = g.centre_px
        place = f"meets the sensor {x:+.1f}, {y:+.1f} px from its centre, ± {g.centre_std_px:.2g} px"
        facts.append(("line of the source", f"{place} (a rail beside the axis and a slanted one look alike)"))
    largest = float(np.linalg.norm(g.shifts_px, axis=1).max())
    facts.append(("planes moved", f"by up to {largest:.2f} px, each known to ± {g.shift_std_px:.2g} px"))
    exposures = [plane.exposure for plane in calibration.planes]
    facts.append(("brightness was", f"{share(min(exposures))} to {share(max(exposures))} of the mean; equalised"))
    return facts


def _with_error(found: Distance) -> str:
    std = found.distance_std_m
    digits = int(np.clip(np.ceil(-np.log10(max(std * 1e3, 1e-6))) + 1, 0, 5))
    percent = f"{100 * std / found.distance_m:.2g} %"
    bias = f"plus about {share(_BIAS)} if the mask has net focusing power"
    return f"{found.distance_m * 1e3:.{digits}f} ± {std * 1e3:.{digits}f} mm ({percent}; {bias})"


def _zero(found: Distance, given_m: float) -> str:
    assert found.offset_m is not None
    assert found.offset_std_m is not None
    o, std = found.offset_m * 1e3, found.offset_std_m * 1e3
    open_fit = f"with it free, mask to sensor is {found.distance_m * 1e3:.3f} ± {found.distance_std_m * 1e3:.2g} mm"
    if found.distance_std_m > 0.2 * found.distance_m:
        return f"not told apart from the mask's distance by this range of distances ({o:+.2g} ± {std:.2g} mm)"
    if abs(o) > _SIGNIFICANT * std:
        stated = f"stated with --offset-mm {given_m * 1e3:g}" if given_m else "stated"
        return (
            f"{o:+.2f} ± {std:.2g} mm from the mask: the sources seem to be {'farther' if o > 0 else 'nearer'} than "
            f"{stated} by that; {open_fit}; if that is so, run again with --offset-mm {given_m * 1e3 + o:.2f}"
        )
    return f"at the mask, within the error ({o:+.2f} ± {std:.2g} mm; {open_fit})"


def describe_calibration(calibration: Calibration) -> str:
    """Return the lines for the terminal: the geometry, a line for every distance, and what to measure again."""
    g, planes = calibration.geometry, calibration.planes
    known = key_facts(calibration)
    width = max(len(what) for what, _ in known)
    lines = [f"{what:<{width}}  {value}" for what, value in known]
    lines += [
        "",
        f"{'distance':>9}  {'frames':>6}  {'peak':>6}  {'full':>7}  {'S/N':>5}  {'off by':>9}  "
        f"{'shift x, y (px)':>16}  {'light':>7}",
    ]
    for k, plane in enumerate(planes):
        x, y = g.shifts_px[k]
        lines.append(
            f"{length(plane.depth_m):>9}  {len(plane.files):>6}  {share(plane.peak):>6}  {share(plane.saturated):>7}  "
            f"{plane.signal_to_noise:>5.0f}  {_off_by(g.depth_errors_m[k]):>9}  {x:+8.2f}, {y:+6.2f}  "
            f"{share(plane.exposure):>7}"
        )
    again = [plane for plane in planes if plane.faults]
    lines += [
        "",
        f"measure again: {counted(len(again), 'distance')}" if again else "nothing needs to be measured again",
    ]
    lines += [f"  {length(plane.depth_m)}: {'; '.join(plane.faults)}" for plane in again]
    noted = [*calibration.notes, *_notes(planes)]
    lines += ["worth knowing:"] * bool(noted) + [f"  {line}" for line in noted]
    return "\n".join(lines)


def _off_by(error_m: float) -> str:
    return f"{error_m * 1e3:+.2f} mm" if np.isfinite(error_m) else "-"


def _notes(planes: tuple[Plane, ...]) -> list[str]:
    """Return the notes, each with the distances that share it."""
    of: dict[str, list[str]] = {}
    for plane in planes:
        for note in plane.notes:
            of.setdefault(note, []).append(length(plane.depth_m))
    every = len(planes)
    return [
        f"{'every distance' if len(where) == every > 1 else ', '.join(where)}: {note}" for note, where in of.items()
    ]


def calibration_html(calibration: Calibration, title: str) -> str:
    """Return the page; one file that needs no network.

    Args:
        calibration: what was found.
        title: such as the folder's name.
    """
    again = [plane for plane in calibration.planes if plane.faults]
    verdict = (
        f"Measure again: {', '.join(length(plane.depth_m) for plane in again)}"
        if again
        else "Nothing needs to be measured again."
    )
    css = files("simulator.plots.report").joinpath("page.css").read_text(encoding="utf-8")
    body = joined(
        [
            paragraph(verdict, "notice" if again else "lead"),
            *(paragraph(note, "small") for note in calibration.notes),
            section("geometry", "Geometry", facts(key_facts(calibration))),
            section("pictures", "Pictures", _images(calibration)),
            section("distances", "Distances one by one", _table(calibration)),
        ]
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{shown(title)}</title>
<style>{css}
.panels {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 19rem), 1fr)); gap: 1rem; }}
.panels img {{ display: block; width: 100%; height: auto; background: #fff; border-radius: 6px; }}
td, tbody th {{ white-space: nowrap; }}
td:last-child {{ white-space: normal; min-width: 18rem; }}
td .warn {{ margin: 0; }}</style>
</head>
<body>
<header>
<p class="kind">Calibration</p>
<h1>{shown(title)}</h1>
</header>
<main id="content">
{body}
</main>
<footer><p>Drawn by flatlight from the pictures alone.</p></footer>
</body>
</html>
"""


def _table(calibration: Calibration) -> Html:
    g = calibration.geometry
    heads = [
        "Distance",
        "Frames",
        "Peak",
        "Full pixels",
        "S/N",
        "Farther by",
        "Centroid x, y (px)",
        "Shift x, y (px)",
        "Light",
        "Remarks",
    ]
    rows = []
    for k, plane in enumerate(calibration.planes):
        remarks = [Html(f'<strong class="warn">{shown(fault)}</strong>') for fault in plane.faults]
        remarks += [shown(note) for note in plane.notes]
        rows.append(
            [
                length(plane.depth_m),
                len(plane.files),
                share(plane.peak),
                share(plane.saturated),
                f"{plane.signal_to_noise:.0f}",
                _off_by(g.depth_errors_m[k]),
                f"{plane.centroid_px[0]:+.2f}, {plane.centroid_px[1]:+.2f}",
                f"{g.shifts_px[k, 0]:+.2f}, {g.shifts_px[k, 1]:+.2f}",
                share(plane.exposure),
                Html("<br>".join(remarks)),
            ]
        )
    caption = (
        "Peak: brightest pixel, of full scale. Farther by: where the magnification puts the source against its stated "
        "distance. Shift: taken out, so that all sources lie on one axis. Light: against the mean of all; equalised."
    )
    return table(caption, heads, rows)


def _images(calibration: Calibration) -> Html:
    images = [
        Html(f'<img src="data:image/png;base64,{base64.b64encode(png).decode()}" alt="{shown(words)}">')
        for png, words in calibration_pngs(calibration)
    ]
    return Html(f'<div class="panels">{joined(images)}</div>')


def calibration_pngs(calibration: Calibration) -> list[tuple[bytes, str]]:
    """Return figures and what they show: up to three PSFs on one axis; errors of distance, the source's path, peak values."""
    stack = calibration.stack
    chosen = shown_depths(stack.depths_m)
    draw = {"distances by magnification": _draw_distances, "the source's path": _draw_path, "peaks": _draw_peaks}
    names = [length(stack.depths_m[k]) for k in chosen]
    figures = [new_figure(_PANEL_INCH, _DPI) for _ in (*chosen, *draw)]
    views = []
    for k, name in zip(chosen, names, strict=True):
        psf = to_numpy(stack.values)[k].astype(np.float64)
        colour = _BAD if calibration.planes[k].faults else INK
        views.append(DepthView(name, colour, psf, psf.mean(0), stack.channels))
    scale = draw_psfs([figure.subplots() for figure in figures[: len(views)]], views, stack.pixel_pitch_m)
    for figure in figures[: len(views)]:
        figure.supxlabel(scale, x=0.01, ha="left", fontsize=SMALL, color=FAINT)
    for figure, drawn in zip(figures[len(views) :], draw.values(), strict=True):
        drawn(figure.subplots(), calibration)
    words = [*(f"PSF at {name}" for name in names), *draw]
    return [(figure_png(figure), word) for figure, word in zip(figures, words, strict=True)]


def _draw_distances(axes: Axes, calibration: Calibration) -> None:
    head(axes, "Distance: as magnification has it")
    style(axes, "stated distance (cm), even in 1 / z", "farther than stated (mm)")
    errors = calibration.geometry.depth_errors_m * 1e3
    if not np.isfinite(errors).any():
        _nothing(axes, "three distances or more tell it")
        return
    depths = np.array([plane.depth_m for plane in calibration.planes])
    axes.axhline(0, color=GRID)
    for k, (depth, error) in enumerate(zip(depths, errors, strict=True)):
        axes.plot(1 / depth, error, "o", color=_BAD if k in calibration.geometry.misplaced else _GOOD)
    ticks = shown_depths(depths)
    axes.set_xticks(1 / depths[ticks], [f"{depths[k] * 100:.4g}" for k in ticks])
    axes.invert_xaxis()


def _draw_path(axes: Axes, calibration: Calibration) -> None:
    head(axes, "Source: off its straight line")
    style(axes, "x (mm)", "y (mm)")
    off = calibration.geometry.off_line_m * 1e3
    if not np.isfinite(off).any():
        _nothing(axes, "three distances or more tell it")
        return
    axes.axhline(0, color=GRID)
    axes.axvline(0, color=GRID)
    for k, (x, y) in enumerate(off):
        axes.plot(x, y, "o", color=_BAD if k in calibration.geometry.off_the_line else _GOOD)
        words = length(calibration.planes[k].depth_m)
        if calibration.geometry.off_the_line and k not in calibration.geometry.off_the_line:
            continue  # all lie in one place then
        axes.annotate(words, (x, y), (5, 4), textcoords="offset points", fontsize=SMALL, color=FAINT)
    axes.set_aspect("equal", "datalim")
    axes.invert_yaxis()  # down, as images have it


def _draw_peaks(axes: Axes, calibration: Calibration) -> None:
    head(axes, "Brightest pixel of full scale")
    style(axes, "", "%")
    planes = calibration.planes
    colours = [_BAD if plane.faults else _GOOD for plane in planes]
    axes.bar(range(len(planes)), [100 * plane.peak for plane in planes], color=colours)
    axes.axhline(100, color=FAINT, linewidth=0.8)
    axes.axhline(100 * DARK_PEAK, color=FAINT, linewidth=0.8, linestyle=":")
    axes.set_ylim(0, 108)
    ticks = range(0, len(planes), max(1, len(planes) // 8))
    axes.set_xticks(list(ticks), [length(planes[k].depth_m) for k in ticks])


def _nothing(axes: Axes, words: str) -> None:
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color=FAINT)
    axes.set(xticks=[], yticks=[])
