"""PNG of 16 bit colour, or grey with alpha, all bits of it: Pillow silently keeps the upper byte only.

Source: W3C, Portable Network Graphics (PNG) Specification (Third Edition), sections 5 (chunks) and 9 (filters).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {2: 3, 4: 2, 6: 4}  # by the type of colour: RGB, grey with alpha, RGBA


def is_deep_png(head: bytes) -> bool:
    """Whether a file that begins with these bytes, 26 at least, is such a PNG."""
    return head[:8] == _SIGNATURE and len(head) >= 26 and head[24] == 16 and head[25] in _CHANNELS


def decode_deep_png(data: bytes) -> NDArray[np.uint16]:
    """Return ``(H, W, C)`` of a file for which `is_deep_png` holds: 2 channels are grey and alpha, 3 RGB, 4 RGBA.

    Raises:
        ValueError: damaged, cut short, interlaced, or with one colour that is transparent.
    """
    chunks = list(_chunks(data))
    if not chunks or chunks[-1][0] != b"IEND":
        msg = "its end is missing"
        raise ValueError(msg)
    columns, rows, _, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[0][1])
    if interlaced or any(kind == b"tRNS" for kind, _ in chunks):
        msg = "interlaced, or with a transparent colour; save it without"
        raise ValueError(msg)
    bytes_per_pixel = 2 * _CHANNELS[colour]
    size = rows * (1 + columns * bytes_per_pixel)
    reader = zlib.decompressobj()
    raw = reader.decompress(b"".join(content for kind, content in chunks if kind == b"IDAT"), size + 1)
    if len(raw) != size:
        msg = f"{len(raw)} bytes of pixels, expected {size}"
        raise ValueError(msg)
    lines = np.frombuffer(raw, np.uint8).reshape(rows, -1)
    values = _unfiltered(lines[:, 0], lines[:, 1:].reshape(rows, columns, bytes_per_pixel))
    return values.view(">u2").astype(np.uint16)


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield kind and content of each chunk, its checksum proven."""
    place = len(_SIGNATURE)
    while place < len(data):
        length, kind = struct.unpack_from(">I4s", data, place)
        content = data[place + 8 : place + 8 + length]
        (checksum,) = struct.unpack_from(">I", data, place + 8 + length)
        if zlib.crc32(kind + content) != checksum:
            msg = f"its chunk {kind!r} does not match its checksum"
            raise ValueError(msg)
        yield kind, content
        place += 12 + length


def _unfiltered(filters: NDArray[np.uint8], coded: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Undo the filter of each row, ``(H,)``, on its bytes ``(H, W, B)``: each is coded by its left and upper neighbours.

    All pixels of a diagonal at once, since their neighbours lie on the two before it: diagonal ``row + column`` of ``row`` is
    what the arrays hold, black before the first row and column.
    """
    if filters.max(initial=0) > 4:
        msg = f"unknown filter {filters.max()}"
        raise ValueError(msg)
    rows, columns, size = coded.shape
    row, column = np.indices((rows, columns), sparse=True)
    differences = np.zeros((rows + columns - 1, rows, size), np.int16)
    differences[row + column, row] = coded
    found = np.zeros((rows + columns + 1, rows + 1, size), np.int16)
    by_filter = [np.flatnonzero(filters == kind) for kind in range(5)]
    inside = np.zeros((rows + columns - 1, rows, 1), bool)
    inside[row + column, row] = True
    for step, difference in enumerate(differences):
        left, above, before = found[step + 1, 1:], found[step + 1, :-1], found[step, :-1]
        value = found[step + 2, 1:]
        value[:] = difference
        for kind, these in enumerate(by_filter):
            if kind and these.size:
                value[these] += _guess(kind, left[these], above[these], before[these])
        value &= 255
        value *= inside[step]
    return found[2:, 1:][row + column, row].astype(np.uint8)


def _guess(
    kind: int, left: NDArray[np.int16], above: NDArray[np.int16], before: NDArray[np.int16]
) -> NDArray[np.int16]:
    """Return what filter 1 (sub), 2 (up), 3 (average) or 4 (Paeth) expects of bytes with these neighbours."""
    if kind < 4:
        return (left, above, (left + above) >> 1)[kind - 1]
    to_left, to_above = np.abs(above - before), np.abs(left - before)
    to_before = np.abs(left + above - 2 * before)
    other = np.where(to_above <= to_before, above, before)
    return np.where((to_left <= to_above) & (to_left <= to_before), left, other)
