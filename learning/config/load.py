"""Loading: file and overrides become a section, or one clear line per fault with its place."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import PrivateAttr, ValidationError

from simulator.config.load import ConfigError
from simulator.config.sections import Section
from simulator.config.yaml import apply_overrides, read_yaml
from simulator.errors import InputError
from simulator.text import show
from simulator.validation import find_problems, validate


class FileSection(Section):
    """The whole of a YAML file; relative paths in it are taken from its folder."""

    _base_dir: Path = PrivateAttr(default_factory=Path.cwd)

    @property
    def base_dir(self) -> Path:
        """The YAML file's folder (absolute); no part of the dump."""
        return self._base_dir

    def resolve_path(self, text: str | Path) -> Path:
        """Return a path of this file as an absolute one."""
        return self._base_dir / Path(text).expanduser()

    def dump(self) -> dict[str, Any]:
        """Return plain data for JSON with all defaults."""
        return self.model_dump(mode="json")


Model = TypeVar("Model", bound=FileSection)


def load_file(model: type[Model], path: Path | str, overrides: Sequence[str] = ()) -> Model:
    """Load a YAML file: defaults, then the file, then the overrides.

    Args:
        model: what the file must be.
        path: the file.
        overrides: ``a.b=c`` each, as in `simulator.config.load_config`.

    Raises:
        InputError: one line ``file:line:column: key: problem`` per fault; for overrides ``--set a.b=c: ...``.
    """
    path = Path(path)
    document = read_yaml(path, str(path))
    if not isinstance(document.data, dict):
        msg = f"{path}:1:1: expected a mapping of keys to values, got {show(document.data)}"
        raise InputError(msg)
    data, origins = apply_overrides(document, overrides, str(path))
    try:
        loaded = validate(model, data)
    except ValidationError as error:
        raise ConfigError(find_problems(error, model, data), origins) from error
    loaded._base_dir = path.resolve().parent
    return loaded
