"""The scenes of a configuration and the view that they are drawn for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.assemble.camera import build_sensor, distance_m
from simulator.assemble.psfs import stack_depths_m
from simulator.errors import InputError
from simulator.plugins import Plugin, plugin_errors, resolve
from simulator.types import SceneSource, View

if TYPE_CHECKING:
    from simulator.config import Config


def build_view(config: Config) -> View:
    """Return the pinhole view that scenes are drawn for; its depths are the stack's unless the scene has its own."""
    depths = stack_depths_m(config)
    near_cm, far_cm = config.scene.near_cm, config.scene.far_cm
    return View(
        config.scene.size,
        build_sensor(config).binned_pitch_m,
        distance_m(config),
        depths[0] if near_cm is None else near_cm * 1e-2,
        depths[-1] if far_cm is None else far_cm * 1e-2,
    )


def scene_plugin(config: Config) -> Plugin:
    """Return the plugin that makes the scenes."""
    scene = config.scene
    kind, name = ("scene", scene.family) if scene.family is not None else ("source", scene.source)
    assert name is not None
    return resolve(kind, name, config.base_dir)


def build_source(config: Config, backend: str) -> SceneSource:
    """Return the scene source.

    Args:
        config: the configuration.
        backend: Mitsuba variant for families that render.
    """
    plugin = scene_plugin(config)
    arguments = plugin.bind(config.scene.params)
    if plugin.takes_renderer:
        from simulator.render import Renderer  # imported data sets need no renderer

        chosen = config.render
        bands_nm = chosen.bands.edges if chosen.bands else ()
        arguments["renderer"] = Renderer(
            backend, tuple(chosen.outputs), chosen.hidden_layers, denoise=chosen.denoise, bands_nm=bands_nm
        )
    with plugin_errors(plugin):
        source = plugin.function(build_view(config), **arguments)
    if not isinstance(source, SceneSource):
        msg = f"scene {plugin.name!r} returned {type(source).__name__}, expected an object with inputs and clip(index, rng)"
        raise InputError(msg)
    return source
