"""What a data set will cost in time, bytes, files and money, from three samples that are thrown away."""

from __future__ import annotations

import io
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simulator.camera.sensor import full_scale_from_pilots
from simulator.config import Config, load_config
from simulator.dataset.engines import available_cpus
from simulator.dataset.engines.stopping import stop_signals
from simulator.dataset.plan import Plan, Report, Say, make_plan
from simulator.dataset.preparation import data_set_stack
from simulator.dataset.recipe import Recipe, make_pilot, make_sample, perform
from simulator.dataset.sample import sample_folder
from simulator.errors import InputError
from simulator.io.store import Place, size_of
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER
from simulator.text import counted, duration, size

_PILOTS = 2
_FILES_BESIDE = (
    7  # dataset.json, manifest.jsonl, checksums.json, croissant.json, README.md, report.html, contact_sheet.png
)


@dataclass(frozen=True)
class Estimate:
    """What a data set will cost.

    Attributes:
        counts: samples wanted per split.
        preparation_s: wall time of mask and PSFs here; seconds where they are cached.
        start_s: wall time until a worker has made its first sample.
        sample_s: wall time of a sample on one worker, mean of two after one that warms up.
        sample_cpu_s: CPU time of a sample, of the same.
        sample_bytes: size of a sample, mean.
        sample_files: files of a sample.
        stack_bytes: size of the PSF stack, and of the captured one where there is one.
        other_files: files beside those of samples.
        memory_bytes: the most that a worker took.
        workers: of this machine, one for ``inline``.
        free_bytes: room where the data set is to lie; None in a store.
        price: per CPU-hour; None where it was not given.
    """

    counts: dict[str, int]
    preparation_s: float
    start_s: float
    sample_s: float
    sample_cpu_s: float
    sample_bytes: float
    sample_files: int
    stack_bytes: int
    other_files: int
    memory_bytes: int
    workers: int
    free_bytes: int | None
    price: float | None

    @property
    def samples(self) -> int:
        """Samples of all splits."""
        return sum(self.counts.values())

    @property
    def cpu_hours(self) -> float:
        """CPU-hours of all samples."""
        return self.samples * self.sample_cpu_s / 3600

    @property
    def bytes(self) -> float:
        """Size of the whole data set."""
        return self.samples * self.sample_bytes + self.stack_bytes

    @property
    def files(self) -> int:
        """Files of the whole data set."""
        return self.samples * self.sample_files + self.other_files

    def __str__(self) -> str:
        splits = ", ".join(f"{split} {count:,}" for split, count in self.counts.items() if count)
        wall_s = self.preparation_s + self.start_s + self.samples * self.sample_s / self.workers
        rows = [
            ("samples", f"{self.samples:,} ({splits})"),
            (
                "each",
                f"{duration(self.sample_cpu_s)} of CPU time, {size(self.sample_bytes)} in {self.sample_files} files",
            ),
            ("all", f"{self.cpu_hours:.3g} CPU-hours, {size(self.bytes)}, {self.files:,} files"),
            (
                "here",
                f"about {duration(wall_s)} with {counted(self.workers, 'worker')}, {duration(self.preparation_s)} of "
                "it for PSFs",
            ),
            ("memory", f"{size(self.memory_bytes)} for each worker"),
        ]
        if self.price is not None:
            rows.append(("money", f"{self.cpu_hours * self.price:,.2f} at {self.price:g} per CPU-hour"))
        if self.free_bytes is not None:
            fits = "enough" if self.free_bytes > self.bytes else "TOO LITTLE"
            rows.append(("disk", f"{size(self.free_bytes)} free: {fits}"))
        return "\n".join(f"{name:>8}  {text}" for name, text in rows)


