"""A disk cache of arrays that cost seconds to compute: mask designs and PSF stacks.

Safe against two writers and against dying ones: an entry is written under a name of its own and renamed into place, so
readers meet whole entries only; a damaged one is computed again. The folder is ``$FLATLIGHT_CACHE_DIR`` or the user's cache
folder; deleting it is always safe.
"""

from __future__ import annotations

import json
import os
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simulator.io.files import StorageError, storage_errors, temporary_path

Entry = tuple[dict[str, np.ndarray], dict[str, Any]]  # arrays, and JSON-serialisable metadata


def cache_folder() -> Path:
    """Return the folder of the cache; it need not exist yet."""
    chosen = os.environ.get("FLATLIGHT_CACHE_DIR")
    if chosen:
        return Path(chosen)
    import platformdirs

    return Path(platformdirs.user_cache_dir("flatlight"))


def cached(kind: str, key: str, compute: Callable[[], Entry]) -> Entry:
    """Return the entry of this key, computed only when the cache does not hold it.

    Args:
        kind: folder inside the cache, such as ``psf``.
        key: hash of everything that decides the entry.
        compute: makes the entry.

    A cache that cannot be written to costs time, not results: it is warned about and left alone.
    """
    path = cache_folder() / kind / f"{key}.npz"
    stored = _load(path)
    if stored is not None:
        return stored
    arrays, metadata = compute()
    try:
        _store(path, arrays, metadata)
    except StorageError as error:
        warnings.warn(f"the result is not cached: {error}", stacklevel=2)
    return arrays, metadata


def _load(path: Path) -> Entry | None:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files if name != "metadata"}
            return arrays, json.loads(str(file["metadata"]))
    # Absent or damaged: compute it again. zipfile raises RuntimeError for damaged flags.
    except (OSError, ValueError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile):
        return None


def _store(path: Path, arrays: dict[str, np.ndarray], metadata: dict[str, Any]) -> None:
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = temporary_path(path)
        try:
            with open(temporary, "xb") as file:
                contents: dict[str, Any] = {**arrays, "metadata": np.array(json.dumps(metadata))}
                np.savez(file, **contents)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
