"""The command ``flatlight``: thin; each command loads a configuration, calls one function and prints what it did."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from simulator import __version__
from simulator.errors import InputError

app = typer.Typer(
    help="Flatlight: a physically based simulator of lensless cameras.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

ConfigPath = Annotated[Path, typer.Argument(help="configuration; `flatlight init` writes one", show_default=False)]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override one setting, e.g. dataset.train=100")
]


@app.command()
def init(
    path: Annotated[Path, typer.Argument(help="file to write")] = Path("sim_config.yaml"),
    force: Annotated[bool, typer.Option("--force", help="overwrite an existing file")] = False,
) -> None:
    """Write a commented sim_config.yaml that runs as it is."""
    from simulator.config import default_config_text
    from simulator.files import write_atomic

    if path.exists() and not force:
        msg = f"{path} exists already; choose another name, or --force to overwrite it"
        raise InputError(msg)
    write_atomic(path, default_config_text().encode())
    print(f"wrote {path}; make its data set with: flatlight generate {path}")


@app.command()
def generate(config: ConfigPath, set_: Overrides = None) -> None:
    """Make a data set, or finish one that was begun."""
    from simulator.console import Bar
    from simulator.dataset.job import generate as run

    with Bar() as bar:
        result = run(config, set_ or [], progress=bar.update, say=bar.say)
    kept = f", {result.kept} were there before" if result.kept else ""
    print(f"{result.made} samples made in {result.seconds:.0f} s{kept}: {result.path}")
    if result.contact_sheet:
        print(f"look at {result.contact_sheet}")
    for line in result.failed:
        print(f"failed: {line}", file=sys.stderr)
    if result.failed:
        print(f"{len(result.failed)} samples failed; run the same command again to retry them", file=sys.stderr)
        raise typer.Exit(1)


@app.command()
def psf(
    config: ConfigPath,
    set_: Overrides = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="draw mask, PSFs, cross-sections, MTF to this PNG")
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", help="write the stack to this folder (EXR)")] = None,
) -> None:
    """Compute the PSF stack of a configuration and say how good it is."""
    from simulator.assemble import build_mask, build_psf_stack
    from simulator.config import load_config
    from simulator.console import Bar, describe_stack
    from simulator.dataset.engines import available_cpus
    from simulator.dataset.psf_files import check_replaceable, write_psf_stack

    if plot and not plot.absolute().parent.is_dir():
        msg = f"--plot: the folder {plot.parent} does not exist; make it first, or choose another"
        raise InputError(msg)
    loaded = load_config(config, set_ or [])
    if output:
        check_replaceable(output)
    with Bar() as bar:
        stack = build_psf_stack(loaded, threads=available_cpus(), progress=lambda a, b: bar.update("PSFs", a, b))
    print(describe_stack(stack, loaded.camera.sensor.shape, loaded.scene.size))
    if output:
        write_psf_stack(output, stack)
        print(f"wrote {output}")
    if plot:
        from simulator.optics.plot import plot_psf_stack

        plot_psf_stack(
            stack,
            build_mask(loaded),
            plot,
            scene_shape=loaded.scene.size,
            sensor_shape=loaded.camera.sensor.shape,
        )
        print(f"look at {plot}")


@app.command()
def masks() -> None:
    """List the mask designs and their parameters."""
    from simulator.console import describe_plugins

    print(describe_plugins("mask", "camera.mask.design"))


@app.command()
def scenes() -> None:
    """List the scene families and imported sources with their parameters."""
    from simulator.console import describe_plugins

    print(describe_plugins("scene", "scene.family") + "\n" + describe_plugins("source", "scene.source"))


@app.command()
def verify(
    path: Annotated[Path, typer.Argument(help="folder of the data set")],
    workers: Annotated[int, typer.Option(min=1, help="processes that check samples")] = 1,
) -> None:
    """Re-hash and re-read every file of a data set; runs none of its code."""
    from simulator.console import Bar
    from simulator.dataset.verify import verify as run

    with Bar() as bar:
        report = run(path, workers=workers, progress=lambda done, total: bar.update("samples checked", done, total))
    print(report)
    if not report.ok:
        raise typer.Exit(2)


@app.command()
def schema() -> None:
    """Print the JSON schema of sim_config.yaml, for editors."""
    import json

    from simulator.config import json_schema

    print(json.dumps(json_schema(), indent=2))


@app.command()
def doctor() -> None:
    """Say what this machine offers, and what to install to go faster."""
    from simulator.console import print_checks
    from simulator.doctor import diagnose

    print_checks(diagnose())


def _version(wanted: bool) -> None:
    if wanted:
        print(f"flatlight {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    """Options of the command itself."""


def main() -> None:
    """Run the command: one clear line per mistake, exit code 2 for the user's, 1 for ours."""
    from simulator.entry_points import commands

    try:
        for name, entry in commands().items():
            try:
                app.command(name)(entry.load())
            except Exception as error:  # another package's fault must not take our own commands away
                reason = f"{type(error).__name__}: {error}"
                print(f"warning: the command {name!r} ({entry.value}) cannot be loaded: {reason}", file=sys.stderr)
        app(standalone_mode=True)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except Exception as error:
        if os.environ.get("FLATLIGHT_TRACEBACK"):
            raise
        text = f"internal error: {type(error).__name__}: {error}"
        print(f"{text}\nThis is a fault of flatlight; FLATLIGHT_TRACEBACK=1 shows where it is.", file=sys.stderr)
        raise SystemExit(1) from None
    except SystemExit as end:
        if end.code == 130:  # what typer makes of Ctrl-C
            print("\nstopped; what is finished is kept, and the same command goes on from there", file=sys.stderr)
        raise
