"""The perceptual loss: mean squared difference of a VGG network's features, trained on ImageNet or random."""

from __future__ import annotations

from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn.utils import skip_init

from learning.perceptual.random_weights import calibrate, draw_weights
from learning.perceptual.weights import FILES, check_size, load_features
from simulator.errors import InputError

# What torchvision's networks were trained on: sRGB codes 0..1 less the mean, by the spread, of ImageNet's pictures.
_MEAN, _SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

LAYERS = {"vgg19": ("relu4_2",), "vgg16": ("relu2_2", "relu4_3")}
"""Which features are compared. Still scenes: VGG-19 up to and with relu4_2, ``features[:23]``.

The thesis names the "22nd convolution" of VGG-19, which has only 16; index 22 of torchvision's ``features`` is the ReLU after
the second convolution of the fourth block. Videos: VGG-16, relu2_2 and relu4_3.
"""

# Simonyan and Zisserman, arXiv 1409.1556, table 1, columns D and E: channels of the convolutions of each block.
_BLOCKS = {
    "vgg16": ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512)),
    "vgg19": ((64, 64), (128, 128), (256, 256, 256, 256), (512, 512, 512, 512), (512, 512, 512, 512)),
}


class PerceptualLoss(nn.Module):
    """Distance between pictures: the mean squared difference of features, summed over layers.

    Source: Johnson et al., Perceptual Losses for Real-Time Style Transfer and Super-Resolution, ECCV 2016, equation 2.

    The weights are frozen; gradients go to the pictures only. Computed in float32, whatever autocast says.
    """

    mean: Tensor
    spread: Tensor

    def __init__(self, weights: Literal["vgg", "random_vgg"], network: str = "vgg19", *, seed: int = 0) -> None:
        """Build the network.

        Args:
            weights: ``vgg``, trained on ImageNet, from torchvision's file; ``random_vgg``, drawn from ``seed`` and with
                normalised features (see `learning.perceptual.random_weights`).
            network: ``vgg19`` or ``vgg16``; see `LAYERS`.
            seed: of ``random_vgg``; torch's global generator is neither used nor changed.

        Raises:
            InputError: an unknown name, or ``vgg`` without the weight file.
        """
        super().__init__()
        for name, value, known in (("perceptual", weights, ("vgg", "random_vgg")), ("network", network, tuple(LAYERS))):
            if value not in known:
                msg = f"{name}: got {value!r}, expected one of {', '.join(known)}"
                raise InputError(msg)
        self.weights, self.network, self.seed = weights, network, seed
        self.sha256: str | None = None
        indices = layer_indices(network)
        self.indices = tuple(indices[name] for name in LAYERS[network])
        self.features = build_features(network, max(self.indices) + 1)
        self.register_buffer("mean", torch.tensor(_MEAN)[:, None, None])
        self.register_buffer("spread", torch.tensor(_SPREAD)[:, None, None])
        if weights == "vgg":
            self._load(network)
        else:
            generator = torch.Generator().manual_seed(seed)
            draw_weights(self.features, generator)
            calibrate(self.features, self.indices, generator, self._standardise)
        self.requires_grad_(False).eval()

    def forward(self, picture: Tensor, truth: Tensor) -> Tensor:
        """Return the distance, a scalar; the mean over the batch.

        Args:
            picture: ``(B, 3, h, w)`` sRGB codes, nominally 0..1; not clipped, so that gradients lead back.
            truth: the same shape.

        Raises:
            InputError: shapes that differ, or fewer than 32 x 32 pixels.
        """
        check_size(picture, truth)
        with torch.autocast(picture.device.type, enabled=False):
            with torch.no_grad():
                wanted = self.extract(truth.float())
            found = self.extract(picture.float())
            differences = [(one - other).square().mean() for one, other in zip(found, wanted, strict=True)]
        return torch.stack(differences).sum()

    def extract(self, picture: Tensor) -> list[Tensor]:
        """Return the features of each layer of `LAYERS`, ``(B, channels, h / stride, w / stride)``."""
        values, found = self._standardise(picture), []
        for index, layer in enumerate(self.features):
            values = layer(values)
            if index in self.indices:
                found.append(values)
        return found

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint and a table of results must say of this loss."""
        record: dict[str, Any] = {
            "perceptual": self.weights,
            "network": self.network,
            "layers": list(LAYERS[self.network]),
        }
        if self.weights == "vgg":
            return record | {"file": FILES[self.network], "sha256": self.sha256}
        return record | {"seed": self.seed, "features": "each channel divided by its spread over random pictures"}

    def _standardise(self, picture: Tensor) -> Tensor:
        return (picture - self.mean) / self.spread

    def _load(self, network: str) -> None:
        choices = "choose perceptual: none (no such loss) or perceptual: random_vgg (the same network, random weights)"
        state, self.sha256 = load_features(network, choices)
        wanted = self.features.state_dict()
        if any(name not in state or state[name].shape != value.shape for name, value in wanted.items()):
            msg = f"{FILES[network]}: not the weights of torchvision's {network}; get the file again, or {choices}"
            raise InputError(msg)
        self.features.load_state_dict({name: state[name] for name in wanted})


def layer_indices(network: str) -> dict[str, int]:
    """Return the index in torchvision's ``features`` of each ReLU, named by block and convolution as in the literature.

    Example:
        >>> layer_indices("vgg19")["relu4_2"]
        22
    """
    indices, index = {}, 0
    for block, channels in enumerate(_BLOCKS[network], start=1):
        for number in range(1, len(channels) + 1):
            indices[f"relu{block}_{number}"] = index + 1
            index += 2  # a convolution and its ReLU
        index += 1  # the pool
    return indices


def build_features(network: str, length: int) -> nn.Sequential:
    """Return ``features[:length]`` of torchvision's network with weights of no meaning, without torchvision's slow import."""
    layers, inputs = [], 3
    for channels in _BLOCKS[network]:
        for outputs in channels:
            layers += [skip_init(nn.Conv2d, inputs, outputs, kernel_size=3, padding=1), nn.ReLU()]
            inputs = outputs
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers[:length])
