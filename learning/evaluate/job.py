"""`flatlight evaluate`: all methods on the same scenes and measurements, by the same scores; what is finished is kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from learning.camera import CaptureModel
from learning.classical.clips import ClipMethod
from learning.config import EvaluateConfig
from learning.data import check_dataset
from learning.evaluate.curves import Curve, learning_curve
from learning.evaluate.figures import Shown
from learning.evaluate.films import NamedFilm
from learning.evaluate.folder import claim_folder, is_claimed
from learning.evaluate.methods import Entry, LearnedEntry, read_methods, says_scenes
from learning.evaluate.outcome import Outcome, chosen_scenes, first_scenes, outcome
from learning.evaluate.report import OWN_FILES, Evaluation, Findings, write_results
from learning.evaluate.runs import CACHE, Cameras, ResultCache, Run, Runner
from learning.evaluate.scoring import Baseline, Criteria, Times, baselines, score, take_times
from learning.method import Progress, Say, choose_device, describe_device, linear_to_srgb, torch_threads
from learning.perceptual import LpipsDistance, available_lpips
from learning.timing import recorded_timing
from learning.video_quality import VideoQuality, available_video_quality
from simulator.dataset.reader import Dataset, open_dataset, spread_positions
from simulator.errors import InputError
from simulator.plots.drawing import depth_colours

_BINS, _TIMED_SCENES = 8, 8


def evaluate(
    config: EvaluateConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None
) -> tuple[Evaluation, list[Path]]:
    """Evaluate as a file says, write results, tables and figures to its folder, and return findings and files, report first.

    Raises:
        InputError: data without scenes or depth, methods of other cameras, missing files, a non-finite estimate, scenes
            that a method knows already, or a folder that holds something else.
        StorageError: the folder cannot be written to.
    """
    folder = config.resolve_path(config.output)
    device = choose_device(config.device)
    # What does not fit is said of all data sets now, not after hours of work.
    for name in config.sets:
        if name in (CACHE, *OWN_FILES):
            raise InputError(f"data.test.{name}", f"{name} is a file or folder of each evaluation; take another name")
    opened = {name: _open(alone) for name, alone in config.sets.items()}
    is_claimed(folder, config.name)
    clips = any(recorded_timing(test) is not None for test, _ in opened.values())
    lpips, cvvdp, perceptual = find_perceptual(config.perceptual, device, clips)
    cache = ResultCache(folder / CACHE)
    trials = {
        name: Trial(alone, *opened[name], cache, device=device, lpips=lpips, cvvdp=cvvdp)
        for name, alone in config.sets.items()
    }
    claim_folder(folder, config.name)
    say(perceptual)
    findings: dict[str, Findings] = {}
    with torch_threads(config.threads):
        for name, trial in trials.items():
            whose = f"{name}: " if name else ""
            findings[name] = trial.run(lambda stage, *counts, whose=whose: progress(whose + stage, *counts))
            for line in findings[name].unknown:
                say(whose + line)
        evaluation = Evaluation(config, findings, perceptual, describe_device(device))
    return evaluation, write_results(folder, evaluation)


def _open(config: EvaluateConfig) -> tuple[Dataset, list[list[Entry]]]:
    """Return the scenes of a file's only data set, and the methods, which do not know them."""
    assert isinstance(config.data.test, str)
    test = open_dataset(config.resolve_path(config.data.test), config.data.split)
    test = test if config.data.scenes is None else test[: config.data.scenes]
    check_dataset(test)
    return test, read_methods(config, test)


