"""``import``: what a data set's folder holds, before a configuration relies on it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from simulator.errors import InputError

if TYPE_CHECKING:
    from simulator.importers import Survey
    from simulator.plugins import Plugin

_EXAMPLE_SIZE = "[128, 128]"


def import_check(
    path: Annotated[Path, typer.Argument(help="folder, film or table to read and report on", show_default=False)],
    check: Annotated[bool, typer.Option("--check", help="read and report, as without it")] = False,
    source: Annotated[
        str | None,
        typer.Option("--source", metavar="NAME", help="importer; found by the folder's layout when left out"),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="a parameter of the importer, e.g. subset=val"),
    ] = None,
    skip_bad: Annotated[bool, typer.Option("--skip-bad", help="list what is bad, but do not fail for it")] = False,
) -> None:
    """Say what a folder looks like, how confidently and why; then read it once and report; nothing is copied or changed."""
    from simulator.config.yaml import apply_overrides, parse_yaml
    from simulator.console import Bar
    from simulator.importers.inspection import choose, find_candidates, run_survey
    from simulator.plugins import resolve

    if not path.exists():
        raise InputError(path, "there is no such file or folder; expected a data set in its original layout")
    options, _ = apply_overrides(parse_yaml("{}", "--set"), set_ or [], "--set")
    with Bar() as bar:
        if source is not None:
            plugin = resolve("source", source)
        else:
            candidates = find_candidates(path)
            for line in candidates.broken:
                bar.say(f"warning: this source cannot be asked: {line}")
            plugin = choose(path, candidates)
            print(f"{path} looks like\n{candidates}", flush=True)
        survey = run_survey(plugin, path, options, lambda done, total: bar.update("read", done, total))
    print(survey)
    if not survey.usable:
        raise InputError(survey.path, "nothing can be used; mend the problems above, or check the path")
    if survey.problems and not skip_bad:
        raise InputError(
            survey.path, f"{len(survey.problems)} problems, see above; mend them, or go on with --skip-bad"
        )
    print(_usage(plugin, path, options, survey))


def _usage(plugin: Plugin, path: Path, options: dict[str, Any], survey: Survey) -> str:
    """The lines of a configuration that use the folder; what has no default, or is needed, is left open and explained."""
    from simulator.plugin_listing import parameter_lines

    given = dict(survey.found) | options
    required = [
        line
        for line in parameter_lines(plugin)
        if (line.default == "required" or line.name in survey.needed) and line.name not in ("path", *given)
    ]
    values = {
        "source": plugin.name,
        "path": json.dumps(str(path.resolve()), ensure_ascii=False),
        "size": _EXAMPLE_SIZE,
        **{name: json.dumps(value, ensure_ascii=False) for name, value in given.items()},
        **{line.name: "..." for line in required},
    }
    lines = [
        "use it in sim_config.yaml with",
        f"  scene: {{{', '.join(f'{key}: {value}' for key, value in values.items())}}}",
    ]
    hints = {name: hint for name, hint in survey.hints.items() if name not in options}
    for line in required:
        here = f"; {hints.pop(line.name)}" if line.name in hints else ""
        lines.append(f"  where {line.name} is: {line.expected}; {line.meaning}{here}")
    lines += [f"  {name}: {hint}" for name, hint in hints.items() if name in given]
    return "\n".join(lines)
