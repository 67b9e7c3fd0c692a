"""A disk cache of arrays that cost seconds to compute: mask designs and PSF stacks.

Safe against two writers and against dying ones: an entry is written under a temporary name and renamed into place, so
readers meet whole entries only; a damaged one is computed again. The folder is ``$FLATLIGHT_CACHE_DIR`` or the user's cache
folder; deleting it is always safe.

A key holds every value that decides the entry, and :func:`code_digest` of the modules that make it.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
import warnings
import zipfile
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from simulator.io.files import StorageError, storage_errors, temporary_path

_OWN_PACKAGES = ("simulator", "scenes", "psf_library", "learning")
_TOP = Path(__file__).resolve().parents[2]  # the folder of these packages
_DISTRIBUTIONS = {"colour": "colour-science", "skimage": "scikit-image", "PIL": "pillow", "yaml": "PyYAML"}
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

    ``kind``: folder inside the cache, such as ``psf``.
    ``key``: hash of everything that decides the entry.

    A cache that cannot be written to costs time, not results: it is warned about and left alone.
    """
    path = _path(kind, key)
    stored = _load(path)
    if stored is not None:
        return stored
    arrays, metadata = compute()
    try:
        _store(path, arrays, metadata)
    except StorageError as error:
        warnings.warn(f"the result is not cached: {error}", stacklevel=2)
    return arrays, metadata


def is_cached(kind: str, key: str) -> bool:
    """Return whether the cache has an entry of this key; it may still turn out to be damaged."""
    return _path(kind, key).is_file()


def code_digest(*origins: str | Path) -> str:
    """Return a hash of all code that results of some modules can depend on, so that no cached one outlives a change.

    It covers the modules, what they import of Flatlight at any depth (also inside functions), and the versions of the other
    packages that any of these import.

    Args:
        origins: names of our own modules, or files of a user's.

    Raises:
        ValueError: for a name that is not one of our modules.
    """
    files, foreign = _dependencies(origins)
    sha = hashlib.sha256()
    for file in sorted(files):
        sha.update(files[file])
    for package in sorted(foreign):
        sha.update(f"{package} {_version(package)}\n".encode())
    return sha.hexdigest()


def _dependencies(origins: tuple[str | Path, ...]) -> tuple[dict[Path, bytes], set[str]]:
    """Return our own files behind some modules with their code, and the other packages that these import."""
    files, foreign, waiting = dict[Path, bytes](), set[str](), list(origins)
    while waiting:
        origin = waiting.pop()
        file = _own_file(origin) if isinstance(origin, str) else origin
        if file is None:
            msg = f"origins: got {origin!r}, expected a module of {', '.join(_OWN_PACKAGES)}"
            raise ValueError(msg)
        if file in files:
            continue
        files[file] = file.read_bytes()
        for name in _imported(files[file]):
            if name.partition(".")[0] in _OWN_PACKAGES:
                waiting += [name] if _own_file(name) is not None else []
            else:
                foreign.add(name.partition(".")[0])
    return files, foreign - sys.stdlib_module_names


def _own_file(module: str) -> Path | None:
    if module.partition(".")[0] not in _OWN_PACKAGES:
        return None
    path = _TOP.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


@cache
def _imported(code: bytes) -> list[str]:
    """Return the names of the modules that code imports, and of what it takes from them, which may be modules, too."""
    try:
        nodes = list(ast.walk(ast.parse(code)))
    except SyntaxError:  # its import says so
        return []
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return names


@cache
def _version(package: str) -> str:
    try:
        return metadata.version(_DISTRIBUTIONS.get(package, package))
    except metadata.PackageNotFoundError:
        return "none"


def _path(kind: str, key: str) -> Path:
    return cache_folder() / kind / f"{key}.npz"


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
