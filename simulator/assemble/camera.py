"""The sensor of a configuration, and how far the mask is from it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from simulator.assemble.layers import build_gap
from simulator.assemble.light import build_electron_rates
from simulator.assemble.shutter import exposure_s
from simulator.camera.noise import GaussianNoise, Noise, NoNoise, PhysicalNoise
from simulator.camera.sensor import Sensor
from simulator.camera.sensor_models import MODELS
from simulator.camera.shutter import Shutter
from simulator.config import camera as camera_config
from simulator.errors import InputError
from simulator.optics.propagation import air_equivalent_m

if TYPE_CHECKING:
    from simulator.config import Config

EQUIVALENT_WAVELENGTH_M = 550e-9
"""Where a layer's thickness becomes a distance in air: the middle of the visible."""

_CFA = "RGGB"
_REPLACEABLE = (
    "full_well_e",
    "read_noise_e",
    "row_noise_e",
    "dark_current_e_per_s",
    "dsnu_e",
    "black_level_dn",
    "bit_depth",
    "peak_quantum_efficiency",
)


def build_sensor(config: Config, full_scale: float = 1.0, shutter: Shutter | None = None) -> Sensor:
    """Return the sensor: the model's numbers, with those that the configuration replaces.

    Where the configuration gives the scene's illuminance, channels count as many electrons as their spectral responses say.

    Args:
        config: the configuration.
        full_scale: the exposure that fills a pixel.
        shutter: the configuration's shutter, where it is built already; None builds it.

    Raises:
        InputError: for an unknown model, or a picture larger than the sensor.
    """
    chosen, camera = config.camera.sensor, config.camera
    if chosen.model not in MODELS:
        msg = f"camera.sensor.model: got {chosen.model!r}, expected one of {', '.join(MODELS)}"
        raise InputError(msg)
    numbers = dict(MODELS[chosen.model])
    for name in _REPLACEABLE:
        if getattr(chosen, name) is not None:
            numbers[name] = getattr(chosen, name)
    if chosen.pixel_pitch_um is not None:
        numbers["pixel_pitch_m"] = chosen.pixel_pitch_um * 1e-6
    if chosen.prnu_percent is not None:
        numbers["prnu"] = chosen.prnu_percent * 1e-2
    return Sensor(
        name=chosen.model,
        binning=chosen.binning,
        shape=chosen.shape,
        exposure_s=exposure_s(config, shutter),
        full_scale=full_scale,
        responsivity=None if camera.exposure.illuminance_lux is None else _responsivity(config),
        readout=chosen.readout,
        cfa=chosen.cfa or _CFA,
        pattern_seed=chosen.pattern_seed,
        noise=_noise(camera.noise),
        **numbers,
    )


def distance_m(config: Config) -> float:
    """Return the distance in air at which paraxial rays from the mask arrive at the same place: the sum of d / n, metres.

    Raises:
        InputError: for an unknown material of a layer, or one that is not known at 550 nm.
    """
    gap = build_gap(config)
    if not gap:
        assert config.camera.mask_to_sensor_mm is not None
        return config.camera.mask_to_sensor_mm * 1e-3
    return air_equivalent_m(gap, EQUIVALENT_WAVELENGTH_M)


def _responsivity(config: Config) -> tuple[float, ...]:
    rates = build_electron_rates(config)
    return tuple(rate / max(rates.values()) for rate in rates.values())


def _noise(chosen: Any) -> Noise:
    if isinstance(chosen, camera_config.GaussianNoise):
        return GaussianNoise(chosen.std, chosen.psnr_db, chosen.peak, chosen.clip, chosen.quantise)
    return PhysicalNoise() if isinstance(chosen, camera_config.PhysicalNoise) else NoNoise()
