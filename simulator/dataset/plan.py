"""What a configuration will make: every part that decides the samples, looked at before anything is written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from simulator.assembly import Assembly
from simulator.config import Config, dump
from simulator.dataset.clips import check_parameters, clip_order
from simulator.dataset.engines import GivenUpError, available_cpus, run
from simulator.dataset.fingerprint import build_fingerprint
from simulator.dataset.problems import refuse_problems
from simulator.dataset.recipe import Recipe
from simulator.dataset.sample import SPLITS
from simulator.errors import InputError
from simulator.io.files import StorageError, expanded
from simulator.io.store import Place, place
from simulator.optics.mask import Mask
from simulator.optics.stack_files import PSF_FOLDER
from simulator.plugins import Plugin
from simulator.render.backend import choose_backend
from simulator.types import SceneSource

Report = Callable[[str, int, int], None]  # (stage, done, total)
Say = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """A data set that is to be made, or gone on with.

    Attributes:
        config: the configuration.
        root: where it will lie.
        assembly: the parts, on the backend that was chosen.
        recipe: what makes a sample; without the exposure, which is found later.
        fingerprint: of what decides the samples' bytes.
        parts: what was hashed for it.
        problems: lines about what the source cannot use.
        skip_bad: whether to go on without what cannot be used.
        timed: whether the parameters have shown already that the clips suit the shutter.
    """

    config: Config
    root: Place
    assembly: Assembly
    recipe: Recipe
    fingerprint: str
    parts: dict[str, Any]
    problems: tuple[str, ...]
    skip_bad: bool
    timed: bool

    @property
    def counts(self) -> dict[str, int]:
        """Samples wanted per split."""
        return {split: getattr(self.config.dataset, split) for split in SPLITS}

    def skips(self, error: Exception) -> bool:
        """Whether an error is one that ``skip_bad`` passes over."""
        return self.skip_bad and isinstance(error, InputError) and not isinstance(error, StorageError)


def make_plan(config: Config, skip_bad: bool, progress: Report, say: Say) -> Plan:
    """Build the parts of a configuration and refuse what does not suit.

    Args:
        config: the configuration.
        skip_bad: go on without files that the source names as its ``problems``.
        progress: called with (stage, done, total).
        say: called with lines worth reading.

    Raises:
        InputError: for mistakes in the configuration or its files.
    """
    root = output_place(config.dataset.output)
    assembly = Assembly(config, threads=available_cpus(), progress=progress)
    plugin, shutter = assembly.scene_plugin, assembly.shutter
    timed = _check_times(config, assembly, plugin)
    renders = plugin.takes_renderer
    backend = choose_backend(config.render.backend, config.render.bands is not None) if renders else None
    variant = backend.variant if backend else "none"
    if backend:
        say(f"rendering with {backend.message}" + (f". {backend.advice}" if backend.advice else ""))
    assembly = _with_mask(replace(assembly, backend=variant).having(shutter=shutter))
    source = assembly.source
    problems = _check_source(config, source, skip_bad, say)
    packages = getattr(source, "packages", ())
    fingerprint, parts = build_fingerprint(dump(config), variant, assembly.input_files, packages)
    folder = (root / PSF_FOLDER).resolve()
    sent = source if plugin.path is None else None
    recipe = Recipe(config, variant, folder, sent, shutter, assembly.view, versions=parts["versions"])
    return Plan(config, root, assembly, recipe, fingerprint, parts, problems, skip_bad, timed or renders)


def output_place(text: str) -> Place:
    """Return where a data set is to lie, complete: a plugin may change the current folder."""
    return place(text) if "://" in text else expanded(text).absolute()


def _check_times(config: Config, assembly: Assembly, plugin: Plugin) -> bool:
    """Refuse scenes whose parameters show that their clips do not suit the shutter; return whether they show it."""
    if ":" in plugin.name:
        return False  # a user's parameters may be called alike and mean something else
    params = plugin.bind(config.scene.params)
    return check_parameters(params, assembly.shutter, config.camera.sensor.shape[0], config.dataset)


def _check_source(config: Config, source: SceneSource, skip_bad: bool, say: Say) -> tuple[str, ...]:
    """Refuse a source with problems, unless they are to be skipped, and splits that would share a video."""
    problems = tuple(getattr(source, "problems", ()))
    if not skip_bad:
        refuse_problems(problems)
    order = clip_order(source)
    shortage = None if order is None else order.shortage({split: getattr(config.dataset, split) for split in SPLITS})
    if shortage and not config.dataset.share_videos:
        raise InputError("dataset", f"{shortage}, or for a trial let them: dataset.share_videos: true")
    if shortage:
        say(f"note: splits share source videos, so results on them mean nothing: {shortage}")
    return problems


def _with_mask(assembly: Assembly) -> Assembly:
    """Return the parts with the mask, where it is a user's design: made in a worker process, which it may end or block.

    Before any other part asks for it, as the view does for an automatic margin.
    """
    config, chosen = assembly.config, assembly.config.camera.mask
    if chosen is None or ":" not in chosen.design or config.dataset.engine == "inline":
        return assembly
    (outcome,) = run("local", _design_mask, [config], workers=1, timeout_s=config.dataset.timeout_s)
    if isinstance(outcome.error, GivenUpError):
        outcome = replace(outcome, error=InputError(f"mask design {chosen.design!r}", outcome.reason))
    with config.refusals("camera.mask"):
        if outcome.error is not None:
            raise outcome.error
    return assembly.having(mask=outcome.value)


def _design_mask(config: Config) -> Mask:
    mask = Assembly(config).mask
    assert mask is not None
    return mask
