"""The job: makes a data set, resumes it after any death, never mixes two."""

from __future__ import annotations

import shutil
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulator.assembly import Assembly
from simulator.camera.exposure import ExposureShares
from simulator.camera.shutter import Shutter, shutter_record
from simulator.captured_psf import captured_stack, check_calibration
from simulator.config import Config, dump, load_config
from simulator.config.psf import ComputedPsf
from simulator.dataset.checksums import unseal, write_seal
from simulator.dataset.clips import ClipTimesError, check_parameters, clip_order
from simulator.dataset.dataset_info import FILE, DatasetInfo, read_info, write_info
from simulator.dataset.engines import GivenUpError, Outcome, WorkerError, available_cpus, run
from simulator.dataset.exposure import complaints, exposure_record, pilots_wanted, refuse_useless
from simulator.dataset.fingerprint import build_fingerprint, difference
from simulator.dataset.manifest import (
    FAILED,
    MANIFEST,
    FailedWriter,
    ManifestWriter,
    SkippedWriter,
    list_problems,
    load_manifest,
    load_skipped,
    refuse_problems,
)
from simulator.dataset.reader import all_metadata
from simulator.dataset.recipe import Recipe, check_first_clip, make_pilot, make_sample, start_worker
from simulator.dataset.sample import SPLITS, sample_id
from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX, StorageError, expanded, remove_leftovers, storage_errors
from simulator.io.json import canonical_json
from simulator.optics.error_budget.budget import budget_lines, read_budget
from simulator.optics.error_budget.sampling import SamplingWarning
from simulator.optics.metrics import light_off_sensor
from simulator.optics.stack import UNPROVEN, PsfStack
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, read_psf_stack, write_psf_stack
from simulator.plugins import Plugin
from simulator.render.backend import choose_backend
from simulator.text import described
from simulator.types import SceneSource


def existing_info(
    root: Path, counts: dict[str, int], fingerprint: str, parts: dict[str, Any], shutter: Shutter
) -> DatasetInfo | None:
    """Return the description of a data set that is begun in a folder already; None where there is none.

    Raises:
        InputError: the folder holds something else, another data set, or one with more samples.
    """
    if not root.exists():
        return None
    if not root.is_dir():
        raise InputError("dataset.output", f"{root} is a file; choose another folder")
    if not (root / FILE).exists():
        foreign = [path.name for path in sorted(root.iterdir()) if not _left_by_a_start(path)]
        if foreign:
            raise InputError("dataset.output", f"{root} holds other files ({foreign[0]}, ...); choose another folder")
        return None
    info = read_info(root)
    if info.fingerprint != fingerprint:
        raise InputError(
            "dataset.output",
            f"{root} holds another data set; choose another folder, or undo:\n{difference(info.fingerprint_parts, parts)}",
        )
    _refuse_other_windows(root, info, shutter, parts["config"]["camera"]["shutter"].get("function"))
    for split, count in counts.items():
        if count < info.counts.get(split, 0):
            raise InputError(
                f"dataset.{split}",
                f"got {count}, but {root} already has {info.counts[split]}; choose another folder for fewer",
            )
    return info


@contextmanager
def made_folder(root: Path) -> Iterator[None]:
    """Make the data set's folder; on an error, take away what is empty of the folders made.

    Raises:
        StorageError: the folder cannot be made.
    """
    made = [folder for folder in (root, *root.parents) if not folder.exists()]
    with storage_errors(root):
        root.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):
            for folder in made:
                folder.rmdir()
        raise


@contextmanager
def all_or_nothing(root: Path) -> Iterator[None]:
    """On an error before the data set has its description, leave nothing of it; to be entered under its lock."""
    try:
        yield
    except BaseException:
        if not (root / FILE).exists():
            for name in (PSF_FOLDER, CAPTURED_FOLDER):
                shutil.rmtree(root / name, ignore_errors=True)
            with suppress(OSError):
                (root / MANIFEST).unlink()
        raise


