"""`flatlight swap-masks`: masks judged by what is reconstructed through them, beside the merits of their PSFs.

For each mask: the scenes of a data set seen through it (nothing is rendered), the classical methods tuned for it, a trained
network given its PSFs, and the same network after a few hundred further steps. All of these are the usual jobs, which go on
where they stopped: adding a mask leaves the others as they are.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import Checkpoint, find_checkpoint, load_checkpoint, save_checkpoint
from learning.config import (
    FEWEST_SCENES,
    DataConfig,
    EvaluateConfig,
    EvaluationData,
    MethodConfig,
    NetworkConfig,
    SwapConfig,
    Timing,
    TrainConfig,
    TuneConfig,
    TuneData,
    WarmStart,
)
from learning.evaluate.folder import is_claimed
from learning.evaluate.job import evaluate, find_perceptual
from learning.evaluate.methods import check_learned
from learning.evaluate.outcome import SCORES, Outcome
from learning.evaluate.paired import EXPLAINED, compare
from learning.evaluate.report import OWN_FILES, Evaluation, compared_scores
from learning.evaluate.runs import CACHE
from learning.evaluate.tables import markdown, markdown_differences, markdown_verdicts
from learning.method import Progress, Say, choose_device
from learning.models.flatnet import FlatNet
from learning.resume import BEST
from learning.timing import recorded_timing
from learning.train import train
from learning.transfer import for_camera
from learning.tune.job import tune_file
from simulator.assembly import Assembly
from simulator.camera.noise import PhysicalNoise
from simulator.config import Config, ConfigError, load_config
from simulator.dataset import generate, open_dataset
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import storage_errors, write_atomic
from simulator.plots.comparison import COLUMNS, Candidate, cameras_in_words, measure
from simulator.plots.comparison_page import comparison_html
from simulator.text import dotted, key_path, share

REPORT, PAGE = "report.md", "psfs.html"
_DATA, _TEST, _TUNED, _NETWORK = "data", "test", "tuned.json", "network"
_SWAPPED, _EVALUATION = "swapped.safetensors", "evaluation"


@dataclass(frozen=True)
class Swapped:
    """What came out: ``table`` has a column for each mask, its first row their names; ``report`` is the file."""

    table: list[list[str]]
    light: str
    report: Path


def swap_masks(config: SwapConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None) -> Swapped:
    """Do all that a file asks, or what is missing of it, and write the report.

    Raises:
        InputError: a mistake in the file, its configuration, scenes or checkpoint, or a folder that holds something else.
        StorageError: the disk is full or protected; the same call goes on from there.
    """
    folder = config.resolve_path(config.output)
    # Mistakes come out before the work that they would spoil.
    find_perceptual(config.perceptual, choose_device(config.device), clips=False)
    for name in config.masks:
        if name in (REPORT, PAGE, _EVALUATION, CACHE, *OWN_FILES):
            raise InputError(f"masks.{name}", f"{name} is a file or folder of the result; take another name")
    unseen = _check_scenes(config)
    cameras = {name: _cameras(config, name, folder / name) for name in config.masks}
    known = None
    if config.network is not None:
        path = find_checkpoint(config.network.init_from, "network.init_from", config.resolve_path)
        known = load_checkpoint(path)
        if not isinstance(known.network, FlatNet):
            raise InputError(
                "network.init_from", f"{path} is a {type(known.network).__name__}; expected a FlatNet: masks see stills"
            )
        check_learned("network.init_from", path, known.record, unseen)
    judged = _evaluation(config, known, folder)
    is_claimed(folder / _EVALUATION, config.name)
    for name, both in cameras.items():
        with _mask_named(name):
            _check_camera(*both)
    merits: dict[str, Candidate] = {}
    for name, (learned, _) in cameras.items():
        with _mask_named(name):
            merits[name] = measure(name, learned, depths=None, progress=progress)  # those of the data sets made next
    for name, (learned, test) in cameras.items():
        tell, speak = partial(_tell, progress, name), partial(_speak, say, name)
        _generate(learned, tell)
        _generate(test, partial(_tell, progress, f"{name}, test"))  # stages of its own: rates are per stage
        if config.tuned:
            tune_file(_tuning(config, folder / name), progress=tell, say=speak)
        if known is not None and config.network is not None:
            _swap(known, folder / name)
            if config.network.steps:
                train(_training(config, config.network, known, folder / name), progress=tell, say=speak)
    evaluation, _ = evaluate(judged, progress=progress, say=say)
    before = "" if known is None else _before(known)
    return _write(folder, evaluation, merits, _light(next(iter(cameras.values()))[0]), before)


def _tell(progress: Progress, name: str, stage: str, done: int, total: int) -> None:
    progress(f"{name}: {stage}", done, total)


def _speak(say: Say, name: str, line: str) -> None:
    say(f"{name}: {line}")


def _generate(config: Config, progress: Progress) -> None:
    """Make a data set; what there is to say of it stands in the report."""
    made = generate(config, progress=progress)
    if made.failed:
        raise InputError(made.path, f"{len(made.failed)} samples could not be made, {made.failed[0]}")


def _check_scenes(config: SwapConfig) -> Dataset:
    """Refuse splits with fewer scenes than are asked for, and return that of the test."""
    chosen = config.scenes
    asked = {
        "train": (chosen.train, chosen.train_scenes),
        "validation": (chosen.train, chosen.validation_scenes),
        "test": (chosen.test or chosen.train, chosen.test_scenes),
    }
    found = {split: open_dataset(config.resolve_path(folder), split) for split, (folder, _) in asked.items()}
    for split, (_, count) in asked.items():
        if recorded_timing(found[split]) is not None:
            raise InputError("scenes", f"got clips, {found[split].root}, expected stills: masks are compared by those")
        if len(found[split]) < count:
            has = f"split {split!r} of {found[split].root} has {len(found[split])} samples"
            raise InputError(f"scenes.{split}_scenes", f"got {count}, but {has}; ask for fewer, or generate more")
    return found["test"]


@contextmanager
def _mask_named(name: str) -> Iterator[None]:
    """Name a mask by its key in the file where it is refused as a configuration's."""
    try:
        yield
    except InputError as error:
        faults = [(each.path, each.text) for each in error.problems] if isinstance(error, ConfigError) else []
        for path, reason in [*faults, (key_path(error.path), error.reason)]:
            if path[:2] == ("camera", "mask"):
                raise InputError(dotted(("masks", name, *path[2:])), reason) from error
        raise


