"""A method's run over the test scenes: built, scored, or taken from what an earlier evaluation kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from learning.capture import CaptureModel
from learning.code_fingerprint import code_fingerprint
from learning.data import Example, ExampleSet
from learning.evaluation.cache import ResultCache
from learning.evaluation.cameras import Cameras, camera_identity
from learning.evaluation.outcome import OWN
from learning.evaluation.roster import Entry
from learning.evaluation.scoring import Criteria, Progress, checked, score
from learning.method import Method
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json

_PILOTS, _NOISELESS_DB = 16, 120.0
# By these, and what they import, a measurement becomes a score.
_DECIDING = (
    "learning.baselines.method",
    "learning.checkpoint",
    "learning.data",
    "learning.evaluation.scoring",
    "learning.models.method",
)


@dataclass(frozen=True)
class Run:
    """A method with one seed, with some PSFs, at one level of noise.

    Attributes:
        entry: the method.
        stack: the name of its PSFs; see `Cameras.believed`.
        noise_db: level at which noise is drawn anew; None for measurements as stored.
        scenes: only the first so many; None for all.
    """

    entry: Entry
    stack: str = OWN
    noise_db: float | None = None
    scenes: int | None = None


class Runner:
    """Runs on one split of a data set.

    Attributes:
        test: the split.
        stored_db: the PSNR of its measurements as stored, decibels: by it parameters are chosen that depend on noise.
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
        """Look at the noise of a few samples; see `learning.config.evaluate` for the settings."""
        self.test, self.stored_db = test, measured_psnr_db(test)
        self._cameras, self._criteria, self._cache = cameras, criteria, cache
        self._device, self._batch, self._seed = device, batch, seed
        kept = load_manifest(test.root).entries
        self._digests = [kept[test.split, sample].digest for sample in test.ids]

    def level_db(self, run: Run) -> float:
        """Return the PSNR of the measurements that a run sees."""
        return self.stored_db if run.noise_db is None else run.noise_db

    def examples(self, noise_db: float | None, scenes: int | None = None) -> ExampleSet:
        """Return the scenes at a level of noise; all, or the first so many."""
        test = self.test if scenes is None else self.test[:scenes]
        return ExampleSet(test, noise_db=None if noise_db is None else (noise_db, noise_db), seed=self._seed)

    @property
    def white(self) -> float:
        """The radiance that all pictures show as 1."""
        return self._cameras.test.white

    def camera(self, run: Run) -> CaptureModel:
        """Return the camera that a run's method is told of."""
        return self._cameras.believed(run.entry, run.stack)

    def method(self, run: Run) -> Method:
        """Return a run's method, ready on the device.

        Raises:
            InputError: PSFs or checkpoints of another camera.
        """
        return run.entry.build(self.camera(run), self.level_db(run), self._device)

    def result(self, run: Run, progress: Progress = lambda _: None) -> dict[str, Any]:
        """Return what `score` finds, which is kept.

        Raises:
            InputError: see `method` and `score`.
            StorageError: the result cannot be kept.
        """
        criteria = {
            "edges_cm": self._criteria.edges_cm,
            "dark_share": self._criteria.dark_share,
            "lpips": self._criteria.lpips and self._criteria.lpips.record(),
        }
        key = self._key(run) | {"criteria": criteria}
        known = self._cache.load(key)
        if known is not None:
            progress(len(known["scores"]))
            return known
        examples = self.examples(run.noise_db, run.scenes)
        found = score(
            self.method(run), examples, self._criteria, device=self._device, batch=self._batch, progress=progress
        )
        self._cache.save(key, found)
        return found

    def estimates(self, run: Run, positions: Sequence[int]) -> list[dict[str, NDArray[np.float32]]]:
        """Return ``picture`` (3, h, w) and ``depth_m`` (h, w) of some scenes, which are kept.

        Raises:
            InputError: see `method` and `score`.
            StorageError: the result cannot be kept.
        """
        method: Method | None = None
        examples, shown = self.examples(run.noise_db), []
        for position in positions:
            key = self._key(run) | {"scene": position}
            arrays = self._cache.load_arrays(key)
            if arrays is None:
                method = method or self.method(run)
                example = Example(*(values[None].to(self._device) for values in examples[position]))
                estimate = checked(method, method.reconstruct(example.measurement), examples, position)
                depth_m = estimate.depth_m(method.capture)
                arrays = {"picture": estimate.picture[0].cpu().numpy(), "depth_m": depth_m[0, 0].cpu().numpy()}
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
            "device": self._device.type,
            "torch": torch.__version__,
            "code": code_fingerprint(*_DECIDING),
        }


def measured_psnr_db(dataset: Dataset) -> float:
    """Return the PSNR of a data set's measurements: the peak of each noiseless one, the mean over its first 16 samples.

    Of measurements without noise it is 120 dB.
    """
    levels = []
    for position in range(min(len(dataset), _PILOTS)):
        measurement, noiseless = dataset.stored(position).measurement()
        error = float(np.sqrt(np.mean((measurement - noiseless).astype(np.float64) ** 2)))
        levels.append(20 * np.log10(float(noiseless.max()) / error) if error > 0 else _NOISELESS_DB)
    return float(min(np.mean(levels), _NOISELESS_DB))
