"""``report``: a data set as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import check_output_file
from simulator.plots.report import SAMPLES


def report(
    path: Annotated[str, typer.Argument(metavar="FOLDER", help="folder of the data set, or its place in a store")],
    output: Annotated[
        Path | None, typer.Option("--output", help="the page (.html); FOLDER/report.html", show_default=False)
    ] = None,
    samples: Annotated[int, typer.Option(min=1, help="samples shown, spread over the splits")] = SAMPLES,
) -> None:
    """Draw a data set, finished or still growing, as one page to look at; runs none of its code."""
    from simulator.io.files import write_atomic
    from simulator.plots.report.page import report_html, write_report

    if output is None:
        print(f"look at {write_report(path, samples=samples)}")
        return
    check_output_file("--output", output, (".html",))
    write_atomic(output, report_html(path, samples=samples).encode())
    print(f"look at {output}")
