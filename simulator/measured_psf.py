"""The measured PSF stack of a configuration: from images, or from a folder; at its own depths or between them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from simulator.camera.sensor import Sensor
from simulator.config import Config
from simulator.config.psf import MeasuredPsf, StoredPsf
from simulator.errors import InputError
from simulator.optics.materials import AIR
from simulator.optics.stack import PsfStack, with_channels
from simulator.optics.stack_files import read_depths_m, read_psf_stack, stack_files, stack_folder
from simulator.types import CameraGeometry

_SAME_LENGTH = 1e-6  # relative: a length written in mm or um and in metres differs by rounding

Layers = list[tuple[float, str]]
"""(thickness in metres, name of the material), from the mask on."""


def measured_stack(
    config: Config,
    chosen: MeasuredPsf | StoredPsf,
    camera: CameraGeometry,
    sensor: Sensor,
) -> PsfStack:
    """Read the measured stack and, where other planes are asked for, register its planes and interpolate them.

    Only what was measured (in a laboratory or a simulated one) is registered, and only once.

    Args:
        config: the configuration.
        chosen: its PSF section.
        camera: whose channels, distance and layers they are.
        sensor: whose pixels the PSF's must become.

    Raises:
        InputError: for unreadable files, pixels or channels that are not the camera's, planes outside the measured range, or
            ones whose stated error is too great.
    """
    from simulator.optics.interpolation import interpolate_stack
    from simulator.optics.registration import register_stack

    if isinstance(chosen, StoredPsf):
        stack = read_psf_stack(_folder(config, chosen))
        _refuse_other_geometry(chosen, stack, camera)
        stack = with_channels(stack, camera.response.channels, "psf.measured")
    else:
        stack = _from_pictures(config, chosen, sensor, camera.response.channels)
    planes = chosen.planes
    if planes is None:
        return stack
    registration = None
    measured = stack.provenance.get("kind") in ("measured", "captured") and "registration" not in stack.provenance
    if measured and len(stack.depths_m) > 1 and (planes.registration or planes.equal_exposure):
        registration = register_stack(
            stack, camera.mask_to_sensor_m, lateral=planes.registration, exposure=planes.equal_exposure
        )
    return interpolate_stack(
        stack,
        planes.depths_m,
        camera.mask_to_sensor_m,
        extrapolate=planes.extrapolate,
        registration=registration,
        accept_error=planes.accept_error,
    )


def measured_depths_m(config: Config, chosen: MeasuredPsf | StoredPsf) -> tuple[float, ...]:
    """Return the depths of the stack that ``measured_stack`` gives, without reading its images."""
    if chosen.planes is not None:
        return chosen.planes.depths_m
    if isinstance(chosen, StoredPsf):
        return tuple(map(float, read_depths_m(_folder(config, chosen))))
    return tuple(depth * 1e-2 for depth in chosen.depths_cm)


def measured_files(config: Config, chosen: MeasuredPsf | StoredPsf) -> list[Path]:
    """Return the files whose contents decide the stack."""
    if isinstance(chosen, StoredPsf):
        folder = _folder(config, chosen)
        return [folder / name for name in stack_files(folder)]
    background = _background(config, chosen)
    return _pictures(config, chosen) + ([background] if isinstance(background, Path) else [])


def _pictures(config: Config, chosen: MeasuredPsf) -> list[Path]:
    files = [config.resolve_path(name) for name in chosen.measured]
    for index, file in enumerate(files):
        if not file.is_file():
            raise InputError(
                f"psf.measured[{index}]", f"there is no file {file}; relative paths start at the YAML file's folder"
            )
    return files


def _from_pictures(config: Config, chosen: MeasuredPsf, sensor: Sensor, channels: tuple[str, ...]) -> PsfStack:
    from simulator.optics.measured import load_measured_psf

    stack = load_measured_psf(
        _pictures(config, chosen),
        [depth * 1e-2 for depth in chosen.depths_cm],
        sensor.binned_pitch_m,
        frame=chosen.frame,
        cfa=chosen.cfa,
        crop=chosen.crop,
        binning=chosen.binning,
        background=_background(config, chosen),
        throughput_m2=chosen.throughput_mm2 * 1e-6,
        channels=channels,
    )
    for axis, have, physical in zip(("rows", "columns"), stack.values.shape[-2:], sensor.physical_shape, strict=True):
        if have * sensor.binning > physical:
            raise InputError(
                "psf.binning",
                f"{chosen.binning} leaves images of {have} {axis}, but sensor {sensor.name!r} has only "
                f"{physical // sensor.binning} binned ones of {sensor.binned_pitch_m * 1e6:g} um; the PSF's pixels "
                "must become the sensor's binned pixels: raise psf.binning",
            )
    return stack


def _refuse_other_geometry(chosen: StoredPsf, stack: PsfStack, camera: CameraGeometry) -> None:
    """Refuse a stack of other pixels or made behind another gap; a stack of images does not say what its gap was.

    Raises:
        InputError: naming both pitches, distances or gaps.
    """
    pitch_m, mask_to_sensor_m = camera.pixel_pitch_m, camera.mask_to_sensor_m
    if not math.isclose(stack.pixel_pitch_m, pitch_m, rel_tol=_SAME_LENGTH):
        raise InputError(
            "psf.measured",
            f"the stack in {chosen.measured} has pixels of {stack.pixel_pitch_m * 1e6:g} um, the sensor's "
            f"binned ones are {pitch_m * 1e6:g} um; set camera.sensor.binning and pixel_pitch_um as when it was made",
        )
    recorded_m = stack.provenance.get("mask_to_sensor_m")
    if recorded_m is None:
        return
    if not math.isclose(recorded_m, mask_to_sensor_m, rel_tol=_SAME_LENGTH):
        made, asked = (f"{metres * 1e3:.7g} mm" for metres in (recorded_m, mask_to_sensor_m))
        raise InputError(
            "psf.measured",
            f"the stack in {chosen.measured} was made with {made} of air, or as much as that, from mask to "
            f"sensor, the camera has {asked}; set camera.mask_to_sensor_mm, or gap and substrate, as when it was made",
        )
    own_gap = [(layer.thickness_m, layer.material.name) for layer in camera.gap]
    made_gap = [(layer["thickness_m"], layer["material"]) for layer in stack.provenance.get("gap", ())]
    if own_gap and not _same_layers(own_gap, made_gap or [(recorded_m, AIR.name)]):
        made, asked = (_shown(layers) for layers in (made_gap, own_gap))
        raise InputError(
            "psf.measured",
            f"the stack in {chosen.measured} was made behind a gap of {made}, the camera's is {asked}; set "
            "camera.gap and substrate as when it was made",
        )


def _same_layers(some: Layers, others: Layers) -> bool:
    return len(some) == len(others) and all(
        name == other_name and math.isclose(thickness_m, other_m, rel_tol=_SAME_LENGTH)
        for (thickness_m, name), (other_m, other_name) in zip(some, others, strict=True)
    )


def _shown(layers: Layers) -> str:
    return " + ".join(f"{thickness_m * 1e3:.7g} mm {name}" for thickness_m, name in layers) or "air"


def _folder(config: Config, chosen: StoredPsf) -> Path:
    place = config.resolve_path(chosen.measured)
    if place.is_file():
        raise InputError(
            "psf.measured",
            f"{chosen.measured} is a file; images are given as a list with their depths: "
            f"measured: [{chosen.measured}], depths_cm: [...], frame: ..., throughput_mm2: ...",
        )
    return stack_folder(place)


def _background(config: Config, chosen: MeasuredPsf) -> Any:
    """Return a measured PSF's background as ``load_measured_psf`` takes it, a file as a path."""
    named = isinstance(chosen.background, str) and chosen.background not in ("border", "none")
    return config.resolve_path(str(chosen.background)) if named else chosen.background
