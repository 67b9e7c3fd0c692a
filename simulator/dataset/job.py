"""The job: makes a data set, resumes it after any death, never mixes two.

Truth is on disk. A sample exists when its line stands in the manifest; everything before that line may be lost and is
made again, byte by byte the same.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from simulator.assemble import build_camera_colour, build_source, input_files, scene_plugin
from simulator.camera.exposure import PERCENTILE, PILOTS, TARGET, full_scale_from_pilots
from simulator.config import Config, dump, load_config
from simulator.dataset.contact_sheet import contact_sheet
from simulator.dataset.dataset_info import CAPTURED_FOLDER, FILE, PSF_FOLDER, DatasetInfo, read_info, write_info
from simulator.dataset.engines import Outcome, WorkerError, available_cpus, run
from simulator.dataset.fingerprint import build_fingerprint, difference, package_versions
from simulator.dataset.manifest import MANIFEST, ManifestWriter, load_manifest
from simulator.dataset.recipe import Recipe, clips_needed, make_pilot, make_sample, start_worker
from simulator.dataset.sample import SPLITS, sample_id
from simulator.dataset.stacks import data_set_stack
from simulator.errors import InputError
from simulator.files import TEMPORARY_PREFIX, StorageError, remove_leftovers, storage_errors
from simulator.optics.psf_stack import PsfStack
from simulator.render.backend import choose_backend

SHEET = "contact_sheet.png"
OFF_SENSOR_WARNING = 0.01

Report = Callable[[str, int, int], None]  # (stage, done, total)
Say = Callable[[str], None]


@dataclass(frozen=True)
class GenerateResult:
    """What a run of ``generate`` did.

    Attributes:
        path: the data set's folder.
        made: samples made by this run.
        kept: samples that were there before.
        failed: one line per sample that could not be made: id and reason.
        contact_sheet: picture of some samples; None when there is no sample.
        seconds: wall time.
    """

    path: Path
    made: int
    kept: int
    failed: tuple[str, ...]
    contact_sheet: Path | None
    seconds: float


def generate(
    config: Config | Path | str,
    overrides: Sequence[str] = (),
    *,
    progress: Report | None = None,
    say: Say | None = None,
) -> GenerateResult:
    """Make a data set, or finish one that was begun.

    Args:
        config: a configuration or the path of a ``sim_config.yaml``. ``dataset.output`` is relative to the current folder.
        overrides: ``a.b=value`` settings, when ``config`` is a path.
        progress: called with (stage, done, total).
        say: called with lines worth reading: the backend, measured errors, warnings.

    Raises:
        InputError: for mistakes in the configuration or its files, or when the folder holds another data set; nothing that
            was written before is lost.
        StorageError: when the disk is full or protected.
    """
    begin = time.perf_counter()
    if not isinstance(config, Config):
        config = load_config(config, overrides)
    job = _Job(config, progress or (lambda stage, done, total: None), say or (lambda line: None))
    made, kept, failed = job.run()
    sheet = None
    if made + kept:
        sheet = contact_sheet(job.root, job.root / SHEET)
    return GenerateResult(job.root, made, kept, tuple(failed), sheet, time.perf_counter() - begin)


def _refuse_clips(frames: object) -> None:
    """Say before any work that clips cannot be stored, of a rendered family whose clips have so many frames."""
    if isinstance(frames, int) and frames > 1:
        msg = (
            f"scene.frames: got {frames}, but data sets hold stills so far; take frames=1, or look at the clips with "
            "`flatlight render`"
        )
        raise InputError(msg)


@dataclass
class _Job:
    config: Config
    progress: Report
    say: Say
    root: Path = field(init=False)

    def __post_init__(self) -> None:
        self.root = Path(self.config.dataset.output).expanduser()

    def run(self) -> tuple[int, int, list[str]]:
        """Return how many samples were made and kept, and what failed."""
        plugin = scene_plugin(self.config)
        renders = plugin.takes_renderer
        if renders:
            _refuse_clips(plugin.fill(self.config.scene.params).get("frames"))
        backend = choose_backend(self.config.render.backend, self.config.render.bands is not None) if renders else None
        variant = backend.variant if backend else "none"
        if backend:
            self.say(f"rendering with {backend.message}" + (f". {backend.advice}" if backend.advice else ""))
        source = build_source(self.config, variant)
        fingerprint, parts = build_fingerprint(dump(self.config), variant, input_files(self.config, source))
        existing = self._existing(fingerprint, parts)
        with self._folder(), ManifestWriter(self.root) as manifest, self._all_or_nothing():
            remove_leftovers(self.root)
            stack = data_set_stack(self.config, self.root, self.progress, self.say)
            portable = scene_plugin(self.config).path is None
            recipe = Recipe(self.config, variant, (self.root / PSF_FOLDER).resolve(), source if portable else None)
            if existing is None:
                colour = build_camera_colour(self.config, stack.channels)
                exposure = self._exposure(recipe)
                existing = DatasetInfo(
                    name=self.config.name,
                    config=dump(self.config),
                    fingerprint=fingerprint,
                    fingerprint_parts=parts,
                    versions=package_versions() | {"cpu": _cpu_level()},
                    backend=variant,
                    exposure=exposure,
                    counts=self._counts(),
                    scene_shape=self.config.scene.size,
                    sensor_shape=self.config.camera.sensor.shape,
                    channels=stack.channels,
                    scene_to_camera=colour.origin | {"matrix": colour.matrix.tolist()},
                )
            write_info(self.root, replace(existing, counts=self._counts(), config=dump(self.config)))
            self._warn(source, stack)
            return self._samples(replace(recipe, full_scale=float(existing.exposure["full_scale"])), manifest)

    @contextmanager
    def _folder(self) -> Iterator[None]:
        """Make the data set's folder; on an error, take away what is empty of the folders made."""
        made = [folder for folder in (self.root, *self.root.parents) if not folder.exists()]
        with storage_errors(self.root):
            self.root.mkdir(parents=True, exist_ok=True)
        try:
            yield
        except BaseException:
            with suppress(OSError):
                for folder in made:
                    folder.rmdir()
            raise

    @contextmanager
    def _all_or_nothing(self) -> Iterator[None]:
        """On an error before the data set has its description, leave nothing of it; to be entered under its lock."""
        try:
            yield
        except BaseException:
            if not (self.root / FILE).exists():
                for name in (PSF_FOLDER, CAPTURED_FOLDER):
                    shutil.rmtree(self.root / name, ignore_errors=True)
                with suppress(OSError):
                    (self.root / MANIFEST).unlink()
            raise

    def _counts(self) -> dict[str, int]:
        return {split: getattr(self.config.dataset, split) for split in SPLITS}

    def _existing(self, fingerprint: str, parts: dict[str, Any]) -> DatasetInfo | None:
        """Return the description of a data set that is begun here already, or refuse another one's folder."""
        if not self.root.exists():
            return None
        if not self.root.is_dir():
            msg = f"dataset.output: {self.root} is a file; choose another folder"
            raise InputError(msg)
        if not (self.root / FILE).exists():
            foreign = [path.name for path in sorted(self.root.iterdir()) if not _left_by_a_start(path)]
            if foreign:
                msg = (
                    f"dataset.output: {self.root} is not empty and holds no data set ({foreign[0]}, ...); choose another "
                    "folder, or empty this one"
                )
                raise InputError(msg)
            return None
        info = read_info(self.root)
        if info.fingerprint != fingerprint:
            msg = (
                f"dataset.output: {self.root} holds a data set of another configuration; choose another folder, or undo "
                f"the change:\n{difference(info.fingerprint_parts, parts)}"
            )
            raise InputError(msg)
        for split, count in self._counts().items():
            if count < info.counts.get(split, 0):
                msg = (
                    f"dataset.{split}: got {count}, but the data set in {self.root} already has {info.counts[split]}; counts "
                    "can grow later, not shrink: choose another folder for a smaller one"
                )
                raise InputError(msg)
        return info

    def _exposure(self, recipe: Recipe) -> dict[str, Any]:
        """Return the one number that maps exposure to full scale, and where it comes from."""
        chosen = self.config.camera.exposure.full_scale
        if chosen != "auto":
            return {"full_scale": float(chosen), "from": "configuration"}
        pilots: dict[int, Any] = {}
        for outcome in self._outcomes(make_pilot, range(PILOTS), recipe):
            if outcome.error is not None:
                raise outcome.error
            pilots[outcome.task] = outcome.value
            self.progress("exposure pilots", len(pilots), PILOTS)
        full_scale = full_scale_from_pilots([pilots[i] for i in range(PILOTS)])
        return {
            "full_scale": full_scale,
            "from": "pilots",
            "pilots": PILOTS,
            "percentile": PERCENTILE,
            "target": TARGET,
        }

    def _samples(self, recipe: Recipe, manifest: ManifestWriter) -> tuple[int, int, list[str]]:
        """Make what the manifest lacks; a failed sample is reported and does not stop the others."""
        done = load_manifest(self.root).entries
        wanted = [(split, index) for split, count in self._counts().items() for index in range(count)]
        tasks = [(str(self.root), s, i) for s, i in wanted if (s, sample_id(i)) not in done]
        made, failed = 0, []
        self.progress("samples", len(wanted) - len(tasks), len(wanted))
        for outcome in self._outcomes(make_sample, tasks, recipe):
            if isinstance(outcome.error, StorageError):
                raise outcome.error
            _, split, index = outcome.task
            if outcome.error is not None:
                failed.append(f"{split}/{sample_id(index)}: {_reason(outcome.error)}")
                continue
            assert outcome.value is not None
            manifest.append(outcome.value, outcome.seconds)
            made += 1
            self.progress("samples", len(wanted) - len(tasks) + made, len(wanted))
        return made, len(wanted) - len(tasks), sorted(failed)

    def _outcomes(
        self, function: Callable[[Any], Any], tasks: Sequence[Any], recipe: Recipe
    ) -> Iterator[Outcome[Any, Any]]:
        chosen = self.config.dataset
        if not tasks:
            return
        workers = min(available_cpus() if chosen.workers == "auto" else chosen.workers, len(tasks))
        outcomes = run(chosen.engine, function, tasks, workers=workers, initializer=start_worker, initargs=(recipe,))
        assert isinstance(outcomes, Generator)  # leaving it early stops the workers
        with closing(outcomes):
            yield from outcomes

    def _warn(self, source: Any, stack: PsfStack) -> None:
        """Say what the user should know before relying on the data."""
        sampling = stack.provenance.get("sampling")
        if sampling:
            self.say(f"sampling error of the PSFs on the sensor's pixels: {sampling['error']:.1%} (recorded)")
        lost = stack.provenance.get("light_off_sensor", 0.0)
        if lost > OFF_SENSOR_WARNING and self.config.forward.boundary == "linear":
            self.say(
                f"note: up to {lost:.1%} of the scene's light falls off the sensor (mean over the field), as in a "
                "real camera; a smaller mask, a nearer mask or a larger sensor keeps it"
            )
        needed = clips_needed(self._counts())
        if hasattr(source, "__len__") and len(source) < needed:
            self.say(
                f"note: the source has {len(source)} clips and the splits ask for {needed}: splits will share clips"
            )


def _left_by_a_start(path: Path) -> bool:
    """Whether a run that was killed before ``dataset.json`` leaves such a file: it holds nothing of worth."""
    empty_manifest = path.name == MANIFEST and path.stat().st_size == 0
    return empty_manifest or path.name in (PSF_FOLDER, CAPTURED_FOLDER) or path.name.startswith(TEMPORARY_PREFIX)


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, InputError | WorkerError) else f"{type(error).__name__}: {error}"


def _cpu_level() -> str:
    """Return the processor kind and its best vector extension: NumPy's float32 functions differ between them."""
    import platform

    shown: Any = np.show_config(mode="dicts")
    found = shown.get("SIMD Extensions", {}).get("found") or ["baseline"]
    return f"{platform.machine()} {found[-1]}"
