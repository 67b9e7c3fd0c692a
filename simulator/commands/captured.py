"""``psf --as-captured``: what a calibration of the configured camera would make of its PSFs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simulator.config import Config
    from simulator.optics.stack import PsfStack


def captured_folder(output: Path) -> Path:
    """Return where the captured stack is written, beside the true one, and refuse a place that holds something else.

    Raises:
        InputError: something other than a stack is there.
    """
    from simulator.optics.stack_files import check_replaceable, stack_folder

    folder = stack_folder(output, captured=True)
    check_replaceable(folder)
    return folder


def captured_picture(plot: Path) -> Path:
    """Return where the comparison with the captured stack is drawn, beside the true one's picture."""
    return plot.with_stem(f"{plot.stem}_captured")


def show_captured(config: Config, nominal: PsfStack, output: Path | None, plot: Path | None) -> None:
    """Compute the stack as captured, print how it differs from the true one, write and draw both side by side.

    Args:
        config: the configuration.
        nominal: its true stack.
        output: folder of the true stack; the captured one goes into ``<output>_captured``.
        plot: picture of the true stack; the comparison goes into ``<plot>_captured.png``.
    """
    from simulator.assemble import build_captured_stack
    from simulator.console import Bar
    from simulator.dataset.engines import available_cpus
    from simulator.optics.stack_files import write_psf_stack
    from simulator.plots.captured import describe_captured

    with Bar() as bar:
        captured = build_captured_stack(
            config, nominal, threads=available_cpus(), progress=lambda a, b: bar.update("captured PSFs", a, b)
        )
    print(f"\n{describe_captured(nominal, captured)}")
    if output:
        folder = captured_folder(output)
        write_psf_stack(folder, captured)
        print(f"wrote {folder}")
    if plot:
        from simulator.plots.captured import plot_captured

        picture = plot_captured(nominal, captured, captured_picture(plot))
        print(f"look at {picture}")
