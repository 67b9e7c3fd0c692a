"""ActivityNet: what is done in a clip, from one capture of a rolling shutter; and what it is measured against.

The thesis, section 4.3: a `ClipNetwork`, MeasNet and a learned inversion, gives estimates of every frame, and a classifier
says what is done in them. The same classifier may look at the frames of a camera with a lens, which is the ceiling, at one of
them, which shows what appearance alone tells, at all of them in random order, which shows what motion adds, or at the capture
itself.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Literal, NamedTuple, get_args

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.classifiers import FrameClassifier
from learning.layers.padding import axis_plans, check_measurement
from learning.method import Clock, Estimate, check_choices, inference, linear_to_srgb
from learning.models.clip_network import (
    FAINTEST,
    ClipNetwork,
    ClipNetworkMethod,
    InvertedClip,
    Start,
    check_clips,
    copy_weights,
)
from learning.perceptual import IMAGENET_MEAN, IMAGENET_SPREAD
from simulator.errors import InputError

Frames = Literal["all", "shuffled", "middle"]
FRAMES: tuple[Frames, ...] = get_args(Frames)
_MOVED = 8  # in training, frames are moved by up to this part of their size to each side
_COMMON = ("inversion.", "measnet.", "wiener.")  # names of the weights that networks for clips have in common


class ClassifierOutput(NamedTuple):
    """What a classifier says of clips.

    Attributes:
        logits: ``(B, classes)``, of which the softmax are probabilities.
        measured: see `learning.models.clip_network.InvertedClip`; empty without MeasNet.
    """

    logits: Tensor
    measured: Tensor


class ActivityNet(ClipNetwork):
    """What is done in captures. In training it looks at the frames through a window that is moved by some pixels.

    Attributes:
        classes: the names of what it tells apart.
    """

    def __init__(
        self,
        capture: CaptureModel,
        *,
        classes: Sequence[str],
        classifier: str,
        initial_estimate: Start,
        measnet: bool,
        dimensions: Literal[2, 3],
        body: Literal["naf", "unet"],
        filters: int,
        blocks: int,
        levels: int,
        stem: int,
        noise_aware: bool,
        joint_iterations: int,
        joint_noise: float,
        joint_correlation: float,
    ) -> None:
        """Build the network for a camera.

        Args:
            capture: the camera, with its timing and the PSFs of one plane.
            classes: the names of what it tells apart.
            classifier: see `learning.layers.classifiers.CLASSIFIERS`.
            initial_estimate: what MeasNet, or the classifier, begins with.
            measnet: complete the capture to a global measurement of each frame, and invert these, too.
            dimensions: of MeasNet, 2: frames are channels; 3: a stack.
            body: of MeasNet: NAF blocks, or the thesis's U-Net.
            filters: of MeasNet's first level.
            blocks: of NAF blocks on each level and way.
            levels: how many.
            stem: pixels per side that MeasNet takes as one; in 2D.
            noise_aware: lambda adapts to the noise level, which is an input, too.
            joint_iterations: of the joint least squares.
            joint_noise: their noise.
            joint_correlation: of their colours.
        """
        super().__init__(
            capture,
            initial_estimate=initial_estimate,
            measnet=measnet,
            dimensions=dimensions,
            body=body,
            filters=filters,
            blocks=blocks,
            levels=levels,
            stem=stem,
            noise_aware=noise_aware,
            joint_iterations=joint_iterations,
            joint_noise=joint_noise,
            joint_correlation=joint_correlation,
        )
        self.classes = tuple(classes)
        shared = 3 + noise_aware
        self.classifier = FrameClassifier(classifier, self.frames, 3 * self.estimates, shared, len(self.classes))

    def forward(self, measurement: Tensor, start: Tensor | None = None) -> ClassifierOutput:
        """Classify measurements ``(B, C, H, W)``, DN / 2^bits; ``start`` is their `initial_estimate`, where known."""
        return self.classify(self.invert(measurement, start))

    def classify(self, inverted: InvertedClip) -> ClassifierOutput:
        """Classify captures of which so much is known."""
        frames = self.codes(inverted.frames.unflatten(2, (self.estimates, -1))).clamp(0, 1).flatten(2, 3)
        channels = self.shared - self.noise_aware
        static = self.codes(inverted.shared[:, :channels]).clamp(0, 1)
        shared = torch.cat([static, inverted.shared[:, channels:]], dim=1)
        both = (frames[self.image], shared[self.image])
        if self.training:
            both = moved_windows(frames, shared, both[0].shape[-2:])
        return ClassifierOutput(self.classifier(*both), inverted.measured)

    def frame_estimates(self, inverted: InvertedClip) -> Tensor:
        """Return the best estimates of the frames, ``(B, N, 3, h, w)`` sRGB codes, not clipped."""
        return self.codes(inverted.best)[self.image]

    def inputs(self, measurement: Tensor, start: Tensor | None, radiance: Tensor) -> tuple[Tensor | None, ...]:
        """Return the arguments of `forward`, of a capture, its `initial_estimate` and its true frames' linear radiance."""
        return measurement, start

    def take(self, known: nn.Module, source: str) -> list[str]:
        """Put what another network for clips has in common with this one into it, and say what was taken.

        Of an ActivityNet that is everything, of one for other classes all but its last layer, of a VideoNet the inversions
        and MeasNet.

        Raises:
            InputError: weights of other shapes, or another kind of network, naming the ``source``; the network stays as it
                was.
        """
        if not isinstance(known, ClipNetwork):
            raise InputError(source, f"got a {type(known).__name__}, expected a VideoNet or an ActivityNet")
        own, found = self.state_dict(), known.state_dict()
        if not isinstance(known, ActivityNet):
            found = {name: value for name, value in found.items() if name.startswith(_COMMON)}
            if self.measnet is not None and known.measnet is None:
                raise InputError(
                    source, "it has no MeasNet; take a VideoNet with measnet: true, or measnet: false here"
                )
            found = {name: value for name, value in found.items() if name in own}
        elif known.classes != self.classes:
            last = {f"classifier.{name}" for name in known.classifier.last_layer}
            found = {name: value for name, value in found.items() if name not in last}
        return copy_weights(self, found, source, "take a checkpoint of the same size and classifier")


