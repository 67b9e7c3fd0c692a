"""A method's run over the test scenes: the camera it is told of, and its result, which is kept."""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import torch
from numpy.typing import NDArray

from learning.camera import CaptureModel, camera_identity, capture_model, measure_reference_white
from learning.classical.clips import ClipMethod
from learning.data import Example, ExampleSet, measured_psnr_db
from learning.evaluate.methods import Entry, LearnedEntry
from learning.evaluate.outcome import OWN
from learning.evaluate.scoring import Criteria, ScenesDone, checked, score
from learning.method import Method
from learning.models.repeated import RepeatedStill
from learning.provenance import sample_digests
from learning.timing import recorded_timing
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.cache import code_digest
from simulator.io.files import sha256_bytes, storage_errors, write_atomic
from simulator.io.json import canonical_json, plain
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack

# Of data rendered on two machines whites differ by 2e-4; a thousandth of white is an error of 60 dB.
_WHITES_ALIKE = 1e-3
_KEEP_EVERY_S = 30.0
# By these, and what they import, a measurement becomes a score.
_DECIDING = (
    "learning.classical.by_name",
    "learning.checkpoint",
    "learning.data",
    "learning.evaluate.methods",
    "learning.evaluate.scoring",
    "learning.models",
)


class Cameras:
    """Which camera each method is told of: the numbers of the one that saw the test scenes, the PSFs that it assumes.

    ``test`` is the camera of the test data set with its own PSFs, and the reference white that all methods share.
    """

    def __init__(
        self, test: Dataset, training: Path | None, entries: Sequence[Entry], folder: Callable[[str], Path] = Path
    ) -> None:
        """Find the white; ``training`` is the data set that methods were trained or tuned on, None where none needs it.

        ``folder`` makes a path of the name of a stack's folder.
        """
        self._training, self._folder = training, folder
        self._stacks: dict[str, PsfStack] = {}
        self._nominal: CaptureModel | None = None
        self._timing = recorded_timing(test)
        self.test = capture_model(test, white=self._white(entries))

    def assumed(self, entry: Entry, name: str) -> CaptureModel:
        """Return the camera that a method is told of, with PSFs ``own``, ``nominal``, ``captured``, or of a folder."""
        try:
            if (known := entry.capture) is None:
                known = self._nominal = self._nominal or capture_model(self._learned_from(), white=self.test.white)
            elif known.timing is None:  # a network for stills takes part in clips as if nothing moved, in their white
                known = replace(known, timing=self._timing, white=self.test.white)
            if name != OWN:
                self._stacks[name] = self._stacks.get(name) or self._stack(name)
                known = known.with_stack(self._stacks[name])
            return self.test.with_assumed(known)
        except InputError as error:
            raise InputError(entry.name, str(error)) from error

    def _learned_from(self) -> Dataset:
        assert self._training is not None  # the configuration sees to it
        return open_dataset(self._training, "train")

    def _stack(self, name: str) -> PsfStack:
        if name in ("nominal", "captured"):
            return capture_model(self._learned_from(), name).stack
        return read_psf_stack(self._folder(name))

    def _white(self, entries: Sequence[Entry]) -> float:
        networks = [entry for entry in entries if isinstance(entry, LearnedEntry)]
        networks += [entry.frames for entry in networks if entry.frames is not None]
        if not networks:
            return measure_reference_white(self._learned_from())
        # In clips, what is for stills takes theirs.
        learned = [each for each in networks if (each.capture.timing is None) == (self._timing is None)] or networks[:1]
        one, first = learned[0], learned[0].capture.white
        for other in learned[1:]:
            if abs((white := other.capture.white) - first) > _WHITES_ALIKE * first:
                found = f"{other.label} shows a radiance of {white:g} as white, {one.label} {first:g}"
                raise InputError("methods", f"{found}: one table needs one white; train them with the same")
        return first


CACHE = "cache"
"""Folder of kept results in that of an evaluation."""
FITS = "fits"
"""Folder, below that of the kept results, of the states of methods that are fitted to each capture, by what computes."""


