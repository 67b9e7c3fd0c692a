"""``evaluate``: the table of all methods on the same scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import Overrides


def evaluate(
    config: Annotated[Path, typer.Argument(help="what is compared, on which scenes (YAML)", show_default=False)],
    set_: Overrides = None,
) -> None:
    """Compare networks and classical methods on test scenes; a run that stopped goes on from there."""
    from learning.config.evaluate import EvaluateConfig
    from learning.config.load import load_file
    from learning.evaluate import evaluate as run
    from learning.evaluation.report import terminal_table
    from simulator.console import Bar

    settings = load_file(EvaluateConfig, config, set_ or [])
    with Bar() as bar:
        findings, files = run(settings, progress=bar.update, say=bar.say)
    print(terminal_table([*findings.main, *findings.trivial], {one.method: one for one in findings.times}))
    print(f"look at {files[0]}")
