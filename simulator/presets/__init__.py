"""Configurations to start from, one commented YAML file each; `flatlight init --preset NAME` writes a copy."""

from __future__ import annotations

from importlib.resources import files

from simulator.config import default_config_text
from simulator.errors import InputError
from simulator.validation import nearest

DEFAULT = "flying_things"
"""The configuration that `flatlight init` writes when nothing is said."""


def preset_names() -> list[str]:
    """Return the names of all presets, the default first."""
    own = sorted(
        entry.name.removesuffix(".yaml") for entry in files(__name__).iterdir() if entry.name.endswith(".yaml")
    )
    return [DEFAULT, *own]


def preset_text(name: str) -> str:
    """Return a preset's YAML.

    Raises:
        InputError: there is none of that name; the nearest one is named.
    """
    names = preset_names()
    if name not in names:
        msg = f"--preset: got {name!r}, expected one of {', '.join(names)}{nearest(name, names)}"
        raise InputError(msg)
    if name == DEFAULT:
        return default_config_text()
    return (files(__name__) / f"{name}.yaml").read_text(encoding="utf-8")
