"""Distances between features of networks trained on other images: as a loss (VGG), as a metric (LPIPS).

Their weights are files that may be absent. They are looked for where torch keeps them, checked, and never downloaded; nothing
else takes their place unless it was asked for by name.
"""

from __future__ import annotations

import math
import pickle
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate
from torch.nn.utils import skip_init

from learning.method import check_choices
from simulator.errors import InputError
from simulator.io.files import sha256_file

# What torchvision's networks were trained on: sRGB codes 0..1 less the mean, by the spread, of ImageNet's images.
IMAGENET_MEAN, IMAGENET_SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

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
    """Distance between images: the mean squared difference of features, summed over layers.

    Source: Johnson et al., Perceptual Losses for Real-Time Style Transfer and Super-Resolution, ECCV 2016, equation 2.

    The weights are frozen; gradients go to the images only. Computed in float32, whatever autocast says.
    """

    mean: Tensor
    spread: Tensor

    def __init__(self, weights: Literal["vgg", "random_vgg"], network: str = "vgg19", *, seed: int = 0) -> None:
        """Build the network.

        Args:
            weights: ``vgg``, trained on ImageNet, from torchvision's file; ``random_vgg``, drawn from ``seed`` and with
                normalised features (see `learning.perceptual`).
            network: ``vgg19`` or ``vgg16``; see `LAYERS`.
            seed: of ``random_vgg``; torch's global generator is left alone.

        Raises:
            InputError: an unknown name, or ``vgg`` without the weight file.
        """
        super().__init__()
        check_choices(("perceptual", weights, ("vgg", "random_vgg")), ("network", network, LAYERS))
        self.weights, self.network, self.seed = weights, network, seed
        self.sha256: str | None = None
        indices = layer_indices(network)
        self.indices = tuple(indices[name] for name in LAYERS[network])
        self.features = build_features(network, max(self.indices) + 1)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN)[:, None, None])
        self.register_buffer("spread", torch.tensor(IMAGENET_SPREAD)[:, None, None])
        if weights == "vgg":
            cure = "choose perceptual: none (no such loss) or random_vgg (the same network, random weights)"
            state, self.sha256 = load_features(network, cure)
            names = {key: key for key in self.features.state_dict()}
            self.features.load_state_dict(fitting(state, names, self.features, network, cure))
        else:
            self._draw(torch.Generator().manual_seed(seed))
        self.requires_grad_(False).eval()

    def forward(self, image: Tensor, truth: Tensor) -> Tensor:
        """Return the distance, a scalar, the mean over the batch, of ``(B, 3, h, w)`` sRGB codes, at least 32 x 32 pixels.

        Codes are nominally 0..1, and not clipped, so that gradients lead back.
        """
        check_size(image, truth)
        with torch.autocast(image.device.type, enabled=False):
            with torch.no_grad():
                wanted = self.extract(truth.float())
            found = self.extract(image.float())
            differences = [(one - other).square().mean() for one, other in zip(found, wanted, strict=True)]
        return torch.stack(differences).sum()

    def extract(self, image: Tensor) -> list[Tensor]:
        """Return the features of each layer of `LAYERS`, ``(B, channels, h / stride, w / stride)``."""
        values, found = self._standardise(image), []
        for index, layer in enumerate(self.features):
            values = layer(values)
            if index in self.indices:
                found.append(values)
        return found

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint and a table of results must say of this loss."""
        record = {"perceptual": self.weights, "network": self.network, "layers": list(LAYERS[self.network])}
        if self.weights == "vgg":
            return record | {"file": FILES[self.network], "sha256": self.sha256}
        return record | {"seed": self.seed, "features": "each channel divided by its spread over random images"}

    def _standardise(self, image: Tensor) -> Tensor:
        return (image - self.mean) / self.spread

    @torch.no_grad()
    def _draw(self, generator: torch.Generator) -> None:
        """Draw weights as He et al. do for ReLUs, without biases; scale them so that each compared channel has unit variance.

        The variance is that over random images. Channels that hardly ever leave zero get less: at most 10 times the median.
        """
        for layer in self.features:
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=generator)
                nn.init.zeros_(layer.bias)  # pyright: ignore[reportArgumentType]
        values = self._standardise(natural_images(generator, 16, 64))
        for index, layer in enumerate(self.features):
            values = layer(values)
            if index in self.indices:
                spread = values.std(dim=(0, 2, 3), correction=0)
                spread = spread.clamp_min(0.1 * spread.median())[:, None, None]
                self.features[index - 1].weight /= spread[..., None]  # ReLU(x) / s = ReLU(x / s)
                values = values / spread


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


def natural_images(generator: torch.Generator, count: int, pixels: int) -> Tensor:
    """Return random images ``(count, 3, pixels, pixels)``, 0..1: noise of all scales with the same contrast in each.

    That every octave has the same variance is the 1 / f^2 power spectrum of natural images: Field, Relations between the
    statistics of natural images and the response properties of cortical cells, JOSA A 4, 1987. Half of it is grey.
    """
    total = torch.zeros(count, 3, pixels, pixels)
    size = 1
    while size <= pixels:
        grey = torch.randn(count, 1, size, size, generator=generator)
        colour = torch.randn(count, 3, size, size, generator=generator)
        total += interpolate(grey + colour, (pixels, pixels), mode="bilinear")
        size *= 2
    return torch.sigmoid(total / total.std())


_BACKBONES = {"alex": "alex", "vgg": "vgg16"}  # the lpips package's names: ours, keys of FILES


class LpipsDistance:
    """LPIPS version 0.1 of the ``lpips`` package with its linear weights; lower is more alike, 0 is equal."""

    def __init__(self, network: str = "alex") -> None:
        """Load the weights of ``alex`` or ``vgg``; the package is kept from downloading any.

        Raises:
            InputError: an unknown name, or no such weight file.
        """
        import lpips

        check_choices(("lpips", network, _BACKBONES))
        self.network, backbone, cure = network, _BACKBONES[network], "leave LPIPS out"
        features, self.sha256 = load_features(backbone, cure)
        with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=UserWarning, module="torchvision")  # lpips calls it as of old
            model = lpips.LPIPS(pretrained=False, pnet_rand=True, net=network, version="0.1", verbose=False)
        linear_file = Path(lpips.__file__).parent / "weights" / "v0.1" / f"{network}.pth"
        state = torch.load(linear_file, map_location="cpu", weights_only=True)
        # The package cuts the network into slices whose layers keep the numbers that they have in torchvision's features.
        names = {name: name.split(".", 1)[1] for name in model.net.state_dict()}
        state |= {f"net.{name}": value for name, value in fitting(features, names, model.net, backbone, cure).items()}
        missing, unexpected = model.load_state_dict(state, strict=False)
        # The linear layers are listed twice by the package; its scaling is a constant.
        if unexpected or any(not name.startswith(("lins.", "scaling_layer.")) for name in missing):
            reason = f"its weights {linear_file} do not fit its network; install lpips 0.1.4"
            raise InputError(f"lpips {version('lpips')}", reason)
        self._model = model.requires_grad_(False).eval()

    def to(self, device: torch.device | str) -> LpipsDistance:
        """Move the network and return this."""
        self._model.to(device)
        return self

    @torch.no_grad()
    def __call__(self, image: Tensor, truth: Tensor) -> Tensor:
        """Return the distances ``(B,)`` of ``(B, 3, h, w)`` sRGB codes 0..1, of at least 32 x 32 pixels."""
        check_size(image, truth)
        return self._model(image.float(), truth.float(), normalize=True).flatten()

    def record(self) -> dict[str, Any]:
        """Return what a table of results must say of this metric."""
        file = FILES[_BACKBONES[self.network]]
        return {"lpips": version("lpips"), "network": self.network, "file": file, "sha256": self.sha256}


def available_lpips() -> tuple[LpipsDistance | None, str]:
    """Return LPIPS with the first weight file that is there, and what a report must say either way.

    Raises:
        InputError: a weight file is there but damaged.
    """
    for name, backbone in _BACKBONES.items():
        if (weight_folder() / FILES[backbone]).is_file():
            return LpipsDistance(name), f"LPIPS {version('lpips')} with {FILES[backbone]}"
    files = " or ".join(FILES[backbone] for backbone in _BACKBONES.values())
    return None, f"no LPIPS: {files} not in {weight_folder()}, and nothing is downloaded"


FILES = {"vgg19": "vgg19-dcbb9e9d.pth", "vgg16": "vgg16-397923af.pth", "alex": "alexnet-owt-7be5be79.pth"}
"""Torchvision's names of the files (weights IMAGENET1K_V1); the digits are the beginning of the file's SHA-256."""

PIXELS_PER_DEGREE = 3840 * math.pi / 180
"""That a viewer sees, of a display as wide as its distance, 3840 pixels across; Andersson et al. 2020 (FLIP), section 4."""

SMALLEST_IMAGE = 32
"""Pixels: below this, the networks' pools leave nothing to compare."""