class ResultCache:
    """Kept results below one folder, a file each, named by a hash of all that decides them; a damaged file counts as none."""

    def __init__(self, folder: Path) -> None:
        """Keep them here; the folder is made when there is something to keep."""
        self.folder = folder

    def load(self, key: Mapping[str, Any]) -> dict[str, Any] | None:
        """Return what was kept under a key, or None."""
        try:
            content = json.loads(self._path(key, ".json").read_bytes())
        except (OSError, ValueError):
            return None
        whole = isinstance(content, dict) and "result" in content and content.get("key") == plain(key)
        return content["result"] if whole else None

    def save(self, key: Mapping[str, Any], result: Mapping[str, Any]) -> None:
        """Keep a result, which may hold infinities; a StorageError says that it cannot be written."""
        self._write(self._path(key, ".json"), json.dumps({"key": plain(key), "result": result}).encode())

    def drop(self, key: Mapping[str, Any]) -> None:
        """Forget what was kept under a key, if anything was."""
        self._path(key, ".json").unlink(missing_ok=True)

    def load_arrays(self, key: Mapping[str, Any]) -> dict[str, NDArray[Any]] | None:
        """Return the arrays that were kept under a key, or None."""
        try:
            with np.load(self._path(key, ".npz"), allow_pickle=False) as kept:
                return dict(kept)
        except (OSError, ValueError, EOFError, BadZipFile):
            return None

    def save_arrays(self, key: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Keep arrays; a StorageError says that they cannot be written."""
        stream = io.BytesIO()
        np.savez(stream, allow_pickle=False, **arrays)
        self._write(self._path(key, ".npz"), stream.getvalue())

    def _write(self, path: Path, content: bytes) -> None:
        with storage_errors(path):
            self.folder.mkdir(parents=True, exist_ok=True)
        write_atomic(path, content)

    def _path(self, key: Mapping[str, Any], suffix: str) -> Path:
        return self.folder / (sha256_bytes(canonical_json(key))[:32] + suffix)


@dataclass(frozen=True)
class Run:
    """A method with one seed, with some PSFs (see `Cameras.assumed`), at one level of noise.

    Noise is drawn anew at ``noise_db``, None takes measurements as stored; ``scenes``: only the first so many, None for all.
    """

    entry: Entry
    stack: str = OWN
    noise_db: float | None = None
    scenes: int | None = None


class Runner:
    """Runs on one split of a data set.

    Attributes:
        stored_db: the PSNR of its measurements as stored, decibels: by it parameters are chosen that depend on noise.
        clips: whether its samples are clips.
    """

    def __init__(
        self,
        test: Dataset,
        cameras: Cameras,
        criteria: Criteria,
        cache: ResultCache,
        *,
        device: torch.device,
        batch: int,
        seed: int,
    ) -> None:
        """Look at the noise of a few samples; see `learning.config.EvaluateConfig` for the settings."""
        self.test, self.stored_db = test, measured_psnr_db(test)
        self.clips = cameras.test.timing is not None
        self.cameras, self.criteria, self._cache = cameras, criteria, cache
        self.device, self.batch, self._seed = device, batch, seed
        self._digests, self._code = sample_digests(test), code_digest(*_DECIDING)

    def level_db(self, run: Run) -> float:
        """Return the PSNR of the measurements that a run sees."""
        return self.stored_db if run.noise_db is None else run.noise_db

    def examples(self, noise_db: float | None, scenes: int | None = None) -> ExampleSet:
        """Return the scenes at a level of noise; all, or the first so many."""
        test = self.test if scenes is None else self.test[:scenes]
        return ExampleSet(test, noise_db=None if noise_db is None else (noise_db, noise_db), seed=self._seed)

    def camera(self, run: Run) -> CaptureModel:
        """Return the camera that a run's method is told of."""
        return self.cameras.assumed(run.entry, run.stack)

    def method(self, run: Run) -> Method:
        """Return a run's method, ready on the device; one that is fitted to each capture keeps its fits."""
        method = run.entry.build(self.camera(run), self.level_db(run), self.device)
        if isinstance(method, RepeatedStill) and isinstance(run.entry, LearnedEntry) and run.entry.frames is not None:
            frames = run.entry.frames
            method.frames = frames.build(self.cameras.assumed(frames, OWN), self.level_db(run), self.device)
        if isinstance(method, ClipMethod) and method.fitting is not None:
            method.fitting.states = self._cache.folder / FITS / sha256_bytes(canonical_json(self._computed_by))[:16]
        return method

    def result(self, run: Run, progress: ScenesDone = lambda _: None) -> dict[str, Any]:
        """Return what `score` finds, which is kept, also on the way."""
        key = self._key(run) | {"criteria": self.criteria.record()}
        part, saved = key | {"part": True}, time.monotonic()
        known = self._cache.load(key)
        if known is not None:
            progress(len(known["scores"]))
            return known
        examples = self.examples(run.noise_db, run.scenes)

        def keep(found: Mapping[str, Any]) -> None:
            nonlocal saved
            if time.monotonic() - saved >= _KEEP_EVERY_S:
                self._cache.save(part, found)
                saved = time.monotonic()

        how: Any = {"device": self.device, "batch": self.batch, "progress": progress, "keep": keep}
        found = score(self.method(run), examples, self.criteria, begun=self._cache.load(part), **how)
        self._cache.save(key, found)
        self._cache.drop(part)
        return found

    def estimates(self, run: Run, positions: Sequence[int]) -> list[dict[str, NDArray[np.float32]]]:
        """Return ``image`` (3, h, w) and ``depth_m`` (h, w) of some scenes, of clips with a leading N, which are kept."""
        method: Method | None = None
        examples, shown = self.examples(run.noise_db), []
        for position in positions:
            key = self._key(run) | {"scene": position}
            arrays = self._cache.load_arrays(key)
            if arrays is None:
                method = method or self.method(run)
                example = Example(*(values[None].to(self.device) for values in examples[position]))
                estimate = checked(method, method.reconstruct(example.measurement), examples, position)
                depth_m = estimate.depth_m(method.capture)
                arrays = {"image": estimate.image[0].cpu().numpy(), "depth_m": depth_m[0, ..., 0, :, :].cpu().numpy()}
                self._cache.save_arrays(key, arrays)
            shown.append(arrays)
        return shown

    def _key(self, run: Run) -> dict[str, Any]:
        """Return all that decides an estimate."""
        return {
            "method": run.entry.identity(self.level_db(run)),
            "camera": camera_identity(self.camera(run)),
            "data": {
                "fingerprint": self.test.fingerprint,
                "split": self.test.split,
                "samples": sha256_bytes(canonical_json(self._digests[: run.scenes])),
            },
            "noise": "stored" if run.noise_db is None else {"db": run.noise_db, "seed": self._seed},
            **self._computed_by,
        }

    @property
    def _computed_by(self) -> dict[str, Any]:
        return {"device": self.device.type, "torch": torch.__version__, "code": self._code}
