"""Filters of fields whose transfer function is even in both frequencies, in blocks of rows that stay in the cache.

Free space treats left and right, up and down alike, so one quadrant of a transfer function stands for all of it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from simulator.arrays import Array, fft, fft_threads, ifft, is_torch, namespace

Quadrant = Callable[[slice], Array]  # rows of a transfer function from zero to Nyquist: (rows, W // 2 + 1)
_BLOCK = 2**17  # samples: about a megabyte of complex64


def even_filter(field: Array, shape: tuple[int, ...], quadrant: Quadrant, *, overwrite: bool = False) -> Array:
    """Zero-pad a field, multiply its spectrum by an even function and return the field's own window.

    Rows of zeros on the way in and rows that the window does not keep on the way out are left out of the transforms.

    Args:
        field: complex ``(..., h, w)``.
        shape: H, W of the padded grid.
        quadrant: gives rows of the function, out of 0..H // 2, with columns 0..W // 2.
        overwrite: lets NumPy reuse the field's memory, which it can where h = H.
    """
    height, width = field.shape[-2:]
    columns = fft(field, shape[0], -2, overwrite=overwrite)

    def filter_rows(rows: slice, weights: Array) -> None:
        spectrum = fft(columns[..., rows, :], shape[1], -1)
        spectrum *= weights
        columns[..., rows, :] = ifft(spectrum, -1, overwrite=True)[..., :width]

    each_rows(field, shape, quadrant, filter_rows)
    return ifft(columns, -2, overwrite=True)[..., :height, :]


def multiply_even(spectrum: Array, quadrant: Array) -> Array:
    """Multiply a spectrum by a function that is even in both frequencies.

    Args:
        spectrum: ``(..., H, W)`` in FFT order.
        quadrant: the function from zero to Nyquist, ``(H // 2 + 1, W // 2 + 1)``.
    """
    product = namespace(spectrum).empty_like(spectrum)

    def multiply(rows: slice, weights: Array) -> None:
        product[..., rows, :] = spectrum[..., rows, :] * weights

    each_rows(spectrum, spectrum.shape[-2:], quadrant.__getitem__, multiply)
    return product


def each_rows(like: Array, shape: tuple[int, ...], quadrant: Quadrant, work: Callable[[slice, Array], None]) -> None:
    """Call ``work(rows, weights)`` once for every block of rows of a spectrum, with an even function's weights there.

    Args:
        like: an array of the spectrum's kind: torch gets blocks as large as possible.
        shape: H, W of the spectrum.
        quadrant: as in ``even_filter``.
        work: its weights are ``(rows, W)``.
    """
    height, width = shape
    xp = namespace(like)

    def both_signs(rows: slice) -> None:
        weights = quadrant(rows)
        weights = xp.concat([weights, xp.flip(weights[:, 1 : (width + 1) // 2], axis=1)], axis=1)
        work(rows, weights)
        # The negative frequencies repeat all rows but zero and, for an even height, Nyquist.
        first, stop = max(rows.start, 1), min(rows.stop, (height + 1) // 2)
        if first < stop:
            mirrored = xp.flip(weights[first - rows.start : stop - rows.start], axis=0)
            work(slice(height - stop + 1, height - first + 1), mirrored)

    in_threads(both_signs, blocks(like, height // 2 + 1, width))


def blocks(like: Array, length: int, width: int, least: int = 8) -> list[slice]:
    """Cut a length into slices of which each, ``width`` samples wide, stays in the cache; torch gets one slice."""
    step = length if is_torch(like) else max(least, _BLOCK // width // 8 * 8)  # whole cache lines
    return [slice(start, min(start + step, length)) for start in range(0, length, step)]


def in_threads(work: Callable[[slice], None], parts: list[slice], threads: int | None = None) -> None:
    """Call ``work`` for every part, on as many threads as given or as FFTs may use; the parts do not depend on the number."""
    threads = min(threads or fft_threads(), len(parts))
    if threads == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, parts))
