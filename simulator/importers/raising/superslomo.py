"""Frames in between by the network of Super SloMo, with weights from a file that the user has.

Source: H. Jiang et al., "Super SloMo: High quality estimation of multiple intermediate frames for video interpolation", CVPR
2018, equations 4 and 5, evaluated as the public weights were trained. Those weights were not at hand when this was written:
it is tested against the formulas, the quality of its pictures is not measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb, srgb_to_linear
from simulator.errors import InputError
from simulator.importers.raising._between import raise_pairs
from simulator.importers.raising._checkpoint import read_checkpoint
from simulator.importers.raising._network import STRIDE, u_net
from simulator.io.files import sha256_file

MEAN_RGB = (0.429, 0.431, 0.397)
"""Subtracted from the encoded frames before the networks see them, as in their training (mean of the Adobe240-fps films)."""

_THREADS = Lock()
"""Held while torch's number of threads, which the process shares, is another."""


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
            InputError: when torch is not installed, or the file is no checkpoint of this network.
        """
        try:
            import torch  # noqa: F401
        except ImportError as error:
            msg = "raise_with: superslomo needs torch, which is not installed; pip install 'flatlight[learn]'"
            raise InputError(msg) from error
        read_checkpoint(checkpoint)
        return cls(checkpoint, sha256_file(checkpoint))

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The checkpoint."""
        return (self.checkpoint,)

    def raise_frames(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two; see ``Raiser``."""
        return raise_pairs(frames, factor, self._between)

    def record(self) -> dict[str, Any]:
        """Return the name, the checkpoint and what ran it."""
        import torch

        return {
            "name": "superslomo",
            "checkpoint": self.checkpoint.name,
            "sha256": self.sha256,
            "torch": torch.__version__,
        }

    def _between(
        self, first: NDArray[np.float32], second: NDArray[np.float32], times: list[float]
    ) -> NDArray[np.float32]:
        import torch

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
        networks: tensors by network and name, see ``_checkpoint``.
        first: torch ``(1, 3, H, W)``, encoded, less the mean; H and W multiples of 32.
        second: the same, one frame later.
        times: N times between 0 and 1.

    Returns:
        torch ``(N, 3, H, W)``, encoded, less the mean.
    """
    import torch

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


def backwarp(picture: Any, flow: Any) -> Any:
    """Look up each pixel of a picture where the flow points to, bilinearly, as the public weights were trained to expect.

    Their training divides places by W and H where W - 1 and H - 1 were meant, so pixel ``x`` is looked up at
    ``(x + flow) * (W - 1) / W``, up to a pixel off at the far edges. Weights are run with the warp that they were trained
    with. Outside the picture is the mean colour.

    Args:
        picture: torch ``(N, C, H, W)``.
        flow: torch ``(N, 2, H, W)`` pixels to the right and down.

    Returns:
        ``(N, C, H, W)``.
    """
    import torch
    from torch.nn import functional

    height, width = picture.shape[-2:]
    x = torch.arange(width) + flow[:, 0]
    y = torch.arange(height)[:, None] + flow[:, 1]
    places = torch.stack((2 * x / width - 1, 2 * y / height - 1), -1)
    return functional.grid_sample(picture, places, align_corners=True)


def _encoded(frame: NDArray[np.float32]) -> Any:
    """Return a linear frame as the networks take it: encoded, less the mean, its edges repeated up to multiples of 32."""
    import torch

    height, width = frame.shape[:2]
    padding = ((0, -height % STRIDE), (0, -width % STRIDE), (0, 0))
    encoded = np.pad(linear_to_srgb(frame), padding, mode="edge") - np.array(MEAN_RGB, np.float32)
    return torch.from_numpy(np.ascontiguousarray(encoded.transpose(2, 0, 1)[None]))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch work on one thread: how it sums depends on their number, and the same frames shall give the same bytes."""
    import torch

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
        msg = f"superslomo_checkpoint: {checkpoint} has changed while the job ran; start again with one checkpoint"
        raise InputError(msg)
    return read_checkpoint(checkpoint)
