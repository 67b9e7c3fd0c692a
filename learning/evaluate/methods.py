"""The methods that take part, each once per seed: what decides them, how they are built for a camera.

Train-test leakage: test scenes must be new to every method; what saw them before is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from learning.camera import CaptureModel
from learning.checkpoint import find_checkpoint, load_checkpoint, load_denoiser
from learning.classical.by_name import ALL_DEFAULTS, build_method, learned_files
from learning.config import EvaluateConfig, MethodConfig
from learning.evaluate.outcome import Kind
from learning.method import Method
from learning.models import NETWORKS, learned_method
from learning.models.repeated import RepeatedStill
from learning.models.still_estimates import still_camera
from learning.provenance import scenes_of
from learning.timing import recorded_timing
from learning.tune.study import load_tuned
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import sha256_file
from simulator.text import show


@dataclass(frozen=True, eq=False)
class LearnedEntry:
    """A network's checkpoint; ``capture`` is the camera that it knows by itself.

    Of clips, one for stills takes part as `RepeatedStill`, with the images of the network ``frames`` where there is one.
    """

    name: str
    path: Path
    digest: str
    capture: CaptureModel
    architecture: Mapping[str, Any]
    record: Mapping[str, Any]
    frames: LearnedEntry | None = None
    kind: Kind = "learned"

    @property
    def label(self) -> str:
        """The method's name with this seed's file, for messages."""
        return f"{self.name} ({self.path})"

    def plain(self) -> dict[str, Any]:
        """Return what results.json says of it."""
        about = {"architecture": dict(self.architecture), "record": dict(self.record)}
        if self.frames is not None:
            about["frames"] = self.frames.plain()
        return {"file": self.path.name, "sha256": self.digest, **about}

    def identity(self, noise_db: float) -> dict[str, Any]:
        """Return what decides it at a level of noise, beside the camera: the files' hashes."""
        return {"checkpoint": self.digest} | ({} if self.frames is None else {"frames": self.frames.digest})

    def note(self, noise_db: float) -> str:
        """Return what a reader should know of it at a level of noise: the architecture in words."""
        known = {"network": "", "size": "", **self.architecture}
        name, size = known.pop("network"), known.pop("size")
        usual = NETWORKS[name].sizes.get(size, {}) if name in NETWORKS else {}
        within = {key: value for key, value in known.items() if not isinstance(value, Mapping)}
        changes = (f"{key} {value}" for key, value in within.items() if usual.get(key) != value)
        of_frames = "" if self.frames is None else f"frames of {self.frames.note(noise_db)}"
        return ", ".join(filter(None, [name, size, *changes, of_frames]))

    def build(self, capture: CaptureModel, noise_db: float, device: torch.device) -> Method:
        """Return the network, ready on a device, for a camera; an InputError says that it does not fit."""
        if capture.timing is None or self.capture.timing is not None:
            return learned_method(self.name, load_checkpoint(self.path, capture=capture).network, capture).to(device)
        return RepeatedStill(self.name, self.build(still_camera(capture), noise_db, device), capture)

    def tuned_db(self, noise_db: float) -> None:
        """Return None: nothing of it was tuned at a level of noise."""