class Trial:
    """All methods on one data set, every method built once for each of its cameras before anything runs."""

    def __init__(
        self,
        config: EvaluateConfig,
        test: Dataset,
        methods: Sequence[Sequence[Entry]],
        cache: ResultCache,
        *,
        device: torch.device,
        lpips: LpipsDistance | None,
        cvvdp: VideoQuality | None,
    ) -> None:
        """Find the cameras; an InputError says what of methods, PSFs and data does not fit."""
        self.config, self.test, self.methods = config, test, methods
        training = None if config.data.training is None else config.resolve_path(config.data.training)
        entries = [entry for seeds in methods for entry in seeds]
        self.cameras = Cameras(test, training, entries, config.resolve_path)
        cameras = [self.cameras.assumed(seeds[0], config.data.stack) for seeds in methods]
        # Of one plane nothing follows for depth.
        self.camera = next((one for one in cameras if len(one.stack.depths_m) > 1), cameras[0])
        edges_cm = tuple(config.depth_bins_cm or ())
        if not edges_cm:  # even in disparity: what a mask resolves
            edges_cm = tuple((100 * self.camera.depth_m(np.linspace(1, 0, _BINS + 1))).tolist())
        criteria = Criteria(edges_cm, config.dark_share, lpips, cvvdp)
        self.runner = Runner(test, self.cameras, criteria, cache, device=device, batch=config.batch, seed=config.seed)
        # PSFs and noise of all runs of a method, each once, the table's first.
        usual = config.data.stack
        levels = [(usual, None), *((usual, level) for level in config.noise_db or ())]
        self.planned = list(dict.fromkeys([*levels, *((stack, None) for stack in config.data.compare_stacks)]))
        for entry in entries:
            for stack, level in self.planned:
                self.runner.method(Run(entry, stack, level))
        self._places = self._grouped()

    def run(self, progress: Progress) -> Findings:
        """Return what comes out."""
        config, test, runner = self.config, self.test, self.runner
        criteria, device = runner.criteria, runner.device
        usual, compared = config.data.stack, config.data.compare_stacks
        part = config.ablation_scenes
        part = None if part is None or part >= len(test) else part
        outcomes = [
            one for seeds in self.methods for one in _outcomes(runner, seeds, self.planned, part, compared, progress)
        ]
        examples, camera = runner.examples(None), self.camera
        naive = [
            (one, score(one, examples, criteria, device=device, batch=config.batch))
            for one in baselines(examples, camera, config.batch)
        ]
        return Findings(
            config=config,
            test=test,
            camera=camera,
            stored_db=runner.stored_db,
            edges_cm=criteria.edges_cm,
            methods=[_about(seeds, self.cameras.assumed(seeds[0], usual)) for seeds in self.methods],
            outcomes=outcomes,
            naive=[outcome(one.name, one.kind, [found], only=one.scores, note=one.best_in) for one, found in naive],
            naive_part=[
                outcome(one.name, one.kind, [first_scenes(found, part or len(test))], only=one.scores)
                for one, found in naive
            ],
            groups=self._groups(naive),
            times=_times(config, runner, self.methods, progress),
            montage=[] if runner.clips else _montage(config, runner, self.methods),
            columns=["truth", *(method.name for method in config.methods)],
            films=_films(config, runner, self.methods, camera) if runner.clips else [],
            curves=[one for seeds in self.methods for each in seeds if (one := _curve(each)) is not None],
        )

    def _grouped(self) -> dict[str, list[int]]:
        """Return the positions of the scenes of each value of ``group_by``; an InputError refuses a key that one lacks."""
        word = self.config.group_by
        if word is None:
            return {}
        scenes = [self.test.stored(at).description["metadata"]["scene"] for at in range(len(self.test))]
        if unknown := [name for name, scene in zip(self.test.ids, scenes, strict=True) if word not in scene]:
            known = ", ".join(sorted(set.intersection(*(set(scene) for scene in scenes))))
            raise InputError(
                "group_by", f"got {word}, which sample {unknown[0]} does not have; expected one of {known}"
            )
        values = [str(scene[word]) for scene in scenes]
        return {
            f"{word}: {value}": [at for at, own in enumerate(values) if own == value] for value in sorted(set(values))
        }

    def _groups(self, naive: Sequence[tuple[Baseline, dict[str, Any]]]) -> dict[str, list[Outcome]]:
        """Return the rows of the table for each value of ``group_by`` alone, as stored."""
        groups: dict[str, list[Outcome]] = {}
        for title, places in self._places.items():
            rows = []
            for seeds in self.methods:
                found = [self.runner.result(Run(entry, self.config.data.stack)) for entry in seeds]
                rows.append(outcome(seeds[0].name, seeds[0].kind, [chosen_scenes(one, places) for one in found]))
            rows += [
                outcome(one.name, one.kind, [chosen_scenes(found, places)], only=one.scores) for one, found in naive
            ]
            groups[title] = rows
        return groups


