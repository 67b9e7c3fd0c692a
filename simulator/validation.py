"""Sections of YAML files, strict validation of plain data by them (pydantic), and one clear line for each fault.

Both sim_config.yaml and the parameters of plugins go through here, so their messages have one form.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Tag, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError

from simulator.errors import InputError
from simulator.io.files import expanded
from simulator.io.store import place
from simulator.settings import Key, Settings, keys_of
from simulator.text import KeyPath, dotted, nearest, show

Model = TypeVar("Model", bound=BaseModel)
SectionType = type[BaseModel] | type[Settings]

_INFINITIES = {sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in ("inf", ".inf")}
_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "path_type": "a path",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping of keys to values",
    "model_type": "a mapping of keys to values",
    "model_attributes_type": "a mapping of keys to values",
    "dataclass_type": "a mapping of keys to values",
    "none_required": "null",
}

RENAMED = {
    "raise_by": "interpolate_by",
    "raise_with": "interpolate_with",
    "strength": "regularisation_lambda",
    "floor": "tikhonov",
    "start": "init_from",
}
"""Keys of earlier versions, in YAML files, data sets, tuned results, checkpoints and trainings: what they are called now."""


def renamed(value: Any) -> Any:
    """Return plain data that an earlier version wrote with today's keys; see `RENAMED`.

    Example:
        >>> renamed({"network": {"strength": 0.1, "size": "tiny"}, "start": None})
        {'network': {'regularisation_lambda': 0.1, 'size': 'tiny'}, 'init_from': None}
    """
    if isinstance(value, dict):
        return {RENAMED.get(key, key): renamed(part) for key, part in value.items()}
    return [renamed(part) for part in value] if isinstance(value, list) else value


def now_called(key: str, known: Container[str]) -> str:
    """Return the end of a message about an unknown key: its name of today where it had another one, else nothing."""
    return f"; {key} is called {RENAMED[key]} now" if key in RENAMED and RENAMED[key] in known else ""


class Section(BaseModel):
    """One mapping of sim_config.yaml: no unknown keys, no silent conversions, no changes afterwards."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, ser_json_inf_nan="constants", defer_build=True)


class PluginSection(Section):
    """A mapping whose further keys are the parameters of a plugin (a mask design, a scene family)."""

    model_config = ConfigDict(extra="allow")

    @property
    def params(self) -> dict[str, Any]:
        """The plugin's parameters as plain data; pass them to ``Plugin.bind``."""
        return dict(self.model_extra or {})


def refusal(text: str, *at: str | int, on_key: bool = False) -> PydanticCustomError:
    """Return an error to raise in a model's validator.

    Args:
        text: what came, why it makes no sense, the cure.
        at: path of the entry that the message is about, from the model; none is the model itself.
        on_key: whether the entry's key is wrong, not its value.
    """
    return PydanticCustomError("sense", "{text}", {"text": text, "at": at, "on_key": on_key or not at})


def _expandable(text: str) -> str:
    return _checked(text, expanded)


def _placeable(text: str) -> str:
    return _checked(text, place if "://" in text else expanded)


def _checked(text: str, read: Callable[[str], object]) -> str:
    try:
        read(text)
    except InputError as error:
        raise PydanticCustomError("sense", "{text}", {"text": str(error), "at": (), "on_key": False}) from error
    return text


PathText = Annotated[str, Field(min_length=1), AfterValidator(_expandable)]
"""A file or folder as a user writes it; `simulator.io.files.expanded` makes a path of it."""
OutputText = Annotated[str, Field(min_length=1), AfterValidator(_placeable)]
"""The same, or a place in an object store; see `simulator.io.store.place`."""


@dataclass(frozen=True)
class Problem:
    """One fault in the data.

    Attributes:
        path: where it is.
        text: what came, what was expected, the cure.
        on_key: whether the key itself is wrong, not its value.
    """

    path: KeyPath
    text: str
    on_key: bool = False

    def __str__(self) -> str:
        return f"{dotted(self.path)}: {self.text}" if self.path else self.text


def validate(model: type[Model], data: Any) -> Model:
    """Validate plain data by a strict model; ``"inf"`` stands for infinity wherever a number is expected.

    JSON has no infinity, so dumped data hold it as text.

    Raises:
        ValidationError: pydantic's, for :func:`find_problems`.
        InputError: when the data hold objects that YAML and JSON do not know.
    """
    try:
        return _validate(model, data)
    except ValidationError as error:
        changed = data
        for item in error.errors(include_url=False):
            value = item["input"]
            if item["type"] == "float_type" and isinstance(value, str) and value in _INFINITIES:
                changed = _replaced(changed, strip_tags(item["loc"], data), _INFINITIES[value])
        if changed is data:
            raise
    return _validate(model, changed)


