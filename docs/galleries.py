"""The galleries of mask designs and scene families, which ``docs/pictures.py KIND [NAME ...] [--text]`` makes.

``designs``: one image per design in ``docs/images/designs`` (mask, PSF of a near and of a distant point, in colour, on one
scale) and ``docs/designs.md`` around them. Each camera is the shipped configuration with the changes of the table below.
``scenes``: one contact sheet of 16 samples per family in ``docs/images/scenes`` and ``docs/scenes.md`` around them. Each
camera is that of a preset (`flatlight init --preset NAME`), with 96 x 96 pixels over the same field of view.
"""

from __future__ import annotations

import io
import json
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset.engines import available_cpus
from simulator.dataset.recipe import scene_clip
from simulator.plots.clips import clip_sheet
from simulator.plots.psf import DepthView, draw_mask, draw_psfs
from simulator.plugin_listing import parameter_lines, summary
from simulator.plugins import resolve
from simulator.presets import preset_text
from simulator.render import Renderer
from simulator.render.backend import activate, choose_backend
from simulator.text import length
from simulator.types import View

DOCS = Path(__file__).parent
SIZE_INCH, DPI = (9.6, 3.6), 75
NEAR, FAR = "#d55e00", "#0072b2"
SIDE, SAMPLES, FRAMES, QUALITY = 96, 16, 3, 80


def no_files(folder: Path) -> None:
    """Most designs and families need no file."""


def own_masks(folder: Path) -> None:
    """Write the files of the designs that read some: a letter, which shows the orientation, and a cone of glass."""
    letter = Image.new("L", (60, 60))
    ImageDraw.Draw(letter).text((30, 30), "F", fill=255, anchor="mm", font=ImageFont.load_default(52))
    letter.point(lambda grey: 255 * (grey > 127)).save(folder / "letter.png")
    x = (np.arange(300) - 149.5) * 2e-6
    radius_m = np.hypot(x[:, None], x[None, :])
    np.save(folder / "cone.npy", np.float32(0.12 * np.maximum(280e-6 - radius_m, 0)))


def own_models(folder: Path) -> None:
    """Write a coloured vase and a ring, as somebody's own meshes."""
    from trimesh import creation

    (folder / "models").mkdir()
    heights = np.linspace(0, 1, 24)
    profile = np.column_stack([0.2 + 0.13 * np.sin(2.2 * np.pi * heights) + 0.08 * heights, heights])
    vase = creation.revolve(np.vstack([(0, 0), profile, (0.12, 1), (0.1, 0.06), (0, 0.06)]), sections=48)
    bands = np.floor(vase.vertices[:, 2] * 6).astype(int) % 2
    vase.visual.vertex_colors = np.array([(196, 88, 54, 255), (236, 214, 170, 255)], np.uint8)[bands]
    vase.export(folder / "models" / "vase.ply")
    creation.torus(0.4, 0.16, major_sections=48, minor_sections=24).export(folder / "models" / "ring.stl")


@dataclass(frozen=True)
class Design:
    """How a design is shown: parameters that differ from its own, files to read, the camera around it, the near depth."""

    parameters: dict[str, Any] = field(default_factory=dict)
    files: Callable[[Path], None] = no_files
    mask_to_sensor_mm: float = 1.9
    near_cm: float = 4.0
    binning: int = 2
    oversampling: int = 1

    @property
    def caption(self) -> str:
        """Say what the image shows."""
        return f"`mask_to_sensor_mm: {self.mask_to_sensor_mm:g}`, points at {self.near_cm:g} cm and infinity."


@dataclass(frozen=True)
class Family:
    """How a family is shown: the preset whose camera looks at it, parameters that differ from its own, files to read."""

    preset: str
    parameters: dict[str, Any] = field(default_factory=dict)
    files: Callable[[Path], None] = no_files

    @property
    def caption(self) -> str:
        """Say what the image shows."""
        return f"the camera of `flatlight init --preset {self.preset}`."


DESIGNS = {
    "amplitude_image": Design({"file": "letter.png", "feature_um": 10.0}, own_masks),
    "diffusercam": Design({"width_mm": 2.0}, mask_to_sensor_mm=10, near_cm=10),
    "flatcam": Design({"order": 6}, mask_to_sensor_mm=0.5),
    "fresnel_zone": Design(),
    "height_map": Design({"file": "cone.npy", "pixel_um": 2.0, "profile": "smooth"}, own_masks, oversampling=2),
    "lens": Design(),
    "mura": Design({"rank": 61}, mask_to_sensor_mm=0.5),
    "phlatcam": Design({"width_mm": 2.0}, oversampling=2),
    "pinhole": Design(),
    "random_lenslets": Design({"width_mm": 1.5}),
    "spiral": Design(),
    "vortex": Design(),
}
FAMILIES = {
    "activity": Family("activity_64"),
    "endoscopy": Family("endoscopy"),
    "files": Family("flying_things", {"path": "models"}, own_models),
    "flying_things": Family("flying_things"),
    "high_speed": Family("high_speed_64"),
}


