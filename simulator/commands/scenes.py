"""`flatlight scenes`: the families with their parameters, and an image of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.commands.shared import check_output_file
from simulator.errors import InputError

if TYPE_CHECKING:
    from simulator.console import Bar
    from simulator.plugins import Plugin
    from simulator.types import Clip, View

SAMPLES = 6
_SIDE = 96  # pixels; the field of view is the preset's


def draw_thumbnails(plugins: Sequence[Plugin], path: Path, bar: Bar) -> list[str]:
    """Render samples of each family with its defaults, seen by the camera of its preset, and draw the middle of each.

    Returns:
        What was left out, each with the reason.

    Raises:
        InputError: nothing is left to draw.
    """
    from simulator.io.files import write_atomic
    from simulator.plots.clips import Cell, common_scales, describe_scales, draw_sheet, radiance_tile
    from simulator.plots.drawing import png_bytes
    from simulator.plugin_listing import summary

    shown: list[tuple[Plugin, list[Clip]]] = []
    left_out: list[str] = []
    for plugin in plugins:
        needed = [name for name, field in plugin.parameters.model_fields.items() if field.is_required()]
        if needed or not plugin.takes_renderer:
            left_out.append(f"{plugin.name} (needs {', '.join(needed) or 'files'})")
            continue
        try:
            shown.append((plugin, _samples(plugin, bar)))
        except InputError as error:
            left_out.append(f"{plugin.name} ({error})")
    if not shown:
        raise InputError("--thumbnails", f"nothing can be drawn: {'; '.join(left_out)}")
    clips = [clip for _, family in shown for clip in family]
    frames = [[_middle(clip)] for clip in clips]
    scales = common_scales(clips, frames, frames)
    cells = [
        Cell(
            f"{plugin.name}: {summary(plugin)}",
            [radiance_tile(clip, _middle(clip), scales, clip.label or "") for clip in family],
        )
        for plugin, family in shown
    ]
    line = f"{_SIDE} x {_SIDE} pixels, default parameters; {describe_scales(scales, set())}"
    write_atomic(path, png_bytes(draw_sheet(cells, "scene families", line, scales, set())))
    return left_out


def _samples(plugin: Plugin, bar: Bar) -> list[Clip]:
    from simulator.dataset.engines import available_cpus
    from simulator.dataset.recipe import scene_clip
    from simulator.plugins import plugin_errors
    from simulator.render import Renderer
    from simulator.render.backend import activate, choose_backend

    variant = choose_backend().variant
    activate(variant, threads=available_cpus())
    clips: list[Clip] = []
    with plugin_errors(plugin):
        source = plugin.function(_view(plugin.name), **plugin.bind({}), renderer=Renderer(variant))
        for number in range(SAMPLES):
            clips.append(scene_clip(source, 0, "train", number))
            bar.update(plugin.name, number + 1, SAMPLES)
    return clips


def _view(family: str) -> View:
    """Return the view of the family's preset, or of the default one: families differ in the depths that they need."""
    import yaml

    from simulator.assembly import Assembly
    from simulator.config import config_from_dict
    from simulator.presets import DEFAULT, preset_names, preset_text

    chosen = next((name for name in preset_names() if name.startswith(family)), DEFAULT)
    view = Assembly(config_from_dict(yaml.safe_load(preset_text(chosen)))).image_view
    return replace(view, shape=(_SIDE, _SIDE), pixel_pitch_m=view.pixel_pitch_m * view.shape[1] / _SIDE)


def _middle(clip: Clip) -> int:
    return len(clip.rgb) // 2


def scenes(
    names: Annotated[list[str] | None, typer.Argument(help="families and sources to list; all when left out")] = None,
    thumbnails: Annotated[
        Path | None, typer.Option("--thumbnails", help="image to write: a few samples of each family (.png)")
    ] = None,
) -> None:
    """List the scene families and imported sources with their parameters; --thumbnails shows them too."""
    from simulator.plugin_listing import print_plugins
    from simulator.plugins import available, resolve

    if thumbnails is not None:
        check_output_file("--thumbnails", thumbnails, (".png",))
    sources = available("source")
    wanted = {
        "scene": [name for name in names if name not in sources] if names else available("scene"),
        "source": [name for name in names if name in sources] if names else sources,
    }
    plugins = [resolve(kind, name) for kind, chosen in wanted.items() for name in chosen]
    for kind, key in (("scene", "scene.family"), ("source", "scene.source")):
        if wanted[kind]:
            print_plugins(kind, key, wanted[kind])
    if thumbnails is not None:
        from simulator.console import Bar

        with Bar() as bar:
            left_out = draw_thumbnails(plugins, thumbnails, bar)
        if left_out:
            print(f"not drawn: {'; '.join(left_out)}")
        print(f"look at {thumbnails}")
