"""`flatlight evaluate` of classifiers, all on the same captures, or the same clips seen otherwise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.camera import CaptureModel, camera_identity
from learning.checkpoint import find_checkpoint, load_checkpoint
from learning.config import ClassifierConfig, RecognitionConfig
from learning.data import ExampleSet, measured_psnr_db
from learning.evaluate.films import NamedFilm
from learning.evaluate.folder import claim_folder, is_claimed
from learning.evaluate.methods import LearnedEntry, check_learned
from learning.evaluate.runs import CACHE, Cameras, ResultCache
from learning.labels import check_forwards, class_numbers, spoken, spread_over_classes
from learning.method import (
    Clock,
    Progress,
    Say,
    choose_device,
    describe_device,
    inference,
    linear_to_srgb,
    threads_for,
)
from learning.models import ActivityMethod, ActivityNet, Classifier, LensClassifier, RawClassifier
from learning.provenance import clips_of, sample_digests
from learning.recognition.report import Recognition, write_recognition
from learning.recognition.scores import Answers
from learning.timing import with_slivers
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.cache import code_digest
from simulator.io.files import sha256_bytes, sha256_file
from simulator.io.json import canonical_json

# What tells trainings apart whose seeds may be averaged.
_TRAINED_BY = ("batch", "steps", "optimiser", "loss", "precision", "validate_every")
_TRAINED_ON = ("noise_db", "augment", "draws", "shuffle_labels")
# By these, and what they import, a measurement becomes probabilities.
_DECIDING = ("learning.checkpoint", "learning.data", "learning.models", "learning.layers.classifiers")


@dataclass(frozen=True, eq=False)
class Trained:
    """One seed of a classifier, built for the camera of the captures that it is tested on, and these."""

    name: str
    path: Path
    digest: str
    network: Classifier
    capture: CaptureModel
    test: Dataset

    @property
    def slivers(self) -> int | None:
        """How many frames it tells apart in a capture; None where it looks at none, or takes it as a whole."""
        return self.capture.frames if isinstance(self.network, ActivityNet) else None


def recognise(
    config: RecognitionConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None
) -> tuple[Recognition, list[Path]]:
    """Evaluate as a file says, write results, tables and figures to its folder, and return findings and files, report first.

    Raises:
        InputError: data without labels, or with classes that a network does not know; networks that are no classifiers, of
            other cameras, or that know the captures already; a folder that holds something else.
        StorageError: the folder cannot be written to.
    """
    folder, device = config.resolve_path(config.output), choose_device(config.device)
    is_claimed(folder, config.name)
    # What does not fit is said of all data sets now, not after hours of work.
    rows = [_read(config, one) for one in config.classifiers]
    reference = next(row for row in rows if row[0].name == (config.reference or rows[0][0].name))
    for one in (row[0] for row in rows):
        if one.network.classes != reference[0].network.classes:
            wanted = f"expected those of {reference[0].name}: {', '.join(reference[0].network.classes)}"
            raise InputError(one.name, f"it has the classes {', '.join(one.network.classes)}, {wanted}")
    back = [] if config.data.backwards is None else [_moved(config, one, config.data.backwards) for one in reference]
    claim_folder(folder, config.name)
    cache = ResultCache(folder / CACHE)
    found: list[Answers] = []
    for level in (None, *(config.noise_db or ())):
        asked = [row for row in rows if level is None or not isinstance(row[0].network, LensClassifier)]
        starts = Starts([one for row in asked for one in row])
        found += [_answers(config, row, level, cache, starts, device, progress) for row in asked]
    backwards = _answers(config, back, None, cache, Starts(back), device, progress) if back else None
    seen = [row[0] for row in rows if row[0].slivers is not None]
    recognition = Recognition(
        config,
        found,
        backwards,
        stored_db=measured_psnr_db(reference[0].test),
        fingerprint=reference[0].test.fingerprint,
        times={one.name: _times(one, config.timed, device, progress) for one in seen} if config.timed else {},
        sheet=_sheet(config, reference[0], device),
        device=describe_device(device),
    )
    say(f"{len(rows)} classifiers on {len(reference[0].test)} captures")
    return recognition, write_recognition(folder, recognition)


def _read(config: RecognitionConfig, row: ClassifierConfig) -> list[Trained]:
    """Return the seeds of a classifier."""
    found = []
    for text in row.checkpoints:
        path = find_checkpoint(text, row.name, config.resolve_path)
        known = load_checkpoint(path)
        network = known.network
        if not isinstance(network, ActivityNet | RawClassifier | LensClassifier):
            names = "activitynet, raw_classifier or lens_classifier"
            raise InputError(row.name, f"{path} is a {type(network).__name__}, not a classifier; expected {names}")
        test = _open(config, row.test or config.data.test, network.classes, known.capture.frames)
        check_forwards(test)
        check_learned(row.name, path, known.record, test)
        found.append(_built(row.name, path, test))
    cure = "give those of trainings that differ in their seed alone, one of each"
    if len({(_kind(each), each.capture.frames) for each in found}) > 1:
        raise InputError(row.name, f"its checkpoints are of different networks or trainings; {cure}")
    seeds = [load_checkpoint(each.path).record.get("config", {}).get("seed", each.digest) for each in found]
    twice = next((str(each.path) for at, each in enumerate(found) if seeds[at] in seeds[:at]), None)
    if twice:
        raise InputError(row.name, f"{twice} is of a training that another of its checkpoints is of, too; {cure}")
    return found


def _kind(one: Trained) -> str:
    """Return what a classifier is, how it was trained and on what it is tested, but for its seed and number of slivers."""
    known = load_checkpoint(one.path)
    config, data_sets = (known.record.get(key, {}) for key in ("config", "data sets"))
    how = {key: config.get(key) for key in _TRAINED_BY}
    how["data"] = {key: config.get("data", {}).get(key) for key in _TRAINED_ON}
    splits = (data_sets.get(split, {}) for split in ("train", "validation"))
    sets = [[split.get(key) for key in ("fingerprint", "samples")] for split in splits]
    sets.append(data_sets.get("stack"))
    told = [known.architecture, how, sets, known.record.get("init_from"), one.test.fingerprint]
    return sha256_bytes(canonical_json(told))


def _moved(config: RecognitionConfig, one: Trained, folder: str) -> Trained:
    """Return the same network for other captures."""
    test = _open(config, folder, one.network.classes, one.capture.frames)
    check_learned(one.name, one.path, load_checkpoint(one.path).record, test)
    if clips_of(test) != clips_of(one.test) or not test.config["scene"].get("backwards"):
        cure = f"make it with scene: {{source: samples, path: {one.test.root}, backwards: true, ...}}"
        raise InputError("data.backwards", f"{test.root} does not have the clips of {one.test.root} backwards; {cure}")
    return _built(one.name, one.path, test)


def _open(config: RecognitionConfig, folder: str, classes: Sequence[str], slivers: int) -> Dataset:
    test = open_dataset(config.resolve_path(folder), config.data.split)
    test = test if config.data.clips is None else test[: config.data.clips]
    if not len(test):
        raise InputError(test.root, f"split {test.split!r} is empty; set dataset.{test.split} and generate again")
    class_numbers(test, classes)
    return with_slivers(test, slivers)


def _built(name: str, path: Path, test: Dataset) -> Trained:
    """Build a checkpoint's network for the camera of a data set, which it takes for its own, but for gain and offset."""
    known, digest = load_checkpoint(path), sha256_file(path)
    entry = LearnedEntry(name, path, digest, known.capture, known.architecture, known.record)
    camera = Cameras(test, None, [entry]).assumed(entry, "own")
    network = load_checkpoint(path, capture=camera).network
    assert isinstance(network, ActivityNet | RawClassifier | LensClassifier)
    return Trained(name, path, digest, network, camera, test)


