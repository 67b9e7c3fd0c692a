"""Entry points of installed packages: packages of plugins, and commands that other rooms and packages add.

Apart from the plugins, so that ``flatlight --help`` starts without the validation library.
"""

from __future__ import annotations

import os
import sys
from functools import cache
from typing import TYPE_CHECKING

from simulator.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint  # imported on use: it would take a tenth of the start

_COMMANDS = "flatlight.commands"
_PRESETS = "flatlight.presets"


def entry_points(group: str) -> list[EntryPoint]:
    """Return the entry points of a group, by name."""
    return list(_installed(group, tuple((place, _changed_ns(place)) for place in sys.path)))


@cache
def _installed(group: str, places: tuple[tuple[str, int], ...]) -> list[EntryPoint]:
    """``places``: where packages lie, and when one was last put there or taken away."""
    from importlib.metadata import entry_points as installed

    return sorted(installed(group=group), key=lambda entry: (entry.name, entry.value))


def _changed_ns(place: str) -> int:
    try:
        return os.stat(place or ".").st_mtime_ns
    except OSError:
        return 0


def commands() -> dict[str, EntryPoint]:
    """Return the commands that other rooms and packages add, by name; ``.load()`` imports one.

    Raises:
        InputError: when two packages add the same command.
    """
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(_COMMANDS):
        other = found.setdefault(entry.name, entry)
        if other.value != entry.value:
            raise InputError(
                "", f"command {entry.name!r} is defined by both {other.value} and {entry.value}; uninstall one of them"
            )
    return found


def preset_packages() -> list[str]:
    """Return the names of packages whose YAML files are offered as presets beside the simulator's own."""
    return [entry.value for entry in entry_points(_PRESETS)]
