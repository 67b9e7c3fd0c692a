"""``render``: the scenes of a configuration as images, without any camera."""

from __future__ import annotations

import json
from collections.abc import Sized
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.commands.shared import ConfigPath, Overrides, check_output_file
from simulator.errors import InputError
from simulator.text import nearest

if TYPE_CHECKING:
    from simulator.config import Config
    from simulator.console import Bar
    from simulator.types import Clip

# What users write, and what the renderer calls it.
_OUTPUTS = {"ids": "shape_id", "normals": "normal", "albedo": "albedo", "motion": "motion", "hidden": "hidden"}
_PROBLEMS = 5  # that are shown one by one
_SAMPLES = {".png": 16, ".gif": 9, ".webp": 9, ".exr": 1}


def render(
    config: ConfigPath,
    set_: Overrides = None,
    split: Annotated[str, typer.Option("--split", help="train, validation or test")] = "train",
    index: Annotated[int, typer.Option("--index", min=0, help="number of the first sample within its split")] = 0,
    samples: Annotated[
        int | None,
        typer.Option("--samples", min=1, help="how many; 16 on a sheet, 9 in an animation", show_default=False),
    ] = None,
    outputs: Annotated[
        str | None,
        typer.Option(
            "--outputs", metavar="LIST", help=f"what to show beside colour and depth: some of {','.join(_OUTPUTS)}"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            help="contact sheet (.png), animation (.gif, .webp) or linear values of one sample (.exr)",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Render scenes as `generate` would see them: a contact sheet, an animation, or OpenEXR."""
    from simulator.config import load_config
    from simulator.console import Bar
    from simulator.dataset.sample import SPLITS
    from simulator.io.clips import write_linear
    from simulator.io.files import write_atomic
    from simulator.plots.clips import ANIMATIONS, animation, clip_sheet
    from simulator.plots.drawing import png_bytes

    path = output or Path(f"{config.stem}_{split}.png")
    check_output_file("--output", path, tuple(_SAMPLES))
    kind = path.suffix.lower()
    count = _count(kind, samples)
    if split not in SPLITS:
        raise InputError("--split", f"got {split!r}, expected one of {', '.join(SPLITS)}{nearest(split, list(SPLITS))}")
    asked = [] if outputs is None else [f"render.outputs={json.dumps(_renderer_names(outputs))}"]
    loaded = load_config(config, [*(set_ or []), *asked])
    with Bar() as bar, loaded.refusals():
        numbers, clips = _clips(
            loaded, split, range(index, index + count), bar, free=outputs is None and kind == ".png"
        )
        if kind == ".exr":
            written = write_linear(path, clips[0])
        else:
            title = _title(loaded, split, numbers, clips)
            labels = (f": {clip.label}" if clip.label else "" for clip in clips)
            captions = [f"{split} {number}{label}" for number, label in zip(numbers, labels, strict=True)]
            if kind in ANIMATIONS:
                bar.say("drawing the animation")
                content = animation(clips, captions, title, kind)
            else:
                content = png_bytes(clip_sheet(clips, captions, title))
            write_atomic(path, content)
            written = [path]
    print(f"look at {written[0]}" + (f" to {written[-1].name}" if len(written) > 1 else ""))


def _clips(config: Config, split: str, numbers: range, bar: Bar, *, free: bool) -> tuple[range, list[Clip]]:
    """Return the clips of samples, and their numbers: a source with an end gives none twice.

    ``free``: nobody said what to show, so that moving scenes may also show their motion.
    """
    from simulator.assembly import Assembly
    from simulator.dataset.engines import available_cpus
    from simulator.dataset.recipe import scene_clip
    from simulator.importers.inspection import first_lines
    from simulator.plugins import plugin_errors
    from simulator.render.backend import activate, choose_backend

    plugin = Assembly(config).scene_plugin
    variant = "none"
    if plugin.takes_renderer:
        backend = choose_backend(config.render.backend, config.render.bands is not None)
        bar.say(f"rendering with {backend.message}" + (f". {backend.advice}" if backend.advice else ""))
        variant = backend.variant
        activate(variant, threads=available_cpus())
    elif config.render.outputs:
        wanted = ", ".join(config.render.outputs)
        raise InputError("render.outputs", f"got {wanted}, but {plugin.name} holds colour and depth only; leave it out")
    clips: list[Clip] = []
    source = Assembly(config, variant).source
    if problems := tuple(getattr(source, "problems", ())):
        listed = "\n  ".join(first_lines(problems, _PROBLEMS))
        bar.say(f"note: {len(problems)} files or videos cannot be used, and are left out:\n  {listed}")
    if isinstance(source, Sized):
        numbers = numbers[: max(1, len(source))]
    for number in numbers:
        with plugin_errors(plugin):
            clip = scene_clip(source, config.seed, split, number)
        if free and not clips and plugin.takes_renderer and len(clip.rgb) > 1 and not config.render.outputs:
            # Only now is it known that something moves.
            moving = config.render.model_copy(update={"outputs": ("motion",)})
            source = Assembly(config.model_copy(update={"render": moving}), variant).source
            with plugin_errors(plugin):
                clip = scene_clip(source, config.seed, split, number)
        clips.append(clip)
        bar.update("samples rendered", len(clips), len(numbers))
    return numbers, clips


def _title(config: Config, split: str, numbers: range, clips: list[Clip]) -> str:
    rows, columns = config.scene.size
    which = f"{split} {numbers[0]}" + (f" to {numbers[-1]}" if len(numbers) > 1 else "")
    frames = max(len(clip.rgb) for clip in clips)
    several = f", {frames} frames" if frames > 1 else ""
    samples = clips[0].source.get("samples_per_pixel")
    paths = f", {samples} samples per pixel" if samples else ""
    return f"{config.scene.family or config.scene.source}: {which}, {rows} x {columns} pixels{several}{paths}"


def _renderer_names(text: str) -> list[str]:
    names = [word.strip() for word in text.split(",") if word.strip()]
    for name in names:
        if name not in _OUTPUTS:
            raise InputError("--outputs", f"got {name!r}, expected {','.join(_OUTPUTS)}{nearest(name, list(_OUTPUTS))}")
    return [_OUTPUTS[name] for name in dict.fromkeys(names)]


def _count(kind: str, samples: int | None) -> int:
    if kind == ".exr" and samples not in (None, 1):
        raise InputError("--samples", f"got {samples}, but an EXR holds one sample; choose it with --index")
    return _SAMPLES[kind] if samples is None else samples
