"""The layers of a configuration: between mask and sensor, and the mask's substrate in front of it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from simulator.optics.materials import AIR, Material, load_material, material_file
from simulator.types import Layer

if TYPE_CHECKING:
    from simulator.config import Config
    from simulator.config.camera import GapLayer


def build_gap(config: Config) -> tuple[Layer, ...]:
    """Return the layers from the mask's modulating surface to the sensor; none where air alone lies between them.

    Raises:
        InputError: for an unknown material or an unreadable file.
    """
    camera, plate = config.camera, _plate(config, "sensor")
    if camera.gap is not None:
        return (*plate, *(Layer(layer.mm * 1e-3, _medium(layer, config)) for layer in camera.gap))
    assert camera.mask_to_sensor_mm is not None
    return (*plate, Layer(camera.mask_to_sensor_mm * 1e-3, AIR)) if plate else ()


def build_window(config: Config) -> tuple[Layer, ...]:
    """Return the layers in front of the modulating surface: the substrate, if it lies on the scene's side."""
    return _plate(config, "scene")


def layer_files(config: Config) -> list[Path]:
    """Return the files of the layers' materials."""
    return [
        file for name in dict.fromkeys(_names(config)) if (file := material_file(name, config.base_dir)) is not None
    ]


def _names(config: Config) -> Iterator[str]:
    camera = config.camera
    yield from (layer.material for layer in camera.gap or () if layer.material is not None)
    if camera.substrate is not None:
        yield camera.substrate.material


def _plate(config: Config, side: str) -> tuple[Layer, ...]:
    plate = config.camera.substrate
    if plate is None or plate.side != side:
        return ()
    return (Layer(plate.mm * 1e-3, load_material(plate.material, config.base_dir)),)


def _medium(layer: GapLayer, config: Config) -> Material:
    if layer.material is not None:
        return load_material(layer.material, config.base_dir)
    assert layer.n is not None
    if layer.n == "air":
        return AIR
    return Material(f"n = {layer.n:g}", "cauchy", (layer.n,), AIR.range_m, "constant index of the configuration")
