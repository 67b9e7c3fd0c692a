"""The folder of a data set before its first sample: description, PSF stack, exposure; never mixed with another's."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

from simulator.assembly import Assembly
from simulator.camera.shutter import Shutter, shutter_record
from simulator.captured_psf import captured_stack, check_calibration
from simulator.config import dump
from simulator.config.psf import ComputedPsf
from simulator.dataset.beginning import is_begun
from simulator.dataset.clips import ClipTimesError
from simulator.dataset.dataset_info import FILE, DatasetInfo, read_info, write_info
from simulator.dataset.exposure import find_exposure
from simulator.dataset.fingerprint import cpu_level, difference
from simulator.dataset.manifest import MANIFEST, WRITERS
from simulator.dataset.plan import Plan, Report, Say
from simulator.dataset.reader import all_metadata
from simulator.dataset.recipe import check_first_clip, perform
from simulator.errors import InputError
from simulator.io.files import make_folder, remove_folder, storage_errors
from simulator.io.json import canonical_json
from simulator.io.store import Place, StorePath, check_store
from simulator.optics.error_budget.sampling import SamplingWarning
from simulator.optics.metrics import light_off_sensor
from simulator.optics.stack import UNPROVEN, PsfStack
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack, write_psf_stack


def existing_info(plan: Plan) -> DatasetInfo | None:
    """Return the description of a data set that is begun already where a plan wants to lie; None where there is none.

    Raises:
        InputError: the folder holds something else, another data set, or one with more samples.
    """
    root = plan.root
    if not is_begun(root, "dataset.output"):
        return None
    info = read_info(root)
    if info.fingerprint != plan.fingerprint:
        changes = difference(info.fingerprint_parts, plan.parts)
        raise InputError("dataset.output", f"{root} holds another data set; choose another folder, or undo:\n{changes}")
    function = plan.parts["config"]["camera"]["shutter"].get("function")
    _refuse_other_windows(root, info, plan.recipe.shutter, function)
    for split, count in plan.counts.items():
        if count < info.counts.get(split, 0):
            raise InputError(
                f"dataset.{split}",
                f"got {count}, but {root} already has {info.counts[split]}; choose another folder for fewer",
            )
    return info


def prepare(
    plan: Plan, existing: DatasetInfo | None, accept_exposure: bool, progress: Report, say: Say
) -> tuple[DatasetInfo, PsfStack]:
    """Write the PSF stack and the description of a data set, where they are not there yet; on an error, nothing of it.

    Raises:
        InputError: mistakes that come out late, or an exposure that is of no use.
        StorageError: the place cannot be written to.
    """
    with _all_or_nothing(plan.root):
        stack = data_set_stack(plan.assembly, plan.root, say)
        info = existing or _described(plan, stack, find_exposure(plan, accept_exposure, progress, say))
        wanted = described_anew(plan, info)
        if wanted != existing:
            write_info(plan.root, wanted)
    return wanted, stack


def described_anew(plan: Plan, info: DatasetInfo) -> DatasetInfo:
    """Return the description of a data set that was begun, with what another run may change: counts, place, workers."""
    return replace(info, counts=plan.counts, config=dump(plan.config))


def _described(plan: Plan, stack: PsfStack, exposure: dict[str, Any]) -> DatasetInfo:
    config, assembly = plan.config, plan.assembly
    colour = assembly.camera_colour(stack.channels)
    slivers = {"slivers": config.dataset.slivers, "ground_truth": config.dataset.ground_truth}
    return DatasetInfo(
        name=config.name,
        config=dump(config),
        fingerprint=plan.fingerprint,
        fingerprint_parts=plan.parts,
        versions=plan.parts["versions"] | {"cpu": cpu_level()},
        backend=plan.recipe.backend,
        exposure=exposure | {"bit_depth": assembly.sensor.bit_depth},
        counts=plan.counts,
        scene_shape=config.scene.size,
        sensor_shape=config.camera.sensor.shape,
        channels=assembly.sensor.channels(stack.channels),
        scene_to_camera=colour.origin | {"matrix": colour.matrix.tolist()},
        field_of_view=assembly.simulated_field.record(stack),
        time={"shutter": shutter_record(plan.recipe.shutter), **slivers},
    )


# ---- the folder


@contextmanager
def made_folder(root: Place) -> Iterator[None]:
    """Make the data set's folder, or try the store; on an error, take away what is empty of the folders made.

    Raises:
        StorageError: the folder cannot be made, or the store not written to.
        InputError: the store overwrites what it should not.
    """
    if isinstance(root, StorePath):
        with storage_errors(root):
            check_store(root)
        yield
        return
    made = [folder for folder in (root, *root.parents) if not folder.exists()]
    with storage_errors(root):
        make_folder(root)
    try:
        yield
    except BaseException:
        with suppress(OSError):
            for folder in made:
                folder.rmdir()
        raise


@contextmanager
def _all_or_nothing(root: Place) -> Iterator[None]:
    """On an error before the data set has its description, leave nothing of it; for a process that is alone there."""
    try:
        yield
    except BaseException:
        if not (root / FILE).exists():
            for name in (PSF_FOLDER, CAPTURED_FOLDER, WRITERS):
                remove_folder(root / name)
            with suppress(OSError):
                (root / MANIFEST).unlink(missing_ok=True)
        raise


def _refuse_other_windows(root: Place, info: DatasetInfo, shutter: Shutter, function: str | None) -> None:
    """Refuse a shutter that is another one than the recorded, though its configuration is the same."""
    recorded = info.time.get("shutter")
    if recorded is None or canonical_json(recorded) == canonical_json(shutter_record(shutter)):
        return
    if function is None:
        raise InputError(root / FILE, "time.shutter is not what its configuration says; restore the file from a copy")
    raise InputError(
        "camera.shutter.function",
        f"{function} gave other windows than the data set in {root} was begun with; it must return "
        "the same at every call: seed what it draws, or write its windows into a file and give camera.shutter.file",
    )


# ---- the PSF stack


def data_set_stack(assembly: Assembly, root: Place, say: Callable[[str], None]) -> PsfStack:
    """Return the true stack; it and the captured one are written on the first run and kept on later ones.

    A stack that was deleted from a data set is made again.
    """
    config, begun = assembly.config, (root / FILE).exists()
    folder, captured_folder = root / PSF_FOLDER, root / CAPTURED_FOLDER
    asked = isinstance(config.psf, ComputedPsf) and config.psf.as_captured is not None
    if begun and folder.exists():
        stack = read_psf_stack(folder)
    else:
        if isinstance(config.psf, ComputedPsf):  # mistakes come out before the work that they would spoil
            assembly.camera_colour(assembly.response.channels)
        if asked:
            check_calibration(assembly)
        say("designing the mask and computing its PSFs" if config.camera.mask else "reading the measured PSF")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)  # the job tells it on every run
            stack = assembly.psf_stack
        if stack.provenance.get("sampling") == UNPROVEN:
            raise InputError(
                "psf",
                "the sampling error of this stack was never measured, so no data set is made with it; compute it with "
                "simulator.optics.error_budget.budget.proven_psf_stack",
            )
        if assembly.wants_full_check:
            say("checking the PSFs against exact ones and direct sums")
            stack = assembly.checked_stack
        if begun:
            _refuse_another_stack(root, stack)
        lost = light_off_sensor(stack, config.camera.sensor.shape, config.scene.size)
        stack = replace(stack, provenance=stack.provenance | {"light_off_sensor": float(lost.max())})
        write_psf_stack(folder, stack)
    if asked and begun and captured_folder.exists():
        read_psf_stack(captured_folder)  # a damaged one is refused, like the true one
    elif asked:
        say("measuring the PSFs as a calibration would")
        write_psf_stack(captured_folder, captured_stack(assembly.having(psf_stack=stack)))
    return stack


def _refuse_another_stack(root: Place, stack: PsfStack) -> None:
    """Refuse a stack that was made again and is not that of the samples which are there."""
    for metadata in all_metadata(root, 1):
        if metadata.get("psf") != stack.fingerprint:
            raise InputError(
                root / PSF_FOLDER,
                "is gone, and what was made again is not the stack of the samples: its mask is another one, as of a design "
                "that draws without a seed. Restore the folder from a copy",
            )


# ---- the clips


def look_at_a_clip(plan: Plan) -> None:
    """Refuse clips that do not suit the shutter before there is anything else to undo.

    What cannot be had at all is reported as its sample's failure.

    Raises:
        ClipTimesError: the first clip does not.
    """
    for outcome in perform(plan.config.dataset, check_first_clip, [plan.recipe], 1):
        if isinstance(outcome.error, ClipTimesError) and not plan.skip_bad:
            raise outcome.error
