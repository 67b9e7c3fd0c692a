"""Lists of designs, families and sources: what each is, and its parameters with type, range, default and meaning.

All of it is read from the plugin's own code: the first line of its module, its signature and its docstring.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from simulator.plugins import Plugin, available, resolve
from simulator.text import documented

if TYPE_CHECKING:
    from rich.console import Group

_TYPES = {float: "number", int: "whole number", bool: "true or false", str: "text", Path: "path"}


@dataclass(frozen=True)
class ParameterLine:
    """One parameter as users read it.

    Attributes:
        name: its key.
        default: as it would stand in YAML, or ``required``.
        expected: its type and range in words.
        meaning: from the docstring, one line.
    """

    name: str
    default: str
    expected: str
    meaning: str


def print_plugins(kind: str, key: str, names: Iterable[str] = ()) -> None:
    """Print plugins and their parameters: tables on a terminal, plain lines elsewhere.

    Args:
        kind: ``mask``, ``scene`` or ``source``.
        key: the configuration's key that takes the name.
        names: those to print; none means all.

    Raises:
        InputError: for an unknown name.
    """
    from rich.console import Console

    plugins = [resolve(kind, name) for name in names or available(kind)]
    console = Console(highlight=False)
    if not console.is_terminal:
        print(plugin_lines(key, plugins))
        return
    console.print(f"[bold]{key}[/]")
    for plugin in plugins:
        console.print(plugin_table(plugin))


def plugin_lines(key: str, plugins: Iterable[Plugin]) -> str:
    """Return plain lines: a plugin's name and summary, then ``parameter: default`` with what is expected and meant."""
    lines = [f"{key}:"]
    for plugin in plugins:
        lines.append(f"  {plugin.name}: {summary(plugin)}")
        shown = [(f"{line.name}: {line.default}", line) for line in parameter_lines(plugin)]
        width = max((len(text) for text, _ in shown), default=0)
        for text, line in shown:
            meaning = f"; {line.meaning}" if line.meaning else ""
            lines.append(f"      {text:<{width}}  {line.expected}{meaning}")
    return "\n".join(lines)


def plugin_table(plugin: Plugin) -> Group:
    """Return the same for a terminal: name and summary above a table."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Group
    from rich.markup import escape
    from rich.table import Table

    table = Table("key", "default", "expected", "meaning", box=SIMPLE_HEAD)
    for line in parameter_lines(plugin):
        table.add_row(f"[cyan]{escape(line.name)}[/]", *map(escape, (line.default, line.expected, line.meaning)))
    return Group(f"[bold]{escape(plugin.name)}[/]  {escape(summary(plugin))}", table)


def summary(plugin: Plugin) -> str:
    """Return what a plugin is and where it was published: the first line of its module, else of its function."""
    described = sys.modules[plugin.function.__module__].__doc__ or plugin.function.__doc__ or ""
    return described.strip().split("\n")[0]


def parameter_lines(plugin: Plugin) -> Iterator[ParameterLine]:
    """Yield a plugin's parameters in the order of its signature."""
    meanings = documented(inspect.getdoc(plugin.function) or "", "Args")
    for name, field in plugin.parameters.model_fields.items():
        default = "required" if field.is_required() else _as_yaml(field.default)
        expected = _expected(field.annotation, field.metadata)
        yield ParameterLine(name, default, expected, meanings.get(name, ""))


def _as_yaml(value: Any) -> str:
    if isinstance(value, bool | NoneType):
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_as_yaml, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _expected(annotation: Any, metadata: Iterable[Any] = ()) -> str:
    """Return a type and its range in words."""
    origin = get_origin(annotation)
    if origin is Annotated:
        inner, *more = get_args(annotation)
        return _expected(inner, more)
    if origin in (Union, UnionType):
        return " or ".join(_expected(part, metadata) for part in get_args(annotation) if part is not NoneType)
    if origin is Literal:
        return " | ".join(_as_yaml(value) for value in get_args(annotation))
    if origin in (tuple, list):
        return _several(get_args(annotation), fixed=origin is tuple)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel) and "type" in annotation.model_fields:
        return f"{{type: {_expected(annotation.model_fields['type'].annotation)}, ...}}"
    words = _TYPES.get(annotation, getattr(annotation, "__name__", str(annotation)))
    limits = _limits(metadata)
    return f"{words} {limits}" if limits else words


def _several(items: tuple[Any, ...], *, fixed: bool) -> str:
    """Return a list's items in words: ``list of paths``, ``3 numbers from 0``, ``list of round | square``."""
    kinds = [_expected(item) for item in items if item is not Ellipsis]
    if not kinds:
        return "list"
    if len(set(kinds)) > 1:
        return f"list of {', '.join(kinds)}"
    many = re.sub(r"^(number|whole number|path|text|list)\b", r"\1s", kinds[0])
    return f"{len(kinds)} {many}" if fixed and Ellipsis not in items else f"list of {many}"


def _limits(metadata: Iterable[Any]) -> str:
    """Return the bounds that pydantic's ``Field`` carries in words, such as ``over 0 to 20``."""
    found: dict[str, Any] = {}
    for item in metadata:
        for part in (item, *getattr(item, "metadata", ())):  # an Annotated Field inside a union keeps its own list
            found |= {name: getattr(part, name) for name in ("ge", "gt", "le", "lt") if hasattr(part, name)}
    low = f"from {found['ge']:g}" if "ge" in found else f"over {found['gt']:g}" if "gt" in found else ""
    high = f"to {found['le']:g}" if "le" in found else f"to under {found['lt']:g}" if "lt" in found else ""
    return f"{low} {high}".strip()
