"""The folder of a data set: made, begun already with the same configuration, or somebody else's; cleaned up on errors."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from simulator.camera.shutter import Shutter
from simulator.camera.shutter_record import shutter_record
from simulator.dataset.dataset_info import CAPTURED_FOLDER, FILE, PSF_FOLDER, DatasetInfo, read_info
from simulator.dataset.fingerprint import difference
from simulator.dataset.manifest import MANIFEST
from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX, storage_errors
from simulator.io.json import canonical_json


def existing_info(
    root: Path, counts: dict[str, int], fingerprint: str, parts: dict[str, Any], shutter: Shutter
) -> DatasetInfo | None:
    """Return the description of a data set that is begun in a folder already; None where there is none.

    Args:
        root: the folder.
        counts: samples that are wanted per split.
        fingerprint: of what is to be made.
        parts: what was hashed for it.
        shutter: through which it is to be exposed.

    Raises:
        InputError: the folder holds something else, another data set, or one with more samples.
    """
    if not root.exists():
        return None
    if not root.is_dir():
        msg = f"dataset.output: {root} is a file; choose another folder"
        raise InputError(msg)
    if not (root / FILE).exists():
        foreign = [path.name for path in sorted(root.iterdir()) if not _left_by_a_start(path)]
        if foreign:
            msg = (
                f"dataset.output: {root} is not empty and holds no data set ({foreign[0]}, ...); choose another "
                "folder, or empty this one"
            )
            raise InputError(msg)
        return None
    info = read_info(root)
    if info.fingerprint != fingerprint:
        msg = (
            f"dataset.output: {root} holds a data set of another configuration; choose another folder, or undo "
            f"the change:\n{difference(info.fingerprint_parts, parts)}"
        )
        raise InputError(msg)
    _refuse_other_windows(root, info, shutter, parts["config"]["camera"]["shutter"].get("function"))
    for split, count in counts.items():
        if count < info.counts.get(split, 0):
            msg = (
                f"dataset.{split}: got {count}, but the data set in {root} already has {info.counts[split]}; counts "
                "can grow later, not shrink: choose another folder for a smaller one"
            )
            raise InputError(msg)
    return info


@contextmanager
def made_folder(root: Path) -> Iterator[None]:
    """Make the data set's folder; on an error, take away what is empty of the folders made.

    Raises:
        StorageError: the folder cannot be made.
    """
    made = [folder for folder in (root, *root.parents) if not folder.exists()]
    with storage_errors(root):
        root.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):
            for folder in made:
                folder.rmdir()
        raise


@contextmanager
def all_or_nothing(root: Path) -> Iterator[None]:
    """On an error before the data set has its description, leave nothing of it; to be entered under its lock."""
    try:
        yield
    except BaseException:
        if not (root / FILE).exists():
            for name in (PSF_FOLDER, CAPTURED_FOLDER):
                shutil.rmtree(root / name, ignore_errors=True)
            with suppress(OSError):
                (root / MANIFEST).unlink()
        raise


def _refuse_other_windows(root: Path, info: DatasetInfo, shutter: Shutter, function: str | None) -> None:
    """Refuse a shutter that is another one than the recorded, though its configuration is the same."""
    recorded = info.time.get("shutter")
    if recorded is None or canonical_json(recorded) == canonical_json(shutter_record(shutter)):
        return
    if function is None:
        msg = f"{root / FILE}: time.shutter is not what its configuration says; restore the file from a copy"
        raise InputError(msg)
    msg = (
        f"camera.shutter.function: {function} gave other windows than the data set in {root} was begun with; it must return "
        "the same at every call: seed what it draws, or write its windows into a file and give camera.shutter.file"
    )
    raise InputError(msg)


def _left_by_a_start(path: Path) -> bool:
    """Whether a run that was killed before ``dataset.json`` leaves such a file: it holds nothing of worth."""
    empty_manifest = path.name == MANIFEST and path.stat().st_size == 0
    return empty_manifest or path.name in (PSF_FOLDER, CAPTURED_FOLDER) or path.name.startswith(TEMPORARY_PREFIX)
