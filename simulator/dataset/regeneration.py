"""Makes samples of a data set again, from what it says of itself, and compares them with those that are stored."""

from __future__ import annotations

import math
import random
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulator.config import Config, config_from_dict, load_config
from simulator.dataset.dataset_info import FILE, DatasetInfo, read_info
from simulator.dataset.exports.source import arrays
from simulator.dataset.fingerprint import cpu_level, difference
from simulator.dataset.manifest import Key, load_manifest
from simulator.dataset.plan import make_plan
from simulator.dataset.recipe import Recipe, make_sample, perform
from simulator.dataset.sample import DESCRIPTION, Sample, StoredSample, read_description, sample_index, stored_folder
from simulator.errors import InputError
from simulator.io.exr import MAX_FILE_BYTES
from simulator.io.files import read_limited
from simulator.io.store import Place, place
from simulator.optics.stack_files import PSF_FOLDER

TOLERANCE = 1e-3
"""Relative L2 difference that another CPU level, library or package version may make: NumPy's float32 functions differ by
1e-7 between vector extensions, but where a ray just meets an edge, or a number just falls to the next DN, a pixel changes."""

Report = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Regenerated:
    """How a sample that was made again compares with the stored one.

    Attributes:
        key: split and id.
        identical: whether every byte is the same.
        difference: the largest relative L2 difference of its arrays; None where they cannot be compared.
        fault: why it is not the same sample; empty where it is.
    """

    key: Key
    identical: bool
    difference: float | None
    fault: str

    def __str__(self) -> str:
        name = "/".join(self.key)
        if self.fault:
            return f"{name}: {self.fault}"
        return f"{name}: " + ("identical" if self.identical else f"the same to {self.difference:.1e} (relative L2)")


@dataclass(frozen=True)
class Regeneration:
    """What making samples again showed.

    Attributes:
        samples: one for each sample asked for, in order.
        elsewhere: what differs here from where the samples were made, one line each: with any, bytes need not agree.
    """

    samples: tuple[Regenerated, ...]
    elsewhere: tuple[str, ...]

    @property
    def faults(self) -> tuple[str, ...]:
        """One line per sample that is not the same."""
        return tuple(str(sample) for sample in self.samples if sample.fault)


def regenerate(
    root: Place | str,
    keys: Sequence[Key],
    *,
    config: Path | str | None = None,
    trust_code: bool = False,
    progress: Report | None = None,
) -> Regeneration:
    """Make samples again and compare them with the stored ones, which stay as they are.

    Args:
        root: the data set.
        keys: split and id of each sample.
        config: the YAML file from which it was made, where it names files or code of its own; their paths start at it. By
            default the configuration in ``dataset.json``, paths from the current folder.
        trust_code: run code that ``dataset.json`` names by file or package.
        progress: called with (stage, done, total).

    Raises:
        InputError: no such sample, code that is not trusted, or a configuration of another data set.
    """
    root = place(root)
    info, entries = read_info(root), load_manifest(root).entries
    for split, name in keys:
        if (split, name) not in entries:
            raise InputError(
                f"{split}/{name}", f"not a finished sample of {root}; `flatlight status {root}` counts them"
            )
    progress = progress or (lambda stage, done, total: None)
    chosen = _configuration(root, info, config, trust_code)
    recipe, changed = _recipe(root, info, chosen, progress)
    cpu, made_on = cpu_level(), {key: entries[key].cpu or info.versions.get("cpu") for key in keys}
    with tempfile.TemporaryDirectory(prefix="flatlight-") as made:
        tasks = [(Path(made), split, sample_index(name)) for split, name in keys]
        found: dict[Key, Regenerated] = {}
        for number, outcome in enumerate(perform(chosen.dataset, make_sample, tasks, len(tasks), recipe), start=1):
            _, split, index = outcome.task
            key = next(key for key in keys if key[0] == split and sample_index(key[1]) == index)
            if outcome.value is None:
                found[key] = Regenerated(key, False, None, f"cannot be made again: {outcome.reason}")
            else:
                found[key] = _compared(root, Path(made), key, may_differ=bool(changed) or made_on[key] != cpu)
            progress("samples made again", number, len(tasks))
    others = tuple(f"cpu: {other} -> {cpu}" for other in sorted({*map(str, made_on.values())} - {cpu}))
    return Regeneration(tuple(found[key] for key in keys), (*changed, *others))


def some_samples(root: Place | str, count: int) -> list[Key]:
    """Return so many finished samples at random, others each time; all where there are fewer."""
    entries = list(load_manifest(root).entries)
    return sorted(random.SystemRandom().sample(entries, min(count, len(entries))))


def named_sample(root: Place | str, name: str) -> Key:
    """Return split and id of a sample that a user named, ``train/s00000012`` or ``s00000012``.

    Raises:
        InputError: there is none, or one in several splits.
    """
    split, _, identifier = name.rpartition("/")
    found = [key for key in load_manifest(root).entries if key[1] == identifier and split in ("", key[0])]
    if len(found) == 1:
        return found[0]
    what = f"in several splits, name one of {', '.join('/'.join(key) for key in found)}" if found else "no such sample"
    raise InputError(name, f"{what} in {root}; expected one like train/s00000012")


