"""Classifiers of clips: what is done in a stack of frames, beside pictures that all frames share.

2D classifiers take the frames as channels of one image, 3D ones as a stack.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from learning.layers.convolution import Conv3d
from learning.method import check_choices

_DROPOUT = 0.5
_TEMPERATURES = (0.1, 10.0)
_X3D_WIDENING = 2.25


class FrameClassifier(nn.Module):
    """A classifier of `CLASSIFIERS` for frames of ``own`` channels each and pictures of ``shared`` channels in all.

    It looks at the mean of the frames and at what each differs from it, all scaled to a variance of 1 over a batch: beside
    what stands still, changes are so faint that from the frames themselves little is learned.

    Attributes:
        temperature: what logits are divided by, except in training; see `calibrate`.
    """

    temperature: Tensor

    def __init__(self, name: str, frames: int, own: int, shared: int, classes: int) -> None:
        """Build it with random weights; an InputError refuses an unknown name."""
        super().__init__()
        check_choices(("classifier", name, CLASSIFIERS))
        self.flat, build = CLASSIFIERS[name]
        shared += own if frames > 1 else 0
        inputs = frames * own + shared if self.flat else own + shared
        self.scaling = (nn.BatchNorm2d if self.flat else nn.BatchNorm3d)(inputs)
        self.body = build(inputs, classes)
        self.register_buffer("temperature", torch.ones(()))

    @property
    def last_layer(self) -> list[str]:
        """The names of the weights and biases that give the classes."""
        return [name for name, _ in self.named_parameters()][-2:]

    def forward(self, own: Tensor, shared: Tensor) -> Tensor:
        """Return logits ``(B, classes)`` of ``own`` ``(B, N, own, h, w)`` and ``shared`` ``(B, shared, h, w)``."""
        if own.shape[1] > 1:
            mean = own.mean(dim=1)
            own, shared = own - mean[:, None], torch.cat([shared, mean], dim=1)
        if self.flat:
            seen = torch.cat([own.flatten(1, 2), shared], dim=1)
        else:
            alike = shared[:, None].expand(-1, own.shape[1], -1, -1, -1)
            seen = torch.cat([own, alike], dim=2).transpose(1, 2)
        logits = self.body(self.scaling(seen))
        return logits if self.training else logits / self.temperature

    def calibrate(self, logits: Tensor, labels: Tensor) -> None:
        """Set the temperature with which clips that were not learned from are least surprising.

        Networks are surer than they are right (Guo et al., On Calibration of Modern Neural Networks, ICML 2017, section 4.2);
        which class is the most likely stays.

        Args:
            logits: ``(n, classes)``, at a temperature of 1.
            labels: ``(n,)``, the numbers of the true classes.
        """
        from scipy.optimize import minimize_scalar

        entropy, known = nn.functional.cross_entropy, logits.double()
        # Convex in 1 / temperature, and so with a single minimum in its logarithm, too.
        found: Any = minimize_scalar(
            lambda log: float(entropy(known / np.exp(log), labels)), bounds=np.log(_TEMPERATURES), method="bounded"
        )
        self.temperature.fill_(float(np.exp(found.x)))


def dronet(inputs: int, classes: int) -> nn.Module:
    """Return DroNet: three residual blocks (Loquercio et al., DroNet: Learning to Fly by Driving, RA-L 2018)."""
    widths = (32, 32, 64, 128)
    return nn.Sequential(
        nn.Conv2d(inputs, widths[0], 5, stride=2, padding=2),
        nn.MaxPool2d(3, stride=2, padding=1),
        *(_DroNetBlock(*pair) for pair in itertools.pairwise(widths)),
        nn.ReLU(),
        nn.AdaptiveAvgPool2d(2),
        nn.Flatten(),
        nn.Dropout(_DROPOUT),
        nn.Linear(4 * widths[-1], classes),
    )


class _DroNetBlock(nn.Module):
    """Normalisation and activation before each of two convolutions, and a linear way around them."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.way = nn.Sequential(
            nn.BatchNorm2d(inputs),
            nn.ReLU(),
            nn.Conv2d(inputs, outputs, 3, stride=2, padding=1),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
            nn.Conv2d(outputs, outputs, 3, padding=1),
        )
        self.around = nn.Conv2d(inputs, outputs, 1, stride=2)

    def forward(self, image: Tensor) -> Tensor:
        return self.way(image) + self.around(image)


