"""What networks over several scales share: checked sizes, images of any size, a stem that folds pixels into channels."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch.nn.functional as nnf
from torch import Tensor, nn

from simulator.errors import InputError
from simulator.text import show


class MultiScaleNetwork(nn.Module):
    """An image-to-image network whose body wants sides that halve ``levels - 1`` times, for images of any size.

    Attributes:
        first_weight: name of the first convolution's weights, whose inputs are the network's.
        head: the last convolution, whose outputs are the network's.
    """

    first_weight: ClassVar[str]
    head: nn.Conv2d | nn.Conv3d

    def __init__(
        self, inputs: int, outputs: int, *, filters: int, levels: int, dimensions: int, stem: int, **others: int
    ) -> None:
        """Check the sizes and keep those that images are brought to; ``others`` are checked, too: 1 to 4096.

        Args:
            inputs: channels of the input.
            outputs: channels of the output.
            filters: channels of the first level; each further level has twice as many.
            levels: how many, the first included.
            dimensions: 2 for ``(B, C, h, w)``, 3 for ``(B, C, T, h, w)``.
            stem: blocks of so many pixels per side become channels before, and pixels again after the network: 2 makes it
                four times cheaper per filter; 1 for none. Only in 2D.
            **others: further numbers of layers or channels.

        Raises:
            InputError: for numbers below one or far beyond any network's, other dimensions, or a stem in 3D.
        """
        super().__init__()
        for name, value, most in (
            ("inputs", inputs, 2**16),
            ("outputs", outputs, 2**16),
            ("filters", filters, 2**12),
            ("levels", levels, 12),
            ("stem", stem, 32),
            *((name, value, 2**12) for name, value in others.items()),
        ):
            if not isinstance(value, int) or not 1 <= value <= most:
                raise InputError(name, f"got {show(value)}, expected 1 to {most}")
        if dimensions not in (2, 3) or (dimensions == 3 and stem > 1):
            raise InputError("dimensions", f"got {dimensions} with stem {stem}; expected 2, or 3 with stem 1")
        self.dimensions, self.stem, self.levels = dimensions, stem, levels

    @abstractmethod
    def body(self, image: Tensor) -> Tensor:
        """Return ``(B, outputs * stem ** 2, ...)`` of ``(B, inputs * stem ** 2, ...)``, each side divisible as needed."""

    def forward(self, image: Tensor) -> Tensor:
        """Return ``(B, outputs, ...)`` of ``(B, inputs, ...)``, any size: odd ones are continued at their ends."""
        size = image.shape[2:]
        multiple = self.stem * 2 ** (self.levels - 1)
        depth = [multiple // self.stem] * (self.dimensions - 2)
        missing = [-length % many for length, many in zip(size, [*depth, multiple, multiple], strict=True)]
        if any(missing):
            image = nnf.pad(image, [n for extra in reversed(missing) for n in (0, extra)], mode="replicate")
        if self.stem > 1:
            image = nnf.pixel_unshuffle(image, self.stem)
        image = self.body(image)
        if self.stem > 1:
            image = nnf.pixel_shuffle(image, self.stem)
        return image[(..., *(slice(length) for length in size))]
