"""Something-Something's label files and tables of classes: which clip shows what."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from simulator.errors import InputError
from simulator.text import nearest

Subset = Literal["train", "validation"]
COARSE_TABLE = Path(__file__).parent / "tables" / "something_something_v2_coarse.csv"
"""The 41 templates in 10 classes of the paper's tables 5 and 7, reconstructed; its first lines say from what."""
_LABEL_FOLDERS = ("", "labels")
_PREFIXES = ("something-something-v2-", "")


@dataclass(frozen=True)
class Entry:
    """One clip of a label file.

    Attributes:
        identity: the clip's number, a text of digits; the name of its file.
        template: what it shows, without brackets, as in the file of labels.
    """

    identity: str
    template: str


def find_labels(root: Path, name: str) -> Path | None:
    """Return a label file's path under one of its original names (``name`` is ``labels``, ``train`` or ``validation``).

    Raises:
        InputError: the folder cannot be looked into.
    """
    places = (root / folder / f"{prefix}{name}.json" for folder in _LABEL_FOLDERS for prefix in _PREFIXES)
    try:
        return next((place for place in places if place.is_file()), None)
    except OSError as error:
        msg = f"path: {root} cannot be read: {error.strerror or error}; check who may read it"
        raise InputError(msg) from error


def read_templates(path: Path) -> tuple[str, ...]:
    """Read the file of all templates, ``{"Closing something": "5", ...}``.

    Raises:
        InputError: naming the file, when it is something else.
    """
    content = _read_json(path)
    if not isinstance(content, dict) or not content or not all(str(value).isdecimal() for value in content.values()):
        msg = f'{path} is no file of labels: expected {{"Approaching something with your camera": "0", ...}}'
        raise InputError(msg)
    return tuple(content)


def read_entries(path: Path, templates: tuple[str, ...], labels: Path) -> tuple[list[Entry], dict[str, str]]:
    """Read a subset's file, ``[{"id": "74225", "template": "Spinning [something] ...", ...}, ...]``.

    Args:
        path: the file.
        templates: all that are known.
        labels: the file that they come from, for messages.

    Returns:
        The clips of known templates; and by its number, for each other one, the line that names its template.

    Raises:
        InputError: naming the file and the clip, when an entry is broken.
    """
    content = _read_json(path)
    if not isinstance(content, list) or not content:
        msg = (
            f'{path} holds no list of clips: expected [{{"id": "74225", "template": "Closing [something]", ...}}, ...]'
        )
        raise InputError(msg)
    known = set(templates)
    entries: dict[str, Entry] = {}
    unknown: dict[str, str] = {}
    for place, item in enumerate(content):
        entry = _entry(item, place, path)
        if entry.template not in known:
            hint = _nearest(entry.template, templates)
            unknown[entry.identity] = (
                f"{path.name}: clip {entry.identity} has the unknown template {item['template']!r}, not in "
                f"{labels.name}{hint}"
            )
            continue
        if entry.identity in entries:
            msg = f"{path} lists clip {entry.identity} twice: keep one of them"
            raise InputError(msg)
        entries[entry.identity] = entry
    return list(entries.values()), unknown


def read_table(path: Path, templates: tuple[str, ...], labels: Path) -> dict[str, str]:
    """Read a table of classes: a CSV file with the columns ``template`` and ``class``; lines that begin with # are comments.

    Args:
        path: the file.
        templates: all that are known.
        labels: the file that they come from, for messages.

    Returns:
        Each listed template's class.

    Raises:
        InputError: naming the file and line, for a missing column, an empty class, an unknown or repeated template.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        msg = f"classes: {path} cannot be read as a table of classes ({error}); expected all, coarse or a CSV file"
        raise InputError(msg) from error
    # Comments become empty lines, so that lines keep their numbers.
    reader = csv.reader(("" if line.startswith("#") else line for line in lines), strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if row]
    except csv.Error as error:
        msg = f"{path}:{reader.line_num} is no line of a CSV file ({error})"
        raise InputError(msg) from error
    columns = [name.strip() for name in rows[0][1]] if rows else []
    if columns != ["template", "class"] or len(rows) == 1:
        msg = f"{path} begins with {','.join(columns) or 'nothing'}; expected the line template,class and a line per template"
        raise InputError(msg)
    known, table = set(templates), dict[str, str]()
    for number, row in rows[1:]:
        if len(row) != 2 or not row[1].strip():
            msg = f"{path}:{number} holds {','.join(row)}; expected a template and its class, in quotes if they hold commas"
            raise InputError(msg)
        template = _bare(row[0]).strip()
        if template not in known:
            hint = _nearest(template, templates)
            msg = f"{path}:{number} has the unknown template {template!r}, not in {labels.name}{hint}"
            raise InputError(msg)
        if template in table:
            msg = f"{path}:{number} lists {template!r} a second time: keep one of them"
            raise InputError(msg)
        table[template] = row[1].strip()
    return table


def _entry(item: Any, place: int, path: Path) -> Entry:
    if not isinstance(item, Mapping) or not str(item.get("id", "")).isdecimal():
        msg = f"{path}: entry {place} has no id of digits, got {str(item)[:80]}"
        raise InputError(msg)
    if not isinstance(item.get("template"), str):
        msg = (
            f"{path}: clip {item['id']} has no template; the file of the test subset has none, use train or validation"
        )
        raise InputError(msg)
    return Entry(str(item["id"]), _bare(item["template"]))


def _bare(template: str) -> str:
    return template.replace("[", "").replace("]", "")


def _nearest(template: str, templates: tuple[str, ...]) -> str:
    by_lower = {known.lower(): known for known in templates}
    hint = nearest(template, by_lower)
    for lower, known in by_lower.items():
        hint = hint.replace(repr(lower), repr(known))
    return hint


def _read_json(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        msg = f"{path} cannot be read as JSON ({error}): fetch it again"
        raise InputError(msg) from error