class RawClassifier(nn.Module):
    """What is done in captures, without any inversion: the classifier looks at the capture, in units of its mean light.

    Each pixel is scaled to a mean of 0 and a variance of 1 over a batch: captures differ so little that without this,
    training stays at chance.
    """

    offset: Tensor

    def __init__(self, capture: CaptureModel, *, classes: Sequence[str], classifier: str) -> None:
        """Build it for the camera of clips; see `ActivityNet`."""
        super().__init__()
        check_clips(capture, type(self).__name__)
        self.classes = tuple(classes)
        self.rows, self.columns = axis_plans(capture)
        offset = torch.from_numpy(capture.offset)[:, None, None].to(torch.get_default_dtype())
        self.register_buffer("offset", offset, persistent=False)
        self.scaling = nn.BatchNorm1d(len(capture.offset) * math.prod(capture.sensor_shape), affine=False)
        self.classifier = FrameClassifier(classifier, 1, len(capture.offset), 0, len(self.classes))

    def forward(self, measurement: Tensor) -> ClassifierOutput:
        """Classify measurements ``(B, C, H, W)``, DN / 2^bits."""
        check_measurement(measurement, self.offset, self.rows, self.columns)
        light = measurement - self.offset
        light = light / light.mean(dim=(1, 2, 3), keepdim=True).clamp_min(FAINTEST)
        light = self.scaling(light.flatten(1)).reshape(light.shape)
        return ClassifierOutput(self.classifier(light[:, None], light[:, :0]), light.new_zeros(0))

    def inputs(self, measurement: Tensor, start: Tensor | None, radiance: Tensor) -> tuple[Tensor | None, ...]:
        """Return the arguments of `forward`; see `ActivityNet.inputs`."""
        return (measurement,)


class LensClassifier(nn.Module):
    """What is done in the frames of a camera with a lens, of the same field of view: noise-free, one for each sliver."""

    def __init__(self, capture: CaptureModel, *, classes: Sequence[str], classifier: str, frames: Frames) -> None:
        """Build it for the clips of a camera; see `ActivityNet`.

        ``frames``: ``all`` in their order; ``shuffled``, all in an order that is drawn for each clip; ``middle``, only one.
        """
        super().__init__()
        check_clips(capture, type(self).__name__)
        check_choices(("frames", frames, FRAMES))
        self.classes, self.frames, self.white = tuple(classes), frames, capture.white
        count = 1 if frames == "middle" else capture.frames
        self.classifier = FrameClassifier(classifier, count, 3, 0, len(self.classes))

    def forward(self, radiance: Tensor) -> ClassifierOutput:
        """Classify frames ``(B, N, 3, h, w)``, linear radiance."""
        if self.frames == "middle":
            middle = radiance.shape[1] // 2
            radiance = radiance[:, middle : middle + 1]
        elif self.frames == "shuffled":
            radiance = torch.stack([clip[self._order(clip)] for clip in radiance])
        frames = linear_to_srgb(radiance, self.white)
        nothing = frames[:, 0, :0]
        if self.training:
            frames, nothing = moved_windows(frames, nothing, frames.shape[-2:])
        return ClassifierOutput(self.classifier(frames, nothing), frames.new_zeros(0))

    def take_pretrained(self, path: Path) -> list[str]:
        """Begin with torchvision's weights of ResNet-18, and say what was taken: all but those of the classes.

        The first convolution, of one image, sees the mean of the frames, scaled like ImageNet's images. Its weights of what
        each frame differs from that begin at zero: equal ones would cancel, as the differences do.

        Raises:
            InputError: not such a file, or another classifier than ``resnet18``; the network stays as it was.
        """
        cure = "give torchvision's resnet18-f37072fd.pth, and take classifier: resnet18"
        try:
            weights: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
            found = {f"classifier.body.{key}": value for key, value in weights.items() if not key.startswith("fc.")}
            first = found[name := "classifier.body.conv1.weight"]
            known = self.state_dict()
            changes = known[name].shape[1] - first.shape[1]
            found[name] = torch.cat([first.new_zeros(len(first), changes, *first.shape[2:]), first], dim=1)
        except (OSError, EOFError, RuntimeError, UnpicklingError, AttributeError, KeyError, TypeError) as error:
            raise InputError(path, f"not the weights of a ResNet-18; {cure}") from error
        variance = tuple(spread**2 for spread in IMAGENET_SPREAD)
        for statistic, of_images in (("running_mean", IMAGENET_MEAN), ("running_var", variance)):
            place = f"classifier.scaling.{statistic}"
            found[place] = torch.cat([known[place][:-3], torch.tensor(of_images)])
        return copy_weights(self, found, str(path), cure)

    def _order(self, clip: Tensor) -> Tensor:
        """Return an order of a clip's frames: another one each time in training, else drawn by its content."""
        generator = None
        if not self.training:
            generator = torch.Generator().manual_seed(zlib.crc32(clip.detach().cpu().float().numpy().tobytes()))
        return torch.randperm(len(clip), generator=generator)

    def inputs(self, measurement: Tensor, start: Tensor | None, radiance: Tensor) -> tuple[Tensor | None, ...]:
        """Return the arguments of `forward`; see `ActivityNet.inputs`."""
        return (radiance,)


