"""From irradiance to stored numbers, by what a data set recorded of its sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulator.assemble.camera import build_sensor
from simulator.camera.sensor import Sensor
from simulator.config import Config
from simulator.config.camera import ExposureConfig
from simulator.dataset.dataset_info import FILE, DatasetInfo
from simulator.errors import InputError


def recorded_sensor(info: DatasetInfo, config: Config) -> Sensor:
    """Return the sensor of a data set from what the data set recorded, wherever the files are that its configuration names.

    Raises:
        InputError: a damaged record.
    """
    try:
        full_scale = float(info.exposure["full_scale"])
        responsivity = info.exposure.get("responsivity")
        if responsivity is not None:
            responsivity = tuple(float(responsivity[channel]) for channel in info.channels)
    except (KeyError, TypeError, ValueError) as error:
        msg = f"{FILE}: exposure is damaged ({type(error).__name__}: {error}); restore it from a copy"
        raise InputError(msg) from error
    # Without the illuminance: what it decides is recorded, and its files of spectra may be elsewhere.
    camera = config.camera.model_copy(update={"exposure": ExposureConfig(full_scale=full_scale)})
    sensor = build_sensor(config.model_copy(update={"camera": camera}), full_scale, info.shutter)
    return replace(sensor, responsivity=responsivity)


def gain_and_offset(sensor: Sensor, channels: int, *, mean: bool) -> tuple[float, NDArray[np.float64]]:
    """Return DN / 2^bits per unit of exposed irradiance, and what is stored without light, ``(C,)``.

    Args:
        sensor: from `recorded_sensor`.
        channels: of the light, C.
        mean: whether the forward model divided exposures by the exposure time (``forward.time: mean``).

    Raises:
        InputError: rows with different exposure times, which have no common gain.
    """
    exposures = np.unique(np.asarray(sensor.exposure_s, np.float64))
    if len(exposures) > 1:
        msg = (
            "camera.shutter: rows have different exposure times; a still is reconstructed from rows that have the same"
        )
        raise InputError(msg)
    exposure = 1.0 if mean else float(exposures[0])
    dark = np.zeros((channels, *sensor.shape))
    offset, bright = sensor.noiseless(dark), sensor.noiseless(dark + sensor.full_scale)
    return float(np.mean(bright - offset)) / sensor.full_scale * exposure, np.mean(offset, axis=(-2, -1))
