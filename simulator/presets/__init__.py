"""Files to start from, one commented YAML each; `flatlight init --preset NAME` writes a copy.

The simulator's own are configurations of data sets; packages of the entry-point group ``flatlight.presets`` add others, such
as trainings.
"""

from __future__ import annotations

from importlib.resources import files
from importlib.resources.abc import Traversable

from simulator.config import default_config_text
from simulator.entry_points import preset_packages
from simulator.errors import InputError
from simulator.text import nearest

DEFAULT = "flying_things"
"""The configuration that `flatlight init` writes when nothing is said."""


def preset_names(*, others: bool = False) -> list[str]:
    """Return the names of the data sets' presets, the default first.

    Args:
        others: those that other packages add, too, behind them.
    """
    added = [name for package in preset_packages() for name in _files(package)] if others else []
    return [DEFAULT, *_files(__name__), *sorted(added)]


def preset_text(name: str) -> str:
    """Return a preset's YAML.

    Raises:
        InputError: there is none of that name; the nearest one is named.
    """
    names = preset_names(others=True)
    if name not in names:
        raise InputError("--preset", f"got {name!r}, expected one of {', '.join(names)}{nearest(name, names)}")
    if name == DEFAULT:
        return default_config_text()
    places = [_files(package) for package in (__name__, *preset_packages())]
    return next(place[name] for place in places if name in place).read_text(encoding="utf-8")


def _files(package: str) -> dict[str, Traversable]:
    """Return a package's YAML files by the names that they are offered under, sorted."""
    found = {
        entry.name.removesuffix(".yaml"): entry for entry in files(package).iterdir() if entry.name.endswith(".yaml")
    }
    return dict(sorted(found.items()))
