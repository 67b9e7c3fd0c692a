"""The grid on which a mask is designed, refused before it is allocated when the machine could not hold it."""

from __future__ import annotations

from simulator.optics.memory import require_memory

# The hungriest design (vortex) holds 40 bytes per sample at its peak, the leanest 10, as tracemalloc counts them.
_BYTES_PER_SAMPLE = 40


def samples_across(width_um: float, pixel_um: float) -> int:
    """Return how many samples make a side of a square mask, whose grid is sure to fit into memory.

    Args:
        width_um: side of the mask, micrometres.
        pixel_um: sample of its grid, micrometres.

    Raises:
        InputError: as :func:`require_mask_memory`.

    Example:
        >>> samples_across(3000, 2)
        1500
    """
    samples = round(width_um / pixel_um)
    require_mask_memory((samples, samples))
    return samples


def require_mask_memory(shape: tuple[int, int]) -> None:
    """Refuse a mask's grid of so many rows and columns that designing on it would exceed the machine's memory.

    Raises:
        InputError: naming ``pixel_um``, with the estimate and the limit.
    """
    require_memory("pixel_um", shape, 1, _BYTES_PER_SAMPLE, "use a coarser pixel or a narrower mask")
