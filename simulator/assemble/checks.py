"""The full error check of a configuration's PSF stack: minutes of work, kept in the cache beside the stack."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from simulator.assemble.masks import build_mask, optics_code
from simulator.assemble.psfs import build_geometry, build_psf_config
from simulator.config.psf import ComputedPsf
from simulator.errors import InputError
from simulator.io.cache import Entry, cached
from simulator.optics.error_budget.budget import full_errors
from simulator.optics.error_budget.drjit_process import llvm_works
from simulator.optics.stack import PsfStack

if TYPE_CHECKING:
    from simulator.config import Config

_PARTS = {"model": "exact PSFs", "direct_sum": "direct sums", "field_angle": "field angles"}


def wants_full_check(config: Config) -> bool:
    """Whether the configuration asks for the full check (``psf.check: full``)."""
    return isinstance(config.psf, ComputedPsf) and config.psf.check == "full"


def check_psf_stack(
    config: Config, stack: PsfStack, *, threads: int = 1, progress: Callable[[str, int, int], None] | None = None
) -> PsfStack:
    """Return the stack with the full error budget in its provenance.

    Args:
        config: the configuration that made the stack.
        stack: the stack.
        threads: depths computed at a time.
        progress: called with (what, done, total).

    Raises:
        InputError: for a measured stack, which has no model to be checked.
    """
    mask = build_mask(config)
    if mask is None:
        msg = "--check: the PSF of this configuration was measured, so there is no model to check; leave --check out"
        raise InputError(msg)
    geometry, psf_config = build_geometry(config), build_psf_config(config)
    rows, columns = config.scene.size
    per_pixel = geometry.pixel_pitch_m / geometry.mask_to_sensor_m
    corner = (columns / 2 * per_pixel, rows / 2 * per_pixel)
    told = {} if progress is None else {part: partial(progress, name) for part, name in _PARTS.items()}

    def compute() -> Entry:
        return {}, full_errors(mask, geometry, psf_config, corner, threads=threads, progress=told)

    key = hashlib.sha256(repr((stack.fingerprint, corner, llvm_works(), optics_code())).encode()).hexdigest()
    _, errors = cached("check", key, compute)
    return replace(stack, provenance=stack.provenance | {"errors": errors})
