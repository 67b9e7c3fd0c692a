"""``compare``: mask designs side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import Overrides, check_output_file


def compare(
    candidates: Annotated[
        list[str],
        typer.Argument(
            metavar="MASK_OR_CONFIG...",
            help="designs (a name, ./file.py:name or '{design: pinhole, diameter_um: 80}') or configurations (*.yaml)",
            show_default=False,
        ),
    ],
    output: Annotated[Path, typer.Option("--output", help="the page (.html) or image (.png) to write")],
    config: Annotated[
        Path, typer.Option("--config", help="configuration whose camera and depths all designs share")
    ] = Path("sim_config.yaml"),
    depths: Annotated[
        int,
        typer.Option("--depths", min=2, help="how many of the configuration's depths are compared, evenly chosen"),
    ] = 7,
    set_: Overrides = None,
) -> None:
    """Compare mask designs: PSFs, contrast, sharpness, depths told apart, light; as one page or image."""
    from simulator.console import Bar
    from simulator.dataset.engines import available_cpus
    from simulator.io.files import write_atomic
    from simulator.plots.comparison import load_configs, measure
    from simulator.plots.comparison_page import comparison_html, comparison_png

    check_output_file("--output", output, (".html", ".png"))
    configs = load_configs(candidates, config, set_ or [])
    with Bar() as bar:
        shared = {"depths": depths, "threads": available_cpus(), "progress": bar.update}
        measured = [measure(name, one, **shared) for name, one in configs.items()]
        bar.say("drawing the images")
    content = comparison_html(measured).encode() if output.suffix.lower() == ".html" else comparison_png(measured)
    write_atomic(output, content)
    print(f"look at {output}")