@dataclass(frozen=True, eq=False)
class ClassicalEntry:
    """A classical method, with parameters that may depend on the noise; it is told of its camera.

    ``tuned`` is the file of its parameters, ``parameters`` are given ones, which come first; files among them are absolute
    paths.
    """

    name: str
    algorithm: str
    tuned: Path | None
    parameters: Mapping[str, Any] | None
    capture: None = None
    kind: Kind = "classical"

    @property
    def learned(self) -> dict[Path, Mapping[str, Any]]:
        """The records of the networks that it trusts at any level of noise, by file: a denoiser, one that it begins with."""
        levels = [0.0] if self.tuned is None else load_tuned(self.tuned).levels_db(self.algorithm)
        found: dict[Path, Mapping[str, Any]] = {}
        for level in levels:
            for parameter, path in learned_files(self.algorithm, self._chosen(level)[0], self.name).items():
                denoiser = parameter == "denoiser"
                found[path] = load_denoiser(path)[1] if denoiser else load_checkpoint(path).record
        return found

    def identity(self, noise_db: float) -> dict[str, Any]:
        """Return algorithm and parameters; of a file its hash, wherever it lies."""
        parameters, _ = self._chosen(noise_db)
        hashes = {
            name: sha256_file(path) for name, path in learned_files(self.algorithm, parameters, self.name).items()
        }
        return {"classical": self.algorithm, "parameters": parameters | hashes}

    def note(self, noise_db: float) -> str:
        """Return the parameters and where they come from."""
        parameters, level = self._chosen(noise_db)
        parameters |= {
            name: Path(parameters[name]).name for name in learned_files(self.algorithm, parameters, self.name)
        }
        shown = {name: f"{value:.4g}" if isinstance(value, float) else value for name, value in parameters.items()}
        words = ", ".join(f"{name} {value}" for name, value in shown.items())
        return f"{words or 'defaults'} ({'as given' if level is None else f'tuned at {level:g} dB'})"

    def tuned_db(self, noise_db: float) -> float | None:
        """Return the level at which the parameters for a level were tuned; None where they were given."""
        return self._chosen(noise_db)[1]

    def build(self, capture: CaptureModel, noise_db: float, device: torch.device) -> Method:
        """Return the method for a camera; an InputError names it, and the file of parameters that it refuses."""
        try:
            method = build_method(capture, self.algorithm, self._chosen(noise_db)[0]).to(device)
        except InputError as error:
            raise InputError(self.name, f"{self.tuned}: {error}" if self.tuned else str(error)) from error
        method.name = self.name
        return method

    def _chosen(self, noise_db: float) -> tuple[dict[str, Any], float | None]:
        if self.tuned is None:
            return ALL_DEFAULTS[self.algorithm] | dict(self.parameters or {}), None
        parameters, level = load_tuned(self.tuned).parameters(self.algorithm, noise_db)
        return ALL_DEFAULTS[self.algorithm] | parameters | dict(self.parameters or {}), level


Entry = LearnedEntry | ClassicalEntry
"""A method with one seed."""


def read_methods(config: EvaluateConfig, test: Dataset) -> list[list[Entry]]:
    """Return the methods in their order, each a list of its seeds.

    Raises:
        InputError: a file that is missing, damaged or of another kind; a network that learned from the test scenes or was
            chosen by them, parameters that were tuned on them.
    """
    return [_read_method(config, method, test) for method in config.methods]


def _read_method(config: EvaluateConfig, method: MethodConfig, test: Dataset) -> list[Entry]:
    if method.classical is not None:
        tuned = None if method.tuned is None else config.resolve_path(method.tuned)
        if tuned is not None:
            check_tuned(method.name, tuned, test)
        parameters = dict(method.parameters or {})
        files = learned_files(method.classical, parameters, method.name, config.resolve_path)
        parameters |= {name: str(path) for name, path in files.items()}
        entry = ClassicalEntry(method.name, method.classical, tuned, parameters)
        for path, record in entry.learned.items():
            check_learned(method.name, path, record, test)
        return [entry]
    frames = None if method.frames is None else _learned(config, method.name, method.frames, test)
    entries = [_learned(config, method.name, text, test, frames) for text in method.checkpoints or ()]
    check_seeds(method.name, entries)
    if frames is not None:
        if frames.capture.timing is None:
            raise InputError(method.name, f"frames: {frames.path} is for stills; take a videonet's file")
        if any(one.capture.timing is not None for one in entries):
            got = f"got frames of {frames.path.name} for a network that has frames of its own"
            raise InputError(method.name, f"{got}; take a flatnet3d in checkpoints, or leave frames out")
        if recorded_timing(test) is None:
            raise InputError(method.name, f"got frames, but {test.root} holds stills; leave frames out")
    return list(entries)


def _learned(
    config: EvaluateConfig, name: str, text: str, test: Dataset, frames: LearnedEntry | None = None
) -> LearnedEntry:
    path = find_checkpoint(text, name, config.resolve_path)
    one = load_checkpoint(path)
    check_learned(name, path, one.record, test)
    return LearnedEntry(name, path, sha256_file(path), one.capture, one.architecture, one.record, frames)


# By these, of the configuration, trainings are told apart.
_TRAINED_BY = ("batch", "steps", "optimiser", "loss", "precision", "validate_every")
_TRAINED_ON = ("noise_db", "augment", "draws", "shuffle_labels")


