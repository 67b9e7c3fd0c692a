"""Makes the gallery of the scene families: ``uv run python docs/scene_gallery.py [FAMILY ...] [--text]``.

One contact sheet of 16 samples per family in ``docs/images/scenes`` and ``docs/scenes.md`` around them. Each camera is that
of a preset (`flatlight init --preset NAME`), with 96 x 96 pixels over the same field of view.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulator.assemble import build_view
from simulator.config import load_config
from simulator.dataset.engines import available_cpus
from simulator.dataset.recipe import scene_clip
from simulator.plots.clips import clip_sheet
from simulator.plugin_listing import parameter_lines, summary
from simulator.plugins import resolve
from simulator.presets import preset_text
from simulator.render import Renderer
from simulator.render.backend import activate, choose_backend
from simulator.types import View

DOCS = Path(__file__).parent
PICTURES = DOCS / "images" / "scenes"
SIDE, SAMPLES, FRAMES, QUALITY = 96, 16, 3, 80


def no_files(folder: Path) -> None:
    """Most families need no file."""


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
class Shown:
    """How a family is shown: the preset whose camera looks at it, parameters that differ from its own, files to read."""

    preset: str
    parameters: dict[str, Any] = field(default_factory=dict)
    files: Callable[[Path], None] = no_files


EXAMPLES = {
    "activity": Shown("activity_64"),
    "endoscopy": Shown("endoscopy"),
    "files": Shown("flying_things", {"path": "models"}, own_models),
    "flying_things": Shown("flying_things"),
    "high_speed": Shown("high_speed_64", {"background": "mixed"}),
}


def view_of(shown: Shown, folder: Path) -> View:
    """Return the preset's view in as many pixels as the gallery shows."""
    path = folder / "camera.yaml"
    path.write_text(preset_text(shown.preset), encoding="utf-8")
    view = build_view(load_config(path))
    return replace(view, shape=(SIDE, SIDE), pixel_pitch_m=view.pixel_pitch_m * view.shape[1] / SIDE)


def draw(family: str) -> Path:
    """Draw a family's contact sheet and return its path."""
    shown = EXAMPLES[family]
    variant = choose_backend().variant
    activate(variant, threads=available_cpus())
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shown.files(folder)
        plugin = resolve("scene", family, folder)
        source = plugin.function(view_of(shown, folder), **plugin.bind(shown.parameters), renderer=Renderer(variant))
        clips = [scene_clip(source, 7, "train", index) for index in range(SAMPLES)]
    captions = [str(index) + (f": {clip.label}" if clip.label else "") for index, clip in enumerate(clips)]
    path = PICTURES / f"{family}.webp"
    PICTURES.mkdir(parents=True, exist_ok=True)
    clip_sheet(clips, captions, family, FRAMES).save(path, quality=QUALITY, method=6)
    return path


def gallery() -> str:
    """Return the text of ``docs/scenes.md``."""
    parts = [
        "# Scene families\n",
        "Written by `docs/scene_gallery.py`; `flatlight scenes` prints the same lists and with `--thumbnails all.png` draws "
        "such pictures; `flatlight render FILE` draws the scenes of a configuration: as a contact sheet, an animation "
        "(`--output clips.gif`) or linear values (`--output sample.exr`).\n",
        f"Each sheet: {SAMPLES} samples of {SIDE} x {SIDE} pixels and their depth; of clips {FRAMES} frames and one depth. "
        "One radiance is white in all of a sheet, and stands on it.\n",
        "Your own family is one function in one file: `./my_scenes.py:name`, or a file put into `scenes/`.\n",
    ]
    for family, shown in sorted(EXAMPLES.items()):
        plugin = resolve("scene", family)
        words = ", ".join(f"{key}: {value}" for key, value in {"family": family, **shown.parameters}.items())
        rows = [
            f"| `{line.name}` | {line.default} | {_cell(line.expected)} | {_cell(line.meaning)} |"
            for line in parameter_lines(plugin)
        ]
        parts += [
            f"## {family}\n",
            f"{summary(plugin)}\n",
            f"![16 samples of {family}](images/scenes/{family}.webp)\n",
            f"Shown: `scene: {{{words}}}`, the camera of `flatlight init --preset {shown.preset}`.\n",
            "| key | default | expected | meaning |\n|---|---|---|---|\n" + "\n".join(rows) + "\n",
        ]
    return "\n".join(parts)


def _cell(words: str) -> str:
    return words.replace("|", "\\|")


def main() -> None:
    """Draw the families that are named, or all, and write the gallery."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("families", nargs="*", help="families to draw; all when left out")
    parser.add_argument("--text", action="store_true", help="write the text alone, and draw nothing")
    chosen = parser.parse_args()
    for family in [] if chosen.text else chosen.families or EXAMPLES:
        path = draw(family)
        print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)")
    (DOCS / "scenes.md").write_text(gallery(), encoding="utf-8")


if __name__ == "__main__":
    main()
