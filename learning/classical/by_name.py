"""All classical methods by the names that YAML files and the command line call them by: of stills and of clips."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from learning.camera import CaptureModel
from learning.checkpoint import find_denoiser
from learning.classical.clip_depth import CLIP_DEPTH_DEFAULTS, CLIP_DEPTH_SEARCH, OF_VOLUME, ClipDepth
from learning.classical.clips import CLIP_DEFAULTS, CLIP_SEARCH, ClipMethod, find_initial_estimate
from learning.classical.method import (
    DEFAULTS,
    SEARCH,
    VOLUME_PARAMETERS,
    ClassicalMethod,
    build_classical,
    check_parameters,
)
from learning.method import Value, check_choices
from simulator.errors import InputError
from simulator.io.files import expanded

OF_CLIPS = (*CLIP_DEFAULTS, *CLIP_DEPTH_DEFAULTS)
"""Names of those of clips."""
ALL_DEFAULTS: dict[str, dict[str, Value]] = DEFAULTS | CLIP_DEFAULTS | CLIP_DEPTH_DEFAULTS
"""All parameters, where tuning begins."""
ALL_SEARCH: dict[str, dict[str, tuple[Value, ...]]] = SEARCH | CLIP_SEARCH | CLIP_DEPTH_SEARCH
"""Candidates for tuning."""
ALL_VOLUME_PARAMETERS = (
    VOLUME_PARAMETERS | {name: tuple(known) for name, known in CLIP_DEFAULTS.items()} | {"joint3d": tuple(OF_VOLUME)}
)
"""Those on which the volume, or the frames, depend."""


def build_method(
    capture: CaptureModel, name: str, parameters: Mapping[str, Value] | None = None
) -> ClassicalMethod | ClipMethod | ClipDepth:
    """Return a method for a camera, with `ALL_DEFAULTS` for the parameters that are not given.

    Raises:
        InputError: another name, a parameter that the method does not have, a value that it refuses, or clips for a method
            of stills and the reverse.
    """
    check_choices(("name", name, ALL_DEFAULTS))
    if name in CLIP_DEFAULTS:
        check_parameters(parameters or {}, CLIP_DEFAULTS[name], name)
        return ClipMethod(capture, name, CLIP_DEFAULTS[name] | dict(parameters or {}))
    if name in CLIP_DEPTH_DEFAULTS:
        check_parameters(parameters or {}, CLIP_DEPTH_DEFAULTS[name], name)
        given: Any = CLIP_DEPTH_DEFAULTS[name] | dict(parameters or {})
        return ClipDepth(capture, **given)
    if capture.timing is not None:
        raise InputError(name, f"got clips, but it reconstructs stills; take one of {', '.join(OF_CLIPS)}")
    return build_classical(capture, name, parameters)


def learned_files(
    method: str, parameters: Mapping[str, Any], key: str, resolve: Callable[[str], Path] = expanded
) -> dict[str, Path]:
    """Return the files of the networks that a method trusts, by parameter; ``key`` and ``resolve`` as of `find_checkpoint`.

    Raises:
        InputError: a file that does not exist, at ``key``.
    """
    found = {}
    if isinstance(text := parameters.get("denoiser"), str):
        found["denoiser"] = find_denoiser(text, key, resolve)
    if isinstance(text := parameters.get("initial_estimate"), str):
        found["initial_estimate"] = find_initial_estimate(method, text, key, resolve)
    return {name: path for name, path in found.items() if path is not None}
