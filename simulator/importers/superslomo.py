"""Temporal frame interpolation by the network of Super SloMo, with weights from a file that the user has.

Source: H. Jiang et al., "Super SloMo: High quality estimation of multiple intermediate frames for video interpolation", CVPR
2018: equations 4 and 5, section 3.3 and figure 4, evaluated as the public weights (A. Paliwal's, MIT licence) were trained;
names, strides and the leaky output are theirs. Those weights were not at hand when this was written: it is tested against the
formulas, the quality of its images is not measured.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch.nn import functional

from simulator.colour import linear_to_srgb, srgb_to_linear
from simulator.errors import InputError
from simulator.importers.frame_interpolation import interpolate_pairs
from simulator.io.files import sha256_file

MEAN_RGB = (0.429, 0.431, 0.397)
"""Subtracted from the encoded frames before the networks see them, as in their training (mean of the Adobe240-fps films)."""

_THREADS = Lock()
"""Held while torch's number of threads, which the process shares, is another."""

STRIDE = 32
"""Rows and columns must be multiples of this: five times halved."""

SLOPE = 0.1
"""Of the leaky rectifiers, section 3.3."""

_DOWN = ((32, 64, 5), (64, 128, 3), (128, 256, 3), (256, 512, 3), (512, 512, 3))
_UP = ((512, 512), (512, 256), (256, 128), (128, 64), (64, 32))

NETWORKS = {"state_dictFC": (6, 4), "state_dictAT": (20, 5)}
"""The checkpoint's two networks, by its keys, with their channels in and out: flow computation, then flow interpolation."""

_OPTION = "superslomo_checkpoint"
_CURE = "give the public SuperSloMo.ckpt (A. Paliwal's), or its tensors named state_dictFC.conv1.weight and so on"


@dataclass(frozen=True)
class SuperSloMo:
    """Runs the network on the processor, on sRGB-encoded frames, and gives linear light.

    Light beyond 1 is encoded along the same curve, which the network has never seen; keep frames in 0..1. What it makes
    below black is black.

    Attributes:
        checkpoint: the file of the weights.
        sha256: of that file.
    """

    checkpoint: Path
    sha256: str
    packages: ClassVar[tuple[str, ...]] = ("torch",)

    @classmethod
    def from_checkpoint(cls, checkpoint: Path) -> SuperSloMo:
        """Read and check the weights.

        Raises:
            InputError: when the file is not a checkpoint of this network.
        """
        read_checkpoint(checkpoint)
        return cls(checkpoint, sha256_file(checkpoint))

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The checkpoint."""
        return (self.checkpoint,)

    def interpolate(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two; see :func:`interpolate_pairs`."""
        return interpolate_pairs(frames, factor, self._between)

    def record(self) -> dict[str, Any]:
        """Return the name, the checkpoint and what ran it."""
        file = {"checkpoint": self.checkpoint.name, "sha256": self.sha256}
        return {"name": "superslomo", **file, "torch": torch.__version__}

    def _between(
        self, first: NDArray[np.float32], second: NDArray[np.float32], times: list[float]
    ) -> NDArray[np.float32]:
        networks = _networks(self.checkpoint, self.sha256)
        with _one_thread(), torch.inference_mode():
            planes = between(networks, _encoded(first), _encoded(second), times)
        height, width = first.shape[:2]
        mean = torch.tensor(MEAN_RGB).reshape(3, 1, 1)
        encoded = (planes + mean)[:, :, :height, :width].clamp(min=0).permute(0, 2, 3, 1)
        return srgb_to_linear(encoded.numpy())


