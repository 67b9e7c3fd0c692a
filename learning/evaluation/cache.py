"""Results that are kept: a file each, named by a hash of all that decides them, so that an evaluation goes on."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from simulator.io.files import sha256_bytes, write_atomic
from simulator.io.json import canonical_json, plain


class ResultCache:
    """Kept results below one folder; a damaged file counts as none."""

    def __init__(self, folder: Path) -> None:
        """Make the folder.

        Raises:
            OSError: it cannot be made.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder

    def load(self, key: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return what was kept under a key, or None."""
        try:
            content = json.loads(self._path(key, ".json").read_bytes())
        except (OSError, ValueError):
            return None
        whole = isinstance(content, dict) and "result" in content and content.get("key") == plain(key)
        return content["result"] if whole else None

    def save(self, key: Mapping[str, Any], result: Mapping[str, Any]) -> None:
        """Keep a result.

        Raises:
            StorageError: the place cannot be written to.
        """
        text = json.dumps(
            {"key": plain(key), "result": result}
        )  # may hold infinities, which JSON's readers of Python know
        write_atomic(self._path(key, ".json"), text.encode())

    def load_arrays(self, key: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """Return the arrays that were kept under a key, or None."""
        try:
            with np.load(self._path(key, ".npz"), allow_pickle=False) as kept:
                return dict(kept)
        except (OSError, ValueError, EOFError, BadZipFile):
            return None

    def save_arrays(self, key: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep arrays.

        Raises:
            StorageError: the place cannot be written to.
        """
        stream = io.BytesIO()
        np.savez(stream, allow_pickle=False, **arrays)
        write_atomic(self._path(key, ".npz"), stream.getvalue())

    def _path(self, key: Mapping[str, Any], suffix: str) -> Path:
        return self.folder / (sha256_bytes(canonical_json(key))[:32] + suffix)