def estimate(
    config: Config | Path | str,
    overrides: Sequence[str] = (),
    *,
    price: float | None = None,
    progress: Report | None = None,
    say: Say | None = None,
) -> Estimate:
    """Make three samples in a temporary folder and say what all will cost; nothing is written where the data set is to lie.

    Args:
        config: a configuration or the path of a ``sim_config.yaml``.
        overrides: ``a.b=value`` settings, when ``config`` is a path.
        price: per CPU-hour, in any currency.
        progress: called with (stage, done, total).
        say: called with lines worth reading.

    Raises:
        InputError: for mistakes in the configuration or its files, or samples that cannot be made.
    """
    if not isinstance(config, Config):
        config = load_config(config, overrides)
    progress, say = progress or (lambda stage, done, total: None), say or (lambda line: None)
    with config.refusals(), stop_signals(), tempfile.TemporaryDirectory(prefix="flatlight-") as made:
        begin = time.perf_counter()
        plan = make_plan(config, True, progress, say)
        stack_folder = Path(made) / PSF_FOLDER
        data_set_stack(plan.assembly, Path(made), say)
        preparation_s = time.perf_counter() - begin
        recipe = replace(plan.recipe, psf_folder=stack_folder)
        recipe = replace(recipe, full_scale=_full_scale(plan, recipe, Path(made)))
        begin = time.perf_counter()
        costs = list(_pilots(plan, recipe, Path(made), progress))
        start_s = time.perf_counter() - begin - sum(cost.wall_s for cost in costs[1:])
        folders = [sample_folder(Path(made), split, index) for split, index in _some(plan)]
        sizes = [[size_of(path) for path in folder.rglob("*") if path.is_file()] for folder in folders]
        stacks = (Path(made) / name for name in (PSF_FOLDER, CAPTURED_FOLDER))
        stack_sizes = [path.stat().st_size for stack in stacks for path in stack.glob("*")]
    timed = costs[1:] or costs
    return Estimate(
        counts=plan.counts,
        preparation_s=preparation_s,
        start_s=max(0.0, start_s),
        sample_s=sum(cost.wall_s for cost in timed) / len(timed),
        sample_cpu_s=sum(cost.cpu_s for cost in timed) / len(timed),
        sample_bytes=sum(map(sum, sizes)) / len(sizes),
        sample_files=max(map(len, sizes)),
        stack_bytes=sum(stack_sizes),
        other_files=len(stack_sizes) + _FILES_BESIDE,
        memory_bytes=max(cost.memory_bytes for cost in costs),
        workers=_workers(config),
        free_bytes=_free(plan.root),
        price=price,
    )


def _some(plan: Plan) -> list[tuple[str, int]]:
    """Return split and number of the samples that are made: of the first split that has any, one to warm up with them."""
    split, count = next((split, count) for split, count in plan.counts.items() if count)
    return [(split, index) for index in range(min(_PILOTS + 1, count))]


def _workers(config: Config) -> int:
    """Return how many samples are made at a time here."""
    chosen = config.dataset
    if chosen.engine == "inline":
        return 1
    return available_cpus() if chosen.workers == "auto" else chosen.workers


@dataclass(frozen=True)
class _Cost:
    """What a sample took: wall time, CPU time, and the most memory of its process so far."""

    wall_s: float
    cpu_s: float
    memory_bytes: int


def _pilots(plan: Plan, recipe: Recipe, made: Path, progress: Report) -> list[_Cost]:
    """Make the samples on one worker; returns what each took."""
    chosen = _one_worker(plan.config)
    tasks = [(made, split, index) for split, index in _some(plan)]
    costs = []
    for number, outcome in enumerate(perform(chosen.dataset, _weighed, tasks, len(tasks), recipe), start=1):
        if outcome.value is None:
            raise outcome.error or InputError("scene", "no pilot sample could be made")
        costs.append(_Cost(outcome.seconds, *outcome.value))
        progress("pilot samples", number, len(tasks))
    return costs


def _weighed(task: tuple[Place, str, int]) -> tuple[float, int]:
    """Make a sample and return its CPU seconds, and the most memory that this process took so far, bytes."""
    begin = time.process_time()
    make_sample(task)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return time.process_time() - begin, most


def _full_scale(plan: Plan, recipe: Recipe, made: Path) -> float:
    """Return the exposure of the configuration, or one from two pilots: the size of a sample depends on it a little."""
    if (fixed := plan.assembly.fixed_exposure) is not None:
        return float(fixed["full_scale"])
    tasks, exposures = ((made, index) for index in range(_PILOTS)), []
    for outcome in perform(_one_worker(plan.config).dataset, make_pilot, tasks, _PILOTS, recipe):
        if outcome.value is None:
            raise outcome.error or InputError("scene", "no pilot sample could be made")
        exposures.append(np.load(io.BytesIO(outcome.value.read_bytes())))
    return full_scale_from_pilots(exposures)


def _one_worker(config: Config) -> Config:
    engine = "inline" if config.dataset.engine == "inline" else "local"
    return config.model_copy(update={"dataset": config.dataset.model_copy(update={"engine": engine, "workers": 1})})


def _free(root: Place) -> int | None:
    if not isinstance(root, Path):
        return None
    return shutil.disk_usage(next(folder for folder in (root, *root.parents) if folder.exists())).free
