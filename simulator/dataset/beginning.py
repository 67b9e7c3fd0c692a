"""Whether a folder holds a data set that was begun, may hold one, or is somebody else's."""

from __future__ import annotations

from pathlib import Path

from simulator.dataset.dataset_info import FILE
from simulator.dataset.manifest import MANIFEST
from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX, read_errors
from simulator.io.store import Place, size_of
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, is_stack_file


def is_begun(root: Place, argument: str) -> bool:
    """Return whether a data set is begun in a folder; the folder need not be there.

    Args:
        root: the folder.
        argument: what named it, for errors.

    Raises:
        InputError: it is a file, holds something else than a data set, or cannot be read.
    """
    with read_errors(root):
        if not root.exists():
            return False
        if not root.is_dir():
            raise InputError(argument, f"{root} is a file; choose another folder")
        if (root / FILE).exists():
            return True
        foreign = [path.name for path in sorted(root.iterdir()) if not _left_by_a_start(path)]
        if foreign and not (root / FILE).exists():  # nor has another process begun meanwhile
            raise InputError(argument, f"{root} holds other files ({foreign[0]}, ...); choose another folder")
    return bool(foreign)


def _left_by_a_start(path: Place) -> bool:
    """Whether a run that was killed before ``dataset.json`` leaves such a file or folder: it holds nothing of worth."""
    if path.name.startswith(TEMPORARY_PREFIX):
        return True
    manifest = path.parent / MANIFEST
    in_store = not isinstance(path, Path)  # where the manifest lies elsewhere
    started = in_store or (manifest.is_file() and size_of(manifest) == 0)
    if path.name in (PSF_FOLDER, CAPTURED_FOLDER):
        return started and path.is_dir() and all(is_stack_file(found.name) for found in path.iterdir())
    return started and path.name == MANIFEST