def find_perceptual(
    wanted: str, device: torch.device, clips: bool
) -> tuple[LpipsDistance | None, VideoQuality | None, str]:
    """Return LPIPS or None, ColorVideoVDP (of clips) or None, and words about both.

    An InputError says which files of LPIPS are missing where it must be.
    """
    if wanted == "none":
        return None, None, "no LPIPS: it was not asked for"
    lpips, words = available_lpips()
    if wanted == "lpips" and lpips is None:
        raise InputError("perceptual", f"got lpips, but {words}; put one there, or take auto")
    cvvdp = None
    if clips:
        cvvdp, more = available_video_quality(device)
        words = f"{words}; {more}"
    return lpips and lpips.to(device), cvvdp, words


def _curve(entry: Entry) -> Curve | None:
    """Return how a network learned, where its training is at hand; None of a classical method."""
    return learning_curve(entry.name, entry.path) if isinstance(entry, LearnedEntry) else None


def _outcomes(
    runner: Runner,
    seeds: Sequence[Entry],
    planned: Sequence[tuple[str, float | None]],
    part: int | None,
    compared: Sequence[str],
    progress: Progress,
) -> list[Outcome]:
    """Return the outcomes of a method, the table's first; all but that one are of ``part`` of the scenes."""
    name, done = seeds[0].name, 0
    whole = len(runner.test)
    total = len(seeds) * (whole + (len(planned) - 1) * (part or whole))

    def count(scenes: int) -> None:
        nonlocal done
        done += scenes
        progress(name, done, total)

    found: list[Outcome] = []
    for stack, level in planned:
        first = (stack, level) == planned[0]
        runs = [Run(entry, stack, level, None if first else part) for entry in seeds]
        results = [runner.result(run, count) for run in runs]
        at_db = runner.level_db(runs[0])
        about = {
            "stack": stack,
            "noise_db": level,
            "note": seeds[0].note(at_db),
            "tuned_db": seeds[0].tuned_db(at_db),
            "details": {
                "identities": [entry.identity(at_db) for entry in seeds],
                "assumed": [runner.camera(run).stack.fingerprint for run in runs],
            },
        }
        found.append(outcome(name, seeds[0].kind, results, **about))
        if first and part and stack in compared:  # beside the others, on the same scenes as they
            found.append(outcome(name, seeds[0].kind, [first_scenes(one, part) for one in results], **about))
    return found


def _times(
    config: EvaluateConfig, runner: Runner, methods: Sequence[Sequence[Entry]], progress: Progress
) -> list[Times]:
    if config.time.repeats == 0:
        return []
    level = config.time.noise_db
    ready = [runner.method(Run(seeds[0], config.data.stack, level)) for seeds in methods]
    # Minutes to hours each, and what is kept would take no time at all: benchmarks/fits.py tells
    timed = [method for method in ready if not (isinstance(method, ClipMethod) and method.fitting is not None)]
    if not timed:
        return []
    examples = runner.examples(level)
    scenes = [examples[position].measurement for position in range(min(len(examples), _TIMED_SCENES))]
    measurements = torch.stack(scenes).to(runner.device)
    return take_times(timed, measurements, config.time.repeats, lambda done, total: progress("times", done, total))