def _configuration(root: Place, info: DatasetInfo, path: Path | str | None, trust_code: bool) -> Config:
    if path is not None:
        config = load_config(path)
    else:
        config = config_from_dict(info.config, check_plugins=False)
        if (foreign := _foreign_code(config)) and not trust_code:
            raise InputError(
                root / FILE,
                f"names code of its own ({', '.join(foreign)}), which is not run; where you trust it: --trust-code, or "
                "--config with the YAML file from which the data set was made",
            )
        config = config_from_dict(info.config)
    engine = "inline" if config.dataset.engine == "inline" else "local"
    return config.model_copy(
        update={"dataset": config.dataset.model_copy(update={"output": str(root), "engine": engine})}
    )


def _foreign_code(config: Config) -> list[str]:
    """Return the plugins of a configuration that are named by their file or package."""
    named = [config.scene.family, config.scene.source, getattr(config.camera.shutter, "function", None)]
    named += [] if config.camera.mask is None else [config.camera.mask.design]
    return [name for name in named if name is not None and ":" in name]


def _recipe(root: Place, info: DatasetInfo, config: Config, progress: Report) -> tuple[Recipe, tuple[str, ...]]:
    """Return what makes the samples of a data set, and a line for each package that is another one here."""
    plan = make_plan(config, True, progress, lambda _: None)
    if plan.recipe.backend != info.backend:
        raise InputError(
            root / FILE,
            f"was rendered with {info.backend}, this machine has {plan.recipe.backend} (`flatlight doctor`)",
        )
    lines = difference(info.fingerprint_parts, plan.parts).splitlines()
    changed = [line for line in lines if not line.startswith("versions.")]
    if changed:
        raise InputError(
            root / FILE, "the configuration is not that of this data set; they differ in:\n" + "\n".join(changed)
        )
    full_scale = float(info.exposure["full_scale"])
    recipe = replace(plan.recipe, psf_folder=(root / PSF_FOLDER).resolve(), full_scale=full_scale)
    return recipe, tuple(lines)


def _compared(root: Place, made: Path, key: Key, may_differ: bool) -> Regenerated:
    try:
        folders = [stored_folder(top, *key) for top in (root, made)]
        if _files(folders[0]) == _files(folders[1]):
            return Regenerated(key, True, 0.0, "")
        stored, again = (_all_of(StoredSample(folder).sample()) for folder in folders)
    except InputError as error:
        return Regenerated(key, False, None, f"cannot be compared: {error}")
    differences = _differences(stored, again)
    name = max(differences, key=differences.__getitem__)
    worst = differences[name]
    if math.isinf(worst):
        return Regenerated(key, False, None, f"another one when it is made again: its {name} is not the same")
    if may_differ and worst <= TOLERANCE:
        return Regenerated(key, False, worst, "")
    expected = f"expected at most {TOLERANCE:g}" if may_differ else "expected the same bytes"
    return Regenerated(key, False, worst, f"its {name} differs by {worst:.1e} (relative L2), {expected}")


def _all_of(sample: Sample) -> dict[str, Any]:
    """Return everything that a sample says."""
    return {**arrays(sample), "label": sample.label, "channels": sample.channels, "metadata": sample.metadata}


def _differences(old: Any, new: Any, name: str = "content") -> dict[str, float]:
    """Return the relative L2 differences of two values by name; infinite where they are not of a kind."""
    if isinstance(old, dict) and isinstance(new, dict) and old.keys() == new.keys():
        parts = {key: _differences(old[key], new[key], str(key)) for key in old}
        return {name: 0.0} | {key: value for part in parts.values() for key, value in part.items()}
    if isinstance(old, list | tuple) and isinstance(new, list | tuple) and len(old) == len(new):
        parts = [_differences(one, other, name) for one, other in zip(old, new, strict=True)]
        return {name: max((value for part in parts for value in part.values()), default=0.0)}
    if isinstance(old, np.ndarray) and isinstance(new, np.ndarray) and old.shape == new.shape:
        first, second = old.astype(np.float64), new.astype(np.float64)
        return {name: float(np.linalg.norm(second - first) / max(np.linalg.norm(first), 1e-30))}
    if type(old) is float and type(new) is float:
        least = _SMALL_SHARE if name.endswith("_share") else 1e-30
        return {name: abs(new - old) / max(abs(old), abs(new), least)}
    return {name: 0.0 if old == new else math.inf}


_SMALL_SHARE = 1e-2  # of pixels: a smaller one counts as if it were so large, as one pixel more is no other sample


def _files(folder: Place) -> dict[str, bytes]:
    description, data = read_description(folder)
    found = {DESCRIPTION: data}
    for name in description["files"]:
        found[name] = read_limited(folder / name, "a file of a sample", MAX_FILE_BYTES)
    return found
