"""``export``: a data set in the formats that others read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import check_output_folder


def export(
    path: Annotated[str, typer.Argument(help="folder of the data set, or its place in an object store")],
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help="webdataset, hdf5, npz or parquet-index")],
    output: Annotated[Path, typer.Option("--output", help="folder to write to; one that was begun is finished")],
    split: Annotated[
        list[str] | None, typer.Option("--split", help="train, validation or test; may be repeated [default: all]")
    ] = None,
    shard_mb: Annotated[
        int | None,
        typer.Option(
            "--shard-mb", min=1, help="size of webdataset's and hdf5's files at most, in 10^6 bytes; else 512"
        ),
    ] = None,
    partial: Annotated[
        bool, typer.Option("--partial", help="export what is finished of an unfinished data set")
    ] = False,
) -> None:
    """Export a data set; every sample is checked first. Runs none of its code."""
    from simulator.console import Bar
    from simulator.dataset.exports import export as run

    check_output_folder("--output", output)
    with Bar() as bar:
        result = run(
            path,
            to,
            output,
            splits=split or (),
            shard_bytes=None if shard_mb is None else shard_mb * 1_000_000,
            partial=partial,
            progress=lambda done, total: bar.update("samples exported", done, total),
        )
    files = sum(result.shards.values())
    kept = f", {result.kept} of them were there before" if result.kept else ""
    print(f"{result.samples} samples in {files} file(s), {result.bytes / 1e6:.3g} MB{kept}: {result.path}")
    if to == "webdataset":
        shards = ", ".join(f"{name} has {count}" for name, count in result.shards.items())
        print(f"shards: {shards}; give a loader at most so many workers, since more would shorten an epoch silently")
