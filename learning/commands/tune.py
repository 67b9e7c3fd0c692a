"""``tune``: the best parameters of the classical methods, for each noise level."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import Overrides


def tune(
    config: Annotated[
        Path, typer.Argument(help="YAML file: data, methods, noise levels, objective", show_default=False)
    ],
    set_: Overrides = None,
) -> None:
    """Tune the classical methods on validation scenes, each noise level by itself; a run that stopped goes on."""
    from learning.config.load import load_file
    from learning.config.tune import TuneConfig
    from learning.tuning import load_tuned
    from learning.tuning.job import tune_file
    from learning.tuning.summary import table
    from simulator.console import Bar

    loaded = load_file(TuneConfig, config, set_ or [])
    with Bar() as bar:
        path = tune_file(loaded, progress=bar.update, say=bar.say)
    print(table(load_tuned(path).content))
    print(f"wrote {path}")
