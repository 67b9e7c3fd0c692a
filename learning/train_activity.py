"""Training a network that recognises what is done in a clip: the usual loop with labels in place of images."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.checkpoint import load_checkpoint
from learning.clip_examples import ClipExample, ClipExamples, open_clip_examples
from learning.config import ActivityLossConfig, ActivityNetworkConfig, ActivityTrainConfig
from learning.data import Loader
from learning.evaluate.films import NamedFilm, film_sheet
from learning.labels import check_forwards, class_names, class_numbers, spoken, spread_over_classes
from learning.method import Progress, Say, inference, linear_to_srgb
from learning.models.activitynet import ACTIVITY_SIZES, ActivityNet, Classifier, ClassifierOutput, LensClassifier
from learning.timing import recorded_timing
from learning.train import origin
from learning.train_clips import ClipTraining
from learning.training_loop import TrainResult, find_cache, run
from learning.validation import to_device
from simulator.dataset.reader import Dataset
from simulator.errors import InputError

_SIDED = re.compile(r"(?<![a-z])((left|right|up|down)(wards?)?|(anti|counter)?clockwise)(?![a-z])", re.IGNORECASE)
_OF_MEASNET = ("dimensions", "body", "filters", "blocks", "levels", "stem")
_OF_JOINT = ("joint_iterations", "joint_noise", "joint_correlation")


def train_activity(
    config: ActivityTrainConfig, *, progress: Progress = lambda *_: None, say: Say = lambda _: None
) -> TrainResult:
    """Train a classifier of clips, or go on with a training that was interrupted; see `learning.training_loop.run`."""
    return run(ActivityTraining, config, progress, say)


class ActivityLoss(nn.Module):
    """Weighted sum of its terms; thesis equations 4.7 and 4.8.

    - ``classes``: cross entropy of the classes;
    - ``measurement``: mean squared error of MeasNet's global measurements, DN / 2^bits; absent without MeasNet.
    """

    def __init__(self, settings: ActivityLossConfig) -> None:
        super().__init__()
        self.settings = settings

    def forward(self, output: ClassifierOutput, label: Tensor, measured: Tensor) -> dict[str, Tensor]:
        """Return scalars: ``total``, each term under its name, and each weighted as ``classes_weighted`` and so on.

        ``label`` ``(B,)`` are the numbers of the classes, ``measured`` ``(B, N, C, H, W)`` the true global measurements less
        the offset, empty where the network has no MeasNet.
        """
        terms = {"classes": nn.functional.cross_entropy(output.logits, label)}
        weights = {"classes": self.settings.class_weight, "measurement": self.settings.measurement_weight}
        if output.measured.numel():
            terms["measurement"] = (output.measured - measured).square().mean()
        weighted = {f"{name}_weighted": weights[name] * value for name, value in terms.items()}
        return {"total": torch.stack(list(weighted.values())).sum(), **terms, **weighted}

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint says of this loss."""
        return self.settings.model_dump()