def _check_camera(learned: Config, test: Config) -> None:
    """Refuse a test by another camera than that of training: other pixels, or depths beyond its own; and other scenes."""
    ours, theirs = Assembly(learned), Assembly(test)
    ends = [1 / np.array([each.depths_m[0], each.depths_m[-1]]) for each in (ours, theirs)]
    slack = 1e-3 * abs(float(ends[0] @ [1, -1]))  # of depths that were written with few digits
    sizes = [
        f"{each.config.camera.sensor.shape} pixels of {each.pixel_pitch_m * 1e6:.4g} um" for each in (ours, theirs)
    ]
    if sizes[0] != sizes[1]:
        raise InputError("test_settings", f"got {sizes[1]}, expected those of training: {sizes[0]}")
    if len(ours.depths_m) > 1 and (ends[1][0] > ends[0][0] + slack or ends[1][1] < ends[0][1] - slack):
        depths = [f"{each.depths_m[0]:g} to {each.depths_m[-1]:g} m" for each in (ours, theirs)]
        raise InputError(
            "test_settings", f"got depths of {depths[1]}, expected some within those of training, {depths[0]}"
        )
    for each in (ours, theirs):
        _ = each.source  # refuses scenes that this camera cannot see


def _cameras(config: SwapConfig, name: str, folder: Path) -> tuple[Config, Config]:
    """Return the configurations of a mask's data sets: for training and tuning, and for the test."""
    path = config.resolve_path(config.config)
    shared = [f"camera.mask={json.dumps(config.masks[name])}", *config.settings, "psf.as_captured=null"]
    with _mask_named(name):
        scene = load_config(path, shared).scene
    again: dict[str, object] = {"source": "samples", "size": list(scene.size)}
    if scene.has_margin:
        again |= {"margin": scene.margin, "margin_deg": scene.margin_deg, "surroundings": "own"}

    def seen(scenes: str, output: str, more: list[str], **counts: int) -> Config:
        dataset = {"output": str(folder / output), "train": 0, "validation": 0, "test": 0, **counts}
        settings = [f"dataset.{key}={json.dumps(value)}" for key, value in dataset.items()]
        source = again | {"path": str(config.resolve_path(scenes))}
        return load_config(path, [*shared, *more, f"scene={json.dumps(source)}", *settings])

    chosen = config.scenes
    counts = {"train": chosen.train_scenes, "validation": chosen.validation_scenes}
    return (
        seen(chosen.train, _DATA, [], **counts),
        seen(chosen.test or chosen.train, _TEST, config.test_settings, test=chosen.test_scenes),
    )


