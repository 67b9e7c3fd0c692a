"""Frame raising: frames in between those of a film, so that a shutter of many rows sees motion and not a slide show.

Two ways, one interface: ``optical_flow`` needs no files, ``superslomo`` runs the published network with weights that the user
has. Every frame that was given stays as it is; only the ones in between are made.

What all raisers share: the frames that came stay, and a pair of frames gives those in between.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
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
        from simulator.importers.optical_flow import OpticalFlow

        return OpticalFlow.checked()
    if name == "superslomo":
        if checkpoint is None:
            msg = (
                "superslomo_checkpoint: got none, but raise_with is superslomo, whose weights are not part of Flatlight; "
                "give the path of SuperSloMo.ckpt, or set raise_with: optical_flow"
            )
            raise InputError(msg)
        from simulator.importers.superslomo import SuperSloMo

        return SuperSloMo.from_checkpoint(checkpoint)
    msg = f"raise_with: got {name!r}, expected one of {', '.join(get_args(RaiserName))}"
    raise InputError(msg)


Between = Callable[[NDArray[np.float32], NDArray[np.float32], list[float]], NDArray[np.float32]]
"""Two frames (H, W, 3) and N times in 0..1 -> the N frames (N, H, W, 3) at these times."""


def raise_pairs(frames: NDArray[np.float32], factor: int, between: Between) -> NDArray[np.float32]:
    """Put ``factor - 1`` frames between each two; see ``Raiser.raise_frames`` for what comes in and what goes out.

    Two equal frames have equal frames in between, which are copied: film repeats frames, and a still scene stays still.

    Args:
        frames: ``(T, H, W, 3)`` float32, linear.
        factor: 1 or more.
        between: makes the frames between two different ones.

    Raises:
        InputError: when shape, type, values or the factor are wrong.
    """
    check_frames(frames, factor)
    count, height, width, _ = frames.shape
    raised = np.empty(((count - 1) * factor + 1, height, width, 3), np.float32)
    raised[::factor] = frames
    if factor == 1:
        return raised
    times = [step / factor for step in range(1, factor)]
    for index, (first, second) in enumerate(pairwise(frames)):
        inner = raised[index * factor + 1 : (index + 1) * factor]
        inner[:] = first if np.array_equal(first, second) else between(first, second, times)
    return raised


def check_frames(frames: NDArray[np.float32], factor: int) -> None:
    """Refuse what cannot be raised.

    Raises:
        InputError: when shape, type, values or the factor are wrong.
    """
    if isinstance(factor, bool) or not isinstance(factor, int | np.integer) or factor < 1:
        msg = f"factor: got {factor!r}, expected a whole number, 1 or more (1 leaves the frames as they are)"
        raise InputError(msg)
    if frames.ndim != 4 or frames.shape[-1] != 3 or 0 in frames.shape or frames.dtype != np.float32:
        msg = f"frames: got {frames.dtype} {frames.shape}, expected float32 (T, H, W, 3) with at least one frame and pixel"
        raise InputError(msg)
    if not np.all(np.isfinite(frames)) or frames.min() < 0:
        msg = "frames: got NaN, inf or negative values, expected linear light: mend the film or leave the clip out"
        raise InputError(msg)