def between(networks: dict[str, dict[str, Any]], first: Any, second: Any, times: list[float]) -> Any:
    """Return the frames at these times between two frames.

    Args:
        networks: tensors by network and name, see :func:`read_checkpoint`.
        first: torch ``(1, 3, H, W)``, encoded, less the mean; H and W multiples of 32.
        second: the same, one frame later.
        times: N times between 0 and 1.

    Returns:
        torch ``(N, 3, H, W)``, encoded, less the mean.
    """
    flows = u_net(networks["state_dictFC"], torch.cat((first, second), 1))
    there, back = flows[:, :2], flows[:, 2:]
    frames = []
    for t in times:
        to_first = -t * (1 - t) * there + t * t * back  # equation 4
        to_second = (1 - t) ** 2 * there - t * (1 - t) * back
        warped = backwarp(second, to_second), backwarp(first, to_first)
        seen = torch.cat((first, second, there, back, to_second, to_first, *warped), 1)
        refined = u_net(networks["state_dictAT"], seen)
        visible_first = torch.sigmoid(refined[:, 4:])
        weight_first, weight_second = (1 - t) * visible_first, t * (1 - visible_first)
        from_first = backwarp(first, to_first + refined[:, :2])
        from_second = backwarp(second, to_second + refined[:, 2:4])
        blended = weight_first * from_first + weight_second * from_second  # equation 5
        frames.append(blended / (weight_first + weight_second))
    return torch.cat(frames)


def backwarp(image: Any, flow: Any) -> Any:
    """Look up each pixel of an image where the flow points to, bilinearly, as the public weights were trained to expect.

    Their training divides places by W and H where W - 1 and H - 1 were meant, so pixel ``x`` is looked up at
    ``(x + flow) * (W - 1) / W``, up to a pixel off at the far edges. Weights are run with the warp that they were trained
    with. Outside the image is the mean colour.

    Args:
        image: torch ``(N, C, H, W)``.
        flow: torch ``(N, 2, H, W)`` pixels to the right and down.

    Returns:
        ``(N, C, H, W)``.
    """
    height, width = image.shape[-2:]
    x = torch.arange(width) + flow[:, 0]
    y = torch.arange(height)[:, None] + flow[:, 1]
    places = torch.stack((2 * x / width - 1, 2 * y / height - 1), -1)
    return functional.grid_sample(image, places, align_corners=True)


