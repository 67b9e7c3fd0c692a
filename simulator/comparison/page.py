"""The comparison as one self-contained HTML page: pictures inlined, no script, no network, light and dark."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from simulator.comparison.candidates import Candidate
from simulator.comparison.columns import COLUMNS, NOTES, TITLE, cameras_in_words
from simulator.comparison.figures import curves_png, design_png

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
    depths = " and ".join(view.name for view in candidate.views)
    lowest = candidate.correlations.min()
    described = f"PSF of {candidate.name} at {depths}, and the correlation of its depths, {lowest:.2f} at the least."
    facts = "".join(
        f'<tr><th scope="row">{escape(what)}</th><td>{escape(value)}</td></tr>' for what, value in candidate.facts
    )
    return (
        f"<h2>{escape(candidate.name)}</h2><figure>{_image(design_png(candidate), described)}</figure>"
        f'<details><summary>What its stack records</summary><table class="facts">{facts}</table></details>'
    )


def _image(png: bytes, described: str) -> str:
    return f'<img src="data:image/png;base64,{base64.b64encode(png).decode()}" alt="{escape(described)}">'
