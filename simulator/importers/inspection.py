"""What lies in a folder: which source reads it, and what reading all of it once shows; for ``flatlight import --check``.

The module of a source may hold two functions beside the one of its name: ``recognises(path)``, which looks at names and at
a few files and returns a `Likeness`, or whether it would read the path, and ``survey(path, progress, **options) -> Survey``,
whose options are some of the source's own parameters. Modules without them, such as a user's own, are left out. Of equally
sure sources those whose module has the lowest ``FALLBACK``, 0 unless it says one, come first: a source of many layouts steps
aside for one that knows the layout by its name. Nothing that the folder names is imported.
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, create_model
from pydantic.fields import FieldInfo

from simulator.errors import InputError
from simulator.importers.listing import first_lines, is_folder, list_folder
from simulator.plugins import SECTION_KEYS, Plugin, available, plugin_errors, resolve

Item = TypeVar("Item")
Progress = Callable[[int, int], None]  # (done, total)


@dataclass(frozen=True)
class Likeness:
    """How much a folder looks like what a source reads.

    Attributes:
        sure: how likely the source is to read it as it is meant.
        why: what was found, in words: ``8 of 8 charts pair with an image by number``.
    """

    sure: Literal["sure", "likely", "possible"]
    why: str

    @property
    def rank(self) -> int:
        """A number that rises with being sure."""
        return ("possible", "likely", "sure").index(self.sure)


@dataclass(frozen=True)
class Survey:
    """The result of reading everything in a data set's folder once, for people to read before they rely on it.

    Attributes:
        importer: the importer's name, as ``scene.source`` takes it.
        path: the folder or file.
        usable: how many videos (or images) can be used.
        facts: what was found, by name, in the order to be shown: ``{"videos": "2", "frames": "20 (16 to 4)", ...}``.
        problems: lines ``"file: what is wrong and what to do"``, for everything that cannot be used.
        notes: lines about what was used all the same but should be known (a mask resized by a pixel, frames skipped).
        needed: parameters that the source demands for what was found, though they have a default: a frame rate for images.
        found: parameters that what was found decides, or suggests, as plain data.
        hints: what was found about a parameter, by its name: how many frames there are.
    """

    importer: str
    path: Path
    usable: int
    facts: dict[str, str]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    found: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    hints: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        width = max((len(name) for name in self.facts), default=0)
        lines = [f"{self.path}: {self.importer}, {self.usable} usable"]
        lines += [f"  {name:<{width}}  {value}" for name, value in self.facts.items()]
        lines += [f"  note: {line}" for line in self.notes]
        lines += [f"  problem: {line}" for line in first_lines(self.problems)]
        return "\n".join(lines)


def told(items: Iterable[Item], total: int, progress: Progress | None) -> Iterator[Item]:
    """Give items one by one, and tell the progress after each."""
    for done, item in enumerate(items, start=1):
        yield item
        if progress is not None:
            progress(done, total)


def frames_hint(lengths: Sequence[int]) -> dict[str, str]:
    """Say how many frames the videos of a survey have, for its hints."""
    if not lengths:
        return {}
    low, high = min(lengths), max(lengths)
    return {"frames": f"those here have {low}" if low == high else f"those here have {low} to {high}"}


def sizes_text(sizes: Iterable[tuple[int, ...]]) -> str:
    """Return sizes in rows and columns, sorted: ``240 x 427, 480 x 854``."""
    return ", ".join(" x ".join(map(str, size)) for size in sorted(sizes))


@dataclass(frozen=True)
class Candidates:
    """The sources that might read a folder.

    Attributes:
        recognised: those that say that they can, the surest first, and how sure.
        others: those that say that they cannot.
        silent: those that cannot tell, as their module has no ``recognises``.
        broken: names and reasons of those that failed.
    """

    recognised: tuple[tuple[Plugin, Likeness], ...]
    others: tuple[Plugin, ...]
    silent: tuple[Plugin, ...]
    broken: tuple[str, ...]

    def __str__(self) -> str:
        width = max((len(plugin.name) for plugin, _ in self.recognised), default=0)
        return "\n".join(f"  {plugin.name:<{width}}  {like.sure:<8}  {like.why}" for plugin, like in self.recognised)


def find_candidates(path: Path) -> Candidates:
    """Ask every installed source whether it recognises a folder or file.

    Raises:
        InputError: the folder cannot be read.
    """
    if is_folder(path):
        list_folder(path)
    recognised: list[tuple[Plugin, Likeness]] = []
    others: list[Plugin] = []
    silent: list[Plugin] = []
    broken: list[str] = []
    for name in available("source"):
        try:
            plugin = resolve("source", name)
            recognises = getattr(_module(plugin), "recognises", None)
            answer = recognises(path) if callable(recognises) else None
        except InputError as error:
            broken.append(f"{name}: {error}")
        except Exception as error:  # another package's fault must not keep ours from answering
            broken.append(f"{name}: {type(error).__name__}: {error}")
        else:
            if not callable(recognises):
                silent.append(plugin)
            elif not answer:
                others.append(plugin)
            else:
                like = answer if isinstance(answer, Likeness) else Likeness("likely", "it says so, and not why")
                recognised.append((plugin, like))
    recognised.sort(key=lambda one: _order(*one))
    return Candidates(tuple(recognised), tuple(others), tuple(silent), tuple(broken))


def choose(path: Path, candidates: Candidates) -> Plugin:
    """Return the one source that is surest of a folder, and not only takes it for possible.

    Raises:
        InputError: none is, or several are equally; the message lists the sources and what each expects.
    """
    best = [(plugin, like) for plugin, like in candidates.recognised if like.sure != "possible"]
    first = [plugin for plugin, like in best if _order(plugin, like) == _order(*best[0])]
    if len(first) == 1:
        return first[0]
    if first:
        raise InputError(
            "--check", f"{path} is recognised by several sources; choose one with --source:{_lines(tuple(first))}"
        )
    if candidates.recognised:
        reason = f"{path} is not clearly one of these; choose one with --source:\n{candidates}"
        raise InputError("--check", f"{reason}{_pictures(path)}")
    reason = f"{path} is laid out like none of these; check the path, or choose one with --source:"
    reason += _lines(candidates.others)
    if candidates.silent:
        reason += f"\nnot asked, as they do not say what they expect:{_lines(candidates.silent)}"
    raise InputError("--check", f"{reason}{_pictures(path)}")


def _order(plugin: Plugin, like: Likeness) -> tuple[int, int]:
    return -like.rank, int(getattr(_module(plugin), "FALLBACK", 0))


def _pictures(path: Path) -> str:
    """What reads images and meshes that belong to no data set."""
    return (
        f"\nimages without depth and meshes, each a scene by itself, are read by scene: {{family: files, path: {path}}}"
    )


def run_survey(plugin: Plugin, path: Path, options: Mapping[str, Any], progress: Progress | None = None) -> Survey:
    """Survey a folder by one source.

    ``options``: of the source's parameters, plain data, those that decide what is read (such as ``subset``).

    Raises:
        InputError: the source has no survey, an option is unknown or wrong, or as the survey does.
    """
    survey = getattr(_module(plugin), "survey", None)
    if not callable(survey):
        raise InputError(
            "--source",
            f"{plugin.name!r} has no survey(path, progress); look with `flatlight render`",
        )
    values = _options(plugin, survey, options)
    with plugin_errors(plugin):
        try:
            result = survey(path, progress, **values)
        except PermissionError as error:
            raise InputError("path", f"{error.filename or path} cannot be read: {error.strerror or error}") from error
    if not isinstance(result, Survey):
        raise InputError(f"source {plugin.name!r}", f"its survey returned {type(result).__name__}, expected a Survey")
    return result


def _module(plugin: Plugin) -> ModuleType:
    """The module that defines a source; already imported."""
    return sys.modules[plugin.function.__module__]


def _options(plugin: Plugin, survey: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """Validate options by those of the source's parameters that its survey takes too.

    Raises:
        InputError: one is a key of the scene, unknown or wrong.
    """
    for key in options:
        if key in SECTION_KEYS["source"]:
            raise InputError("--set", f"{key} decides nothing about what is read here; leave it out")
    taken = inspect.signature(survey).parameters.values()
    anything = any(parameter.kind is parameter.VAR_KEYWORD for parameter in taken)
    named = [parameter for parameter in taken if parameter.kind is parameter.KEYWORD_ONLY]
    names = {parameter.name for parameter in named}
    required = {parameter.name: ... for parameter in named if parameter.default is parameter.empty}
    fields: dict[str, Any] = {
        name: (_annotated(field), required.get(name))
        for name, field in plugin.parameters.model_fields.items()
        if name in names or (anything and name != "path")
    }
    config = plugin.parameters.model_config.copy()
    config["validate_default"] = False  # what is not given is not passed on
    model = create_model(f"{plugin.name} survey", __config__=config, **fields)
    bound = dataclasses.replace(plugin, parameters=model).bind(options)
    return {name: value for name, value in bound.items() if name in options}


def _annotated(field: FieldInfo) -> Any:
    """A parameter's type with its limits, and with the key that tells the kinds of a section apart."""
    by_key = [Field(discriminator=field.discriminator)] if field.discriminator else []
    metadata = (*field.metadata, *by_key)
    return Annotated[field.annotation, *metadata] if metadata else field.annotation


def _lines(plugins: tuple[Plugin, ...]) -> str:
    return "".join(f"\n  {plugin.name}: {_summary(plugin)}" for plugin in plugins)


def _summary(plugin: Plugin) -> str:
    """The first line of the source's module, then where its docstring says what ``path`` is."""
    from simulator.plugin_listing import parameter_lines, summary

    meaning = next((line.meaning for line in parameter_lines(plugin) if line.name == "path"), "")
    return f"{summary(plugin)}{f' path: {meaning}' if meaning else ''}"
