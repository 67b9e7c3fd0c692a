"""A strict reader of YAML that remembers where every key and value stands, and overrides (--set a.b=c) on top of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from yaml.events import AliasEvent, CollectionStartEvent, ScalarEvent
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from simulator.errors import InputError
from simulator.text import KeyPath, dotted, show

MAX_DIGITS = 40  # of an integer: no setting needs more, and Python's own limit would end in a traceback

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_WORDS = {"": None, "~": None}
_WORDS |= dict.fromkeys(("null", "Null", "NULL"))
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True)
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)


def parse_scalar(text: str) -> Any:
    """Return what an unquoted YAML scalar means.

    Raises:
        InputError: for leading zeros, NaN and numbers out of range.

    Example:
        >>> [parse_scalar(text) for text in ("10", "1e3", "off", "true", "-.inf", "2026-11-21")]
        [10, 1000.0, 'off', True, -inf, '2026-11-21']
    """
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        if len(digits) > 1 and digits[0] == "0":
            plain = digits.lstrip("0") or "0"
            raise InputError(text, f"has a leading zero, which some read as octal; write {plain}, or '{text}' for text")
        if len(digits) > MAX_DIGITS:
            raise InputError("", f"the number {text[:12]}... has {len(digits)} digits; expected at most {MAX_DIGITS}")
        return int(text)
    if _FLOAT.fullmatch(text):
        value = float(text)
        if value in (float("inf"), float("-inf")):
            raise InputError("", f"{text[:40]} is too large for a number; write .inf if infinity is meant")
        return value
    if match := _INFINITY.fullmatch(text):
        return float(f"{match[1]}inf")
    if text in (".nan", ".NaN", ".NAN"):
        raise InputError(text, "not a number, and no setting takes it; leave the key out for its default")
    return text


MAX_BYTES = 1 << 20
MAX_DEPTH = 20


@dataclass(frozen=True, order=True)
class Mark:
    """A place in a text: line and column, both counted from 1."""

    line: int
    column: int


@dataclass(frozen=True)
class Document:
    """Plain data and where it stood.

    Attributes:
        data: dict, list, str, int, float, bool or None.
        keys: place of the key (or of the list item) at each path.
        values: place of the value at each path; ``()`` is the whole document.
    """

    data: Any
    keys: dict[KeyPath, Mark] = field(default_factory=dict)
    values: dict[KeyPath, Mark] = field(default_factory=dict)


class YamlError(InputError):
    """What is wrong with a YAML text.

    Attributes:
        problems: place and description of each fault, in the order of the text.
    """

    def __init__(self, problems: list[tuple[Mark, str]], name: str) -> None:
        self.problems = sorted(problems)
        super().__init__("", "\n".join(f"{name}:{mark.line}:{mark.column}: {text}" for mark, text in self.problems))


def read_yaml(path: Path, name: str) -> Document:
    """Read one YAML file.

    Args:
        path: the file.
        name: what messages call it.

    Raises:
        InputError: when the file cannot be read, is larger than 1 MiB or is not UTF-8.
        YamlError: (an InputError) when its text is refused.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(name, f"cannot read the configuration: {error.strerror or error}") from error
    if len(raw) > MAX_BYTES:
        raise InputError(name, "larger than 1 MiB, which no configuration needs; is this the right file?")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start].decode("utf-8")
        problem = f"not UTF-8 text (byte 0x{raw[error.start]:02x}); save the file as UTF-8"
        raise YamlError([(_mark_at(before, len(before)), problem)], name) from error
    return parse_yaml(text, name)


def parse_yaml(text: str, name: str) -> Document:
    """Turn one YAML document into plain data with places.

    Args:
        text: the document.
        name: what messages call it.

    Raises:
        YamlError: listing every fault that can be seen in one pass.

    Example:
        >>> parse_yaml("a: {b: 1e3, c: on}", "example").data
        {'a': {'b': 1000.0, 'c': 'on'}}
    """
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        mark = _mark_at(text, error.position)
        problem = f"the character U+{error.character:04X} is not allowed in YAML; remove it"
        raise YamlError([(mark, problem)], name) from error
    try:
        node = loader.get_single_node()
    except yaml.MarkedYAMLError as error:
        raise YamlError([*loader.problems, _syntax_problem(error)], name) from error
    finally:
        loader.dispose()
    if node is None:
        raise YamlError([(Mark(1, 1), "the document is empty; `flatlight init` writes one to start from")], name)
    builder = _Builder(loader.problems)
    data = builder.build(node, ())
    if builder.problems:
        raise YamlError(builder.problems, name)
    return Document(data, builder.keys, builder.values)


class _Loader(yaml.SafeLoader):
    """SafeLoader that notes aliases, anchors and tags while composing, and stops at deep nesting."""

    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}  # noqa: RUF012 (PyYAML's own name)

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.problems: list[tuple[Mark, str]] = []
        self.depth = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        event = self.peek_event()
        mark = _mark(event.start_mark)
        if isinstance(event, AliasEvent):
            self.get_event()
            self.problems.append((mark, f"the alias *{event.anchor} is not allowed; write the value out"))
            return ScalarNode("str", "", event.start_mark, event.end_mark)
        if isinstance(event, ScalarEvent | CollectionStartEvent):
            if event.anchor is not None:
                self.problems.append((mark, f"the anchor &{event.anchor} is not allowed; write the value out"))
                event.anchor = None
            if event.tag is not None:
                tag = event.tag.replace("tag:yaml.org,2002:", "!!")
                self.problems.append((mark, f"the tag {tag} is not allowed; a value's form says what it is"))
                event.tag = None
        if isinstance(event, CollectionStartEvent) and self.depth >= MAX_DEPTH:
            msg = f"nested more than {MAX_DEPTH} levels deep; no setting needs that"
            raise yaml.MarkedYAMLError(problem=msg, problem_mark=event.start_mark)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


