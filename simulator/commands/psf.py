"""`flatlight psf`: the PSF stack of a configuration, how good it is, and what a calibration would make of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.commands.shared import ConfigPath, Overrides, check_output_file, check_output_folder

if TYPE_CHECKING:
    from simulator.assembly import Assembly


def captured_folder(output: Path) -> Path:
    """Return where the captured stack is written, beside the true one, and refuse a place that holds something else.

    Raises:
        InputError: something other than a stack is there.
    """
    from simulator.optics.stack_files import check_replaceable, stack_folder

    folder = stack_folder(output, captured=True)
    check_replaceable(folder)
    return folder


def captured_image(plot: Path) -> Path:
    """Return where the comparison with the captured stack is drawn, beside the true one's image."""
    return plot.with_stem(f"{plot.stem}_captured")


def show_captured(assembly: Assembly, output: Path | None, plot: Path | None) -> None:
    """Compute the stack as captured, print how it differs from the true one, write and draw both side by side.

    ``output``: folder of the true stack; the captured one goes into ``<output>_captured``.
    ``plot``: image of the true stack; the comparison goes into ``<plot>_captured.png``.
    """
    from simulator.captured_psf import captured_stack
    from simulator.console import Bar
    from simulator.optics.stack_files import write_psf_stack
    from simulator.plots.captured import describe_captured

    nominal = assembly.psf_stack
    with Bar() as bar:
        captured = captured_stack(replace(assembly, progress=bar.update).having(psf_stack=nominal))
    print(f"\n{describe_captured(nominal, captured)}")
    if output:
        folder = captured_folder(output)
        write_psf_stack(folder, captured)
        print(f"wrote {folder}")
    if plot:
        from simulator.plots.captured import plot_captured

        image = plot_captured(nominal, captured, captured_image(plot))
        print(f"look at {image}")


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
    from simulator.assembly import Assembly
    from simulator.captured_psf import check_calibration
    from simulator.config import load_config
    from simulator.console import Bar, describe_stack
    from simulator.dataset.engines import available_cpus
    from simulator.optics.stack_files import check_replaceable, write_psf_stack

    if plot:
        for image in (plot, captured_image(plot)) if as_captured else (plot,):
            check_output_file("--plot", image, (".png",))
    loaded = load_config(config, set_ or [])
    if output:
        check_output_folder("--output", output)
        check_replaceable(output)
        if as_captured:
            captured_folder(output)
    if as_captured:
        check_calibration(Assembly(loaded))
    with Bar() as bar:
        assembly = Assembly(loaded, threads=available_cpus(), progress=bar.update)
        stack = assembly.checked_stack if check or assembly.wants_full_check else assembly.psf_stack
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
            stack, assembly.mask, plot, scene_shape=loaded.scene.size, sensor_shape=loaded.camera.sensor.shape
        )
        print(f"look at {plot}")
    if as_captured:
        show_captured(assembly.having(psf_stack=stack), output, plot)
