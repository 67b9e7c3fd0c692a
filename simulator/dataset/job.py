"""The job: makes a data set, or one shard of it, and resumes it after any death."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from simulator.camera.exposure import ExposureShares
from simulator.config import Config, load_config
from simulator.dataset.checksums import changed_files, read_seal, unseal
from simulator.dataset.completion import complete
from simulator.dataset.dataset_info import DatasetInfo
from simulator.dataset.engines import ready
from simulator.dataset.exposure import say_exposure
from simulator.dataset.forecast import ENOUGH, Facts, Forecast
from simulator.dataset.manifest import (
    FAILED,
    FailedWriter,
    ManifestWriter,
    SkippedWriter,
    accounted_samples,
    finished_samples,
    load_skipped,
)
from simulator.dataset.plan import Plan, Report, Say, make_plan
from simulator.dataset.preparation import (
    described_anew,
    existing_info,
    look_at_a_clip,
    made_folder,
    prepare,
)
from simulator.dataset.problems import list_problems
from simulator.dataset.reader import all_metadata
from simulator.dataset.recipe import Made, make_sample, perform
from simulator.dataset.repair import take_out_bad
from simulator.dataset.sample import sample_folder, sample_id
from simulator.dataset.shards import Shard, alone, remove_unfinished, sharing
from simulator.errors import InputError
from simulator.io.files import StorageError
from simulator.io.store import Place, StorePath
from simulator.optics.error_budget.budget import budget_lines
from simulator.optics.stack import PsfStack

OFF_SENSOR_WARNING = 0.01
CLAMPED_LIGHT_WARNING = 0.05
_LOOKED_AT = 2000  # samples, by whose metadata a data set is judged


@dataclass(frozen=True)
class GenerateResult:
    """What a run of ``generate`` did.

    Attributes:
        path: the data set's folder.
        made: samples made by this run.
        kept: samples, of its shard if it made one, that were there before.
        failed: one line per sample that could not be made: id and reason; the next run tries them again.
        seconds: wall time.
        skipped: one line per sample that this run or one before left out for good: id and reason.
        problems: lines about what the source cannot use.
        missing: samples of the data set that other shards have not made yet.
        sealed: whether the data set is complete by this run; a shard leaves the seal to the last one, and where nothing tells
            it who that is, as in object stores, to a run without ``shard``.
    """

    path: Place
    made: int
    kept: int
    failed: tuple[str, ...]
    seconds: float
    skipped: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()
    missing: int = 0
    sealed: bool = True


def generate(
    config: Config | Path | str,
    overrides: Sequence[str] = (),
    *,
    shard: Shard | None = None,
    skip_bad: bool = False,
    accept_exposure: bool = False,
    repair: bool = False,
    ignore_space: bool = False,
    progress: Report | None = None,
    say: Say | None = None,
    watch: Callable[[Facts], object] | None = None,
    finish: Callable[[Place], object] | None = None,
) -> GenerateResult:
    """Make a data set, or finish one that was begun.

    Args:
        config: a configuration or the path of a ``sim_config.yaml``. ``dataset.output`` is relative to the current folder.
        overrides: ``a.b=value`` settings, when ``config`` is a path.
        shard: make only this part; other parts may be made in the same folder at the same time, on any machine.
        skip_bad: go on without what cannot be used, and list it: files that the source names as its ``problems``, and
            samples that fail by an ``InputError`` (they are not tried again). Without it the former are refused, the latter
            reported and tried again by the next run.
        accept_exposure: go on where no value carries signal: all are saturated, black or below the noise.
        repair: check every byte first, and make anew exactly what is not as it was written.
        ignore_space: go on where the first samples show that the disk has no room for all.
        progress: called with (stage, done, total).
        say: called with lines worth reading: the backend, measured errors, warnings.
        watch: called before ``progress`` with what more is known of the samples.
        finish: called with the data set's folder, where it has samples, before ``checksums.json`` seals it: to draw its
            pages. With shards, by the last to end.

    Raises:
        InputError: for mistakes in the configuration or its files, or when the folder holds another data set, or one that
            is not as it was sealed, or for want of space; nothing that was written before is lost.
        StorageError: when the disk is full or protected.
    """
    begin = time.perf_counter()
    if not isinstance(config, Config):
        config = load_config(config, overrides)
    progress, say = progress or (lambda stage, done, total: None), say or (lambda line: None)
    with config.refusals():
        plan = make_plan(config, skip_bad, progress, say)
        if repair:
            _repair(plan, shard, progress, say)
        quiet = (lambda facts: None, lambda root: None)
        job = _Job(plan, shard, accept_exposure, ignore_space, progress, say, watch or quiet[0], finish or quiet[1])
        job.run()
    skipped = tuple(f"{split}/{name}: {reason}" for (split, name), reason in load_skipped(plan.root).items())
    seconds = time.perf_counter() - begin
    failed = tuple(sorted(job.failed))
    return GenerateResult(
        plan.root, job.made, job.kept, failed, seconds, skipped, plan.problems, job.missing, job.sealed
    )


def _repair(plan: Plan, shard: Shard | None, progress: Report, say: Say) -> None:
    if shard is not None:
        raise InputError("--repair", "got it beside --shard, but it needs to be alone with the data set; leave one out")
    if existing_info(plan) is None:
        raise InputError("--repair", f"{plan.root} holds no data set yet; leave it out")
    workers = 1 if plan.config.dataset.engine == "inline" else plan.config.dataset.workers
    removed = take_out_bad(plan.root, workers, lambda done, total: progress("samples checked", done, total))
    for name in removed.stacks:
        say(f"repair: the stack in {name}/ is damaged and is made anew")
    for name in removed.samples:
        say(f"repair: {name} is damaged and is made anew")
    if not (removed.samples or removed.stacks):
        say("repair: no sample and no stack is damaged")


@dataclass
class _Job:
    plan: Plan
    shard: Shard | None
    accept_exposure: bool
    ignore_space: bool
    progress: Report
    say: Say
    watch: Callable[[Facts], object]
    finish: Callable[[Place], object]
    made: int = 0
    kept: int = 0
    missing: int = 0
    sealed: bool = False
    failed: list[str] = field(default_factory=list)
    _cpus: set[str] = field(default_factory=set)

    def run(self) -> None:
        """Prepare the data set, make its samples and seal it: in one go, or alone, beside others, and alone again."""
        root, chosen, existing = self.plan.root, self.plan.config.dataset, existing_info(self.plan)
        if existing is not None and self._is_complete(existing):
            return
        with ready(chosen.engine, chosen.workers, chosen.ray):
            if existing is None and not self.plan.timed:
                look_at_a_clip(self.plan)
            with made_folder(root):
                if self.shard is None and not isinstance(root, StorePath):
                    with ManifestWriter(root) as manifest:
                        info = self._begin(manifest)
                        self._samples(info, manifest)
                        self._end(info, manifest)
                    return
                info = self._beside_others()
                with alone(root) as manifest:
                    # A shard that cannot know whether others are at work leaves the end to a run without --shard.
                    if manifest is not None and (self.shard is None or (manifest.locked and not self.missing)):
                        self._end(info, manifest)

    def _is_complete(self, existing: DatasetInfo) -> bool:
        """Whether the data set is sealed, as it was sealed, and nothing is left to be made."""
        root, plan = self.plan.root, self.plan
        hashes = read_seal(root)
        if hashes is None or existing != described_anew(plan, existing) or next(changed_files(root, hashes), None):
            return False
        finished = finished_samples(root)
        there = accounted_samples(root, finished)
        self.kept = sum(1 for split, index in self._wanted() if index in finished[split])
        complete = all(index in there[split] for split, index in self._wanted())
        if complete:
            self.sealed = True
            self.progress("samples", self._total, self._total)
        return complete

    def _beside_others(self) -> DatasetInfo:
        """Make the samples of a shard, and count what other shards have not made when it ends."""
        root = self.plan.root
        while True:
            with alone(root) as manifest:
                if manifest is not None:
                    self._begin(manifest)
            with sharing(root, self.shard, self.say) as own:
                if own is None:
                    continue
                info = existing_info(self.plan)
                assert info is not None
                if info.counts != self.plan.counts:
                    raise InputError("dataset", f"{root} is being made with other counts, {info.counts}; wait for it")
                self._samples(info, own)
            there = accounted_samples(root, failed=True)
            every = ((split, index) for split, count in self.plan.counts.items() for index in range(count))
            self.missing = sum(1 for split, index in every if index not in there[split])
            return info

    def _begin(self, manifest: ManifestWriter) -> DatasetInfo:
        """Prepare the data set."""
        plan = self.plan
        unseal(plan.root)
        remove_unfinished(manifest)
        info, stack = prepare(plan, existing_info(plan), self.accept_exposure, self.progress, self.say)
        self._warn(stack)
        if plan.problems:
            self.say(list_problems(plan.root, plan.problems))
        return info

    def _end(self, info: DatasetInfo, manifest: ManifestWriter) -> None:
        """Complete the data set, and say what it is worth."""
        remove_unfinished(manifest)  # of workers that were killed
        complete(manifest, self.finish if self.made + self.kept else None)
        self.sealed = True
        if self.made:
            self._sum_up(info.exposure)

    def _samples(self, info: DatasetInfo, manifest: ManifestWriter) -> None:
        """Make what the manifest lacks; a failed sample is reported and does not stop the others."""
        root, chosen = self.plan.root, self.plan.config.dataset
        recipe = replace(self.plan.recipe, full_scale=float(info.exposure["full_scale"]))
        finished = finished_samples(root)
        there = accounted_samples(root, finished)
        total = self._total
        count = sum(1 for split, index in self._wanted() if index not in there[split])
        self.kept = sum(1 for split, index in self._wanted() if index in finished[split])
        if self.shard is None:
            (root / FAILED).unlink(missing_ok=True)
        tasks = ((root, split, index) for split, index in self._wanted() if index not in there[split])
        forecast = Forecast(root, count)
        for split, index in islice(((name, number) for name in finished for number in finished[name]), ENOUGH):
            self._measure(forecast, split, index)
        passed_over = 0
        self.progress("samples", total - count, total)
        for outcome in perform(chosen, make_sample, tasks, count, recipe):
            if isinstance(outcome.error, StorageError):
                raise outcome.error
            _, split, index = outcome.task
            if outcome.error is not None and self.plan.skips(outcome.error):
                with SkippedWriter(manifest.folder) as skipping:
                    skipping.append(split, index, str(outcome.error))
                passed_over += 1
            elif outcome.error is not None:
                with FailedWriter(manifest.folder) as failing:
                    failing.append(split, index, outcome.reason, outcome.attempts, outcome.traceback)
                self.failed.append(f"{split}/{sample_id(index)}: {outcome.reason}")
            else:
                assert outcome.value is not None
                made = outcome.value
                manifest.append(made.record, outcome.seconds, made.stages, self._other_cpu(made, info))
                self.made += 1
                self._measure(forecast, split, index)
            each = forecast.bytes_per_sample
            self.watch(Facts(len(self.failed), *(None if each is None else each * part for part in (self.made, count))))
            self.progress("samples", total - count + self.made + passed_over, total)

    def _other_cpu(self, made: Made, info: DatasetInfo) -> str | None:
        """Return the level of the processor that made a sample where it is not that of the data set; said once for each."""
        begun = info.versions.get("cpu")
        if made.cpu in (None, begun):
            return None
        if made.cpu not in self._cpus:
            self._cpus.add(made.cpu)
            self.say(f"note: begun on {begun}, a worker is {made.cpu}: samples may differ in their last digits")
        return made.cpu

    def _measure(self, forecast: Forecast, split: str, index: int) -> None:
        """Look at the size of a sample, and refuse to go on where it shows that the disk has no room for all."""
        forecast.measure(sample_folder(self.plan.root, split, index))
        if forecast.measured == ENOUGH and not self.ignore_space:
            forecast.refuse_too_large()

    @cached_property
    def _ours(self) -> dict[str, Sequence[int]]:
        """The numbers of the samples that this run is to see to, by split."""
        shard, counts = self.shard, self.plan.counts
        return {split: range(n) if shard is None else shard.part(split, n) for split, n in counts.items()}

    def _wanted(self) -> Iterator[tuple[str, int]]:
        """Yield split and number of each of them."""
        return ((split, index) for split, indices in self._ours.items() for index in indices)

    @property
    def _total(self) -> int:
        return sum(map(len, self._ours.values()))

    # ---- what is worth reading

    def _sum_up(self, exposure: dict[str, Any]) -> None:
        """Say what the samples' metadata tell of the whole data set."""
        metadata = list(all_metadata(self.plan.root, _LOOKED_AT))
        if shares := [found for one in metadata if (found := ExposureShares.from_record(one)) is not None]:
            say_exposure(f"{len(shares)} samples", ExposureShares.mean(shares), exposure, self.plan, self.say)
        clamped = [one["clamped_light_share"] for one in metadata if "clamped_light_share" in one]
        if clamped and (mean := float(np.mean(clamped))) > CLAMPED_LIGHT_WARNING:
            depths_m = self.plan.assembly.depths_m
            self.say(
                f"note: psf: {mean:.0%} of the light comes from depths outside the planes, {depths_m[0] * 100:g} to "
                f"{depths_m[-1] * 100:g} cm, and is blurred as if from the nearest plane; a wider range holds more of it"
            )

    def _warn(self, stack: PsfStack) -> None:
        """Say what the user should know before relying on the data."""
        for line in budget_lines(stack):
            self.say(line)
        lost = stack.provenance.get("light_off_sensor", 0.0)
        if lost > OFF_SENSOR_WARNING and self.plan.config.forward.boundary == "linear":
            self.say(
                f"note: up to {lost:.1%} of the scene's light falls off the sensor (mean over the field), as in a "
                "real camera; a smaller mask, a nearer mask or a larger sensor keeps it"
            )