class Starts:
    """What networks begin with at a level of noise, which takes longest: those that begin alike share it.

    It is kept until the last of them has had it: under a megabyte for each capture of ten frames of 64 x 64.
    """

    def __init__(self, asking: Sequence[Trained]) -> None:
        """Tell it of all that will ask, in any order."""
        self._asking = Counter(key for one in asking if (key := _begins_by(one)) is not None)
        self._known: dict[tuple[str, int], Tensor] = {}

    def of(self, one: Trained, first: int, measurement: Tensor) -> Tensor | None:
        """Return what a network begins with for the captures of its test from position ``first`` on."""
        if (key := _begins_by(one)) is None:
            return None
        assert isinstance(one.network, ActivityNet)
        begun = self._known.get((key, first))
        if begun is None:
            with threads_for(measurement[0].numel() * one.capture.frames):
                begun = one.network.begin(measurement)
            assert begun is not None
            if self._asking[key] > 1:
                self._known[key, first] = begun.cpu()
        return begun.to(measurement.device)

    def done(self, one: Trained) -> None:
        """Say that a network will ask no more."""
        if (key := _begins_by(one)) is None:
            return
        self._asking[key] -= 1
        if not self._asking[key]:
            self._known = {known: begun for known, begun in self._known.items() if known[0] != key}


def _begins_by(one: Trained) -> str | None:
    """Return what decides all that a network begins with; None of what begins with nothing that takes long."""
    if not isinstance(one.network, ActivityNet) or one.network.joint is None:
        return None
    told = [_samples(one.test), camera_identity(one.capture), one.network.joint.told]
    return sha256_bytes(canonical_json(told))


def _samples(test: Dataset) -> str:
    return sha256_bytes(canonical_json([test.fingerprint, test.split, sample_digests(test)]))


