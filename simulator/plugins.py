"""Resolves the names of mask designs, scene families, imported sources, shutters and commands."""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import pkgutil
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

from pydantic import BaseModel, ConfigDict, PydanticUserError, ValidationError, create_model

from simulator.entry_points import entry_points
from simulator.errors import InputError
from simulator.io.files import StorageError, expanded
from simulator.text import described, nearest, said
from simulator.validation import Problem, find_problems, validate

_FAILURES = (Exception, SystemExit, GeneratorExit)
"""What others' code may raise where it fails; a KeyboardInterrupt may be the user's Ctrl-C."""


def modules_defining(package: str, kind: str) -> frozenset[str]:
    """Return the modules of a package that define something of their own name, without importing them.

    Raises:
        InputError: when the package cannot be imported.
    """
    try:
        paths = importlib.import_module(package).__path__
    except _FAILURES as error:
        label = f"the package {package!r}, which an entry point names for {kind}s"
        raise InputError(label, describe_failure(error)) from error
    names = []
    for info in pkgutil.iter_modules(paths):
        spec = None if info.name.startswith("_") else info.module_finder.find_spec(f"{package}.{info.name}", None)
        if spec is None or spec.loader is None or spec.origin is None:
            continue
        source = spec.loader.get_source(spec.name)  # pyright: ignore[reportAttributeAccessIssue]
        if source is not None and _defines(source, info.name):
            names.append(info.name)
    return frozenset(names)


@cache
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
        raise InputError(label, f"there is no file {path}; a relative path starts at the YAML file's folder")
    path = path.resolve()
    state = path.stat()
    try:
        return _import_version(path, state.st_mtime_ns, state.st_size)
    except _FAILURES as error:
        raise InputError(label, describe_failure(error, path)) from error


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


def describe_failure(error: BaseException, path: Path | None = None) -> str:
    """Return one line that names the file and line where importing a plugin failed.

    ``path``: the plugin's file; the deepest line in it is named. None names the deepest line of all.
    """
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}: {type(error).__name__}: {error.msg}"
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if not frame.filename.startswith("<frozen")]
    own = [frame for frame in frames if path is not None and Path(frame.filename) == path] or frames
    where = f"{own[-1].filename}:{own[-1].lineno}: " if own else ""
    return where + " ".join(described(error).split())


# What messages call each kind; the group of its entry points is flatlight.masks and so on.
_LABELS = {"mask": "mask design", "scene": "scene family", "source": "imported source", "shutter": "shutter function"}

# Keys of the section beside the plugin's parameters, which a parameter therefore cannot be called.
_SCENE_KEYS = ("family", "source", "size", "margin", "margin_deg", "surroundings", "near_cm", "far_cm")
_SHUTTER_KEYS = ("type", "file", "function")
SECTION_KEYS = {"mask": ("design",), "scene": _SCENE_KEYS, "source": _SCENE_KEYS, "shutter": _SHUTTER_KEYS}
_INJECTED = "renderer"
_GIVEN = {"mask": (), "scene": ("view",), "source": ("view",), "shutter": ("rows",)}  # to the function, by position


class ParameterError(InputError):
    """A plugin's parameters are wrong.

    Attributes:
        problems: one per fault, with paths that start at the parameter's name.
    """

    def __init__(self, label: str, problems: list[Problem]) -> None:
        self.problems = problems
        super().__init__("", "\n".join(f"{label}: {problem}" for problem in problems))


