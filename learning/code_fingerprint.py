"""A hash of the code that decides a result: what another version of it computed is not mixed with what this one computes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import learning
from simulator import __version__
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json


@cache
def code_fingerprint(*modules: str) -> str:
    """Return a hash of the sources of modules of `learning`, of all that they import from it, and of the version.

    Imports are read from the sources, those inside functions too, so no list of files can be forgotten.

    Args:
        modules: such as ``"learning.capture"``.

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
