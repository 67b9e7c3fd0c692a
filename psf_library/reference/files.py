"""The pinned files: a folder per design with the mask (``mask.exr``) and its PSFs (``psf/``)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from psf_library.reference.cases import build_mask
from simulator.errors import InputError
from simulator.io.exr import read_exr, write_exr
from simulator.optics.mask import Mask
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack, write_psf_stack
from simulator.text import nearest

PINNED = Path(__file__).parent / "pinned"
"""Folder of the references that are shipped."""


def load(name: str, folder: Path = PINNED) -> PsfStack:
    """Return the pinned PSFs of a design.

    Args:
        name: the design's name.
        folder: where the references lie; the shipped ones when left out.

    Returns:
        Two depths, three channels, float32; ``provenance["reference"]`` says from what it was made.

    Raises:
        InputError: no such reference, or a damaged one.

    Example:
        >>> stack = load("pinhole")
        >>> stack.channels, stack.depths_m.tolist(), stack.provenance["reference"]["parameters"]
        (('R', 'G', 'B'), [0.006, 0.2], {'diameter_um': 40})
    """
    return read_psf_stack(_folder(name, folder) / "psf")


def load_pinned_mask(name: str, folder: Path = PINNED) -> Mask:
    """Return the mask that a reference's PSFs were computed from: its pinned arrays and pitch, of the design's material.

    Raises:
        InputError: no such reference, or a damaged one.
    """
    arrays, described = read_exr(_folder(name, folder) / "mask.exr", require_checksums=True)
    return replace(build_mask(name), pitch_m=described["pitch_m"], **arrays)


def write(name: str, mask: Mask, stack: PsfStack, folder: Path = PINNED) -> None:
    """Write a reference in place of an older one.

    Raises:
        StorageError: the place cannot be written to.
    """
    place = folder / name
    write_psf_stack(place / "psf", stack)
    channels = {"height_m": np.asarray(mask.height_m), "amplitude": np.asarray(mask.amplitude)}
    write_exr(place / "mask.exr", channels, {"design": name, "pitch_m": mask.pitch_m})


def _folder(name: str, folder: Path) -> Path:
    known = sorted(path.name for path in folder.iterdir() if path.is_dir()) if folder.is_dir() else []
    if name not in known:
        msg = f"name: got {name!r}, expected one of {', '.join(known) or f'(there is none in {folder})'}"
        raise InputError(msg + nearest(name, known))
    return folder / name