@dataclass(frozen=True)
class Plugin:
    """A function with named parameters, found by its name.

    Attributes:
        kind: ``mask``, ``scene``, ``source`` or ``shutter``.
        name: as it was written.
        function: what to call.
        parameters: pydantic model of the keyword-only parameters.
        takes_renderer: whether the function wants ``renderer``, which is injected and no parameter.
        base_dir: folder from which relative paths are taken.
        path: the source file of a ``./file.py:name``, else None.
    """

    kind: str
    name: str
    function: Callable[..., Any]
    parameters: type[BaseModel]
    takes_renderer: bool
    base_dir: Path
    path: Path | None = None

    def bind(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return validated keyword arguments, defaults filled in, relative paths taken from ``base_dir``.

        Raises:
            ParameterError: for unknown and missing parameters and for values of the wrong type or size.
        """
        return self._validated(params)[1]

    def fill(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters as plain data, defaults filled in, paths as written.

        Raises:
            ParameterError: as :meth:`bind`.
        """
        return self._validated(params)[0].model_dump(mode="json")

    def _validated(self, params: Mapping[str, Any]) -> tuple[BaseModel, dict[str, Any]]:
        label = f"{_LABELS[self.kind]} {self.name!r}"
        try:
            values = validate(self.parameters, dict(params))
        except ValidationError as error:
            problems = find_problems(error, self.parameters, dict(params), also=SECTION_KEYS[self.kind])
            raise ParameterError(label, problems) from error
        arguments = {}
        for name, value in values.__dict__.items():
            try:
                arguments[name] = _absolute(value, self.base_dir)
            except InputError as error:
                raise ParameterError(label, [Problem((name,), str(error))]) from error
        return values, arguments


def resolve(kind: str, name: str, base_dir: Path | None = None) -> Plugin:
    """Find a plugin by its name and import it.

    Args:
        kind: ``mask``, ``scene``, ``source`` or ``shutter``.
        name: a bare name, ``./file.py:name`` or ``package.module:name``.
        base_dir: folder from which relative paths are taken; None is the current one.

    Raises:
        InputError: for an unknown name (with the nearest one), a name that two packages define, a broken file (with its
            line) or a signature that cannot be checked.
    """
    base_dir = (base_dir or Path()).resolve()
    place, separator, attribute = name.rpartition(":")
    path: Path | None = None
    if not separator:
        place, attribute = _module_of(kind, name), name
        module = _import_module(kind, name, place)
    elif place.endswith(".py"):
        path = expanded(place, base_dir)
        module = import_file(path, f"{_LABELS[kind]} {name!r}")
    else:
        module = _import_module(kind, name, place)
    function = getattr(module, attribute, None)
    if not inspect.isroutine(function) and not inspect.isclass(function):
        known = [key for key, value in vars(module).items() if inspect.isfunction(value) and not key.startswith("_")]
        raise InputError(
            f"{_LABELS[kind]} {name!r}", f"{place} defines no function {attribute!r}{nearest(attribute, known)}"
        )
    try:
        inspect.getsourcefile(function)
    except TypeError:
        reason = (
            f"{attribute!r} of {place} is not written in Python; name a function or class of a module or file of yours"
        )
        raise InputError(f"{_LABELS[kind]} {name!r}", reason) from None
    parameters, takes_renderer = _model_of(kind, name, function)
    return Plugin(kind, name, function, parameters, takes_renderer, base_dir, path)


def available(kind: str) -> list[str]:
    """Return the sorted bare names of a kind, without importing their modules."""
    return sorted({name for package in _packages(kind) for name in modules_defining(package, kind)})


@contextmanager
def plugin_errors(plugin: Plugin) -> Iterator[None]:
    """Name the user's own code, and its line, where it fails; the failures of built-in plugins stay ours.

    Raises:
        InputError: for anything that a ``./file.py:name`` or ``package.module:name`` raises, and for what would end the
            process, such as ``sys.exit()``, whoever calls it.
    """
    try:
        yield
    except _FAILURES as error:
        if isinstance(error, StorageError) or (":" not in plugin.name and isinstance(error, Exception)):
            raise
        label = f"{plugin.kind} {plugin.name!r}"
        if isinstance(error, InputError):
            reason = said(error)
        else:
            reason = describe_failure(error, plugin.path.resolve() if plugin.path else None)
        raise InputError(label, reason) from error


def _packages(kind: str) -> list[str]:
    built_in = ("simulator.importers",) if kind == "source" else ()
    return list(dict.fromkeys([*built_in, *(entry.value for entry in entry_points(f"flatlight.{kind}s"))]))


def _module_of(kind: str, name: str) -> str:
    """Return the one module that defines a bare name."""
    found = [package for package in _packages(kind) if name in modules_defining(package, kind)]
    if len(found) > 1:
        places = " and ".join(f"{package}.{name}" for package in found)
        raise InputError(f"{_LABELS[kind]} {name!r}", f"defined by both {places}; write package.module:name")
    if not found:
        known = available(kind)
        raise InputError(
            _LABELS[kind],
            f"got {name!r}, expected one of {', '.join(known) or '(none is installed)'}, ./file.py:name or "
            f"package.module:name{nearest(name, known)}",
        )
    return f"{found[0]}.{name}"


def _import_module(kind: str, name: str, module: str) -> Any:
    label = f"{_LABELS[kind]} {name!r}"
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise InputError(label, describe_failure(error)) from error
        raise InputError(
            label, f"no module {error.name!r} is installed; write a file of your own as ./file.py:name"
        ) from error
    except _FAILURES as error:
        raise InputError(label, describe_failure(error)) from error


def _model_of(kind: str, name: str, function: Callable[..., Any]) -> tuple[type[BaseModel], bool]:
    """Turn the keyword-only parameters of a signature into a strict model."""
    label = f"{_LABELS[kind]} {name!r}"
    takes_renderer = False
    fields: dict[str, Any] = {}
    try:
        signature = inspect.signature(function)
        target = function.__init__ if inspect.isclass(function) else function
        hints = get_type_hints(target, include_extras=True)
    except (NameError, TypeError, ValueError, AttributeError) as error:
        raise InputError(label, f"cannot read its annotations ({error}); import their names in its module") from error
    for parameter in signature.parameters.values():
        if parameter.name == _INJECTED:
            takes_renderer = True
        elif parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
            raise InputError(label, f"'{parameter}' cannot be checked; name each parameter after a '*'")
        elif parameter.kind is parameter.KEYWORD_ONLY:
            if parameter.name.startswith("_"):
                raise InputError(label, f"the parameter {parameter.name!r} begins with an underscore; rename it")
            if parameter.name in SECTION_KEYS[kind]:
                raise InputError(label, f"the parameter {parameter.name!r} is a key of its section already; rename it")
            if parameter.name not in hints:
                raise InputError(label, f"the parameter {parameter.name!r} has no type; annotate it, for example float")
            default = ... if parameter.default is parameter.empty else parameter.default
            fields[parameter.name] = (hints[parameter.name], default)
    given = _GIVEN[kind]
    try:
        signature.bind(*given, **fields, **({_INJECTED: None} if takes_renderer else {}))
    except TypeError as error:
        called = f"{function.__name__}({', '.join([*given, '*', '...'])})"
        raise InputError(label, f"{error}; a {kind} is called as {called}, parameters by name") from error
    config = ConfigDict(
        strict=True,
        extra="forbid",
        frozen=True,
        validate_default=True,
        protected_namespaces=(),
        ser_json_inf_nan="constants",
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # a parameter may be called like a method of BaseModel
            return create_model(f"{name} parameters", __config__=config, **fields), takes_renderer
    except (PydanticUserError, NameError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(label, f"its parameters cannot come from YAML ({reason}); use float, str or Path") from error


def _absolute(value: Any, base_dir: Path) -> Any:
    if isinstance(value, Path):
        return expanded(value, base_dir)
    if isinstance(value, list | tuple):
        return type(value)(_absolute(item, base_dir) for item in value)
    return value
