"""What the YAML files of learning share: strict sections, loading, and types of values."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import ConfigDict, PrivateAttr

from simulator import validation
from simulator.config.load import load_model
from simulator.io.files import expanded
from simulator.settings import Range
from simulator.text import show
from simulator.validation import RENAMED, Problem, refusal


class Section(validation.Section):
    """A mapping whose keys are described below each."""

    model_config = ConfigDict(use_attribute_docstrings=True)


class FileSection(Section):
    """The whole of a YAML file; relative paths in it are taken from its folder."""

    _base_dir: Path = PrivateAttr(default_factory=Path.cwd)
    _source: tuple[Path, tuple[str, ...]] | None = PrivateAttr(None)

    @property
    def source(self) -> tuple[Path, tuple[str, ...]] | None:
        """The file and the overrides that it was loaded from, no part of what it says; None where Python made it."""
        return self._source

    def resolve_path(self, text: str | Path) -> Path:
        """Return a path of this file as an absolute one."""
        return expanded(text, self._base_dir)

    def resolve_stack(self, name: str) -> str | Path:
        """Return PSFs as `learning.camera.capture_model` takes them: nominal, captured, or a stack's folder."""
        return name if name in ("nominal", "captured") else self.resolve_path(name)

    def dump(self) -> dict[str, Any]:
        """Return plain data for JSON with all defaults."""
        return self.model_dump(mode="json")


Model = TypeVar("Model", bound=FileSection)


def load_file(
    model: type[Model] | Callable[[dict[str, Any]], type[Model]], path: Path | str, overrides: Sequence[str] = ()
) -> Model:
    """Load a YAML file; see `simulator.config.load.load_model`. Keys of earlier versions are refused with today's names."""
    loaded = load_model(model, path, overrides, _old_names)
    loaded._base_dir, loaded._source = Path(path).resolve().parent, (Path(path), tuple(overrides))
    return loaded


def _old_names(data: Any, path: tuple[str | int, ...] = ()) -> Iterator[Problem]:
    parts = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in parts:
        if key in RENAMED:
            yield Problem((*path, key), f"it is called {RENAMED[key]} now", on_key=True)
        elif (*path, key, value) == ("objective", "picture"):
            yield Problem((key,), "picture is called image now")
        yield from _old_names(value, (*path, key))


Weight = Annotated[float, Range(0, 1e6, below="a weight is not negative")]
Decibels = Annotated[float, Range(0.1, 120, "dB")]
Count = Annotated[int, Range(1, 10_000_000, below="at least one")]
OfStills = Literal["cls", "admm", "pnp"]
OfClips = Literal["static", "slivers", "joint", "fista", "pnp_clips", "udn", "nstm", "joint3d"]
Classical = OfStills | OfClips
CLASSICAL = (*get_args(OfStills), *get_args(OfClips))


def refuse_folder_names(names: Iterable[str], key: str) -> None:
    """Refuse names at ``key`` that no folder may have."""
    for name in names:
        if not re.fullmatch(r"\w[\w .()+-]*", name):
            text = f"got the name {name!r}, expected one that a folder may have: letters, digits, spaces, - or _"
            raise refusal(text, key, name, on_key=True)


def check_once(values: Sequence[Any], each: str, *at: str | int, key: str | None = None) -> None:
    """Refuse a list at the path ``at`` that has a value twice; ``key`` is the value's where entries are mappings."""
    for place, value in enumerate(values):
        if value in values[:place]:
            text = f"got {show(value)} twice, expected each {each} once; leave one out, or change it"
            raise refusal(text, *at, place, *([] if key is None else [key]))
