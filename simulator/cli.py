"""The command ``flatlight``: its options, its commands and what its exit codes mean."""

from __future__ import annotations

import errno
import os
import sys
from typing import Annotated

import typer

from simulator import __version__
from simulator.commands import (
    calibrating,
    compare,
    datasets,
    exporting,
    importing,
    masks,
    psf,
    render,
    reporting,
    scenes,
    shutter,
)
from simulator.errors import InputError
from simulator.text import described, show


def schema() -> None:
    """Print the JSON schema of sim_config.yaml, for editors."""
    import json

    from simulator.config import json_schema

    print(json.dumps(json_schema(), indent=2))


def doctor() -> None:
    """Say what this machine offers, and what to install to go faster."""
    from simulator.console import print_checks
    from simulator.doctor import diagnose

    print_checks(diagnose())


def _version(wanted: bool) -> None:
    if wanted:
        print(f"flatlight {__version__}")
        raise typer.Exit


def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="print the version")
    ] = False,
) -> None:
    """Options of the command itself."""


_OWN = (
    datasets.init,
    datasets.generate,
    datasets.status,
    datasets.regenerate,
    datasets.merge,
    render.render,
    psf.psf,
    calibrating.calibrate,
    shutter.shutter,
    compare.compare,
    masks.masks,
    masks.export_mask,
    scenes.scenes,
    masks.materials,
    datasets.verify,
    exporting.export,
    reporting.report,
    schema,
    doctor,
)


def _command_line() -> typer.Typer:
    """Return the simulator's commands and those that other rooms and packages add."""
    from simulator.entry_points import commands

    app = typer.Typer(
        help="Flatlight: a physically based simulator of lensless cameras.",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_options)
    for command in _OWN:
        app.command()(command)
    app.command("import")(importing.import_check)  # a word that no function can be called
    for name, entry in commands().items():
        try:
            app.command(name)(entry.load())
        except (Exception, SystemExit) as error:  # another package's fault must not take our own commands away
            reason = f"({entry.value}) cannot be loaded: {described(error)}"
            print(f"warning: the command {name!r} {reason}", file=sys.stderr)
    return app


_CURES = {
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
    errno.EACCES: "permission denied; ask its owner, or choose another place",
}


def main() -> None:
    """Run the command: one clear line per mistake, exit code 2 for the user's, 1 for ours."""
    if sys.platform == "win32":  # workers, locks and files that survive a power cut are made for Unix
        print("error: flatlight runs on Linux; on Windows, install and use it in WSL 2", file=sys.stderr)
        raise SystemExit(2)
    try:
        _command_line()(standalone_mode=True)
    except InputError as error:
        print("error: " + (f"{error.place}: " if error.place else "") + str(error), file=sys.stderr)
        raise SystemExit(2) from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _CURES:  # whichever option it came from
            print(f"error: {show(str(error.filename))}: {_CURES[error.errno]}", file=sys.stderr)
            raise SystemExit(2) from None
        if os.environ.get("FLATLIGHT_TRACEBACK"):
            raise
        print(f"internal error: {described(error)}", file=sys.stderr)
        print("This is a fault of flatlight; FLATLIGHT_TRACEBACK=1 shows where it is.", file=sys.stderr)
        raise SystemExit(1) from None
    except SystemExit as end:
        if end.code == 130:  # what typer makes of Ctrl-C
            print("\nstopped; what is finished is kept, and the same command goes on from there", file=sys.stderr)
        raise
