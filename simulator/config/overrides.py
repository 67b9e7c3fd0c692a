"""Overrides (``--set a.b=c``) on top of a document, and where each value of the result came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from simulator.config.yaml_loader import Document, Mark, YamlError, parse_yaml
from simulator.errors import InputError
from simulator.text import KeyPath, dotted, show


@dataclass
class Origins:
    """Where values came from: places in a file, or overrides; nothing for plain data.

    Attributes:
        name: what messages call the file.
        document: its places.
        overrides: text of the override that set a path.
    """

    name: str = ""
    document: Document = field(default_factory=lambda: Document(None))
    overrides: dict[KeyPath, str] = field(default_factory=dict)

    def find(self, path: KeyPath, on_key: bool) -> str | Mark | None:
        """Return the override or place of a path, else that of the nearest section around it."""
        for length in range(len(path), -1, -1):
            prefix = path[:length]
            if prefix in self.overrides:
                return self.overrides[prefix]
            own = length == len(path) and not on_key
            first, second = (self.document.values, self.document.keys)[:: 1 if own else -1]
            mark = first.get(prefix) or second.get(prefix)
            if mark is not None:
                return mark
        return None

    def label(self, path: KeyPath, on_key: bool) -> str:
        """Return the beginning of a message: ``file:line:column: ``, ``--set a.b=c: `` or nothing."""
        place = self.find(path, on_key)
        if isinstance(place, Mark):
            return f"{self.name}:{place.line}:{place.column}: "
        return f"--set {place}: " if place is not None else ""

    def order(self, path: KeyPath, on_key: bool) -> tuple[int, int, str]:
        """Return a sort key: the file from top to bottom, then the overrides."""
        place = self.find(path, on_key)
        if isinstance(place, Mark):
            return place.line, place.column, dotted(path)
        return 1 << 60, 0, dotted(path)


def apply_overrides(document: Document, overrides: Sequence[str], name: str) -> tuple[dict[str, Any], Origins]:
    """Set the overrides in a copy of the document's data.

    Args:
        document: with a mapping as its data.
        overrides: ``a.b=c`` each; a later one wins.
        name: what messages call the document.

    Raises:
        InputError: for an override without ``=``, with text that is no YAML, or below something that is no mapping.
    """
    origins = Origins(name, Document(document.data, dict(document.keys), dict(document.values)))
    data: dict[str, Any] = dict(document.data)
    for text in overrides:
        path, value = _parse(text)
        _set(data, path, value, text)
        for places in (origins.document.keys, origins.document.values, origins.overrides):
            for stale in [place for place in places if place[: len(path)] == path]:
                del places[stale]
        # Sections that the override had to make are its own too: an unknown one is reported at its top.
        made = [path[:length] for length in range(1, len(path)) if path[:length] not in origins.document.values]
        for prefix in [*made, path]:
            origins.overrides.setdefault(prefix, text)
    return data, origins


def _parse(text: str) -> tuple[KeyPath, Any]:
    key, separator, value = text.partition("=")
    path = tuple(key.strip().split("."))
    if not separator or not all(path):
        msg = f"--set {text}: expected key=value with a dotted key, for example camera.mask_to_sensor_mm=2.5"
        raise InputError(msg)
    if not value.strip():
        msg = f"--set {text}: the value is missing; null takes the key away, '' is empty text"
        raise InputError(msg)
    try:
        return path, parse_yaml(value, "value").data
    except YamlError as error:
        msg = "\n".join(f"--set {text}: {problem}" for _, problem in error.problems)
        raise InputError(msg) from error


def _set(data: dict[str, Any], path: KeyPath, value: Any, text: str) -> None:
    section: Any = data
    for position, step in enumerate(path[:-1], start=1):
        inner = section.get(step, {})
        if not isinstance(inner, dict):
            msg = f"--set {text}: {dotted(path[:position])} is {show(inner)}, not a mapping; set it as a whole"
            raise InputError(msg)
        section[step] = dict(inner)  # the document stays as it was read
        section = section[step]
    if value is None:
        section.pop(path[-1], None)
    else:
        section[path[-1]] = value
