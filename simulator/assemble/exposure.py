"""The one number that maps exposure to full scale, where the configuration decides it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from simulator.assemble.camera import build_sensor
from simulator.assemble.light import build_electron_rates

if TYPE_CHECKING:
    from simulator.config import Config


def fixed_exposure(config: Config) -> dict[str, Any] | None:
    """Return the exposure as a data set records it, or None where pilot samples must find it.

    ``full_scale`` is the radiant exposure (scene radiance x steradian x seconds, per unit irradiance at the mask) that
    fills a pixel. With ``illuminance_lux``, a scene radiance of 1 is a white surface lit so brightly, and the pixel is one
    of the channel that counts the most electrons for white.

    Raises:
        InputError: for an unknown sensor, or as `build_electron_rates`.
    """
    chosen = config.camera.exposure
    if chosen.illuminance_lux is None:
        return (
            None if chosen.full_scale == "auto" else {"full_scale": float(chosen.full_scale), "from": "configuration"}
        )
    chosen_efficiency = config.camera.sensor.peak_quantum_efficiency
    sensor, rates = build_sensor(config), build_electron_rates(config)
    per_lux = max(rates.values()) * sensor.peak_quantum_efficiency * sensor.pixel_pitch_m**2
    electrons = chosen.illuminance_lux * per_lux
    assert sensor.responsivity is not None
    return {
        "full_scale": sensor.full_well_e / electrons,
        "from": "illuminance",
        "illuminance_lux": chosen.illuminance_lux,
        "peak_quantum_efficiency": sensor.peak_quantum_efficiency,
        "peak_quantum_efficiency_from": sensor.source if chosen_efficiency is None else "configuration",
        "full_well_e": sensor.full_well_e,
        "electrons_per_exposure": electrons,
        "responsivity": dict(zip(rates, sensor.responsivity, strict=True)),
    }
