"""``shutter``: when the sensor's rows are open, what that means for the scenes, and figures of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import ConfigPath, Overrides, check_output_folder


def shutter(
    config: ConfigPath,
    set_: Overrides = None,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="draw the shutter, flashes and depths into this folder (PNG)")
    ] = None,
) -> None:
    """Say when the rows are open, how many frames come apart, whether the scenes last; draw what the camera makes of it."""
    from simulator.assembly import Assembly
    from simulator.config import load_config
    from simulator.console import Bar
    from simulator.dataset.engines import available_cpus
    from simulator.plots.shutter_bench import shutter_facts

    if figures:
        check_output_folder("--figures", figures)
    loaded = load_config(config, set_ or [])
    rows = loaded.camera.sensor.shape[0]
    assembly = Assembly(loaded)
    facts = shutter_facts(
        assembly.shutter, rows, loaded.scene.params, loaded.dataset.slivers, light=assembly.nearest_light
    )
    width = max(len(what) for what, _ in facts)
    print("\n".join(f"{what:>{width}}  {value}" for what, value in facts))
    if figures:
        from simulator.plots.shutter_bench import Bench
        from simulator.plots.shutter_figures import draw_figures

        with Bar() as bar:
            bench = Bench(Assembly(loaded, threads=available_cpus(), progress=bar.update))
        for path in draw_figures(bench, figures):
            print(f"look at {path}")