def find_problems(error: ValidationError, model: type[BaseModel], data: Any, also: Iterable[str] = ()) -> list[Problem]:
    """Describe what pydantic found.

    Args:
        error: from :func:`validate`.
        model: the model that refused the data.
        data: the plain data.
        also: further keys that are known at the top level, though not to the model.

    Returns:
        One problem per place; the branches of a union are merged ("expected 'auto' or a number").
    """
    unknown: dict[KeyPath, Problem] = {}
    missing: dict[KeyPath, Problem] = {}
    values: dict[KeyPath, tuple[Any, list[str], str]] = {}
    others: list[Problem] = []
    for item in error.errors(include_url=False):
        kind, loc, context = item["type"], item["loc"], item.get("ctx", {})
        if kind == "too_short" and len(item["input"]) >= context["min_length"]:
            continue  # long enough: its entries are wrong, which has a message of its own
        path = strip_tags(loc, data)
        if kind in ("extra_forbidden", "unexpected_keyword_argument"):
            unknown[path] = Problem(path, _unknown_key(model, loc, item["input"], also), on_key=True)
        elif kind == "missing" and isinstance(loc[-1], int):
            got = show(_get(data, path[:-1]))
            others.append(Problem(path[:-1], f"got {got}; expected at least {loc[-1] + 1} entries"))
        elif kind == "missing":
            missing[path] = Problem(path, f"missing{_description(model, loc)}")
        elif kind in ("union_tag_invalid", "union_tag_not_found"):
            others.append(_wrong_tag(path, item["input"], context, model, loc))
        elif isinstance(fault := context.get("error"), InputError):  # a part's own, about one key or several together
            section = _get(data, path)
            at = (fault.path,) if isinstance(section, Mapping) and fault.path in section else ()
            others.append(Problem((*path, *at), fault.reason, not at))
        elif kind == "sense":
            others.append(Problem((*path, *context["at"]), context["text"], context["on_key"]))
        else:
            expected, hint = _expected(kind, item["msg"], context, item["input"])
            _, expectations, _ = values.setdefault(path, (item["input"], [], hint))
            if expected not in expectations:
                expectations.append(expected)
    for path in list(missing):
        siblings = _get(data, path[:-1])
        for key in siblings if isinstance(siblings, Mapping) else ():
            place = (*path[:-1], key)
            hint = nearest(key, [str(path[-1])])
            if hint and (place in unknown or not _knows(model, place)):  # a misspelt key is one fault, not two
                unknown.setdefault(place, Problem(place, f"unknown key, got {show(siblings[key])}{hint}", on_key=True))
                missing.pop(path, None)
    texts = [
        Problem(path, f"got {show(value)}; expected {' or '.join(expectations)}{hint}")
        for path, (value, expectations, hint) in values.items()
    ]
    return [*unknown.values(), *missing.values(), *others, *texts]


def strip_tags(loc: KeyPath, data: Any) -> KeyPath:
    """Return pydantic's location without the names of union branches, which the data do not hold."""
    path: list[str | int] = []
    for position, step in enumerate(loc):
        if _holds(data, step):
            data = data[step]
            path.append(step)
        elif position == len(loc) - 1 and _could_hold(data, step):
            path.append(step)
    return tuple(path)


def _holds(data: Any, step: str | int) -> bool:
    return (isinstance(data, list) and isinstance(step, int) and step < len(data)) or (
        isinstance(data, Mapping) and step in data
    )


def _could_hold(data: Any, step: str | int) -> bool:
    """Whether an absent last step is a missing entry (and not the name of a union branch)."""
    if isinstance(step, int):
        return isinstance(data, list)
    return isinstance(data, Mapping) and step.isidentifier() and data.get("type") != step


def _validate(model: type[Model], data: Any) -> Model:
    try:
        text = json.dumps(data)
    except (TypeError, ValueError) as error:
        wanted = "plain data (mappings, lists, text, numbers, true, false, null)"
        raise InputError("configuration", f"expected {wanted}: {error}") from error
    # JSON mode keeps the types strict, but lets a list be a tuple and a text a path.
    return model.model_validate_json(text, strict=True)


