"""What a number of the configuration may be, and parts of the camera whose section of the configuration they are.

A part is a plain dataclass in SI units, here without pydantic; only when a configuration is read does pydantic ask it for
its schema: its fields are the section's keys, its docstring what they mean.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

from simulator.text import documented

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
    from pydantic_core.core_schema import CoreSchema

# Units that are easily taken for another one of the same kind.
_MISTAKEN = ("um", "mm", "mm2", "cm", "ms")
_UNITS = {"ms": (1e-3, "milliseconds"), "us": (1e-6, "microseconds"), "nm": (1e-9, "nanometres")}

NO_KEY = {"key": None}
"""Metadata of a part's field that is no key of its section, because another section decides it."""


@dataclass(frozen=True)
class Range:
    """A number's plausible range, for ``Annotated``.

    Attributes:
        low: the least value.
        high: the greatest.
        unit: as in the key's name; empty for counts and ratios.
        infinite: whether infinity is meant to be given too.
        below: the physical reason why smaller values make no sense.
    """

    low: float
    high: float
    unit: str = ""
    infinite: bool = False
    below: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check after pydantic's own type check."""
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Put the range into the JSON schema; infinity is a text there, because JSON has no number for it."""
        number = handler(schema) | {"minimum": self.low, "maximum": self.high}
        return {"anyOf": [number, {"const": "inf"}]} if self.infinite else number

    def check(self, value: float) -> float:
        """Return the value, or raise pydantic's error with the range, the unit and the reason."""
        if self.low <= value <= self.high or (self.infinite and value == math.inf):
            return value
        from pydantic_core import PydanticCustomError

        unit = f" {self.unit}" if self.unit else ""
        expected = f"{self.low:g} to {self.high:g}{unit}{' or inf' if self.infinite else ''}"
        hint = ""
        if value < self.low and self.below:
            hint = f"; {self.below}"
        elif self.unit in _MISTAKEN:
            hint = f"; the unit is {self.unit}: was the number meant in another one?"
        kind, message = "range", "expected {expected}"
        raise PydanticCustomError(kind, message, {"expected": expected, "hint": hint})


@dataclass(frozen=True, kw_only=True)
class Quantity(Range):
    """A field in SI units that the configuration gives in the unit of its key.

    Attributes:
        key: such as ``exposure_ms``; the range is in that unit.
        default: in that unit; None where the key has to be given, or the field itself has a default.
    """

    key: str
    default: float | None = None

    @property
    def factor(self) -> float:
        """The unit, in SI units."""
        return _UNITS[self.unit][0]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check in the key's unit, then convert."""
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(
            lambda value: self.check(value) * self.factor,
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(self.shown),
        )

    def shown(self, value: float) -> float:
        """Return the shortest number in the key's unit that means exactly this value."""
        near = [value / self.factor]
        for towards in (0.0, math.inf):  # two roundings lie between the number and its quotient
            near += [first := math.nextafter(near[0], towards), math.nextafter(first, towards)]
        numbers = (float(f"{number:.{digits}g}") for digits in range(1, 18) for number in near)
        return next((number for number in numbers if number * self.factor == value), near[0])


@dataclass(frozen=True)
class Key:
    """A key of a part's section.

    Attributes:
        name: the part's field.
        annotation: its type.
        default: of the field, SI units; ``MISSING`` where the key has to be given.
        description: from the part's docstring.
        quantity: the key's unit, where it has one of its own.
    """

    name: str
    annotation: Any
    default: Any
    description: str
    quantity: Quantity | None


@cache
def keys_of(part: type[Settings]) -> dict[str, Key]:
    """Return the keys of a part's section."""
    hints, meanings = get_type_hints(part, include_extras=True), documented(inspect.getdoc(part) or "", "Attributes")
    keys = {}
    for entry in sorted(fields(part), key=lambda entry: entry.name != "type"):  # pyright: ignore[reportArgumentType]
        if entry.metadata == NO_KEY:
            continue
        hint, key, default, meaning = hints[entry.name], entry.name, entry.default, meanings.get(entry.name, "")
        quantity = get_args(hint)[1] if get_origin(hint) is Annotated else None
        if isinstance(quantity, Quantity):
            key, meaning = quantity.key, f"{meaning}, {_UNITS[quantity.unit][1]}"
            default = default if quantity.default is None else quantity.default * quantity.factor
        keys[key] = Key(entry.name, hint, default, meaning, quantity if isinstance(quantity, Quantity) else None)
    return keys


def fields_from(part: type[Settings], section: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields that a section, plain data, gives a part, in SI units; nothing is checked."""
    keys, found = keys_of(part), {}
    for name, value in section.items():
        key = keys.get(name)
        found[key.name if key else name] = value * key.quantity.factor if key and key.quantity else value
    return found


class Settings:
    """The base of a part, a frozen dataclass, that is a section of the configuration."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a mapping with the part's keys: strict, and no others."""
        from pydantic_core import core_schema

        arguments = []
        for key, entry in keys_of(cls).items():
            schema = handler.generate_schema(entry.annotation)
            if entry.default is not MISSING:
                schema = core_schema.with_default_schema(schema, default=entry.default)
            updates: dict[str, Any] = {"description": entry.description} if entry.description else {}
            if entry.quantity is not None and entry.default is not MISSING:
                updates["default"] = entry.quantity.shown(entry.default)
            arguments.append(
                core_schema.dataclass_field(
                    entry.name,
                    schema,
                    kw_only=True,
                    validation_alias=key,
                    serialization_alias=key,
                    metadata={"pydantic_js_updates": updates},
                )
            )
        about = {"description": (inspect.getdoc(cls) or "").partition("\n")[0], "additionalProperties": False}
        return core_schema.dataclass_schema(
            cls,
            core_schema.dataclass_args_schema(cls.__name__, arguments),
            [argument["name"] for argument in arguments],
            post_init=hasattr(cls, "__post_init__"),
            frozen=True,
            config=core_schema.CoreConfig(strict=True, extra_fields_behavior="forbid", serialize_by_alias=True),
            metadata={"pydantic_js_updates": about},
        )