def training_of(one: LearnedEntry) -> dict[str, Any]:
    """Return what a network is and how it was trained, but for its seed and number of slivers: values by dotted keys."""
    config, data_sets = (one.record.get(key) or {} for key in ("config", "data sets"))
    told: dict[str, Any] = {"network": None} | dict(one.architecture)  # what tells most comes first
    told |= {key: config.get(key) for key in _TRAINED_BY}
    told["data"] = {key: (config.get("data") or {}).get(key) for key in _TRAINED_ON}
    for split in ("train", "validation"):
        told[f"{split} data"] = {key: (data_sets.get(split) or {}).get(key) for key in ("fingerprint", "samples")}
    told["psf stack"] = data_sets.get("stack")
    told["init_from"] = dict(one.record.get("init_from") or {}).get("architecture")
    return _flat(told)


def check_seeds(name: str, seeds: Sequence[LearnedEntry]) -> None:
    """Refuse checkpoints whose scores may not be averaged: all must be of one training, each with another seed."""
    cure = "give checkpoints that differ in their seed alone, one of each"
    paths: dict[Any, Path] = {}
    every = [training_of(one) | {"slivers": one.capture.frames} for one in seeds]
    for one, own in zip(seeds, every, strict=True):
        first = every[0]
        for key in (*first, *own):
            if (value := own.get(key)) != (known := first.get(key)):
                got = f"{one.path} has {key} {show(value)}, {seeds[0].path} {show(known)}"
                raise InputError(name, f"got different trainings: {got}; {cure}")
        seed = dict(one.record.get("config") or {}).get("seed", one.digest)
        if seed in paths:
            raise InputError(name, f"{one.path} and {paths[seed]} are of the same training and seed; {cure}")
        paths[seed] = one.path


def _flat(values: Mapping[str, Any], within: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in values.items():
        found |= _flat(value, f"{within}{key}.") if isinstance(value, Mapping) else {f"{within}{key}": value}
    return found


_USED = {"train": "learned from", "validation": "was chosen among its own steps by"}


def check_learned(name: str, path: Path, record: Mapping[str, Any], test: Dataset) -> None:
    """Refuse a network that knows the test scenes, be it from the training of the checkpoint that it began with.

    They may be those of its train split, or of the validation split by which its best step was chosen, seen by whatever
    camera: ``scenes`` in the checkpoint's record, at any depth, see `learning.provenance.scenes_of`.
    """
    for training in _trainings(record):
        for split, words in _USED.items():
            known, data = (dict(training.get(what) or {}).get(split) for what in ("scenes", "data sets"))
            _refuse_known(test, known, dict(data or {}).get("fingerprint"), split, name, f"{path} {words}")


def check_tuned(name: str, tuned: Path, test: Dataset) -> None:
    """Refuse parameters of a method that `flatlight tune` found on the test scenes, seen by whatever camera."""
    identity = load_tuned(tuned).content["identity"]
    known, fingerprint, split = (identity.get(what) for what in ("scenes", "data", "split"))
    _refuse_known(test, known, fingerprint, split, name, f"{tuned} was tuned on")


def says_scenes(entry: Entry) -> bool:
    """Return whether it is on record which scenes a method has seen; earlier versions of Flatlight kept data sets only."""
    if isinstance(entry, LearnedEntry):
        return _all_say_scenes(entry.record) and (entry.frames is None or says_scenes(entry.frames))
    learned = all(map(_all_say_scenes, entry.learned.values()))
    return learned and (entry.tuned is None or "scenes" in load_tuned(entry.tuned).content["identity"])


def _all_say_scenes(record: Mapping[str, Any]) -> bool:
    trainings = list(_trainings(record))
    return bool(trainings) and all(training.get("scenes") for training in trainings)


def _refuse_known(test: Dataset, known: Any, fingerprint: Any, split: Any, name: str, words: str) -> None:
    """Refuse a method, ``words`` say how, that has seen the scenes ``known`` or, without these, the split of a data set."""
    if known:
        shared = sorted(set(known).intersection(scenes_of(test)))
    else:
        shared = [f"data set {test.fingerprint[:12]}"] if (fingerprint, split) == (test.fingerprint, test.split) else []
    if shared:
        which = shared[0] + (f" and {len(shared) - 1} more" if shared[1:] else "")
        scenes = f"test scenes, split {test.split!r} of {test.root}, through this camera or another ({which})"
        raise InputError(name, f"{words} {scenes}; evaluate on another split, or on scenes of another seed")


def _trainings(record: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield what is on record of a checkpoint's training, and of those of the checkpoints that it began with."""
    if record.get("data sets") or record.get("scenes"):
        yield record
    for value in record.values():
        if isinstance(value, Mapping):
            yield from _trainings(value)