def _encoded(frame: NDArray[np.float32]) -> Any:
    """Return a linear frame as the networks take it: encoded, less the mean, its edges repeated up to multiples of 32."""
    height, width = frame.shape[:2]
    padding = ((0, -height % STRIDE), (0, -width % STRIDE), (0, 0))
    encoded = np.pad(linear_to_srgb(frame), padding, mode="edge") - np.array(MEAN_RGB, np.float32)
    return torch.from_numpy(np.ascontiguousarray(encoded.transpose(2, 0, 1)[None]))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch work on one thread: how it sums depends on their number, and the same frames shall give the same bytes."""
    with _THREADS:
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(before)


@lru_cache(maxsize=1)
def _networks(checkpoint: Path, sha256: str) -> dict[str, dict[str, Any]]:
    """Weights of a checkpoint, read once per process.

    Raises:
        InputError: when the file has changed since the source was made.
    """
    if sha256_file(checkpoint) != sha256:
        raise InputError(_OPTION, f"{checkpoint} has changed while the job ran; start again")
    return read_checkpoint(checkpoint)


def tensor_shapes(channels_in: int, channels_out: int) -> dict[str, tuple[int, ...]]:
    """Return the name and shape of each tensor of a network with so many channels in and out."""
    convolutions = [("conv1", channels_in, 32, 7), ("conv2", 32, 32, 7)]
    for level, (before, after, size) in enumerate(_DOWN, start=1):
        convolutions += [(f"down{level}.conv1", before, after, size), (f"down{level}.conv2", after, after, size)]
    for level, (before, after) in enumerate(_UP, start=1):
        convolutions += [(f"up{level}.conv1", before, after, 3), (f"up{level}.conv2", 2 * after, after, 3)]
    convolutions.append(("conv3", 32, channels_out, 3))
    shapes: dict[str, tuple[int, ...]] = {}
    for name, before, after, size in convolutions:
        shapes[f"{name}.weight"] = (after, before, size, size)
        shapes[f"{name}.bias"] = (after,)
    return shapes


def u_net(tensors: Mapping[str, Any], planes: Any) -> Any:
    """Evaluate a network.

    Args:
        tensors: torch tensors, named and shaped as :func:`tensor_shapes` says.
        planes: torch ``(N, channels_in, H, W)``, H and W multiples of :data:`STRIDE`.

    Returns:
        ``(N, channels_out, H, W)``.
    """

    def layer(name: str, values: Any) -> Any:
        weight = tensors[f"{name}.weight"]
        convolved = functional.conv2d(values, weight, tensors[f"{name}.bias"], padding=weight.shape[-1] // 2)
        return functional.leaky_relu(convolved, SLOPE)

    values = layer("conv2", layer("conv1", planes))
    skipped = []
    for level in range(1, len(_DOWN) + 1):
        skipped.append(values)
        values = functional.avg_pool2d(values, 2)
        values = layer(f"down{level}.conv2", layer(f"down{level}.conv1", values))
    for level in range(1, len(_UP) + 1):
        values = functional.interpolate(values, scale_factor=2, mode="bilinear", align_corners=True)
        values = torch.cat((layer(f"up{level}.conv1", values), skipped.pop()), 1)
        values = layer(f"up{level}.conv2", values)
    return layer("conv3", values)


def read_checkpoint(path: Path) -> dict[str, dict[str, Any]]:
    """Return the float32 tensors of both networks, by the keys of :data:`NETWORKS`.

    A ``.safetensors`` file is flat, so its names are prefixed: ``state_dictFC.conv1.weight``. Any other file is read by
    ``torch.load`` with ``weights_only``, which refuses all that could run; beside numbers and tensors only the date is let
    pass at which the public file was saved.

    Raises:
        InputError: naming the file, when it is missing, not a checkpoint, or holds other tensors than the two networks need.
    """
    if not path.is_file():
        raise InputError(_OPTION, f"{path} is not a file; {_CURE}")
    flat = path.suffix == ".safetensors"
    try:
        # A date holds numbers alone; without it the public file, which notes when it was saved, would not be read.
        with torch.serialization.safe_globals([datetime.datetime]):
            content = load_file(path) if flat else torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # torch.load meets a foreign file with almost any exception
        # Torch's own words may end in the advice to let the file run its code.
        kind = f"as safetensors: {error}" if flat else f"as weights of torch ({type(error).__name__})"
        raise InputError(_OPTION, f"cannot read {path} {kind}; {_CURE}") from error
    if flat:
        content = {
            key: {name.removeprefix(f"{key}."): content[name] for name in content if name.startswith(f"{key}.")}
            for key in NETWORKS
        }
    return {key: _network(path, content, key) for key in NETWORKS}


def _network(path: Path, content: Any, key: str) -> dict[str, Any]:
    found = content.get(key) if isinstance(content, dict) else None
    if not isinstance(found, dict) or not found:
        keys = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
        raise InputError(_OPTION, f"{path} holds {keys[:200]}, not {' and '.join(NETWORKS)}; {_CURE}")
    expected = tensor_shapes(*NETWORKS[key])
    for name, shape in expected.items():
        tensor = found.get(name)
        if not isinstance(tensor, torch.Tensor) or tuple(tensor.shape) != shape or not tensor.is_floating_point():
            got = f"{tensor.dtype} {tuple(tensor.shape)}" if isinstance(tensor, torch.Tensor) else "nothing"
            raise InputError(_OPTION, f"{path}: {key}: {name} is {got}, expected float32 {shape}; {_CURE}")
        if not torch.isfinite(tensor).all():
            raise InputError(_OPTION, f"{path}: {key}: {name} holds NaN or inf, the file is damaged; {_CURE}")
    if unknown := sorted(set(found) - set(expected)):
        raise InputError(_OPTION, f"{path}: {key} also holds {', '.join(map(str, unknown[:5]))}; {_CURE}")
    return {name: found[name].float() for name in expected}
