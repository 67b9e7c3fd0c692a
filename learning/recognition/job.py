"""`flatlight evaluate` of classifiers, all on the same captures, or the same clips through another camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from learning.camera import camera_identity
from learning.config import RecognitionConfig
from learning.data import ExampleSet, measured_psnr_db
from learning.evaluate.films import NamedFilm
from learning.evaluate.folder import claim_folder, is_claimed
from learning.evaluate.methods import training_of
from learning.evaluate.runs import CACHE, ResultCache
from learning.evaluate.scoring import Times, take_times
from learning.labels import class_numbers, spoken, spread_over_classes
from learning.method import Progress, Say, choose_device, describe_device, linear_to_srgb, torch_threads
from learning.models import ActivityMethod, ActivityNet, LensClassifier
from learning.provenance import clips_of
from learning.recognition.report import Recognition, write_recognition
from learning.recognition.scores import Predictions
from learning.recognition.trained import InitialEstimates, Trained, probabilities, read_backwards, read_classifier
from simulator.errors import InputError
from simulator.io.cache import code_digest
from simulator.io.files import sha256_bytes
from simulator.io.json import canonical_json

_LOOKS = {"all": "all frames", "shuffled": "shuffled frames", "middle": "the middle frame"}


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
    rows = [read_classifier(config, row) for row in config.classifiers]
    reference = next(row for row in rows if row[0].name == (config.reference or rows[0][0].name))
    for one in (row[0] for row in rows):
        if one.network.classes != reference[0].network.classes:
            wanted = f"expected those of {reference[0].name}: {', '.join(reference[0].network.classes)}"
            raise InputError(one.name, f"it has the classes {', '.join(one.network.classes)}, {wanted}")
    folder_back = config.data.backwards
    back = [] if folder_back is None else [read_backwards(config, one, folder_back) for one in reference]
    claim_folder(folder, config.name)
    trial = _Trial(config, ResultCache(folder / CACHE), device, progress)
    with torch_threads(config.threads):
        recognition = Recognition(
            config,
            [one for level in (None, *(config.noise_db or ())) for one in trial.predictions(rows, level)],
            trial.predictions([back], None)[0] if back else None,
            stored_db=measured_psnr_db(reference[0].test),
            fingerprint=reference[0].test.fingerprint,
            times=trial.times(reference[0], [row[0] for row in rows]),
            sheet=trial.sheet(reference[0]),
            device=describe_device(device),
        )
    say(f"{len(rows)} classifiers on {len(reference[0].test)} captures")
    return recognition, write_recognition(folder, recognition)


class _Trial:
    """What classifiers make of their captures; probabilities are kept in a cache."""

    def __init__(self, config: RecognitionConfig, cache: ResultCache, device: torch.device, progress: Progress) -> None:
        self.config, self.cache, self.device, self.progress = config, cache, device, progress

    def predictions(self, rows: Sequence[Sequence[Trained]], noise_db: float | None) -> list[Predictions]:
        """Return those of all rows at a level of noise, None as stored; at others a lens, which has none, is left out."""
        asked = [row for row in rows if noise_db is None or not isinstance(row[0].network, LensClassifier)]
        estimates = InitialEstimates(one for row in asked for one in row)
        return [self._of_row(row, noise_db, estimates) for row in asked]

    def _of_row(self, seeds: Sequence[Trained], noise_db: float | None, estimates: InitialEstimates) -> Predictions:
        config, first = self.config, seeds[0]
        found = []
        for number, one in enumerate(seeds):
            key = {
                "checkpoint": one.entry.digest,
                "camera": camera_identity(one.capture),
                "samples": one.samples,
                "noise": "stored" if noise_db is None else {"db": noise_db, "seed": config.seed},
                "device": self.device.type,
                "torch": torch.__version__,
                "code": code_digest("learning.recognition.trained"),
            }
            if (kept := self.cache.load_arrays(key)) is None:
                level = "" if noise_db is None else f" at {noise_db:g} dB"
                stage = f"{one.name}{level}{f', seed {number + 1}' if len(seeds) > 1 else ''}"
                chances = probabilities(
                    one,
                    estimates,
                    noise_db,
                    seed=config.seed,
                    batch=config.batch,
                    device=self.device,
                    progress=lambda done, total, stage=stage: self.progress(stage, done, total),
                )
                self.cache.save_arrays(key, kept := {"probabilities": chances})
            estimates.release(one)
            found.append(kept["probabilities"])
        return Predictions(
            first.name,
            first.network.classes,
            np.array(class_numbers(first.test, first.network.classes)),
            np.stack(found),
            noise_db=noise_db,
            clips=clips_of(first.test),
            slivers=first.slivers,
            kind=sha256_bytes(canonical_json([training_of(first.entry), first.test.fingerprint])),
            note=_in_words(first),
            checkpoints=[_about(one) for one in seeds],
            test_fingerprint=first.test.fingerprint,
            bootstrap_seed=config.seed,
        )

    def times(self, reference: Trained, others: Sequence[Trained]) -> list[Times]:
        """Return the seconds of those that invert captures, on the captures of the reference."""
        count = self.config.timed
        methods = [
            ActivityMethod(one.name, one.network, one.capture).to(self.device)
            for one in others
            if isinstance(one.network, ActivityNet) and one.samples == reference.samples
        ]
        if not methods or not count:
            return []
        examples = ExampleSet(reference.test)
        captures = torch.stack([examples[at].measurement for at in range(min(count, len(examples)))])
        return take_times(methods, captures.to(self.device), count, lambda *done: self.progress("time", *done))

    def sheet(self, one: Trained) -> list[list[NamedFilm]]:
        """Return, for some captures, the true frames, and what a network sees in each sliver and predicts."""
        if not isinstance(one.network, ActivityNet):
            return []
        method, examples = ActivityMethod(one.name, one.network, one.capture).to(self.device), ExampleSet(one.test)
        numbers, classes = class_numbers(one.test, one.network.classes), list(map(spoken, one.network.classes))
        sheet = []
        for at in spread_over_classes(numbers, self.config.shown):
            example = examples[at]
            frames = linear_to_srgb(example.radiance, one.capture.white)
            estimate, chances = method.recognise(example.measurement[None].to(self.device))
            best = chances[0].cpu().topk(2)
            words = ", ".join(f"{classes[int(k)]} {float(p):.0%}" for p, k in zip(*best, strict=True) if p >= 0.005)
            seen = estimate.clamped().image[0]
            truth, seen = (each.permute(0, 2, 3, 1).cpu().numpy() for each in (frames, seen))
            sheet.append([NamedFilm(classes[numbers[at]], truth), NamedFilm(words, seen)])
        return sheet


def _in_words(one: Trained) -> str:
    """Return what a reader should know of a classifier."""
    architecture, steps = one.entry.architecture, dict(one.entry.record.get("config") or {}).get("steps")
    parameters = sum(parameter.numel() for parameter in one.network.parameters()) / 1e6
    words = [architecture["network"], _LOOKS.get(architecture.get("frames", "")), architecture["classifier"]]
    words += [f"{parameters:.2f} million parameters", f"{steps} steps" if steps else None]
    return ", ".join(filter(None, [*words, f"tested on {one.test.root.name}"]))


def _about(one: Trained) -> dict[str, Any]:
    """Return what the results say of a checkpoint."""
    record, entry = one.entry.record, one.entry
    config, data_sets = (dict(record.get(key) or {}) for key in ("config", "data sets"))
    return {
        "file": str(entry.path),
        "sha256": entry.digest,
        **{key: config.get(key) for key in ("seed", "steps")},
        "step": record.get("step"),
        "trained_on": data_sets.get("train"),
    }
