"""``psf``: the PSF stack of a configuration and how good it is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.options import ConfigPath, Overrides
from simulator.commands.outputs import check_output_file, check_output_folder


def psf(
    config: ConfigPath,
    set_: Overrides = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="draw mask, PSFs, cross-sections, MTF to this PNG")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", help="write the stack to this folder (EXR)")] = None,
    check: Annotated[
        bool, typer.Option("--check", help="measure every error, against direct sums and exact PSFs too (minutes)")
    ] = False,
    as_captured: Annotated[
        bool, typer.Option("--as-captured", help="simulate a real calibration too (psf.as_captured) and compare")
    ] = False,
) -> None:
    """Compute the PSF stack of a configuration and say how good it is."""
    from simulator.assemble import build_mask, build_psf_stack, check_calibration, check_psf_stack, wants_full_check
    from simulator.commands.captured import captured_folder, captured_picture, show_captured
    from simulator.config import load_config
    from simulator.console import Bar, describe_stack
    from simulator.dataset.engines import available_cpus
    from simulator.optics.stack_files import check_replaceable, write_psf_stack

    if plot:
        for picture in (plot, captured_picture(plot)) if as_captured else (plot,):
            check_output_file("--plot", picture, (".png",))
    loaded = load_config(config, set_ or [])
    if output:
        check_output_folder("--output", output)
        check_replaceable(output)
        if as_captured:
            captured_folder(output)
    if as_captured:
        check_calibration(loaded)
    with Bar() as bar:
        stack = build_psf_stack(loaded, threads=available_cpus(), progress=lambda a, b: bar.update("PSFs", a, b))
        if check or wants_full_check(loaded):
            stack = check_psf_stack(loaded, stack, threads=available_cpus(), progress=bar.update)
    print(describe_stack(stack, loaded.camera.sensor.shape, loaded.scene.size))
    if stack.provenance.get("errors", {}).get("check") == "full":
        from simulator.plots.psf_facts import budget_tables

        print(f"\n{budget_tables(stack.provenance['errors'], stack.provenance['sampling'])}")
    if output:
        write_psf_stack(output, stack)
        print(f"wrote {output}")
    if plot:
        from simulator.plots.psf import plot_psf_stack

        plot_psf_stack(
            stack,
            build_mask(loaded),
            plot,
            scene_shape=loaded.scene.size,
            sensor_shape=loaded.camera.sensor.shape,
        )
        print(f"look at {plot}")
    if as_captured:
        show_captured(loaded, stack, output, plot)
