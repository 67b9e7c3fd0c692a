"""The files whose contents decide a data set, for its fingerprint."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import TYPE_CHECKING

from simulator.assemble.layers import layer_files
from simulator.assemble.light import light_files
from simulator.assemble.masks import mask_arguments
from simulator.assemble.measured import measured_files
from simulator.assemble.scenes import scene_plugin
from simulator.assemble.shutter import shutter_files, shutter_plugin
from simulator.config.psf import ComputedPsf
from simulator.plugins import Plugin, resolve
from simulator.types import SceneSource

if TYPE_CHECKING:
    from simulator.config import Config

_OWN_PACKAGES = ("simulator", "scenes", "psf_library")


def input_files(config: Config, source: SceneSource) -> list[Path]:
    """Return all files whose contents decide the samples: plugins' code, materials, spectra, shutters, PSFs, frames."""
    files = [*_own_code(scene_plugin(config)), *layer_files(config), *light_files(config), *shutter_files(config)]
    if (shutter := shutter_plugin(config)) is not None:
        files += _own_code(shutter)
    if config.camera.mask is not None:
        plugin = resolve("mask", config.camera.mask.design, config.base_dir)
        files += [*_own_code(plugin), *mask_arguments(plugin, config.camera.mask.params)[1]]
    if not isinstance(config.psf, ComputedPsf):
        files += measured_files(config, config.psf)
    return [*files, *source.inputs]


def _own_code(plugin: Plugin) -> list[Path]:
    """Return the file of a plugin's code unless it came with flatlight, whose version stands for it."""
    module = inspect.getmodule(plugin.function)
    if plugin.path is None and module is not None and module.__name__.partition(".")[0] in _OWN_PACKAGES:
        return []
    path = plugin.path or inspect.getsourcefile(plugin.function)
    return [Path(path)] if path else []
