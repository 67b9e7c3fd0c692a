"""Makes the gallery of the mask designs: ``uv run python docs/designs.py [DESIGN ...] [--text]``.

One picture per design in ``docs/images/designs`` (mask, PSF of a near and of a distant point, in colour, on one scale) and
``docs/designs.md`` around them. Each camera is the shipped configuration with the changes of the table below.
"""

from __future__ import annotations

import argparse
import io
import json
import tempfile
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from simulator.assemble import build_mask, build_psf_stack
from simulator.config import load_config
from simulator.plots.psf import DepthView, draw_mask, draw_psfs
from simulator.plugin_listing import parameter_lines, summary
from simulator.plugins import available, resolve
from simulator.text import length

DOCS = Path(__file__).parent
PICTURES = DOCS / "images" / "designs"
SIZE_INCH, DPI = (9.6, 3.6), 75
NEAR, FAR = "#d55e00", "#0072b2"


@dataclass(frozen=True)
class Shown:
    """How a design is shown: parameters that differ from its own, the camera around it, the two depths."""

    parameters: dict[str, Any] = field(default_factory=dict)
    mask_to_sensor_mm: float = 1.9
    near_cm: float = 4.0
    binning: int = 2
    oversampling: int = 1


EXAMPLES = {
    "amplitude_image": Shown({"file": "letter.png", "feature_um": 10.0}),
    "diffusercam": Shown({"width_mm": 2.0}, mask_to_sensor_mm=10, near_cm=10),
    "flatcam": Shown({"order": 6}, mask_to_sensor_mm=0.5),
    "fresnel_zone": Shown(),
    "height_map": Shown({"file": "cone.npy", "pixel_um": 2.0, "profile": "smooth"}, oversampling=2),
    "lens": Shown(),
    "mura": Shown({"rank": 61}, mask_to_sensor_mm=0.5),
    "phlatcam": Shown({"width_mm": 2.0}, oversampling=2),
    "pinhole": Shown(),
    "random_lenslets": Shown({"width_mm": 1.5}),
    "spiral": Shown(),
    "vortex": Shown(),
}


def own_files(folder: Path) -> None:
    """Write the files of the designs that read some: a letter, which shows the orientation, and a cone of glass."""
    letter = Image.new("L", (60, 60))
    ImageDraw.Draw(letter).text((30, 30), "F", fill=255, anchor="mm", font=ImageFont.load_default(52))
    letter.point(lambda grey: 255 * (grey > 127)).save(folder / "letter.png")
    x = (np.arange(300) - 149.5) * 2e-6
    radius_m = np.hypot(x[:, None], x[None, :])
    np.save(folder / "cone.npy", np.float32(0.12 * np.maximum(280e-6 - radius_m, 0)))


def draw(design: str) -> Path:
    """Draw a design's picture and return its path."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = EXAMPLES[design]
    with tempfile.TemporaryDirectory() as folder:
        own_files(Path(folder))
        config = Path(folder) / "camera.yaml"
        config.write_text((DOCS.parent / "sim_config.yaml").read_text())
        changes = {
            "camera.mask": {"design": design, **shown.parameters},
            "camera.mask_to_sensor_mm": shown.mask_to_sensor_mm,
            "camera.sensor.binning": shown.binning,
            "psf": {"depths_cm": [shown.near_cm, "inf"], "oversampling": shown.oversampling},
        }
        loaded = load_config(config, [f"{key}={json.dumps(value)}" for key, value in changes.items()])
        mask, stack = build_mask(loaded), build_psf_stack(loaded, threads=2)
    figure = Figure(figsize=SIZE_INCH, dpi=DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 3)
    draw_mask(panels[0], mask)
    views = []
    for depth_m, planes, colour in zip(stack.depths_m, stack.values, (NEAR, FAR), strict=True):
        name = length(depth_m) if np.isfinite(depth_m) else "infinity"
        psf = np.asarray(planes, np.float64)
        views.append(DepthView(name, colour, psf, psf.mean(0), stack.channels))
    draw_psfs(list(panels[1:]), views, stack.pixel_pitch_m)
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", metadata={"Software": None})
    path = PICTURES / f"{design}.png"
    PICTURES.mkdir(parents=True, exist_ok=True)
    colours = Image.open(drawn).convert("RGB")
    # The palette that keeps the extremes: the median's loses the titles' colours.
    colours.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def gallery() -> str:
    """Return the text of ``docs/designs.md``."""
    parts = [
        "# Mask designs\n",
        "Written by `docs/designs.py`; `flatlight masks` prints the same lists. Each picture: the mask, then the PSF of a "
        "near point and of a distant one, in the colours of the default camera under daylight, both on one scale with a "
        "square-root stretch, on pixels of 4.8 um. PSFs are in the stored frame: turned by 180 degrees, so that a pinhole's "
        "picture is upright.\n",
        "Your own design is one function in one file: see [README](../README.md#swap-the-mask).\n",
    ]
    for design in available("mask"):
        if design not in EXAMPLES:
            continue
        shown, plugin = EXAMPLES[design], resolve("mask", design)
        words = ", ".join(f"{key}: {value}" for key, value in {"design": design, **shown.parameters}.items())
        rows = [
            f"| `{p.name}` | {p.default} | {_cell(p.expected)} | {_cell(p.meaning)} |" for p in parameter_lines(plugin)
        ]
        parts += [
            f"## {design}\n",
            f"{summary(plugin)}\n",
            f"![mask and PSFs of {design}](images/designs/{design}.png)\n",
            f"Shown: `mask: {{{words}}}`, `mask_to_sensor_mm: {shown.mask_to_sensor_mm:g}`, points at {shown.near_cm:g} cm "
            f"and infinity.\n",
            "| key | default | expected | meaning |\n|---|---|---|---|\n" + "\n".join(rows) + "\n",
        ]
    return "\n".join(parts)


def _cell(words: str) -> str:
    return words.replace("|", "\\|")


def main() -> None:
    """Draw the designs that are named, or all, and write the gallery."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("designs", nargs="*", help="designs to draw; all when left out")
    parser.add_argument("--text", action="store_true", help="write the text alone, and draw nothing")
    chosen = parser.parse_args()
    for design in [] if chosen.text else chosen.designs or EXAMPLES:
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            path = draw(design)
        print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)", *(str(item.message) for item in heard), sep="\n  ")
    (DOCS / "designs.md").write_text(gallery())


if __name__ == "__main__":
    main()