def cnn3d(inputs: int, classes: int) -> nn.Module:
    """Return a plain 3D network: convolutions of 3 x 3 x 3 and pooling in turn (as C3D, Tran et al., ICCV 2015)."""
    layers: list[nn.Module] = []
    for number, width in enumerate((16, 32, 64, 128)):
        layers += [Conv3d(inputs, width, 3, padding=1, bias=False), nn.BatchNorm3d(width), nn.ReLU()]
        layers.append(nn.MaxPool3d((1 if number == 0 else 2, 2, 2), ceil_mode=True))
        inputs = width
    return nn.Sequential(
        *layers, nn.AdaptiveAvgPool3d((1, 2, 2)), nn.Flatten(), nn.Dropout(_DROPOUT), nn.Linear(4 * inputs, classes)
    )


def resnet18(inputs: int, classes: int) -> nn.Module:
    """Return ResNet-18 (He et al., CVPR 2016)."""
    from torchvision.models import resnet18 as build

    network = build(num_classes=classes)
    network.conv1 = nn.Conv2d(inputs, 64, 7, stride=2, padding=3, bias=False)
    nn.init.kaiming_normal_(network.conv1.weight, mode="fan_out", nonlinearity="relu")
    return network


def x3d(inputs: int, classes: int, depths: tuple[int, ...] = (1, 2, 5, 3)) -> nn.Module:
    """Return X3D-XS (Feichtenhofer, X3D, CVPR 2020), but as shallow as the X2D of table 1, from which it was expanded.

    Its own number of blocks in each stage is ``(3, 5, 11, 7)``.
    """
    widths = (24, 48, 96, 192)
    last, hidden = int(_X3D_WIDENING * widths[-1]), 2048
    network = nn.Sequential(
        Conv3d(inputs, widths[0], (1, 3, 3), stride=(1, 2, 2), padding=(0, 1, 1), bias=False),
        Conv3d(widths[0], widths[0], (5, 1, 1), padding=(2, 0, 0), groups=widths[0], bias=False),
        nn.BatchNorm3d(widths[0]),
        nn.ReLU(),
        *(
            _X3dBlock(width if number else before, width, stride=1 if number else 2, excited=number % 2 == 0)
            for (before, width), depth in zip(itertools.pairwise((widths[0], *widths)), depths, strict=True)
            for number in range(depth)
        ),
        *(Conv3d(widths[-1], last, 1, bias=False), nn.BatchNorm3d(last), nn.ReLU()),
        *(nn.AdaptiveAvgPool3d(1), nn.Flatten(), nn.Linear(last, hidden, bias=False), nn.ReLU()),
        *(nn.Dropout(_DROPOUT), nn.Linear(hidden, classes)),
    )
    # Twice as fast on CPUs: channel by channel, 3 x 3 x 3 convolutions crawl through whole images.
    return network.to(memory_format=torch.channels_last_3d)  # pyright: ignore[reportCallIssue]  torch types no such call


class _X3dBlock(nn.Module):
    """An inverted bottleneck: widened, filtered channel by channel, perhaps excited, and narrowed.

    Unlike the paper's, its last normalisation does not begin at 0.
    """

    def __init__(self, inputs: int, outputs: int, *, stride: int, excited: bool) -> None:
        super().__init__()
        wide, step = int(_X3D_WIDENING * outputs), (1, stride, stride)
        self.way = nn.Sequential(
            *(Conv3d(inputs, wide, 1, bias=False), nn.BatchNorm3d(wide), nn.ReLU()),
            *(Conv3d(wide, wide, 3, stride=step, padding=1, groups=wide, bias=False), nn.BatchNorm3d(wide)),
            *((_Excitation(wide),) if excited else ()),
            *(nn.SiLU(), Conv3d(wide, outputs, 1, bias=False), nn.BatchNorm3d(outputs)),
        )
        alike = inputs == outputs and stride == 1
        self.around = (
            nn.Identity()
            if alike
            else nn.Sequential(Conv3d(inputs, outputs, 1, stride=step, bias=False), nn.BatchNorm3d(outputs))
        )

    def forward(self, clip: Tensor) -> Tensor:
        return torch.relu(self.around(clip) + self.way(clip))


class _Excitation(nn.Module):
    """Each channel by a factor that the means of all tell (Hu et al., Squeeze-and-Excitation Networks, CVPR 2018).

    Its hidden width is a sixteenth of the channels, to the nearest 8; the paper's code takes 32 for 24 in the last stage.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        few = max(8, 8 * round(channels / 16 / 8))
        self.gate = nn.Sequential(nn.Linear(channels, few), nn.ReLU(), nn.Linear(few, channels), nn.Sigmoid())

    def forward(self, clip: Tensor) -> Tensor:
        return clip * self.gate(clip.mean(dim=(2, 3, 4)))[..., None, None, None]


CLASSIFIERS: dict[str, tuple[bool, Callable[[int, int], nn.Module]]] = {
    "dronet": (True, dronet),
    "resnet18": (True, resnet18),
    "cnn3d": (False, cnn3d),
    "x3d": (False, x3d),
}
"""Whether it takes the frames as channels of one image, and what builds it for input channels and classes."""
