"""The shutter of a configuration."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simulator.camera.shutter import (
    DualRollingShutter,
    GlobalShutter,
    RollingShutter,
    RowShutter,
    Shutter,
    read_row_shutter,
    row_shutter,
)
from simulator.config import camera as shutter_config
from simulator.errors import InputError
from simulator.plugins import Plugin, plugin_errors, resolve

if TYPE_CHECKING:
    from simulator.config import Config


def build_shutter(config: Config) -> Shutter:
    """Return the shutter.

    Raises:
        InputError: a file or function of row windows is missing, fails, or gives what is no window for every physical row.
    """
    chosen, binning = config.camera.shutter, config.camera.sensor.binning
    if isinstance(chosen, shutter_config.RowWindows):
        return _row_shutter(config, chosen)
    exposure_s = chosen.exposure_ms * 1e-3
    if isinstance(chosen, shutter_config.RollingShutter):
        return RollingShutter(exposure_s, chosen.line_time_us * 1e-6, chosen.direction, binning)
    if isinstance(chosen, shutter_config.DualRollingShutter):
        return DualRollingShutter(exposure_s, chosen.line_time_us * 1e-6, chosen.order, binning)
    return GlobalShutter(exposure_s, binning)


def exposure_s(config: Config, shutter: Shutter | None = None) -> float | tuple[float, ...]:
    """Return how long rows are open, seconds: one number, or where rows differ, one per row of the stored picture.

    Args:
        config: the configuration.
        shutter: its shutter, where it is built already; None builds it.

    Raises:
        InputError: as :func:`build_shutter`.
    """
    chosen = config.camera.shutter
    if not isinstance(chosen, shutter_config.RowWindows):
        return chosen.exposure_ms * 1e-3
    physical = (build_shutter(config) if shutter is None else shutter).exposures_s(config.camera.sensor.shape[0])
    return tuple(physical[::-1].tolist())  # the stored picture is the physical one turned by 180 degrees


def shutter_plugin(config: Config) -> Plugin | None:
    """Return the function that gives the rows' windows; None for other shutters."""
    chosen = config.camera.shutter
    if not isinstance(chosen, shutter_config.RowWindows) or chosen.function is None:
        return None
    return resolve("shutter", chosen.function, config.base_dir)


def shutter_files(config: Config) -> list[Path]:
    """Return the files of data that decide when rows are open: the windows', or the function's parameters of type Path."""
    chosen, plugin = config.camera.shutter, shutter_plugin(config)
    if plugin is not None and isinstance(chosen, shutter_config.RowWindows):
        return [value for value in plugin.bind(chosen.params).values() if isinstance(value, Path)]
    if isinstance(chosen, shutter_config.RowWindows) and chosen.file is not None:
        return [config.resolve_path(chosen.file)]
    return []


def _row_shutter(config: Config, chosen: shutter_config.RowWindows) -> RowShutter:
    rows, binning = config.camera.sensor.shape[0], config.camera.sensor.binning
    if chosen.file is not None:
        path = config.resolve_path(chosen.file)
        try:
            return read_row_shutter(path, rows, binning)
        except InputError as error:
            msg = f"camera.shutter.file: {error}"
            raise InputError(msg) from error
    plugin = shutter_plugin(config)
    assert plugin is not None
    with plugin_errors(plugin):
        windows = plugin.function(rows * binning, **plugin.bind(chosen.params))
    return row_shutter(windows, rows, binning, f"camera.shutter.function: {plugin.name} returned: ")
