"""A classifier with one seed, built for the camera of its test captures: where it comes from, and what it makes of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.camera import CaptureModel, camera_identity
from learning.checkpoint import find_checkpoint, load_checkpoint
from learning.config import ClassifierConfig, RecognitionConfig
from learning.data import ExampleSet
from learning.evaluate.methods import LearnedEntry, check_learned, check_seeds
from learning.evaluate.runs import Cameras
from learning.labels import check_forwards, class_numbers
from learning.method import inference, threads_for
from learning.models import ActivityNet, Classifier, LensClassifier, RawClassifier
from learning.provenance import clips_of, playback, sample_digests
from learning.timing import with_slivers
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.files import sha256_bytes, sha256_file
from simulator.io.json import canonical_json


@dataclass(frozen=True, eq=False)
class Trained:
    """One seed of a classifier, built for the camera of the captures ``test``."""

    entry: LearnedEntry
    network: Classifier
    capture: CaptureModel
    test: Dataset

    @property
    def name(self) -> str:
        """That of its row."""
        return self.entry.name

    @property
    def slivers(self) -> int | None:
        """How many frames it tells apart in a capture; None where it looks at none, or takes it as a whole."""
        return self.capture.frames if isinstance(self.network, ActivityNet) else None

    @property
    def samples(self) -> str:
        """A hash of the captures that it is tested on."""
        return sha256_bytes(canonical_json([self.test.fingerprint, self.test.split, sample_digests(self.test)]))


def read_classifier(config: RecognitionConfig, row: ClassifierConfig) -> list[Trained]:
    """Return the seeds of a row.

    Raises:
        InputError: a file of another network; captures of stills, without labels, of other classes, or that run backwards;
            checkpoints that know the captures, or that are no seeds of one training.
    """
    found = []
    for text in row.checkpoints:
        path = find_checkpoint(text, row.name, config.resolve_path)
        known = load_checkpoint(path)
        if not isinstance(known.network, ActivityNet | RawClassifier | LensClassifier):
            got = f"{path} is a {type(known.network).__name__}, not a classifier"
            raise InputError(row.name, f"{got}; expected activitynet, raw_classifier or lens_classifier")
        entry = LearnedEntry(row.name, path, sha256_file(path), known.capture, known.architecture, known.record)
        test = _opened(config, row.test or config.data.test, entry)
        check_forwards(test)
        found.append(_built(entry, test))
    check_seeds(row.name, [one.entry for one in found])
    return found


def read_backwards(config: RecognitionConfig, one: Trained, folder: str) -> Trained:
    """Return the same network for the same clips backwards; an InputError says that a data set does not have these."""
    test = _opened(config, folder, one.entry)
    if clips_of(test) != clips_of(one.test) or playback(test) != "backwards":
        cure = f"make it with scene: {{source: samples, path: {one.test.root}, backwards: true, ...}}"
        raise InputError("data.backwards", f"{test.root} does not have the clips of {one.test.root} backwards; {cure}")
    return _built(one.entry, test)


def _opened(config: RecognitionConfig, folder: str, entry: LearnedEntry) -> Dataset:
    """Return captures that a network may be tested on, with as many slivers as it tells apart."""
    test = open_dataset(config.resolve_path(folder), config.data.split)
    test = test if config.data.clips is None else test[: config.data.clips]
    if not len(test):
        raise InputError(test.root, f"split {test.split!r} is empty; set dataset.{test.split} and generate again")
    class_numbers(test, entry.architecture["classes"])
    try:
        test = with_slivers(test, entry.capture.frames)
    except InputError as error:
        raise InputError(entry.name, f"its network does not fit {test.root}: {error}") from error
    check_learned(entry.name, entry.path, entry.record, test)
    return test


def _built(entry: LearnedEntry, test: Dataset) -> Trained:
    """Build a checkpoint's network for the camera of a data set, which it takes for its own, but for gain and offset."""
    camera = Cameras(test, None, [entry]).assumed(entry, "own")
    network = load_checkpoint(entry.path, capture=camera).network
    assert isinstance(network, ActivityNet | RawClassifier | LensClassifier)
    return Trained(entry, network, camera, test)


class InitialEstimates:
    """The initial estimates of networks at a level of noise, which take longest: networks with the same ones share them.

    They are kept until the last network has had them: under a megabyte for each capture of ten frames of 64 x 64.
    """

    def __init__(self, users: Iterable[Trained]) -> None:
        """Tell it of all that will ask, in any order."""
        self._users = Counter(key for one in users if (key := _estimated_by(one)) is not None)
        self._known: dict[tuple[str, int], Tensor] = {}

    def of(self, one: Trained, first: int, measurement: Tensor) -> Tensor | None:
        """Return a network's initial estimate of its captures from position ``first`` on; None where it has none."""
        if (key := _estimated_by(one)) is None:
            return None
        assert isinstance(one.network, ActivityNet)
        estimate = self._known.get((key, first))
        if estimate is None:
            with threads_for(measurement[0].numel() * one.capture.frames):
                estimate = one.network.initial_estimate(measurement)
            assert estimate is not None
            if self._users[key] > 1:
                self._known[key, first] = estimate.cpu()
        return estimate.to(measurement.device)

    def release(self, one: Trained) -> None:
        """Say that a network will ask no more."""
        if (key := _estimated_by(one)) is None:
            return
        self._users[key] -= 1
        if not self._users[key]:
            self._known = {name: estimate for name, estimate in self._known.items() if name[0] != key}


def _estimated_by(one: Trained) -> str | None:
    """Return what decides a network's initial estimates; None of one that has none."""
    if not isinstance(one.network, ActivityNet) or one.network.joint is None:
        return None
    return sha256_bytes(canonical_json([one.samples, camera_identity(one.capture), one.network.joint.told]))


def probabilities(
    one: Trained,
    estimates: InitialEstimates,
    noise_db: float | None,
    *,
    seed: int,
    batch: int,
    device: torch.device,
    progress: Callable[[int, int], None],
) -> NDArray[np.float32]:
    """Return the probabilities ``(n, classes)`` of all captures; noise of a level is drawn anew, by ``seed``.

    Raises:
        InputError: they are not finite.
    """
    examples = ExampleSet(one.test, noise_db=None if noise_db is None else (noise_db, noise_db), seed=seed)
    network, found = one.network.to(device), []
    with inference(network):
        for first in range(0, len(examples), batch):
            taken = [examples[at] for at in range(first, min(first + batch, len(examples)))]
            measurement = torch.stack([each.measurement for each in taken]).to(device)
            radiance = torch.stack([each.radiance for each in taken]).to(device)
            logits = network(*network.inputs(measurement, estimates.of(one, first, measurement), radiance)).logits
            if not bool((good := logits.isfinite().all(dim=1)).all()):
                sample = one.test.ids[first + int((~good).nonzero()[0])]
                got = f"its probabilities of sample {sample} are NaN or infinite"
                raise InputError(one.name, f"{got}; check {one.entry.path}")
            found.append(logits.softmax(dim=1).cpu().numpy())
            progress(first + len(taken), len(examples))
    return np.concatenate(found)
