"""The files behind plugins: which modules define one, importing a single file, naming the line that failed."""

from __future__ import annotations

import ast
import hashlib
import importlib
import pkgutil
import re
import sys
import traceback
from functools import cache
from pathlib import Path
from types import ModuleType

from simulator.errors import InputError


def modules_defining(package: str, kind: str) -> frozenset[str]:
    """Return the modules of a package that define something of their own name, without importing them.

    Args:
        package: dotted name; only the package itself is imported.
        kind: for the message.

    Raises:
        InputError: when the package cannot be imported.
    """
    try:
        paths = importlib.import_module(package).__path__
    except (Exception, SystemExit) as error:
        label = f"the package {package!r}, which an entry point names for {kind}s"
        raise InputError(describe_failure(error, label)) from error
    names = []
    for info in pkgutil.iter_modules(paths):
        spec = None if info.name.startswith("_") else info.module_finder.find_spec(f"{package}.{info.name}", None)
        if spec is None or spec.loader is None or spec.origin is None:
            continue
        source = spec.loader.get_source(spec.name)  # pyright: ignore[reportAttributeAccessIssue]
        if source is not None and _defines(source, info.name):
            names.append(info.name)
    return frozenset(names)


def _defines(source: str, name: str) -> bool:
    """Whether a module's top level binds a name; a module that does not even parse is left for its import to report."""
    binding = rf"^(?:(?:def|class)\s+)?{name}\b|^(?:from|import)\s.*\b{name}\b|^[ \t]+(?:\w+\s+as\s+)?{name}\b"
    if not re.search(binding, source, re.MULTILINE):  # parsing takes a thousand times as long
        return False
    try:
        body = ast.parse(source).body
    except (SyntaxError, ValueError):
        return True
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return True
        if isinstance(node, ast.ImportFrom) and any((alias.asname or alias.name) == name for alias in node.names):
            return True
        if isinstance(node, ast.Assign) and any(isinstance(to, ast.Name) and to.id == name for to in node.targets):
            return True
    return False


def import_file(path: Path, label: str) -> ModuleType:
    """Import one Python file by its path; a second call returns the same module unless the file has changed.

    Raises:
        InputError: when there is no such file, or naming the line where its code fails.
    """
    if not path.is_file():
        msg = f"{label}: there is no file {path}; a relative path starts at the YAML file's folder"
        raise InputError(msg)
    path = path.resolve()
    state = path.stat()
    try:
        return _import_version(path, state.st_mtime_ns, state.st_size)
    except (Exception, SystemExit) as error:
        raise InputError(describe_failure(error, label, path)) from error


@cache
def _import_version(path: Path, mtime_ns: int, size: int) -> ModuleType:
    digest = hashlib.sha256(str(path).encode()).hexdigest()[:12]
    module = ModuleType(f"flatlight_plugin_{path.stem}_{digest}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # where dataclasses and pickle look for it
    try:
        # Not through importlib's loader: its byte code cache takes a file edited within a second for the old one.
        exec(compile(path.read_bytes(), str(path), "exec", dont_inherit=True), module.__dict__)
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module


def describe_failure(error: BaseException, label: str, path: Path | None = None) -> str:
    """Return one line that names the file and line where importing a plugin failed.

    Args:
        error: what was raised.
        label: what was being imported.
        path: the plugin's file; the deepest line in it is named. None names the deepest line of all.
    """
    reason = " ".join(str(error).split())
    if isinstance(error, SyntaxError) and error.filename:
        return f"{label}: {error.filename}:{error.lineno}: {type(error).__name__}: {error.msg}"
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith("<frozen")]
    own = [frame for frame in frames if path is not None and Path(frame.filename) == path] or frames
    where = f"{own[-1].filename}:{own[-1].lineno}: " if own else ""
    return f"{label}: {where}{type(error).__name__}: {reason}"