def moved_windows(frames: Tensor, shared: Tensor, size: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return windows of a size that are moved by up to an eighth of it to each side, each clip's by its own number of pixels.

    Args:
        frames: ``(B, N, c, H, W)``, of this size or larger; where they end, their last pixels go on.
        shared: what all frames share, ``(B, c, H, W)``.
        size: h, w.
    """
    rows, columns = size
    moved = [rows // _MOVED, columns // _MOVED]
    images = torch.cat([frames.flatten(1, 2), shared], dim=1)
    below, beside = (
        (part + 2 * most - whole) // 2 for part, most, whole in zip(size, moved, images.shape[-2:], strict=True)
    )
    images = nnf.pad(images, (beside, beside, below, below), mode="replicate")
    places = zip(*(torch.randint(2 * most + 1, (len(images),)).tolist() for most in moved), strict=True)
    seen = [clip[:, top : top + rows, left : left + columns] for clip, (top, left) in zip(images, places, strict=True)]
    own, alike = torch.stack(seen).split([images.shape[1] - shared.shape[1], shared.shape[1]], dim=1)
    return own.unflatten(1, frames.shape[1:3]), alike


Classifier = ActivityNet | RawClassifier | LensClassifier
"""Each has ``classes``, and ``inputs``, which says what of a clip it is given."""

ACTIVITY_SIZES: dict[str, dict[str, Any]] = {
    "thesis": {
        **{"classifier": "dronet", "initial_estimate": "slivers", "measnet": True, "dimensions": 2, "body": "unet"},
        **{"filters": 32, "blocks": 1, "levels": 3, "stem": 1, "noise_aware": False},
        **{"joint_iterations": 10, "joint_noise": 1.0, "joint_correlation": 0.0},
    },
    "compact": {
        **{"classifier": "dronet", "initial_estimate": "joint", "measnet": False, "dimensions": 2, "body": "naf"},
        **{"filters": 32, "blocks": 1, "levels": 4, "stem": 2, "noise_aware": True},
        **{"joint_iterations": 40, "joint_noise": 3.0, "joint_correlation": 0.9},
    },
    "tiny": {
        **{"classifier": "dronet", "initial_estimate": "joint", "measnet": True, "dimensions": 2, "body": "naf"},
        **{"filters": 8, "blocks": 1, "levels": 2, "stem": 2, "noise_aware": True},
        **{"joint_iterations": 10, "joint_noise": 1.0, "joint_correlation": 0.0},
    },
}
"""``thesis``: MeasNet and its inversion from zero-filled slivers, blind to the noise; see `VIDEO_SIZES`. ``compact``: joint
least squares, with more iterations and noise than VideoNet's, which corrects them, correlated channels, and the static
inversion."""


class ActivityMethod(ClipNetworkMethod[ActivityNet]):
    """An ActivityNet as a method: the estimates of the frames that it looks at, and what it says is done in them."""

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimated frames of measurements ``(B, C, H, W)``; stages ``joint`` where it begins so, ``network``."""
        return self.recognise(measurement, clock)[0]

    def recognise(self, measurement: Tensor, clock: Clock | None = None) -> tuple[Estimate, Tensor]:
        """Return the same, and the probabilities ``(B, classes)`` of the network's classes."""
        clock = clock or Clock(measurement.device)
        with inference(self.network):
            start = self.initial_estimate(measurement, clock)
            with clock.stage("network"):
                inverted = self.network.invert(measurement, start)
                chances = self.network.classify(inverted).logits.softmax(dim=1)
                image = self.network.frame_estimates(inverted)
        return Estimate(image, torch.zeros_like(image[:, :, :1])), chances