def _refuse_other_windows(root: Path, info: DatasetInfo, shutter: Shutter, function: str | None) -> None:
    """Refuse a shutter that is another one than the recorded, though its configuration is the same."""
    recorded = info.time.get("shutter")
    if recorded is None or canonical_json(recorded) == canonical_json(shutter_record(shutter)):
        return
    if function is None:
        raise InputError(root / FILE, "time.shutter is not what its configuration says; restore the file from a copy")
    raise InputError(
        "camera.shutter.function",
        f"{function} gave other windows than the data set in {root} was begun with; it must return "
        "the same at every call: seed what it draws, or write its windows into a file and give camera.shutter.file",
    )


def _left_by_a_start(path: Path) -> bool:
    """Whether a run that was killed before ``dataset.json`` leaves such a file: it holds nothing of worth."""
    empty_manifest = path.name == MANIFEST and path.stat().st_size == 0
    return empty_manifest or path.name in (PSF_FOLDER, CAPTURED_FOLDER) or path.name.startswith(TEMPORARY_PREFIX)


def data_set_stack(assembly: Assembly, root: Path, say: Callable[[str], None]) -> PsfStack:
    """Return the true stack; it and the captured one are written on the first run and kept on later ones.

    A stack that was deleted from a data set is made again.
    """
    config, begun = assembly.config, (root / FILE).exists()
    folder, captured_folder = root / PSF_FOLDER, root / CAPTURED_FOLDER
    asked = isinstance(config.psf, ComputedPsf) and config.psf.as_captured is not None
    if begun and folder.exists():
        stack = read_psf_stack(folder)
    else:
        if isinstance(config.psf, ComputedPsf):  # mistakes come out before the work that they would spoil
            assembly.camera_colour(assembly.response.channels)
        if asked:
            check_calibration(assembly)
        say("designing the mask and computing its PSFs" if config.camera.mask else "reading the measured PSF")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SamplingWarning)  # the job tells it on every run
            stack = assembly.psf_stack
        if stack.provenance.get("sampling") == UNPROVEN:
            raise InputError(
                "psf",
                "the sampling error of this stack was never measured, so no data set is made with it; compute it with "
                "simulator.optics.error_budget.budget.proven_psf_stack",
            )
        if assembly.wants_full_check:
            say("checking the PSFs against exact ones and direct sums")
            stack = assembly.checked_stack
        lost = light_off_sensor(stack, config.camera.sensor.shape, config.scene.size)
        stack = replace(stack, provenance=stack.provenance | {"light_off_sensor": float(lost.max())})
        write_psf_stack(folder, stack)
    if asked and begun and captured_folder.exists():
        read_psf_stack(captured_folder)  # a damaged one is refused, like the true one
    elif asked:
        say("measuring the PSFs as a calibration would")
        write_psf_stack(captured_folder, captured_stack(assembly.having(psf_stack=stack)))
    return stack


OFF_SENSOR_WARNING = 0.01
CLAMPED_LIGHT_WARNING = 0.05

Report = Callable[[str, int, int], None]  # (stage, done, total)
Say = Callable[[str], None]


@dataclass(frozen=True)
class GenerateResult:
    """What a run of ``generate`` did.

    Attributes:
        path: the data set's folder.
        made: samples made by this run.
        kept: samples that were there before.
        failed: one line per sample that could not be made: id and reason; the next run tries them again.
        seconds: wall time.
        skipped: one line per sample that this run or one before left out for good: id and reason.
        problems: lines about what the source cannot use.
    """

    path: Path
    made: int
    kept: int
    failed: tuple[str, ...]
    seconds: float
    skipped: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def generate(
    config: Config | Path | str,
    overrides: Sequence[str] = (),
    *,
    skip_bad: bool = False,
    accept_exposure: bool = False,
    progress: Report | None = None,
    say: Say | None = None,
    finish: Callable[[Path], object] | None = None,
) -> GenerateResult:
    """Make a data set, or finish one that was begun.

    Args:
        config: a configuration or the path of a ``sim_config.yaml``. ``dataset.output`` is relative to the current folder.
        overrides: ``a.b=value`` settings, when ``config`` is a path.
        skip_bad: go on without what cannot be used, and list it: files that the source names as its ``problems``, and
            samples that fail by an ``InputError`` (they are not tried again). Without it the former are refused, the latter
            reported and tried again by the next run.
        accept_exposure: go on where no value carries signal: all are saturated, black or below the noise.
        progress: called with (stage, done, total).
        say: called with lines worth reading: the backend, measured errors, warnings.
        finish: called with the data set's folder, where it has samples, before ``checksums.json`` seals it: to draw its
            contact sheet.

    Raises:
        InputError: for mistakes in the configuration or its files, or when the folder holds another data set, or one that
            is not as it was sealed; nothing that was written before is lost.
        StorageError: when the disk is full or protected.
    """
    begin = time.perf_counter()
    if not isinstance(config, Config):
        config = load_config(config, overrides)
    job = _Job(
        config, skip_bad, accept_exposure, progress or (lambda stage, done, total: None), say or (lambda line: None)
    )
    with config.refusals():
        made, kept, failed = job.run(finish or (lambda root: None))
    skipped = tuple(f"{split}/{name}: {reason}" for (split, name), reason in load_skipped(job.root).items())
    seconds = time.perf_counter() - begin
    return GenerateResult(job.root, made, kept, tuple(failed), seconds, skipped, job.problems)