def _expected(kind: str, message: str, context: dict[str, Any], value: Any) -> tuple[str, str]:
    if kind == "range":
        return context["expected"], context["hint"]
    if kind == "literal_error":
        names = re.findall(r"'([^']*)'", context["expected"])
        hint = nearest(value, names) if isinstance(value, str) else ""
        return (f"one of {', '.join(names)}" if len(names) > 1 else repr(names[0])) if names else message, hint
    if kind in ("too_long", "too_short") and "actual_length" in context:
        bound, count = ("at most", context["max_length"]) if kind == "too_long" else ("at least", context["min_length"])
        return f"{bound} {count} {'entry' if count == 1 else 'entries'}", f" (there are {context['actual_length']})"
    return _EXPECTED.get(kind, message.removeprefix("Input should be ").removeprefix("Value error, ")), ""


def _unknown_key(model: type[BaseModel], loc: KeyPath, value: Any, also: Iterable[str]) -> str:
    key = str(loc[-1])
    options, tag = _section(model, loc[:-1])
    text = f"unknown key, got {show(value)}"
    if tag not in options:
        return text
    if hint := now_called(key, _keys(options[tag])):
        return f"got {show(value)}{hint}"
    for other, section in options.items():
        if other != tag and key in _keys(section):
            return f"got {show(value)}; this key belongs to {other}, but this is {tag}: keep one of the two"
    known = [*(also if len(loc) == 1 else ()), *_keys(options[tag])]
    elsewhere = [place for place in _all_keys(model) if place.rpartition(".")[2] == key]
    hint = f"; did you mean {' or '.join(elsewhere[:3])}?" if elsewhere else nearest(key, known)
    return f"{text}; expected one of {', '.join(known)}{hint}"


def _description(model: type[BaseModel], loc: KeyPath) -> str:
    options, tag = _section(model, loc[:-1])
    field = _keys(options[tag]).get(str(loc[-1])) if tag in options else None
    return f"; expected {field.description}" if field is not None and field.description else ", and has no default"


def _wrong_tag(path: KeyPath, value: Any, context: dict[str, Any], model: type[BaseModel], loc: KeyPath) -> Problem:
    names = [str(tag) for tag in _section(model, loc)[0]]
    choice = f"one of {', '.join(names)}"
    key = context["discriminator"].strip("'")
    if "tag" not in context:
        return Problem(path, f"got {show(value)}; expected a mapping with the key '{key}', {choice}")
    return Problem((*path, key), f"got {context['tag']!r}; expected {choice}{nearest(context['tag'], names)}")


def _section(model: type[BaseModel], loc: KeyPath) -> tuple[dict[str | None, SectionType], str | None]:
    """Return the models that may stand at a location, by union tag, and the tag that was chosen."""
    options: dict[str | None, SectionType] = {None: model}
    tag: str | None = None
    for step in loc:
        if len(options) > 1 and step in options:
            tag = str(step)
            continue
        section = options.get(tag)
        if section is None or step not in _keys(section):
            return {}, None
        options = _members(_keys(section)[str(step)].annotation)
        tag = next(iter(options), None) if len(options) == 1 else None
    return options, tag


def _members(annotation: Any) -> dict[str | None, SectionType]:
    origin = get_origin(annotation)
    if origin is Annotated:
        base, *metadata = get_args(annotation)
        tags = [item.tag for item in metadata if isinstance(item, Tag)]
        return {tags[0] if tags else tag: member for tag, member in _members(base).items()}
    if origin in (Union, UnionType):
        return {tag: member for part in get_args(annotation) for tag, member in _members(part).items()}
    if isinstance(annotation, type) and issubclass(annotation, BaseModel | Settings):
        kind = _keys(annotation).get("type")
        return {kind.default if kind is not None else None: annotation}
    return {}


def _keys(section: SectionType) -> Mapping[str, FieldInfo | Key]:
    return section.model_fields if issubclass(section, BaseModel) else keys_of(section)


def _all_keys(model: SectionType, prefix: str = "") -> list[str]:
    """Return every dotted key of a section, shallow ones first."""
    keys = [prefix + name for name in _keys(model)]
    for name, info in _keys(model).items():
        for member in _members(info.annotation).values():
            keys += [key for key in _all_keys(member, f"{prefix}{name}.") if key not in keys]
    return sorted(keys, key=lambda key: key.count("."))


def _knows(model: type[BaseModel], path: KeyPath) -> bool:
    options, tag = _section(model, path[:-1])
    return tag not in options or str(path[-1]) in _keys(options[tag])


def _get(data: Any, path: KeyPath) -> Any:
    for step in path:
        data = data[step]
    return data


def _replaced(data: Any, path: KeyPath, value: Any) -> Any:
    """Return a copy of the data with one entry changed; what is not on the way is shared."""
    if not path:
        return value
    copy = dict(data) if isinstance(data, Mapping) else list(data)
    copy[path[0]] = _replaced(data[path[0]], path[1:], value)  # pyright: ignore[reportArgumentType, reportCallIssue]
    return copy
