"""Frame raising: frames in between those of a film, so that a shutter of many rows sees motion and not a slide show.

Two ways, one interface: ``optical_flow`` needs no files, ``superslomo`` runs the published network with weights that the user
has. Every frame that was given stays as it is; only the ones in between are made.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

RaiserName = Literal["optical_flow", "superslomo"]
"""The ways to raise frames, as a configuration names them."""


class Raiser(Protocol):
    """Makes frames in between. Cheap to hold and to pickle; the same frames give the same bytes, in any process.

    Attributes:
        packages: what computes them, as pip knows it; its version counts in the data set's fingerprint.
    """

    packages: ClassVar[tuple[str, ...]]

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Files whose contents decide what comes out; they are hashed into the data set's fingerprint."""
        ...

    def raise_frames(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two.

        Args:
            frames: linear light ``(T, H, W, 3)``, float32, finite and not negative; 1 is white of the film. Brighter light is
                carried through.
            factor: frames that one becomes, 1 or more.

        Returns:
            ``((T - 1) * factor + 1, H, W, 3)``, float32, finite and not negative; frame ``i * factor`` is frame ``i``, bit
            for bit.

        Raises:
            InputError: when shape, type, values or the factor break these rules.
        """
        ...

    def record(self) -> dict[str, Any]:
        """Return what the frames are made by, JSON-serialisable; it is stored with each sample."""
        ...


def build_raiser(name: RaiserName, checkpoint: Path | None = None) -> Raiser:
    """Return the raiser of a name.

    Args:
        name: ``optical_flow`` or ``superslomo``.
        checkpoint: the weights of ``superslomo``: the public ``SuperSloMo.ckpt``, or the same tensors as ``.safetensors``.

    Raises:
        InputError: for an unknown name, a checkpoint that is missing, unreadable or not asked for, or a package that is not
            installed.
    """
    if name == "optical_flow":
        if checkpoint is not None:
            msg = (
                f"superslomo_checkpoint: got {checkpoint}, but raise_with is optical_flow, which takes no weights; "
                "set raise_with: superslomo, or leave the checkpoint out"
            )
            raise InputError(msg)
        from simulator.importers.raising.optical_flow import OpticalFlow

        return OpticalFlow.checked()
    if name == "superslomo":
        if checkpoint is None:
            msg = (
                "superslomo_checkpoint: got none, but raise_with is superslomo, whose weights are not part of Flatlight; "
                "give the path of SuperSloMo.ckpt, or set raise_with: optical_flow"
            )
            raise InputError(msg)
        from simulator.importers.raising.superslomo import SuperSloMo

        return SuperSloMo.from_checkpoint(checkpoint)
    msg = f"raise_with: got {name!r}, expected one of {', '.join(get_args(RaiserName))}"
    raise InputError(msg)
