"""LPIPS, where its weight files are: Zhang et al., The Unreasonable Effectiveness of Deep Features, CVPR 2018."""

from __future__ import annotations

import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from learning.perceptual.weights import FILES, check_size, has_weights, load_features, weight_folder
from simulator.errors import InputError

_BACKBONES = {"alex": "alex", "vgg": "vgg16"}  # the lpips package's names: ours, keys of FILES


class LpipsDistance:
    """LPIPS version 0.1 of the ``lpips`` package with its linear weights; lower is more alike, 0 is equal."""

    def __init__(self, network: str = "alex") -> None:
        """Load the weights; the package is kept from downloading any.

        Args:
            network: ``alex`` or ``vgg``.

        Raises:
            InputError: an unknown name, or no such weight file.
        """
        if network not in _BACKBONES:
            msg = f"lpips: got {network!r}, expected one of {', '.join(_BACKBONES)}"
            raise InputError(msg)
        self.network = network
        state, self.sha256 = load_features(_BACKBONES[network], "leave LPIPS out")
        self._model = _build(network, state)

    def to(self, device: torch.device | str) -> LpipsDistance:
        """Move the network and return this."""
        self._model.to(device)
        return self

    @torch.no_grad()
    def __call__(self, picture: Tensor, truth: Tensor) -> Tensor:
        """Return the distance of each picture, ``(B,)``.

        Args:
            picture: ``(B, 3, h, w)`` sRGB codes 0..1.
            truth: the same shape.

        Raises:
            InputError: shapes that differ, or fewer than 32 x 32 pixels.
        """
        check_size(picture, truth)
        return self._model(picture.float(), truth.float(), normalize=True).flatten()

    def record(self) -> dict[str, Any]:
        """Return what a table of results must say of this metric."""
        file = FILES[_BACKBONES[self.network]]
        return {"lpips": version("lpips"), "network": self.network, "file": file, "sha256": self.sha256}


def available_lpips(network: str | None = None) -> tuple[LpipsDistance | None, str]:
    """Return LPIPS if a weight file for it is there, and what a report must say either way.

    Args:
        network: ``alex`` or ``vgg``; None takes the first of them that is there.

    Raises:
        InputError: a weight file is there but damaged, or an unknown name.
    """
    wanted = list(_BACKBONES) if network is None else [network]
    for name in wanted:
        if name not in _BACKBONES or has_weights(_BACKBONES[name]):
            distance = LpipsDistance(name)
            return distance, f"LPIPS {version('lpips')} with {FILES[_BACKBONES[name]]}"
    files = " or ".join(FILES[_BACKBONES[name]] for name in wanted)
    return None, f"no LPIPS: {files} not in {weight_folder()}, and nothing is downloaded"


def _build(network: str, backbone: dict[str, Tensor]) -> torch.nn.Module:
    """Return the package's network, built without weights, so that it asks nobody for them, and filled from files."""
    import lpips

    with torch.random.fork_rng(devices=[]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=UserWarning, module="torchvision")  # lpips calls it as of old
        model = lpips.LPIPS(pretrained=False, pnet_rand=True, net=network, version="0.1", verbose=False)
    linear_file = Path(lpips.__file__).parent / "weights" / "v0.1" / f"{network}.pth"
    state = torch.load(linear_file, map_location="cpu", weights_only=True)
    # The package cuts the network into slices whose layers keep the numbers that they have in torchvision's features.
    for name, value in model.net.state_dict().items():
        layer = name.split(".", 1)[1]
        if layer not in backbone or backbone[layer].shape != value.shape:
            msg = f"{FILES[_BACKBONES[network]]}: not the weights of torchvision's network; get the file again"
            raise InputError(msg)
        state[f"net.{name}"] = backbone[layer]
    missing, unexpected = model.load_state_dict(state, strict=False)
    # The linear layers are listed twice by the package; its scaling is a constant.
    if unexpected or any(not name.startswith(("lins.", "scaling_layer.")) for name in missing):
        msg = f"lpips {version('lpips')}: its weights {linear_file} do not fit its network; install lpips 0.1.4"
        raise InputError(msg)
    return model.requires_grad_(False).eval()