def weight_folder() -> Path:
    """Return where torch's hub keeps weight files: ``$TORCH_HOME/hub/checkpoints``, by default below ``~/.cache/torch``."""
    return Path(torch.hub.get_dir()) / "checkpoints"


def load_features(network: str, cure: str) -> tuple[dict[str, Tensor], str]:
    """Return the weights of a network (a key of `FILES`), keyed as in its ``features``, and the file's SHA-256.

    ``cure`` ends the message of a refusal: what to do instead of using this file.
    """
    path = weight_folder() / FILES[network]
    if not path.is_file():
        where = f"{path.name} is not in {path.parent}, and nothing is downloaded"
        put = "put it there (torchvision's IMAGENET1K_V1), set TORCH_HOME to the folder above its hub/checkpoints"
        raise InputError(f"weights of {network}", f"{where}; {put}, or {cure}")
    try:
        digest = sha256_file(path)
        if not digest.startswith(promised := path.stem.rpartition("-")[2]):
            raise InputError(path, f"its SHA-256 begins with {digest[:8]}, its name says {promised}; get it again")
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise InputError(path, f"cannot be read: {error}; get the file again, or {cure}") from error
    prefix = "features."
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}, digest


def fitting(
    state: dict[str, Tensor], names: dict[str, str], network: nn.Module, file: str, cure: str
) -> dict[str, Tensor]:
    """Return the weights of a network's file under the names that they have in a network, which gives the shapes.

    ``names`` lead from the network's tensors to those of the file, a key of `FILES`; ``cure`` ends the message of a refusal.
    """
    wanted = network.state_dict()
    if any(own not in state or state[own].shape != wanted[name].shape for name, own in names.items()):
        raise InputError(FILES[file], f"not the weights of torchvision's {file}; get the file again, or {cure}")
    return {name: state[own] for name, own in names.items()}


def check_size(*images: Tensor) -> None:
    """Refuse images ``(B, 3, h, w)`` that differ in shape or are too small."""
    shapes = [tuple(image.shape) for image in images]
    if len(set(shapes)) > 1 or len(shapes[0]) != 4 or shapes[0][1] != 3:
        raise InputError("images", f"got shapes {' and '.join(map(str, shapes))}, expected (B, 3, h, w) twice")
    if min(shapes[0][2:]) < SMALLEST_IMAGE:
        got = f"got {shapes[0][2]} x {shapes[0][3]} pixels, expected at least {SMALLEST_IMAGE} x {SMALLEST_IMAGE}"
        raise InputError("images", f"{got} for deep features; choose perceptual: none, or larger scenes")
