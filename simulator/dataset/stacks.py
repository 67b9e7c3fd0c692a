"""The PSF stacks of a data set: the true one, with which samples are made, and the one that a calibration would measure."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from simulator.assemble import (
    build_camera_colour,
    build_captured_stack,
    build_psf_stack,
    build_response,
    check_calibration,
    check_psf_stack,
    wants_full_check,
)
from simulator.config import Config
from simulator.config.psf import ComputedPsf
from simulator.dataset.dataset_info import CAPTURED_FOLDER, FILE, PSF_FOLDER
from simulator.dataset.engines import available_cpus
from simulator.optics.error_budget.sampling import SamplingWarning
from simulator.optics.metrics import light_off_sensor
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack, write_psf_stack


def data_set_stack(
    config: Config, root: Path, progress: Callable[[str, int, int], None], say: Callable[[str], None]
) -> PsfStack:
    """Return the true stack; it and the captured one are written on the first run and kept on later ones.

    A stack that was deleted from a data set is made again.

    Args:
        config: the data set's configuration.
        root: the data set's folder.
        progress: called with (stage, done, total).
        say: called with lines worth reading.
    """
    begun = (root / FILE).exists()
    folder, captured_folder = root / PSF_FOLDER, root / CAPTURED_FOLDER
    asked = isinstance(config.psf, ComputedPsf) and config.psf.as_captured is not None
    if begun and folder.exists():
        stack = read_psf_stack(folder)
    else:
        if isinstance(config.psf, ComputedPsf):  # mistakes come out before the work that they would spoil
            build_camera_colour(config, build_response(config).channels)
        if asked:
            check_calibration(config)
        say("designing the mask and computing its PSFs" if config.camera.mask else "reading the measured PSF")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)  # the job tells it on every run
            stack = build_psf_stack(
                config, threads=available_cpus(), progress=lambda done, total: progress("PSFs", done, total)
            )
        if wants_full_check(config):
            say("checking the PSFs against exact ones and direct sums")
            stack = check_psf_stack(config, stack, threads=available_cpus(), progress=progress)
        lost = light_off_sensor(stack, config.camera.sensor.shape, config.scene.size)
        stack = replace(stack, provenance=stack.provenance | {"light_off_sensor": float(lost.max())})
        write_psf_stack(folder, stack)
    if asked and begun and captured_folder.exists():
        read_psf_stack(captured_folder)  # a damaged one is refused, like the true one
    elif asked:
        say("measuring the PSFs as a calibration would")
        captured = build_captured_stack(
            config,
            stack,
            threads=available_cpus(),
            progress=lambda done, total: progress("captured PSFs", done, total),
        )
        write_psf_stack(captured_folder, captured)
    return stack