def draw_design(design: str, path: Path) -> None:
    """Draw a design's mask and PSFs."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = DESIGNS[design]
    with tempfile.TemporaryDirectory() as folder:
        shown.files(Path(folder))
        config = Path(folder) / "camera.yaml"
        config.write_text((DOCS.parent / "sim_config.yaml").read_text())
        changes = {
            "camera.mask": {"design": design, **shown.parameters},
            "camera.mask_to_sensor_mm": shown.mask_to_sensor_mm,
            "camera.sensor.binning": shown.binning,
            "psf": {"depths_cm": [shown.near_cm, "inf"], "oversampling": shown.oversampling},
        }
        loaded = load_config(config, [f"{key}={json.dumps(value)}" for key, value in changes.items()])
        mask, stack = Assembly(loaded).mask, Assembly(loaded, threads=2).psf_stack
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
    colours = Image.open(drawn).convert("RGB")
    # The palette that keeps the extremes: the median's loses the titles' colours.
    colours.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)


def view_of(shown: Family, folder: Path) -> View:
    """Return the preset's view in as many pixels as the gallery shows."""
    path = folder / "camera.yaml"
    path.write_text(preset_text(shown.preset), encoding="utf-8")
    view = Assembly(load_config(path)).image_view
    return replace(view, shape=(SIDE, SIDE), pixel_pitch_m=view.pixel_pitch_m * view.shape[1] / SIDE)


def draw_family(family: str, path: Path) -> None:
    """Draw a family's contact sheet."""
    shown = FAMILIES[family]
    variant = choose_backend().variant
    activate(variant, threads=available_cpus())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shown.files(folder)
        plugin = resolve("scene", family, folder)
        source = plugin.function(view_of(shown, folder), **plugin.bind(shown.parameters), renderer=Renderer(variant))
        clips = [scene_clip(source, 7, "train", index) for index in range(SAMPLES)]
    captions = [str(index) + (f": {clip.label}" if clip.label else "") for index, clip in enumerate(clips)]
    clip_sheet(clips, captions, family, FRAMES).save(path, quality=QUALITY, method=6)


@dataclass(frozen=True)
class Gallery:
    """A gallery of plugins.

    Attributes:
        kind: of the plugins.
        section: the configuration's key, and the section's key that takes the plugin's name.
        examples: what is shown, by the plugin's name.
        suffix: of the images.
        draw: name of the plugin and path to its image.
        alt: what stands for an image, before the plugin's name.
        head: the page's first paragraphs.
    """

    kind: str
    section: tuple[str, str]
    examples: dict[str, Any]
    suffix: str
    draw: Callable[[str, Path], None]
    alt: str
    head: tuple[str, ...]

    def text(self, folder: str) -> str:
        """Return the page whose images lie in ``docs/images/FOLDER``."""
        parts = list(self.head)
        for name, shown in sorted(self.examples.items()):
            plugin = resolve(self.kind, name)
            words = ", ".join(f"{key}: {value}" for key, value in {self.section[1]: name, **shown.parameters}.items())
            cells = [(p.name, p.default, p.expected, p.meaning) for p in parameter_lines(plugin)]
            rows = [f"| `{key}` | {default} | {' | '.join(map(_cell, more))} |" for key, default, *more in cells]
            parts += [
                f"## {name}\n",
                f"{summary(plugin)}\n",
                f"![{self.alt} {name}](images/{folder}/{name}{self.suffix})\n",
                f"Shown: `{self.section[0]}: {{{words}}}`, {shown.caption}\n",
                "| key | default | expected | meaning |\n|---|---|---|---|\n" + "\n".join(rows) + "\n",
            ]
        return "\n".join(parts)

    def make(self, folder: str, names: Sequence[str] = (), *, text_only: bool = False) -> None:
        """Draw what is named, or all, into ``docs/images/FOLDER``, and write the page."""
        images = DOCS / "images" / folder
        images.mkdir(parents=True, exist_ok=True)
        for name in [] if text_only else names or self.examples:
            path = images / f"{name}{self.suffix}"
            with warnings.catch_warnings(record=True) as heard:
                warnings.simplefilter("always")
                self.draw(name, path)
            print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)", *(str(item.message) for item in heard), sep="\n  ")
        (DOCS / f"{folder}.md").write_text(self.text(folder), encoding="utf-8")


GALLERIES = {
    "designs": Gallery(
        "mask",
        ("mask", "design"),
        DESIGNS,
        ".png",
        draw_design,
        "mask and PSFs of",
        (
            "# Mask designs\n",
            "Written by `docs/pictures.py designs`; `flatlight masks` prints the same lists. Each image: the mask, then the "
            "PSF of a near point and of a distant one, in the colours of the default camera under daylight, both on one "
            "scale with a square-root stretch, on pixels of 4.8 um. PSFs are in the stored frame: rotated by 180 degrees, so "
            "that a pinhole's image is upright.\n",
            "Your own design is one function in one file: see [Your own mask](my_mask.md).\n",
        ),
    ),
    "scenes": Gallery(
        "scene",
        ("scene", "family"),
        FAMILIES,
        ".webp",
        draw_family,
        "16 samples of",
        (
            "# Scene families\n",
            "Written by `docs/pictures.py scenes`; `flatlight scenes` prints the same lists and with `--thumbnails all.png` "
            "draws such images; `flatlight render FILE` draws the scenes of a configuration: as a contact sheet, an "
            "animation (`--output clips.gif`) or linear values (`--output sample.exr`).\n",
            f"Each sheet: {SAMPLES} samples of {SIDE} x {SIDE} pixels and their depth; of clips {FRAMES} frames and one "
            "depth. One radiance is white in all of a sheet, and stands on it.\n",
            "Your own family is one function in one file: see [Your own scenes](my_scenes.md).\n",
        ),
    ),
}


def _cell(words: str) -> str:
    return words.replace("|", "\\|")