def _answers(
    config: RecognitionConfig,
    seeds: Sequence[Trained],
    noise_db: float | None,
    cache: ResultCache,
    starts: Starts,
    device: torch.device,
    progress: Progress,
) -> Answers:
    """Return the answers of a classifier at a level of noise, which are kept."""
    chances = []
    for number, one in enumerate(seeds):
        level = "" if noise_db is None else f" at {noise_db:g} dB"
        stage = f"{one.name}{level}{f', seed {number + 1}' if len(seeds) > 1 else ''}"
        key = {
            "checkpoint": one.digest,
            "camera": camera_identity(one.capture),
            "samples": _samples(one.test),
            "noise": "stored" if noise_db is None else {"db": noise_db, "seed": config.seed},
            "device": device.type,
            "torch": torch.__version__,
            "code": code_digest(*_DECIDING),
        }
        kept = cache.load_arrays(key)
        if kept is None:
            kept = {"probabilities": _probabilities(config, one, noise_db, starts, device, stage, progress)}
            cache.save_arrays(key, kept)
        starts.done(one)
        chances.append(kept["probabilities"])
    first, known = seeds[0], [load_checkpoint(one.path) for one in seeds]
    truth = np.array(class_numbers(first.test, first.network.classes))
    parameters = sum(parameter.numel() for parameter in first.network.parameters()) / 1e6
    architecture, steps = known[0].architecture, known[0].record.get("config", {}).get("steps")
    looks = {"all": "all frames", "shuffled": "shuffled frames", "middle": "the middle frame"}
    words = [architecture["network"], looks.get(architecture.get("frames", "")), architecture["classifier"]]
    words += [f"{parameters:.2f} million parameters", f"{steps} steps" if steps else None]
    words += [f"tested on {first.test.root.name}"]
    return Answers(
        first.name,
        first.network.classes,
        truth,
        np.stack(chances),
        noise_db=noise_db,
        clips=clips_of(first.test),
        slivers=first.slivers,
        kind=_kind(first),
        note=", ".join(filter(None, words)),
        checkpoints=tuple(
            {
                "file": str(one.path),
                "sha256": one.digest,
                **{key: each.record.get("config", {}).get(key) for key in ("seed", "steps")},
                "step": each.record.get("step"),
                "trained_on": each.record.get("data sets", {}).get("train"),
            }
            for one, each in zip(seeds, known, strict=True)
        ),
        test=first.test.fingerprint,
        seed=config.seed,
    )


def _probabilities(
    config: RecognitionConfig,
    one: Trained,
    noise_db: float | None,
    starts: Starts,
    device: torch.device,
    stage: str,
    progress: Progress,
) -> NDArray[np.float32]:
    """Return the probabilities ``(n, classes)`` of all captures."""
    examples = ExampleSet(one.test, noise_db=None if noise_db is None else (noise_db, noise_db), seed=config.seed)
    network, found = one.network.to(device), []
    with inference(network):
        for first in range(0, len(examples), config.batch):
            batch = [examples[at] for at in range(first, min(first + config.batch, len(examples)))]
            measurement = torch.stack([each.measurement for each in batch]).to(device)
            radiance = torch.stack([each.radiance for each in batch]).to(device)
            answer = network(*network.looks_at(measurement, starts.of(one, first, measurement), radiance))
            if not bool((good := answer.logits.isfinite().all(dim=1)).all()):
                sample = one.test.ids[first + int((~good).nonzero()[0])]
                raise InputError(one.name, f"its answer to sample {sample} is NaN or infinite; check {one.path}")
            found.append(answer.logits.softmax(dim=1).cpu().numpy())
            progress(stage, first + len(batch), len(examples))
    return np.concatenate(found)


def _times(one: Trained, count: int, device: torch.device, progress: Progress) -> dict[str, float]:
    """Return the median seconds of each stage, for one capture at a time."""
    assert isinstance(one.network, ActivityNet)
    method = ActivityMethod(one.name, one.network, one.capture).to(device)
    examples, taken = ExampleSet(one.test), []
    for at in range(min(count, len(examples)) + 1):  # the first one warms up
        clock = Clock(device)
        method.recognise(examples[at % len(examples)].measurement[None].to(device), clock)
        taken.append(clock.seconds)
        progress(f"{one.name}: time", at, min(count, len(examples)))
    return {stage: float(np.median([each[stage] for each in taken[1:]])) for stage in taken[0]}


def _sheet(config: RecognitionConfig, one: Trained, device: torch.device) -> list[list[NamedFilm]]:
    """Return, for some captures, the true frames and what the reference's first seed sees in each sliver, and says."""
    if not isinstance(one.network, ActivityNet):
        return []
    method, examples = ActivityMethod(one.name, one.network, one.capture).to(device), ExampleSet(one.test)
    numbers, classes = class_numbers(one.test, one.network.classes), list(map(spoken, one.network.classes))
    sheet = []
    for at in spread_over_classes(numbers, config.shown):
        example = examples[at]
        measurement = example.measurement[None].to(device)
        frames = linear_to_srgb(example.radiance, one.capture.white)
        estimate, chances = method.recognise(measurement)
        best = chances[0].cpu().topk(2)
        words = ", ".join(f"{classes[int(k)]} {float(p):.0%}" for p, k in zip(*best, strict=True))
        looked = estimate.clamped().image[0]
        truth, seen = (each.permute(0, 2, 3, 1).cpu().numpy() for each in (frames, looked))
        sheet.append([NamedFilm(classes[numbers[at]], truth), NamedFilm(words, seen)])
    return sheet