class ActivityTraining(ClipTraining):
    """From captures, or the frames of a lens, to classes."""

    _config: ActivityTrainConfig
    _network: Classifier

    @classmethod
    def _build_loss(cls, config: ActivityTrainConfig, capture: CaptureModel) -> ActivityLoss:
        return ActivityLoss(config.loss)

    @classmethod
    def _architecture_from_data(
        cls, config: ActivityTrainConfig, train: Dataset, validation: Dataset
    ) -> dict[str, Any]:
        if isinstance(config.network, ActivityNetworkConfig):
            _check_used(config.network)
        classes = class_names(train)
        class_numbers(validation, classes)  # refuses a class that is not learned
        for dataset in (train, validation):
            if recorded_timing(dataset) is None:
                raise InputError(dataset.root, "holds stills, in which nothing is done; take clips (scene.frames)")
            check_forwards(dataset)
        sided = [name for name in classes if _SIDED.search(name)]
        if sided and config.data.augment is not None and config.data.augment.flip:
            got = (
                f"got true, but {sided[0]} flipped, left to right and top to bottom, is another class; set flip: false"
            )
            raise InputError("data.augment.flip", got)
        return {"classes": list(classes)}

    @classmethod
    def _init_path(cls, config: ActivityTrainConfig) -> Path:
        if config.network.name != "lens_classifier":
            return super()._init_path(config)
        path = config.resolve_path(str(config.init_from))
        if not path.is_file():
            raise InputError("init_from", f"no such file: {path}; expected torchvision's resnet18-f37072fd.pth")
        return path

    @classmethod
    def _take(cls, config: ActivityTrainConfig, network: Any, path: Path) -> tuple[dict[str, Any], list[str]]:
        if isinstance(network, LensClassifier):
            return {"architecture": "torchvision's ResNet-18"}, network.take_pretrained(path)
        known = load_checkpoint(path)
        return origin(known), network.take(known.network, str(path))

    def _open(self, dataset: Dataset) -> ClipExamples:
        config, network = self._config, self._plan.network
        numbers = class_numbers(dataset, self._network.classes)
        if config.data.shuffle_labels and dataset.split == "train":
            numbers = np.random.default_rng(config.seed).permutation(numbers).tolist()
        of_clips = isinstance(network, ActivityNet)
        return open_clip_examples(
            dataset,
            config,
            self._capture,
            joint=network.joint if of_clips else None,
            measured=of_clips and network.measnet is not None,
            cache=find_cache(dataset, config, self._say),
            on_gpu=self._group.on_cuda,
            labels=numbers,
        )

    def _schedule(self) -> None:
        super()._schedule()
        # Dropout and the places of windows follow from the seed and the step, so that a resumed training sees the same.
        key = (self.progress.step, self._group.rank)
        torch.manual_seed(int(np.random.SeedSequence(self._config.seed, spawn_key=key).generate_state(1)[0]))

    def _shown(self, count: int) -> list[int]:
        return spread_over_classes(self._held_out.labels or [], count)

    def _classified(self, network: nn.Module, example: ClipExample) -> ClassifierOutput:
        with self._plan.precision.autocast():
            output = network(*self._network.inputs(example.measurement, _start(example), example.radiance))
        return ClassifierOutput(output.logits.float(), output.measured.float())

    def _losses(self, output: ClassifierOutput, example: ClipExample) -> dict[str, Tensor]:
        measured = example.measured  # as if all rows had the same exposure, like MeasNet's
        if measured.numel() and isinstance(self._network, ActivityNet):
            measured = self._network.inversion.light(measured)
        return self._loss(output, example.label, measured)

    def _terms(self, wrapped: nn.Module, example: ClipExample) -> dict[str, Tensor]:
        return self._losses(self._classified(wrapped, example), example)

    def _metrics(self, batches: Loader[ClipExample]) -> dict[str, float]:
        """Return means over the validation clips: the loss's terms, ``top_1``, ``top_2``; ``temperature``, and ``score``.

        The network is left with the temperature that these clips call for. The score is minus the cross entropy at this one,
        which tells steps apart that are right as often: surer is not better. The loss is at a temperature of 1.
        """
        sums: dict[str, float] = {}
        clips = 0
        seen: list[tuple[Tensor, Tensor]] = []
        classifier = self._network.classifier
        classifier.temperature.fill_(1)
        with inference(self._network):
            for batch in batches:
                example = to_device(batch, self._group.device)
                output = self._classified(self._network, example)
                count = len(example.label)
                truth = example.label[:, None]
                guesses = output.logits.topk(2, dim=1).indices == truth
                values = {name: value * count for name, value in self._losses(output, example).items()}
                values |= {"top_1": guesses[:, 0].sum(), "top_2": guesses.sum()}
                for name, value in values.items():
                    sums[name] = sums.get(name, 0.0) + float(value)
                clips += count
                seen.append((output.logits.cpu(), example.label.cpu()))
        together = torch.tensor([*sums.values(), clips], dtype=torch.float64, device=self._group.device)
        *totals, of = self._group.add(together).tolist()
        every = itertools.chain.from_iterable(self._group.gather(seen))
        logits, labels = map(torch.cat, zip(*every, strict=True))
        classifier.calibrate(logits, labels)
        temperature = float(classifier.temperature)
        score = -float(nn.functional.cross_entropy(logits.double() / temperature, labels))
        means = {name: total / of for name, total in zip(sums, totals, strict=True)}
        return means | {"temperature": temperature, "score": score}

    def _drawn(self, example: ClipExample) -> NDArray[np.uint8]:
        """Return an image: of each clip its true frames and, if it looks at estimates, these, beside what it says of them."""
        with inference(self._network):
            estimated = None
            if isinstance(self._network, ActivityNet):
                with self._plan.precision.autocast():
                    inverted = self._network.invert(example.measurement, _start(example))
                    estimated, output = self._network.frame_estimates(inverted), self._network.classify(inverted)
            else:
                output = self._classified(self._network, example)
            chances = output.logits.float().softmax(dim=1).cpu()
        truth = linear_to_srgb(example.radiance, self._capture.white)
        clips, classes = [], list(map(spoken, self._network.classes))
        for at, (frames, label) in enumerate(zip(truth, example.label.tolist(), strict=True)):
            chance, guess = chances[at].max(dim=0)
            said = f"{classes[int(guess)]} {float(chance):.0%}"
            films = [NamedFilm(classes[label], _pixels(frames), "" if estimated is not None else said)]
            clips.append(films if estimated is None else [*films, NamedFilm("estimated", _pixels(estimated[at]), said)])
        return np.asarray(
            film_sheet(clips, self._config.name, "true frames and class; estimate of each sliver, and predicted class")
        )


def _start(example: ClipExample) -> Tensor | None:
    """Return the kept initial estimate, None where there is none."""
    return example.start if example.start.numel() else None


def _check_used(network: ActivityNetworkConfig) -> None:
    """Refuse numbers of what the network does not have."""
    numbers = ACTIVITY_SIZES[network.size] | network.changes
    absent = [] if numbers["measnet"] else [(key, "MeasNet", "measnet: true") for key in _OF_MEASNET]
    if numbers["initial_estimate"] != "joint":
        absent += [(key, "joint least squares", "initial_estimate: joint") for key in _OF_JOINT]
    for key, part, cure in absent:
        if key in network.changes:
            got = f"got {network.changes[key]}, but a network without {part} has none"
            raise InputError(f"network.{key}", f"{got}; set {cure}, or leave it out")


def _pixels(frames: Tensor) -> NDArray[np.float32]:
    """Return frames ``(N, 3, h, w)`` as ``(N, h, w, 3)``."""
    return frames.clamp(0, 1).permute(0, 2, 3, 1).cpu().numpy()
