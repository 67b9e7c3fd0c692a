"""A trained network's weights in one for another camera: what belongs to a depth plane is resampled, the rest copied."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.camera import CaptureModel
from learning.checkpoint import Checkpoint, check_shapes
from learning.models import build_network
from learning.models.flatnet import FlatNet, PlaneWeights
from simulator.errors import InputError


def transfer(network: FlatNet, checkpoint: Checkpoint) -> list[str]:
    """Put a checkpoint's weights into a network of the same architecture for another camera.

    What belongs to a plane (P, lambda, the soft head's choice) is interpolated linearly between the checkpoint's planes, at
    the same share of the range of disparities (0 for the farthest plane, 1 for the nearest, whatever their depths are). The
    first convolution then sees the new volumes interpolated at the checkpoint's planes, so that a volume that is linear over
    the planes has the same response; a choice, whose weights add up to 1, is shared out among the checkpoint's planes, each
    weight between the two beside it. Refinements that the checkpoint lacks begin anew.

    Args:
        network: for the other camera; changed in place.
        checkpoint: as `load_checkpoint` gives it without another camera.

    Returns:
        One line for every group of weights: what was copied, what resampled.

    Raises:
        InputError: another architecture, or other channels, naming the checkpoint's file; the network stays as it was.
    """
    own, found = network.state_dict(), checkpoint.network.state_dict()
    if type(network) is not type(checkpoint.network) or not isinstance(checkpoint.network, FlatNet):
        kinds = f"got a {type(checkpoint.network).__name__}, expected a {type(network).__name__}"
        raise InputError(checkpoint.path, f"{kinds}; take a checkpoint of the same network")
    mine, other = network.inversion.channels, checkpoint.network.inversion.channels
    if mine != other:
        raise InputError(checkpoint.path, f"its camera has the channels {', '.join(other)}, expected {', '.join(mine)}")
    new, old = network.inversion.disparities, checkpoint.network.inversion.disparities
    same = len(new) == len(old) and np.allclose(new, old, atol=1e-6)
    known = checkpoint.network.plane_weights
    alike = network.plane_weights[: len(known)] == known  # else refused for its shapes
    taken = found | _resampled(known, found, old, new) if alike and not same else dict(found)
    further = tuple(f"refinements.{n}." for n in range(len(known) - 1, len(network.refinements)))
    anew = {key: value for key, value in own.items() if key.startswith(further)} if further else {}
    cure = f"take a checkpoint of the same size, or build the network with its numbers: {checkpoint.named}"
    check_shapes(own, taken | anew, str(checkpoint.path), f"; {cure}")
    network.load_state_dict(taken | anew)
    changed = [name for name in taken if taken[name] is not found[name]]
    copied = f"copied the other {len(taken) - len(changed)} tensors"
    return [
        *(f"resampled {name} from {len(old)} to {len(new)} planes" for name in changed),
        f"copied all {len(taken)} tensors: the planes lie alike" if same else copied,
        *(
            [f"{len(further)} refinement{'s' * (len(further) > 1)} of {len(anew)} tensors, not in it, begin anew"]
            if anew
            else []
        ),
    ]


def for_camera(checkpoint: Checkpoint, capture: CaptureModel) -> FlatNet:
    """Return a checkpoint's FlatNet for another camera, whose planes and PSFs may differ.

    Torch's generator stays where it is.
    """
    with torch.random.fork_rng(devices=[]):
        network = build_network(capture, **checkpoint.named)
    assert isinstance(network, FlatNet)
    transfer(network, checkpoint)
    return network


def plane_mixing(old: NDArray[np.float64], new: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weights ``(new, old)`` that interpolate linearly from old disparities to new ones, both decreasing.

    Example:
        >>> plane_mixing(np.array([1.0, 0.0]), np.array([1.0, 0.75, 0.0])).tolist()
        [[1.0, 0.0], [0.75, 0.25], [0.0, 1.0]]
    """
    unit = np.eye(len(old))
    return np.stack([np.interp(new, old[::-1], row[::-1]) for row in unit], axis=1)


def _resampled(
    bodies: list[PlaneWeights], found: dict[str, Tensor], old: NDArray[np.float64], new: NDArray[np.float64]
) -> dict[str, Tensor]:
    """Return the weights that belong to planes, for the new ones."""
    forth, back = (torch.from_numpy(plane_mixing(*order)).float() for order in ((old, new), (new, old)))
    changed: dict[str, Tensor] = {}
    for planes in bodies:
        changed |= _resampled_body(planes, found, forth, back)
    return changed


def _resampled_body(planes: PlaneWeights, found: dict[str, Tensor], forth: Tensor, back: Tensor) -> dict[str, Tensor]:
    """Return these weights of one body and its inversions, by the mixing of planes forth, old to new, and back."""
    old = len(back)
    changed = {name: torch.einsum("no,o...->n...", forth, found[name]) for name in planes.per_plane}
    # Planes are the slowest of a volume's channels, before those of a stem; what follows the volumes has no plane.
    first = found[planes.first]
    of_planes = planes.volumes * old * planes.width
    volumes = first[:, :of_planes].unflatten(1, (-1, old, planes.width))
    light, choice = volumes.split([planes.width - planes.choice, planes.choice], dim=3)
    mixed = [torch.einsum("fvow...,on->fvnw...", light, back), torch.einsum("fvow...,no->fvnw...", choice, forth)]
    changed[planes.first] = torch.cat([torch.cat(mixed, dim=3).flatten(1, 3), first[:, of_planes:]], dim=1)
    for name in planes.last:
        fixed, chosen = found[name].split([planes.fixed, old * planes.stem], dim=0)
        mixed = torch.einsum("no,os...->ns...", forth, chosen.unflatten(0, (old, planes.stem))).flatten(0, 1)
        changed[name] = torch.cat([fixed, mixed])
    return changed
