"""What an exposure is worth: how many of the stored values are saturated, black or below the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np


@dataclass(frozen=True)
class ExposureShares:
    """Shares of the stored values, each 0 to 1; a value may be black and below the noise.

    Attributes:
        saturated: expected to reach full scale, with the dark current.
        black: the light adds less than half of the smallest step between stored numbers: 0, or the black level.
        below_noise: the light is fainter than the standard deviation of the noise in darkness.
        signal: none of these.
    """

    saturated: float
    black: float
    below_noise: float
    signal: float

    @classmethod
    def mean(cls, several: Sequence[Self]) -> Self:
        """Return the shares over several images of one size."""
        return cls(*(float(np.mean([getattr(one, entry.name) for one in several])) for entry in fields(cls)))

    @property
    def record(self) -> dict[str, float]:
        """The shares as a sample's metadata hold them: ``saturated_share`` and so on."""
        return {f"{entry.name}_share": getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def from_record(cls, metadata: Mapping[str, Any]) -> Self | None:
        """Return the shares in a sample's metadata; None where some are missing."""
        found = [metadata.get(f"{entry.name}_share") for entry in fields(cls)]
        return None if None in found else cls(*(float(share) for share in found if share is not None))

    def __str__(self) -> str:
        return f"{self.saturated:.2%} of the values saturated, {self.black:.2%} black, {self.below_noise:.2%} below the noise"
