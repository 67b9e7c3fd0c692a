"""The ``camera.shutter`` section: when the sensor's rows are open."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from simulator.config.base import PluginSection, Range, Section, refusal
from simulator.errors import InputError
from simulator.text import nearest, show
from simulator.validation import Problem

if TYPE_CHECKING:
    from simulator.config.schema import Config

ExposureMs = Annotated[float, Range(1e-4, 1e5, "ms", below="without exposure time there is no light")]
LineTimeUs = Annotated[float, Range(1e-3, 1e6, "us", below="rows that open together are a global shutter")]
_EXPOSURE = "exposure time of each row, milliseconds"


class GlobalShutter(Section):
    """All rows are exposed at once."""

    type: Literal["global"] = "global"
    exposure_ms: ExposureMs = Field(default=10.0, description="exposure time, milliseconds")


class RollingShutter(Section):
    """One physical row after another."""

    type: Literal["rolling"] = "rolling"
    exposure_ms: ExposureMs = Field(default=10.0, description=_EXPOSURE)
    line_time_us: LineTimeUs = Field(description="time from one physical row's opening to the next, microseconds")
    direction: Literal["down", "up"] = Field(
        default="down",
        description="from the physical sensor's top row down (the stored picture's bottom row up), or up",
    )


class DualRollingShutter(Section):
    """Two halves at once: a pair of physical rows after another."""

    type: Literal["dual_rolling"] = "dual_rolling"
    exposure_ms: ExposureMs = Field(default=10.0, description=_EXPOSURE)
    line_time_us: LineTimeUs = Field(description="time from one pair of physical rows to the next, microseconds")
    order: Literal["outside_in", "centre_out"] = Field(
        default="outside_in", description="begin with the top and bottom rows (pco.edge) or in the middle (Zyla)"
    )


class RowWindows(PluginSection):
    """A window of its own for every physical row, from a file or a function; further keys are the function's parameters."""

    type: Literal["windows"] = "windows"
    file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description=".csv (a line per physical row, top first: open_s,close_s; the header may say _ms or _us) or .npy "
        "(rows, 2) in seconds",
    )
    function: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="./file.py:name or package.module:name: called with the number of physical rows, returns seconds "
        "(rows, 2)",
    )

    @model_validator(mode="after")
    def _one_origin(self) -> Self:
        if self.function is None:
            for key, value in self.params.items():
                hint = nearest(key, ["file", "function"])
                text = f"unknown key, got {show(value)}; expected type and file, or function and its parameters{hint}"
                raise refusal(text, key, on_key=True)
        if (self.file is None) == (self.function is None):
            came = "neither" if self.file is None else "both"
            text = f"needs exactly one of file and function, got {came}; each says when every row opens and closes"
            raise refusal(text, *([] if self.file is None else ["file"]))
        return self


def _named(data: Any) -> Any:
    """Take a shutter without a type for a global one."""
    return {"type": "global", **data} if isinstance(data, dict) and "type" not in data else data


ShutterConfig = Annotated[
    GlobalShutter | RollingShutter | DualRollingShutter | RowWindows,
    Field(discriminator="type"),
    BeforeValidator(_named),
]


def shutter_problems(config: Config) -> list[Problem]:
    """Return what is wrong with the file of the rows' windows."""
    chosen, sensor = config.camera.shutter, config.camera.sensor
    if not isinstance(chosen, RowWindows) or chosen.file is None:
        return []
    from simulator.camera.shutter import read_row_shutter  # imports NumPy, which other shutters do not need

    try:
        read_row_shutter(config.resolve_path(chosen.file), sensor.shape[0], sensor.binning)
    except InputError as error:
        return [Problem(("camera", "shutter", "file"), str(error))]
    return []