class _Builder:
    """Walks the nodes: plain data, places, and every fault on the way."""

    def __init__(self, problems: list[tuple[Mark, str]]) -> None:
        self.problems = problems
        self.keys: dict[KeyPath, Mark] = {}
        self.values: dict[KeyPath, Mark] = {}

    def build(self, node: Node, path: KeyPath) -> Any:
        mark = _mark(node.start_mark)
        self.values[path] = mark
        if isinstance(node, MappingNode):
            return self._mapping(node, path)
        if isinstance(node, SequenceNode):
            for index, item in enumerate(node.value):
                self.keys[(*path, index)] = _mark(item.start_mark)
            return [self.build(item, (*path, index)) for index, item in enumerate(node.value)]
        assert isinstance(node, ScalarNode)
        return self._scalar(node, mark)

    def _mapping(self, node: MappingNode, path: KeyPath) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            mark = _mark(key_node.start_mark)
            if not isinstance(key_node, ScalarNode):
                self.problems.append((mark, "a key must be a word, not a mapping or list"))
                continue
            key = self._scalar(key_node, mark)
            if not isinstance(key, str):
                self.problems.append((mark, f"a key must be a word, got {key_node.value or 'nothing'!r}"))
                continue
            if key in data:
                first = self.keys[(*path, key)]
                problem = f"{key}: given twice, first in line {first.line}; keep one of them"
                self.problems.append((mark, problem))
                continue
            self.keys[(*path, key)] = mark
            data[key] = self.build(value_node, (*path, key))
        return data

    def _scalar(self, node: ScalarNode, mark: Mark) -> Any:
        try:
            # JSON, which is YAML too, writes rare characters as a pair of surrogates.
            text = node.value.encode("utf-16", "surrogatepass").decode("utf-16")
        except UnicodeDecodeError:
            self.problems.append((mark, "an unpaired surrogate is not allowed in text; remove it"))
            return ""
        if "\0" in text:
            self.problems.append((mark, "NUL is not allowed in text; remove it"))
            return ""
        if node.style is not None:  # quoted or block: text whatever it looks like
            return text
        try:
            return parse_scalar(text)
        except InputError as error:
            self.problems.append((mark, str(error)))
            return text


def _mark(mark: Any) -> Mark:
    return Mark(mark.line + 1, mark.column + 1)


def _mark_at(text: str, position: int) -> Mark:
    before = text[:position]
    return Mark(before.count("\n") + 1, position - before.rfind("\n"))


def _syntax_problem(error: yaml.MarkedYAMLError) -> tuple[Mark, str]:
    place = error.problem_mark or error.context_mark
    mark = _mark(place) if place is not None else Mark(1, 1)
    problem = error.problem or error.context or "not YAML"
    if "expected a single document" in str(error):
        return mark, "a second document starts here; a configuration is one document, remove this '---'"
    if problem.startswith("nested"):
        return mark, problem
    if "'\\t'" in problem:
        return mark, "a tab cannot indent YAML; use spaces"
    context = f" {error.context}" if error.context and error.problem else ""
    return mark, f"not valid YAML{context}: {problem}"


@dataclass
class Origins:
    """Where values came from: places in a file, or overrides; nothing for plain data. Equal whatever they hold.

    Attributes:
        name: what messages call the file.
        document: its places.
        overrides: text of the override that set a path.
    """

    name: str = field(default="", compare=False)
    document: Document = field(default_factory=lambda: Document(None), compare=False)
    overrides: dict[KeyPath, str] = field(default_factory=dict, compare=False)

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
        """Return what a message begins with: ``file:line:column``, ``--set a.b=c`` or nothing."""
        place = self.find(path, on_key)
        if isinstance(place, Mark):
            return f"{self.name}:{place.line}:{place.column}"
        return f"--set {place}" if place is not None else ""

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
        raise InputError(
            f"--set {text}", "expected key=value with a dotted key, for example camera.mask_to_sensor_mm=2.5"
        )
    if not value.strip():
        raise InputError(f"--set {text}", "the value is missing; null takes the key away, '' is empty text")
    try:
        return path, parse_yaml(value, "value").data
    except YamlError as error:
        raise InputError("", "\n".join(f"--set {text}: {problem}" for _, problem in error.problems)) from error


def _set(data: dict[str, Any], path: KeyPath, value: Any, text: str) -> None:
    section: Any = data
    for position, step in enumerate(path[:-1], start=1):
        inner = section.get(step, {})
        if not isinstance(inner, dict):
            raise InputError(
                f"--set {text}", f"{dotted(path[:position])} is {show(inner)}, not a mapping; set it as a whole"
            )
        section[step] = dict(inner)  # the document stays as it was read
        section = section[step]
    if value is None:
        section.pop(path[-1], None)
    else:
        section[path[-1]] = value
