"""What all sections of the schema share: strictness, plausible ranges with their unit, refusals with their reason."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

# Units that are easily taken for another one of the same kind.
_MISTAKEN = ("um", "mm", "mm2", "cm", "ms")


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

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        """Check after pydantic's own type check."""
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Put the range into the JSON schema; infinity is a text there, because JSON has no number for it."""
        number = handler(schema) | {"minimum": self.low, "maximum": self.high}
        return {"anyOf": [number, {"const": "inf"}]} if self.infinite else number

    def check(self, value: float) -> float:
        """Return the value, or raise pydantic's error with the range, the unit and the reason."""
        if self.low <= value <= self.high or (self.infinite and value == math.inf):
            return value
        unit = f" {self.unit}" if self.unit else ""
        expected = f"{self.low:g} to {self.high:g}{unit}{' or inf' if self.infinite else ''}"
        hint = ""
        if value < self.low and self.below:
            hint = f"; {self.below}"
        elif self.unit in _MISTAKEN:
            hint = f"; the unit is {self.unit}: was the number meant in another one?"
        kind, message = "range", "expected {expected}"
        raise PydanticCustomError(kind, message, {"expected": expected, "hint": hint})


def refusal(text: str, *at: str | int, on_key: bool = False) -> PydanticCustomError:
    """Return an error to raise in a model's validator.

    Args:
        text: what came, why it makes no sense, the cure.
        at: path of the entry that the message is about, from the model; none is the model itself.
        on_key: whether the entry's key is wrong, not its value.
    """
    return PydanticCustomError("sense", "{text}", {"text": text, "at": at, "on_key": on_key or not at})
