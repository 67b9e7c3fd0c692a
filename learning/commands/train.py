"""``flatlight train``: a network from a data set."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import Overrides


def train(
    config: Annotated[
        Path,
        typer.Argument(help="training (YAML); `flatlight init --preset flatnet3d_64` writes one", show_default=False),
    ],
    set_: Overrides = None,
) -> None:
    """Train a network on a data set, or go on with a training that was interrupted."""
    from learning.train import train as run
    from simulator.console import Bar

    with Bar() as bar:
        result = run(config, set_ or [], show=bar.update, say=bar.say)
    best = result.best
    what = (
        f"{result.steps} steps, {result.seconds:.0f} s in all"
        if result.steps
        else "was finished before; raise steps to go on"
    )
    print(f"{result.folder}: {what}")
    print(
        f"best after step {best['step']:.0f}: PSNR {best['psnr_db']:.2f} dB, depth RMSE {best['depth_rmse_cm']:.2f} cm on "
        f"validation; {result.folder / 'best.safetensors'}"
    )
    print(f"look at {result.folder / 'validation.png'}, or at the curves: tensorboard --logdir {result.folder}")
