"""Masks by the name of their design: designed once and then cached."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from simulator.errors import InputError
from simulator.io.cache import Entry, cached, code_digest
from simulator.optics.mask import UNNAMED, Mask
from simulator.optics.materials import Material, material_file
from simulator.plugins import Plugin, plugin_errors, resolve


def load_mask(design: str, base_dir: Path | None = None, **params: Any) -> Mask:
    """Design a mask, or take it from the cache when the same design was made before.

    Args:
        design: a design's name, ``./file.py:name`` or ``package.module:name``.
        base_dir: folder from which relative paths are taken; None is the current one.
        params: the design's parameters; see ``flatlight masks``.

    Raises:
        InputError: for an unknown design, wrong parameters, or a mask that exceeds the machine's memory.
    """
    plugin = resolve("mask", design, base_dir)
    arguments, files = mask_arguments(plugin, params)

    def compute() -> Entry:
        try:
            with plugin_errors(plugin):
                mask = plugin.function(**arguments)
        except MemoryError as error:
            raise InputError(
                f"mask design {design!r}", "exceeds the memory; use a coarser pixel or a narrower mask"
            ) from error
        if not isinstance(mask, Mask):
            raise InputError(
                f"mask design {design!r}", f"returned {type(mask).__name__}, expected a simulator.optics.mask.Mask"
            )
        described = {
            "pitch_m": mask.pitch_m,
            "material": asdict(mask.material),
            "profile": mask.profile,
            "name": plugin.function.__name__ if mask.name == UNNAMED else mask.name,
            "notes": dict(mask.notes),
        }
        arrays = {"height_m": mask.height_m, "amplitude": mask.amplitude}
        return {name: np.asarray(array, np.float32) for name, array in arrays.items()}, described

    source = Path(inspect.getsourcefile(plugin.function) or "")
    code = code_digest(__name__, *([source] if source.is_file() else []))
    key = hashlib.sha256(repr((design, sorted(arguments.items()), code)).encode())
    for file in files:
        if file.is_file():
            key.update(file.read_bytes())
    arrays, described = cached("masks", key.hexdigest(), compute)
    material = described["material"] | {key: tuple(described["material"][key]) for key in ("coefficients", "range_m")}
    return Mask(
        arrays["height_m"],
        arrays["amplitude"],
        described["pitch_m"],
        Material(**material),
        described["profile"],
        described["name"],
        described["notes"],
    )


def mask_arguments(plugin: Plugin, params: Mapping[str, Any]) -> tuple[dict[str, Any], list[Path]]:
    """Return a design's arguments, relative paths taken from the plugin's folder, and the files among them.

    Files are the parameters of type Path, and the text parameter ``material`` where it names a file.
    """
    arguments = plugin.bind(params)
    files = [value for value in arguments.values() if isinstance(value, Path)]
    material = arguments.get("material")
    if isinstance(material, str) and (file := material_file(material, plugin.base_dir)) is not None:
        arguments["material"] = str(file)
        files.append(file)
    return arguments, files
