"""Whose a folder is, and which code made a result."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import learning
from simulator import __version__
from simulator.dataset.plain import canonical_json, readable_json
from simulator.errors import InputError
from simulator.files import TEMPORARY_PREFIX, sha256_bytes, storage_errors, write_atomic

DESCRIPTION = "evaluation.json"
"""Says that the folder is an evaluation's, and its name; written first."""
RESULTS, TABLE, REPORT = "results.json", "table.csv", "report.md"
MONTAGE, NOISE, DEPTH, STACKS, TIMES = "montage.png", "noise.png", "depth.png", "stacks.png", "times.png"
_OWN = (REPORT, TABLE, RESULTS, MONTAGE, NOISE, DEPTH, STACKS, TIMES)
_FORMAT = "flatlight evaluation"


def claim_folder(folder: Path, name: str) -> None:
    """See that a folder is new, empty, or of the same evaluation; make it and say whose it is.

    Args:
        folder: the folder.
        name: of the evaluation.

    Raises:
        InputError: a file, a data set, a training, anything else, or an evaluation of another name.
        StorageError: the folder cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        msg = f"output: {folder} is a file; choose another folder"
        raise InputError(msg)
    description = folder / DESCRIPTION
    if description.exists():
        known = _name(description)
        if known != name:
            msg = (
                f"output: {folder} holds the evaluation {known!r}, this one is {name!r}; choose another folder, or keep its "
                "name"
            )
            raise InputError(msg)
        return
    foreign = [each.name for each in sorted(folder.iterdir())] if folder.exists() else []
    foreign = [each for each in foreign if not each.startswith(TEMPORARY_PREFIX)]
    if foreign:
        msg = f"output: {folder} is not empty and holds no evaluation ({foreign[0]}, ...); choose another folder, or empty it"
        raise InputError(msg)
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomic(description, readable_json({"format": _FORMAT, "name": name}))


def remove_stale(folder: Path, written: Iterable[str]) -> None:
    """Delete the files of an earlier run that this one did not write: they show other scenes or settings.

    Raises:
        StorageError: one cannot be deleted.
    """
    for name in set(_OWN) - set(written):
        with storage_errors(folder / name):
            (folder / name).unlink(missing_ok=True)


def _name(description: Path) -> str:
    try:
        content = json.loads(description.read_bytes())
    except (OSError, ValueError) as error:
        msg = f"{description} cannot be read ({error}); restore it from a copy, or choose another output folder"
        raise InputError(msg) from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT or not isinstance(content.get("name"), str):
        msg = f"{description} is no description of an evaluation; choose another output folder"
        raise InputError(msg)
    return content["name"]


@cache
def code_fingerprint(*modules: str) -> str:
    """Return a hash of the sources of modules of `learning`, of all that they import from it, and of the version.

    Imports are read from the sources, those inside functions too, so no list of files can be forgotten.

    Args:
        modules: such as ``"learning.camera"``.

    Raises:
        ModuleNotFoundError: there is no such module.
    """
    sources: dict[str, bytes] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name in sources:
            continue
        path = _file(name)
        if path is None:
            raise ModuleNotFoundError(name)
        sources[name] = path.read_bytes()
        waiting += [each for each in _imports(sources[name]) if _file(each) is not None]
    digests = {name: sha256_bytes(source) for name, source in sorted(sources.items())}
    return sha256_bytes(canonical_json({"flatlight": __version__, "sources": digests}))


def _file(name: str) -> Path | None:
    """Return the source of a module of `learning`; None for what is none, such as a function."""
    first, *rest = name.split(".")
    if first != learning.__name__:
        return None
    place = Path(learning.__path__[0]).joinpath(*rest)
    candidates = (place.with_suffix(".py"), place / "__init__.py") if rest else (place / "__init__.py",)
    return next((path for path in candidates if path.is_file()), None)


def _imports(source: bytes) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
