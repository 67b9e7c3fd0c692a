"""Warm start: what a network learned for one camera, put into the network of another camera with other planes."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.checkpoint import Checkpoint
from learning.models.flatnet import FlatNet
from simulator.errors import InputError

_PER_PLANE = ("inversion.filters", "inversion.log_lambda")
_FIRST = "enhancement.down.0.0.weight"


def transfer(network: FlatNet, checkpoint: Checkpoint) -> list[str]:
    """Put a checkpoint's weights into a network of the same architecture for another camera.

    P and lambda of a plane are interpolated linearly between the checkpoint's planes, at the same share of the range of
    disparities (0 for the farthest plane, 1 for the nearest, whatever their depths are). The first convolution then sees the
    new volume interpolated at the checkpoint's planes, so that a volume that is linear over the planes has the same response.

    Args:
        network: for the other camera; changed in place.
        checkpoint: as `load_checkpoint` gives it without another camera.

    Returns:
        One line for every group of weights: what was copied, what resampled.

    Raises:
        InputError: another architecture, or other channels; the network stays as it was.
    """
    own, found = network.state_dict(), checkpoint.network.state_dict()
    if type(network) is not type(checkpoint.network):
        msg = (
            f"checkpoint: got a {type(checkpoint.network).__name__}, expected a {type(network).__name__}; start from a "
            "checkpoint of the same network"
        )
        raise InputError(msg)
    mine, other = network.inversion.channels, checkpoint.network.inversion.channels
    if mine != other:
        msg = f"checkpoint: its camera has the channels {', '.join(other)}, expected {', '.join(mine)}"
        raise InputError(msg)
    new, old = network.inversion.disparities, checkpoint.network.inversion.disparities
    same = len(new) == len(old) and np.allclose(new, old, atol=1e-6)
    taken = dict(found) if same else found | _resampled(found, old, new)
    for name in own.keys() | taken.keys():
        got, wanted = _shape(taken, name), _shape(own, name)
        if got != wanted:
            msg = (
                f"checkpoint: {name} has the shape {got}, expected {wanted}; start from a checkpoint of the same size, or "
                f"build the network with its numbers: {checkpoint.architecture}"
            )
            raise InputError(msg)
    network.load_state_dict(taken)
    if same:
        return [f"copied all {len(taken)} tensors: the planes lie alike"]
    rest = len(taken) - len(_PER_PLANE) - 1
    planes = f"from {len(old)} to {len(new)} planes"
    return [*(f"resampled {name} {planes}" for name in (*_PER_PLANE, _FIRST)), f"copied the other {rest} tensors"]


def plane_mixing(old: NDArray[np.float64], new: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights ``(new, old)`` that interpolate linearly from old disparities to new ones.

    Args:
        old: disparities of the planes that are known, 0..1, decreasing.
        new: those that are wanted, decreasing.

    Example:
        >>> plane_mixing(np.array([1.0, 0.0]), np.array([1.0, 0.75, 0.0])).tolist()
        [[1.0, 0.0], [0.75, 0.25], [0.0, 1.0]]
    """
    unit = np.eye(len(old))
    return np.stack([np.interp(new, old[::-1], row[::-1]) for row in unit], axis=1)


def _resampled(found: dict[str, Tensor], old: NDArray[np.float64], new: NDArray[np.float64]) -> dict[str, Tensor]:
    """Return the weights that belong to planes, for the new ones."""
    forth, back = (torch.from_numpy(plane_mixing(*order)).float() for order in ((old, new), (new, old)))
    changed = {name: torch.einsum("no,o...->n...", forth, found[name]) for name in _PER_PLANE}
    first = found[_FIRST]
    planes = first.unflatten(1, (len(old), -1))  # planes are the slowest of the channels, before those of a stem
    changed[_FIRST] = torch.einsum("fo...,on->fn...", planes, back).flatten(1, 2)
    return changed


def _shape(tensors: dict[str, Tensor], name: str) -> str | tuple[int, ...]:
    return tuple(tensors[name].shape) if name in tensors else "nothing"
