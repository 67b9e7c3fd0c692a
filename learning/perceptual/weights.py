"""Weight files of networks trained on ImageNet: where they are looked for, and whether they are what their name says."""

from __future__ import annotations

import hashlib
import pickle
import re
from pathlib import Path

import torch
from torch import Tensor

from simulator.errors import InputError

FILES = {
    "vgg19": "vgg19-dcbb9e9d.pth",
    "vgg16": "vgg16-397923af.pth",
    "alex": "alexnet-owt-7be5be79.pth",
}
"""Torchvision's names of the files (weights IMAGENET1K_V1); the digits are the beginning of the file's SHA-256."""

SMALLEST_PICTURE = 32
"""Pixels: below this, the networks' pools leave nothing to compare."""


def weight_folder() -> Path:
    """Return where torch's hub keeps weight files: ``$TORCH_HOME/hub/checkpoints``, by default below ``~/.cache/torch``."""
    return Path(torch.hub.get_dir()) / "checkpoints"


def has_weights(network: str) -> bool:
    """Whether the weight file of a network is there; see `FILES`."""
    return (weight_folder() / FILES[network]).is_file()


def load_features(network: str, cure: str) -> tuple[dict[str, Tensor], str]:
    """Return the weights of a network's convolutions, keyed as in its ``features``, and the file's SHA-256.

    Args:
        network: a key of `FILES`.
        cure: what to do instead of using this file, for the message.

    Raises:
        InputError: the file is absent, damaged or not what its name says.
    """
    path = weight_folder() / FILES[network]
    if not path.is_file():
        msg = (
            f"weights of {network}: {path.name} is not in {path.parent} and is not downloaded; put it there (torchvision's "
            f"IMAGENET1K_V1), or set TORCH_HOME to the folder above its hub/checkpoints, or {cure}"
        )
        raise InputError(msg)
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        _check_digest(path, digest)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        msg = f"cannot read {path}: {error}; get the file again, or {cure}"
        raise InputError(msg) from error
    prefix = "features."
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}, digest


def check_size(*pictures: Tensor) -> None:
    """Refuse pictures ``(B, 3, h, w)`` that differ in shape or are too small.

    Raises:
        InputError: naming the shapes.
    """
    shapes = [tuple(picture.shape) for picture in pictures]
    if len(set(shapes)) > 1 or len(shapes[0]) != 4 or shapes[0][1] != 3:
        msg = f"pictures: got shapes {' and '.join(map(str, shapes))}, expected (B, 3, h, w) twice"
        raise InputError(msg)
    if min(shapes[0][2:]) < SMALLEST_PICTURE:
        msg = (
            f"pictures: got {shapes[0][2]} x {shapes[0][3]} pixels, expected at least {SMALLEST_PICTURE} x "
            f"{SMALLEST_PICTURE} for features of a deep network; choose perceptual: none, and no LPIPS, or larger scenes"
        )
        raise InputError(msg)


def _check_digest(path: Path, digest: str) -> None:
    match = re.search(r"-([0-9a-f]{8,64})\.", path.name)
    if match and not digest.startswith(match[1]):
        msg = f"{path}: its SHA-256 begins with {digest[:8]}, its name says {match[1]}: damaged or another file; get it again"
        raise InputError(msg)
