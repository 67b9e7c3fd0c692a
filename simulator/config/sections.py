"""What all sections of the schema share: strictness, and refusals with their reason."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError


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