def _tuning(config: SwapConfig, folder: Path) -> TuneConfig:
    scenes = min(FEWEST_SCENES, config.scenes.validation_scenes)
    return TuneConfig(
        output=folder / _TUNED,
        data=TuneData(validation=folder / _DATA, scenes=scenes, allow_few_scenes=scenes < FEWEST_SCENES),
        methods=list(config.tuned),
        noise_db=["stored", *config.noise_db],
        seed=config.seed,
        device=config.device,
    )


def _swap(known: Checkpoint, folder: Path) -> None:
    """Write the network as it is with the PSFs of a mask."""
    scenes = open_dataset(folder / _DATA, "train")
    capture = capture_model(scenes, white=measure_reference_white(scenes))
    record = known.record | {"name": f"{known.architecture['network']} with other PSFs"}
    network = for_camera(known, capture)
    save_checkpoint(folder / _SWAPPED, network, architecture=known.architecture, capture=capture, record=record)


def _training(config: SwapConfig, network: WarmStart, known: Checkpoint, folder: Path) -> TrainConfig:
    return TrainConfig(
        name=folder.name,
        output=str(folder / _NETWORK),
        seed=config.seed,
        data=DataConfig(train=str(folder / _DATA), stack="nominal", augment=network.augment),
        network=NetworkConfig(**known.named),
        init_from=str(known.path),
        loss=network.loss,
        optimiser=network.optimiser,
        steps=network.steps,
        batch=network.batch,
        device=config.device,
        validate_every=network.validate_every,
    )


def _evaluation(config: SwapConfig, known: Checkpoint | None, folder: Path) -> EvaluateConfig:
    """Return the evaluation: a data set for each mask, and of each method what belongs to the mask."""
    methods: list[MethodConfig] = []
    if known is not None and config.network is not None:
        name, steps = type(known.network).__name__, config.network.steps
        if steps:
            trained = str(folder / "<set>" / _NETWORK / BEST)
            methods.append(MethodConfig(name=f"{name}, {steps} steps with the mask", checkpoints=[trained]))
        methods.append(MethodConfig(name=f"{name}, given the PSFs", checkpoints=[str(folder / "<set>" / _SWAPPED)]))
    tuned = str(folder / "<set>" / _TUNED)
    methods += [MethodConfig(name=f"{one.upper()} + graph cut", classical=one, tuned=tuned) for one in config.tuned]
    methods += [
        MethodConfig(name=f"{one.upper()} + graph cut, untuned", classical=one, parameters={}) for one in config.untuned
    ]
    test = {name: str(folder / name / _TEST) for name in config.masks}
    return EvaluateConfig(
        name=config.name,
        output=str(folder / _EVALUATION),
        data=EvaluationData(test=test, training=str(folder / "<set>" / _DATA)),
        methods=methods,
        noise_db=config.noise_db or None,
        perceptual=config.perceptual,
        seed=config.seed,
        time=Timing(repeats=0),
        device=config.device,
    )


