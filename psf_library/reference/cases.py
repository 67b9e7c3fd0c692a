"""What is pinned: one entry per mask design, all seen through one small camera, and the files that hold it.

The masks are 0.3 mm wide, half a millimetre from the sensor: large enough for every part of a design and of the light
path to matter, small enough for the whole of the light that is followed to fit into 67 x 67 pixels. Each design has a
folder with its mask (``mask.exr``) and its PSFs (``psf/``).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.io.exr import read_exr, write_exr
from simulator.optics.error_budget.budget import proven_psf_stack
from simulator.optics.error_budget.sampling import SamplingWarning
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig
from simulator.optics.spectra import spectral_response
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack, write_psf_stack
from simulator.plugins import resolve
from simulator.text import nearest
from simulator.types import CameraGeometry

INPUTS = Path(__file__).parent / "inputs"
"""Folder of the images that designs read, neither with any symmetry: a letter F of three greys, and a tilted bowl with a
ridge. Paths among a case's parameters are relative to it."""

PIXEL_PITCH_M = 14.4e-6  # six pixels of an IMX183
DEPTHS_M = (6e-3, 0.2)  # near enough to magnify by a twelfth, and far enough to be nearly parallel light


@dataclass(frozen=True)
class Case:
    """How one design is pinned: its parameters, as in YAML, and the distance from mask to sensor."""

    parameters: Mapping[str, Any] = field(default_factory=dict)
    mask_to_sensor_m: float = 5e-4


CASES: dict[str, Case] = {
    "amplitude_image": Case({"file": "amplitudes.png", "feature_um": 16, "pixel_um": 2}),
    "diffusercam": Case({"width_mm": 0.3, "correlation_um": 25, "slope_degrees": 1.2}),
    "flatcam": Case({"order": 5, "feature_um": 10}),
    "fresnel_zone": Case({"width_mm": 0.3, "first_zone_um": 40}),
    "height_map": Case({"file": "heights.png", "pixel_um": 4, "max_height_um": 5, "profile": "smooth"}),
    "lens": Case({"width_mm": 0.2, "distance_um": 500}),
    "mura": Case({"rank": 29, "feature_um": 10}),
    "phlatcam": Case({"width_mm": 0.3, "distance_um": 500, "cell_um": 60, "line_um": 8}),
    "pinhole": Case({"diameter_um": 40}),
    "random_lenslets": Case({"width_mm": 0.3, "distance_um": 500, "spacing_um": 50}),
    "spiral": Case({"width_mm": 0.3}),
    "vortex": Case({"width_mm": 0.2, "distance_um": 500, "charge": 24}),
}


def build_mask(name: str) -> Mask:
    """Design a case's mask anew, in float32, whatever a cache holds.

    Raises:
        InputError: for a name without a case.
    """
    plugin = resolve("mask", name, INPUTS)
    mask = plugin.function(**plugin.bind(_case(name).parameters))
    height_m, amplitude = (np.asarray(to_numpy(part), np.float32) for part in (mask.height_m, mask.amplitude))
    return replace(mask, height_m=height_m, amplitude=amplitude)


def compute(name: str, mask: Mask | None = None) -> PsfStack:
    """Compute a case's PSFs with the code that is installed.

    Args:
        name: a key of ``CASES``.
        mask: in place of the mask that the design makes; the regression test hands in the pinned one, so that a change of
            the design and a change of the optics are told apart.

    Returns:
        The stack: two depths, three channels, one wavelength each; ``provenance["reference"]`` says what it was made from.

    Raises:
        InputError: for a name without a case.
    """
    case = _case(name)
    camera = CameraGeometry(case.mask_to_sensor_m, PIXEL_PITCH_M, spectral_response())
    mask = build_mask(name) if mask is None else mask
    psf_config = PsfConfig(DEPTHS_M, wavelengths_per_channel=1, accept_error=10.0)
    with warnings.catch_warnings():
        # These grids pin what the code computes, not how well it samples: the error is recorded with the stack.
        warnings.simplefilter("ignore", SamplingWarning)
        stack = proven_psf_stack(mask, camera, psf_config)
    made_from = {"design": name, "parameters": dict(case.parameters), "mask_to_sensor_m": case.mask_to_sensor_m}
    return replace(stack, provenance=stack.provenance | {"reference": made_from})


def _case(name: str) -> Case:
    if name not in CASES:
        raise InputError("name", f"got {name!r}, expected one of {', '.join(CASES)}{nearest(name, list(CASES))}")
    return CASES[name]


PINNED = Path(__file__).parent / "pinned"
"""Folder of the references that are shipped."""


def load(name: str, folder: Path = PINNED) -> PsfStack:
    """Return the pinned PSFs of a design: two depths, three channels, float32.

    ``provenance["reference"]`` says from what they were made.

    Raises:
        InputError: no such reference in the folder, or a damaged one.

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
        choices = ", ".join(known) or f"(there is none in {folder})"
        raise InputError("name", f"got {name!r}, expected one of {choices}{nearest(name, known)}")
    return folder / name
