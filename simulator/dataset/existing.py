"""The folder of a data set before a job begins: empty, begun with the same configuration, or somebody else's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from simulator.dataset.dataset_info import CAPTURED_FOLDER, FILE, PSF_FOLDER, DatasetInfo, read_info
from simulator.dataset.fingerprint import difference
from simulator.dataset.manifest import MANIFEST
from simulator.errors import InputError
from simulator.files import TEMPORARY_PREFIX


def existing_info(root: Path, counts: dict[str, int], fingerprint: str, parts: dict[str, Any]) -> DatasetInfo | None:
    """Return the description of a data set that is begun in a folder already; None where there is none.

    Args:
        root: the folder.
        counts: samples that are wanted per split.
        fingerprint: of what is to be made.
        parts: what was hashed for it.

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
    for split, count in counts.items():
        if count < info.counts.get(split, 0):
            msg = (
                f"dataset.{split}: got {count}, but the data set in {root} already has {info.counts[split]}; counts "
                "can grow later, not shrink: choose another folder for a smaller one"
            )
            raise InputError(msg)
    return info


def _left_by_a_start(path: Path) -> bool:
    """Whether a run that was killed before ``dataset.json`` leaves such a file: it holds nothing of worth."""
    empty_manifest = path.name == MANIFEST and path.stat().st_size == 0
    return empty_manifest or path.name in (PSF_FOLDER, CAPTURED_FOLDER) or path.name.startswith(TEMPORARY_PREFIX)
