"""How pixels become stored values: bins that hold all colours, or a mosaic of one colour each.

The colour filter array belongs to the physical sensor, whose image is stored rotated by 180 degrees: stored pixel
``(i, j)`` of ``H x W`` is the physical window's pixel ``(H - 1 - i, W - 1 - j)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, like, namespace, normal
from simulator.errors import InputError

COLOURS = ("R", "G", "B")
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
MOSAIC = ("mosaic",)
BAYER_SHARE = (0.25, 0.5, 0.25)  # of the physical pixels in a bin, for R, G, B


@dataclass(frozen=True)
class BinnedReadout:
    """Every stored value has all colours: a colour's value is the digital mean of its pixels in the bin.

    A bin of at least 2 x 2 holds a quarter red, half green and a quarter blue pixels (Bayer). Below, a stored value is one
    idealised pixel per colour; light of one channel is seen by all pixels.

    All colours are taken to lie in the bin's middle. In a real bin red's pixels have their centroid half a physical pixel
    towards its corner of the pattern and blue's as far the other way, so red and blue images lie 1 / binning of a bin apart
    (of a PhlatCam's PSF, 1.5 mm at 1.9 mm, half of that is 10 % at bins of 8, 19.2 um). It is left out in the measurement
    and its PSFs alike; a calibration of a real camera has it in its PSFs.

    Attributes:
        binning: physical pixels per side of a bin.
    """

    binning: int

    def extent(self, stored: int) -> int:
        """Return how many physical rows (or columns) so many stored ones reach over."""
        return stored * self.binning

    def channels(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the stored image's channels: the light's own."""
        return names

    def read(self, signal: Array) -> Array:
        """Return what the stored values see of the light ``(C, H, W)``: the light itself."""
        return signal

    def spread(self, per_channel: tuple[float, ...]) -> NDArray[np.float64]:
        """Return a number per channel of the light, ``(C, 1, 1)``: a shape that fits what ``read`` returns."""
        return np.asarray(per_channel, np.float64)[:, None, None]

    def pixels(self, channels: int) -> NDArray[np.float64]:
        """Return how many physical pixels a stored value averages, ``(C, 1, 1)``."""
        in_bin = self.binning**2
        if not self._is_bayer(channels):
            return np.full((channels, 1, 1), float(in_bin))
        return self.spread(tuple(max(1.0, in_bin * share) for share in BAYER_SHARE))

    def rows(self, channels: int) -> NDArray[np.float64]:
        """Return how many physical rows a stored value's pixels lie in, ``(C, 1, 1)``; see ``row_errors``."""
        share = (0.5, 1.0, 0.5) if self._is_bayer(channels) else (1.0,) * channels
        return self.spread(tuple(self.binning * part for part in share))

    def row_errors(self, signal: Array, std: float, rng: Any) -> Array:
        """Return the mean error of the physical rows behind each stored row, each with ``std``: ``(C or 1, H, 1)``.

        Of a Bayer bin's rows one half holds red and green pixels, the other green and blue: red and blue see different
        errors, green sees both.
        """
        if not self._is_bayer(signal.shape[0]):
            return normal(rng, signal[:1, :, :1]) * (std / self.binning**0.5)
        with_red, with_blue = normal(rng, signal[:2, :, :1]) * (std / (self.binning / 2) ** 0.5)
        return namespace(signal).stack([with_red, (with_red + with_blue) / 2, with_blue])

    def _is_bayer(self, channels: int) -> bool:
        return channels == 3 and self.binning >= 2


@dataclass(frozen=True)
class BayerReadout:
    """Every stored value has one colour, as raw files do.

    With bins of b x b, a stored value is the mean of b x b pixels of one colour, every second one of 2b - 1 rows and
    columns, and the mosaic keeps its pattern. Their light is taken to be that of the forward model's square bin: that they
    lie up to b / 2 physical pixels further apart is left out, as is (b - 1) / 2 line times of a rolling shutter.

    Attributes:
        binning: physical pixels of one colour per side of a bin.
        pattern: the colours of the physical window's upper left 2 x 2 values, row by row.
        shape: stored rows and columns, H and W.
    """

    binning: int
    pattern: str
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise InputError("cfa", f"got {self.pattern!r}, expected one of {', '.join(PATTERNS)}")

    @property
    def stored_pattern(self) -> str:
        """The colours of the stored image's upper left 2 x 2 values, row by row.

        Example:
            >>> BayerReadout(1, "RGGB", (4, 6)).stored_pattern, BayerReadout(1, "RGGB", (5, 6)).stored_pattern
            ('BGGR', 'GRBG')
        """
        rows, columns = self.shape
        return "".join(self.pattern[2 * ((rows - 1 - i) % 2) + (columns - 1 - j) % 2] for i in (0, 1) for j in (0, 1))

    def colour_map(self) -> NDArray[np.intp]:
        """Return the index in R, G, B of every stored value's colour, ``(H, W)``."""
        tile = np.array([COLOURS.index(colour) for colour in self.stored_pattern]).reshape(2, 2)
        rows, columns = self.shape
        return np.tile(tile, (rows // 2 + 1, columns // 2 + 1))[:rows, :columns]

    def extent(self, stored: int) -> int:
        """Return how many physical rows (or columns) so many stored ones reach over."""
        return stored * self.binning + (self.binning - 1) * (stored % 2)

    def channels(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return ``("mosaic",)``.

        Raises:
            InputError: when the light is not red, green and blue.
        """
        if tuple(names) != COLOURS:
            self._refuse(", ".join(names))
        return MOSAIC

    def read(self, signal: Array) -> Array:
        """Return ``(1, H, W)``: of every pixel the value of its colour."""
        if signal.shape[0] != 3:
            self._refuse(f"{signal.shape[0]} channels")
        xp, colours = namespace(signal), self.colour_map()
        red, green, blue = signal
        is_red, is_blue = (like(colours == n, signal, xp.bool) for n in (0, 2))
        return xp.where(is_red, red, xp.where(is_blue, blue, green))[None]

    def spread(self, per_channel: tuple[float, ...]) -> NDArray[np.float64]:
        """Return ``(1, H, W)``."""
        return np.asarray(per_channel, np.float64)[self.colour_map()][None]

    def pixels(self, channels: int) -> NDArray[np.float64]:
        """Return ``(1, 1, 1)``."""
        return np.full((1, 1, 1), float(self.binning**2))

    def rows(self, channels: int) -> NDArray[np.float64]:
        """Return ``(1, 1, 1)``."""
        return np.full((1, 1, 1), float(self.binning))

    def row_errors(self, signal: Array, std: float, rng: Any) -> Array:
        """Return ``(1, H, 1)``: the b physical rows of a stored row are its own, whatever their colours."""
        return normal(rng, signal[:, :, :1]) * (std / self.binning**0.5)

    @staticmethod
    def _refuse(came: str) -> NoReturn:
        raise InputError(
            "camera.sensor.readout", f"'bayer' needs light of the channels R, G, B, got {came}; use binned_rgb"
        )