def _spread(config: EvaluateConfig, runner: Runner) -> list[int]:
    """Return the positions of the scenes that are shown, evenly spread."""
    return spread_positions(len(runner.test), config.figures.montage)


def _films(
    config: EvaluateConfig, runner: Runner, methods: Sequence[Sequence[Entry]], camera: CaptureModel
) -> list[list[NamedFilm]]:
    """Return evenly spread clips as they were and as the first seed of every method has them; ``camera`` has all depths."""
    positions = _spread(config, runner)
    runs = [Run(seeds[0], config.data.stack) for seeds in methods]
    estimates = [runner.estimates(run, positions) for run in runs]
    known = [runner.result(run)["scores"] for run in runs]
    examples, clips = runner.examples(None), []
    for at, position in enumerate(positions):
        example = examples[position]
        frames = linear_to_srgb(example.radiance, runner.cameras.test.white)
        films = [NamedFilm("truth", np.moveaxis(frames.numpy(), 1, -1), runner.test.ids[position])]
        films += _depth_film("", example.depth_m[:, 0].numpy(), example.valid[:, 0].numpy(), camera)
        for method, shown, scores in zip(config.methods, estimates, known, strict=True):
            moving = scores[position]["moving_psnr"]
            words = f"{scores[position]['psnr']:.1f} dB" + (f", moving {moving:.1f} dB" if np.isfinite(moving) else "")
            films.append(NamedFilm(method.name, np.moveaxis(shown[at]["image"], 1, -1), words))
            depth_m = shown[at]["depth_m"]
            if "depth_rmse_cm" in scores[position]:
                words, seen = f"{scores[position]['depth_rmse_cm']:.2f} cm", np.ones(depth_m.shape, bool)
                films += _depth_film(words, depth_m, seen, camera)
        clips.append(films)
    return clips


def _depth_film(
    words: str, depth_m: NDArray[np.float32], seen: NDArray[np.bool_], capture: CaptureModel
) -> list[NamedFilm]:
    """Return the depths ``(N, h, w)`` of frames in colours, as a list of one; of none where the camera knows one depth."""
    if len(capture.stack.depths_m) < 2:
        return []
    return [NamedFilm("depth", depth_colours(depth_m, seen, capture.near_m, capture.far_m) / 255, words)]


def _montage(config: EvaluateConfig, runner: Runner, methods: Sequence[Sequence[Entry]]) -> list[list[Shown]]:
    """Return evenly spread scenes as they were and as the first seed of every method has them."""
    positions = _spread(config, runner)
    runs = [Run(seeds[0], config.data.stack) for seeds in methods]
    estimates = [runner.estimates(run, positions) for run in runs]
    known = [runner.result(run)["scores"] for run in runs]
    examples, rows = runner.examples(None), []
    for at, position in enumerate(positions):
        example = examples[position]
        image = np.moveaxis(linear_to_srgb(example.radiance, runner.cameras.test.white).numpy(), 0, -1)
        row = [Shown(image, example.depth_m[0].numpy(), runner.test.ids[position], example.valid[0].numpy())]
        for shown, scores in zip(estimates, known, strict=True):
            words = f"{scores[position]['psnr']:.1f} dB, {scores[position]['depth_rmse_cm']:.2f} cm"
            row.append(Shown(np.moveaxis(shown[at]["image"], 0, -1), shown[at]["depth_m"], words))
        rows.append(row)
    return rows


def _about(seeds: Sequence[Entry], camera: CaptureModel) -> dict[str, Any]:
    return {
        "name": seeds[0].name,
        "kind": seeds[0].kind,
        "planes": len(camera.stack.depths_m),
        "depth_range_m": [camera.near_m, camera.far_m],
        "scenes_on_record": all(map(says_scenes, seeds)),
        "checkpoints": [entry.plain() for entry in seeds if isinstance(entry, LearnedEntry)],
    }
