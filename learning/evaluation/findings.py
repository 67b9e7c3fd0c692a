"""All that an evaluation found, and under which conditions."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np

from learning.capture import CaptureModel
from learning.config.evaluate import EvaluateConfig
from learning.evaluation.montage import Shown
from learning.evaluation.outcome import Outcome
from learning.evaluation.timing import Times
from learning.metrics import DEFINITIONS
from simulator import __version__
from simulator.dataset.reader import Dataset

_PACKAGES = ("torch", "numpy", "scikit-image", "flip-evaluator", "lpips", "ortools")


@dataclass(frozen=True, eq=False)
class Findings:
    """What came out.

    Attributes:
        config: the file.
        test: the split that decided.
        camera: what the first method was told of the camera.
        stored_db: PSNR of the measurements as stored.
        edges_cm: of the bins of depth.
        perceptual: which perceptual metric was measured, or why none.
        device: in words.
        methods: what is known of each method and seed.
        outcomes: of all methods, PSFs and levels.
        trivial: of the answers that look at nothing.
        trivial_part: of the same answers, on the scenes of the noise levels and of the PSFs that are compared.
        times: seconds per scene; empty where none were taken.
        montage: for each scene shown the truth and every method, in the order of ``columns``.
        columns: of the montage.
    """

    config: EvaluateConfig
    test: Dataset
    camera: CaptureModel
    stored_db: float
    edges_cm: tuple[float, ...]
    perceptual: str
    device: str
    methods: Sequence[Mapping[str, Any]]
    outcomes: Sequence[Outcome]
    trivial: Sequence[Outcome]
    trivial_part: Sequence[Outcome]
    times: Sequence[Times]
    montage: Sequence[Sequence[Shown]]
    columns: Sequence[str]

    @property
    def part(self) -> int:
        """How many scenes the noise levels and the comparison of PSFs have."""
        return min(self.config.ablation_scenes or len(self.test), len(self.test))

    @property
    def main(self) -> list[Outcome]:
        """The rows of the table: every method with its usual PSFs, on the measurements as stored."""
        usual, whole = self.config.data.stack, len(self.test)
        return [one for one in self.outcomes if (one.stack, one.noise_db, one.scenes) == (usual, None, whole)]

    @property
    def ablation(self) -> list[Outcome]:
        """Every method with its usual PSFs at the further levels of noise."""
        return [one for one in self.outcomes if one.stack == self.config.data.stack and one.noise_db is not None]

    @property
    def compared(self) -> list[Outcome]:
        """Every method with each of the PSFs that are compared, on the measurements as stored."""
        named = self.config.data.compare_stacks
        stored = [one for one in self.outcomes if one.noise_db is None and one.scenes == self.part]
        return [one for one in stored if one.stack in named]

    @property
    def constant_cm(self) -> float | None:
        """Pooled depth RMSE of the best constant depth."""
        return next((one.pooled_depth_rmse_cm for one in self.trivial if one.pooled_depth_rmse_cm is not None), None)

    @property
    def method_names(self) -> list[str]:
        """All methods in their order."""
        return [method.name for method in self.config.methods]

    def plain(self) -> dict[str, Any]:
        """Return all of it but the pictures, for JSON."""
        info = self.test.info
        return {
            "name": self.config.name,
            "config": self.config.dump(),
            "data": {
                "fingerprint": self.test.fingerprint,
                "split": self.test.split,
                "scenes": len(self.test),
                "psf": info.config["psf"],
                "stored_psnr_db": self.stored_db,
            },
            "white": self.camera.white,
            "depth_range_m": [self.camera.near_m, self.camera.far_m],
            "depth_bins_cm": list(self.edges_cm),
            "perceptual": self.perceptual,
            "definitions": DEFINITIONS,
            "device": self.device,
            "versions": versions(),
            "methods": list(self.methods),
            "outcomes": [one.plain() for one in self.outcomes],
            "trivial": [one.plain() for one in self.trivial],
            "times": [one.plain() for one in self.times],
        }


def default_edges_cm(camera: CaptureModel, bins: int) -> tuple[float, ...]:
    """Return edges from the nearest to the farthest depth, even in disparity: what a mask resolves."""
    edges_m = camera.depth_m(np.linspace(1, 0, bins + 1))
    return tuple((100 * edges_m).tolist())


def versions() -> dict[str, str]:
    """Return the versions of what took part."""
    found = {"flatlight": __version__, "python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found