@dataclass
class _Job:
    config: Config
    skip_bad: bool
    accept_exposure: bool
    progress: Report
    say: Say
    root: Path = field(init=False)
    assembly: Assembly = field(init=False)
    problems: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        self.root = expanded(self.config.dataset.output).absolute()  # a plugin may change the current folder

    def run(self, finish: Callable[[Path], object]) -> tuple[int, int, list[str]]:
        """Return how many samples were made and kept, and what failed."""
        assembly = Assembly(self.config, threads=available_cpus(), progress=self.progress)
        plugin, shutter = assembly.scene_plugin, assembly.shutter
        self.assembly = assembly
        timed = self._check_times(plugin)
        renders = plugin.takes_renderer
        backend = choose_backend(self.config.render.backend, self.config.render.bands is not None) if renders else None
        variant = backend.variant if backend else "none"
        if backend:
            self.say(f"rendering with {backend.message}" + (f". {backend.advice}" if backend.advice else ""))
        self.assembly = assembly = replace(assembly, backend=variant).having(shutter=shutter)
        source = assembly.source
        self._check_source(source)
        packages = getattr(source, "packages", ())
        fingerprint, parts = build_fingerprint(dump(self.config), variant, assembly.input_files, packages)
        existing = existing_info(self.root, self._counts(), fingerprint, parts, shutter)
        folder = (self.root / PSF_FOLDER).resolve()
        recipe = Recipe(self.config, variant, folder, source if plugin.path is None else None, shutter, assembly.view)
        if existing is None and not timed and not renders:
            self._look_at_a_clip(recipe)
        with made_folder(self.root), ManifestWriter(self.root) as manifest, all_or_nothing(self.root):
            unseal(self.root)
            remove_leftovers(self.root)
            stack = data_set_stack(assembly, self.root, self.say)
            if existing is None:
                colour = assembly.camera_colour(stack.channels)
                exposure = self._exposure(recipe)
                existing = DatasetInfo(
                    name=self.config.name,
                    config=dump(self.config),
                    fingerprint=fingerprint,
                    fingerprint_parts=parts,
                    versions=parts["versions"] | {"cpu": _cpu_level()},
                    backend=variant,
                    exposure=exposure,
                    counts=self._counts(),
                    scene_shape=self.config.scene.size,
                    sensor_shape=self.config.camera.sensor.shape,
                    channels=assembly.sensor.channels(stack.channels),
                    scene_to_camera=colour.origin | {"matrix": colour.matrix.tolist()},
                    field_of_view=assembly.simulated_field.record(stack),
                    time={"shutter": shutter_record(shutter), **self._slivers()},
                )
            write_info(self.root, replace(existing, counts=self._counts(), config=dump(self.config)))
            self._warn(stack)
            if self.problems:
                self.say(list_problems(self.root, self.problems))
            made, kept, failed = self._samples(
                replace(recipe, full_scale=float(existing.exposure["full_scale"])), manifest
            )
            if made:
                self._sum_up(existing.exposure)
            if made + kept:
                finish(self.root)
            manifest.drop_duplicates()
            write_seal(self.root)
            return made, kept, failed

    def _check_times(self, plugin: Plugin) -> bool:
        """Refuse scenes whose parameters show that their clips do not suit the shutter; return whether they show it."""
        if ":" in plugin.name:
            return False  # a user's parameters may be called alike and mean something else
        params = plugin.bind(self.config.scene.params)
        return check_parameters(params, self.assembly.shutter, self.config.camera.sensor.shape[0], self.config.dataset)

    def _check_source(self, source: SceneSource) -> None:
        """Refuse a source with problems, unless they are to be skipped, and splits that would share a video."""
        self.problems = tuple(getattr(source, "problems", ()))
        if not self.skip_bad:
            refuse_problems(self.problems)
        order = clip_order(source)
        shortage = None if order is None else order.shortage(self._counts())
        if shortage and not self.config.dataset.share_videos:
            raise InputError("dataset", f"{shortage}, or for a trial let them: dataset.share_videos: true")
        if shortage:
            self.say(f"note: splits share source videos, so results on them mean nothing: {shortage}")

    def _look_at_a_clip(self, recipe: Recipe) -> None:
        """Refuse clips that do not suit the shutter before there is anything else to undo.

        What cannot be had at all is reported as its sample's failure.
        """
        for outcome in self._outcomes(check_first_clip, [recipe]):
            if isinstance(outcome.error, ClipTimesError) and not self.skip_bad:
                raise outcome.error

    def _slivers(self) -> dict[str, Any]:
        chosen = self.config.dataset
        return {"slivers": chosen.slivers, "ground_truth": chosen.ground_truth}

    def _counts(self) -> dict[str, int]:
        return {split: getattr(self.config.dataset, split) for split in SPLITS}

    def _exposure(self, recipe: Recipe) -> dict[str, Any]:
        """Return the one number that maps exposure to full scale, where it comes from, and what pilot samples say of it."""
        fixed = self.assembly.fixed_exposure
        wanted = pilots_wanted(fixed, sum(self._counts().values()))
        pilots: dict[int, Any] = {}
        bad: dict[int, Exception] = {}
        for outcome in self._outcomes(make_pilot, range(wanted), start_worker, (recipe,)):
            if outcome.error is None:
                pilots[outcome.task] = outcome.value
            elif isinstance(outcome.error, InputError) and outcome.error.path == "scene.surroundings":
                raise outcome.error  # which fails every sample alike
            elif self._skips(outcome.error) or (fixed is not None and not isinstance(outcome.error, StorageError)):
                bad[outcome.task] = outcome.error
            elif isinstance(outcome.error, GivenUpError):
                raise InputError(f"exposure pilot {outcome.task}", _reason(outcome)) from outcome.error
            else:
                raise outcome.error
            self.progress("exposure pilots", len(pilots) + len(bad), wanted)
        if fixed is not None and not pilots:
            return fixed  # what cannot be had at all is reported as its sample's failure
        if not pilots:
            raise bad[0]
        if bad:
            self.say(f"note: {len(bad)} of {wanted} exposure pilots cannot be made and are left out: {bad[min(bad)]}")
        record = exposure_record([pilots[i] for i in sorted(pilots)], fixed, self.assembly.sensor)
        shares = ExposureShares(**record["pilot_shares"])
        if not self.accept_exposure:
            refuse_useless(shares, record, self.assembly.sensor)
        self._say_exposure(f"{len(pilots)} pilot samples", shares, record)
        return record

    def _sum_up(self, exposure: dict[str, Any]) -> None:
        """Say what the samples' metadata tell of the whole data set."""
        metadata = list(all_metadata(self.root))
        if shares := [found for one in metadata if (found := ExposureShares.from_record(one)) is not None]:
            self._say_exposure(f"{len(shares)} samples", ExposureShares.mean(shares), exposure)
        clamped = [one["clamped_light_share"] for one in metadata if "clamped_light_share" in one]
        if clamped and (mean := float(np.mean(clamped))) > CLAMPED_LIGHT_WARNING:
            depths_m = self.assembly.depths_m
            self.say(
                f"note: psf: {mean:.0%} of the light comes from depths outside the planes, {depths_m[0] * 100:g} to "
                f"{depths_m[-1] * 100:g} cm, and is blurred as if from the nearest plane; a wider range holds more of it"
            )

    def _say_exposure(self, of: str, shares: ExposureShares, record: dict[str, Any]) -> None:
        self.say(f"exposure, {of}: {shares}")
        for key, reason in complaints(shares, record, self.assembly.sensor):
            self.say(f"note: {key}: {reason}")

    def _skips(self, error: Exception) -> bool:
        """Whether an error is one that ``skip_bad`` passes over."""
        return self.skip_bad and isinstance(error, InputError) and not isinstance(error, StorageError)

    def _samples(self, recipe: Recipe, manifest: ManifestWriter) -> tuple[int, int, list[str]]:
        """Make what the manifest lacks; a failed sample is reported and does not stop the others."""
        finished, skipped = load_manifest(self.root).entries, load_skipped(self.root)
        wanted = [(split, index) for split, count in self._counts().items() for index in range(count)]
        missing = [(split, index) for split, index in wanted if (split, sample_id(index)) not in finished]
        tasks = [(str(self.root), split, i) for split, i in missing if (split, sample_id(i)) not in skipped]
        made, passed_over, failed = 0, 0, []
        (self.root / FAILED).unlink(missing_ok=True)
        self.progress("samples", len(wanted) - len(tasks), len(wanted))
        for outcome in self._outcomes(make_sample, tasks, start_worker, (recipe,)):
            if isinstance(outcome.error, StorageError):
                raise outcome.error
            _, split, index = outcome.task
            if outcome.error is not None and self._skips(outcome.error):
                with SkippedWriter(self.root) as skipping:
                    skipping.append(split, index, str(outcome.error))
                passed_over += 1
            elif outcome.error is not None:
                with FailedWriter(self.root) as failing:
                    failing.append(split, index, _reason(outcome), outcome.attempts, outcome.traceback)
                failed.append(f"{split}/{sample_id(index)}: {_reason(outcome)}")
                continue
            else:
                assert outcome.value is not None
                manifest.append(outcome.value, outcome.seconds)
                made += 1
            self.progress("samples", len(wanted) - len(tasks) + made + passed_over, len(wanted))
        return made, len(wanted) - len(missing), sorted(failed)

    def _outcomes(
        self,
        function: Callable[[Any], Any],
        tasks: Sequence[Any],
        initializer: Callable[..., object] | None = None,
        initargs: tuple[Any, ...] = (),
    ) -> Iterator[Outcome[Any, Any]]:
        chosen = self.config.dataset
        if not tasks:
            return
        workers: int | str = chosen.workers
        if chosen.engine == "local":
            workers = min(available_cpus() if workers == "auto" else workers, len(tasks))
        outcomes = run(
            chosen.engine,
            function,
            tasks,
            workers=workers,
            initializer=initializer,
            initargs=initargs,
            timeout_s=chosen.timeout_s,
            ray=chosen.ray,
        )
        assert isinstance(outcomes, Generator)  # leaving it early stops the workers
        with closing(outcomes):
            yield from outcomes

    def _warn(self, stack: PsfStack) -> None:
        """Say what the user should know before relying on the data."""
        for line in budget_lines(read_budget(stack)):
            self.say(line)
        lost = stack.provenance.get("light_off_sensor", 0.0)
        if lost > OFF_SENSOR_WARNING and self.config.forward.boundary == "linear":
            self.say(
                f"note: up to {lost:.1%} of the scene's light falls off the sensor (mean over the field), as in a "
                "real camera; a smaller mask, a nearer mask or a larger sensor keeps it"
            )


def _reason(outcome: Outcome[Any, Any]) -> str:
    error, tried = outcome.error, f" (tried {outcome.attempts} times)" if outcome.attempts > 1 else ""
    assert error is not None
    return (str(error) if isinstance(error, InputError | WorkerError) else described(error)) + tried


def _cpu_level() -> str:
    """Return the processor kind and its best vector extension: NumPy's float32 functions differ between them."""
    import platform

    shown: Any = np.show_config(mode="dicts")
    found = shown.get("SIMD Extensions", {}).get("found") or ["baseline"]
    return f"{platform.machine()} {found[-1]}"