def _light(config: Config) -> str:
    """Return whether a mask that passes less light is the noisier for it."""
    camera = config.camera
    lux, auto = camera.exposure.illuminance_lux, camera.exposure.full_scale == "auto"
    if not isinstance(camera.noise, PhysicalNoise) or (lux is None and auto):
        return "Exposure or noise is scaled to the light of each mask, so its throughput does not count."
    light = f"full scale {camera.exposure.full_scale:g}" if lux is None else f"{lux:g} lux on a white surface"
    return f"The same light for all ({light}), photons counted: less light through a mask means more noise."


def _before(known: Checkpoint) -> str:
    """Return what a reader should know of the network: that it comes from somewhere."""
    mask, step = known.capture.stack.provenance.get("mask"), known.record.get("step")
    what = mask["name"] if isinstance(mask, dict) and "name" in mask else "another mask"
    steps = "some time" if step is None else f"{step} steps"
    return f"The network had learned with {what} for {steps} before, which favours that mask and its like."


def _table(evaluation: Evaluation, merits: Mapping[str, Candidate]) -> list[list[str]]:
    """Return a column for each mask: the merits of its PSFs, then the scores of each method, and of none."""
    sets, methods = evaluation.findings, evaluation.config.methods
    table = [["", *merits]]
    table += [[column.title, *map(column.cell, merits.values())] for column in COLUMNS]
    table.append(["PSNR of the measurement dB", *(f"{found.stored_db:.1f}" for found in sets.values())])
    exposed = [found.test.info.exposure["pilot_shares"] for found in sets.values()]
    for title, key in (("Values saturated", "saturated"), ("Values below the noise", "below_noise")):
        table.append([title, *(share(one[key]) for one in exposed)])
    for score in compared_scores(next(iter(sets.values())).main):
        title, digits, more = SCORES[score]
        title += " ↑" if more else " ↓"

        def row(words: str, outcomes: Iterable[Outcome], score: str = score, digits: int = digits) -> list[str]:
            return [words, *(f"{one.scores[score].mean:.{digits}f}" for one in outcomes)]

        for case, level in (("", None), *((f" at {level:g} dB", level) for level in evaluation.config.noise_db or ())):
            cases = [
                found.main if level is None else [one for one in found.ablation if one.noise_db == level]
                for found in sets.values()
            ]
            for at, method in enumerate(methods):
                table.append(row(f"{title}{case}: {method.name}", [outcomes[at] for outcomes in cases]))
        answers = ([one for one in found.naive if score in one.scores] for found in sets.values())
        best = [sorted(each, key=lambda one: one.scores[score].mean)[-1 if more else 0] for each in answers]
        table.append(row(f"{title}: naive baseline", best))
    return table


def _write(folder: Path, evaluation: Evaluation, merits: Mapping[str, Candidate], light: str, before: str) -> Swapped:
    """Write the report and the page of the PSFs."""
    sets, seed = evaluation.findings, evaluation.config.seed
    table = _table(evaluation, merits)
    candidates, (first, found) = list(merits.values()), next(iter(sets.items()))
    parts = [
        f"# {evaluation.config.name}",
        f"{cameras_in_words(candidates)} {len(found.test)} test scenes, the same through every mask. {light} "
        f"{before}".rstrip(),
        markdown(table[0], table[1:]),
        f"How the merits are defined, and the PSFs: [{PAGE}]({PAGE}). All scores of all methods, pictures: "
        f"[{_EVALUATION}/report.md]({_EVALUATION}/report.md).",
    ]
    if len(sets) > 1:
        differences = {
            method.name: compare(first, [replace(each.main[at], method=mask) for mask, each in sets.items()], seed)
            for at, method in enumerate(evaluation.config.methods)
        }
        parts += ["## Paired differences", f"Of masks, by the same method. {EXPLAINED}", markdown_verdicts(differences)]
        parts += [markdown_differences(score, differences) for score in compared_scores(found.main)]
    with storage_errors(folder):
        write_atomic(folder / PAGE, comparison_html(candidates).encode())
        write_atomic(folder / REPORT, ("\n\n".join(parts) + "\n").encode())
    return Swapped(table, light, folder / REPORT)
