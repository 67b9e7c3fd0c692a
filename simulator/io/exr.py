"""The one writer and the one reader of OpenEXR files, with a guard for every way they were seen to go wrong."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import StorageError, read_errors, write_atomic
from simulator.io.store import Place

_LOCK = threading.RLock()  # two threads that swap descriptors at once would leave the wrong one in place


@contextmanager
def quiet() -> Iterator[None]:
    """Silence file descriptor 2 and ``print`` for the block.

    Descriptors belong to the whole process: what *another* thread writes to stderr (or prints) during the block, some
    milliseconds around one decode, is lost too. Blocks of several threads wait for each other.
    """
    with _LOCK:
        try:
            kept = os.dup(2)
        except OSError:  # a daemon without stderr has nothing to silence
            with redirect_stdout(io.StringIO()):
                yield
            return
        try:
            if sys.stderr is not None:
                sys.stderr.flush()
            sink = os.open(os.devnull, os.O_WRONLY)
            os.dup2(sink, 2)
            os.close(sink)
            with redirect_stdout(io.StringIO()):
                yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


ATTRIBUTE = "flatlight"
"""Name of the string attribute that carries metadata and checksums."""
MAX_VALUES = 2**28
"""Rows x columns x channels that are decoded at most by default: 1 GiB of float32."""
MAX_FILE_BYTES = 4 * MAX_VALUES + (64 << 20)
"""Of a file that is read from a data set: as many values, not compressed, and its header."""
_MAX_NAME_BYTES = 255  # of the format


@dataclass(frozen=True)
class Header:
    """What a file says of itself before any pixel is decoded.

    Attributes:
        shape: rows and columns.
        channels: channel names in the file's (alphabetical) order.
        metadata: the writer's metadata; empty for files of other programs.
        checksums: CRC-32 per channel, or None for files of other programs.
    """

    shape: tuple[int, int]
    channels: tuple[str, ...]
    metadata: dict[str, Any]
    checksums: dict[str, int] | None


def write_exr(
    path: Path | str,
    channels: Mapping[str, NDArray[np.float32]],
    metadata: Mapping[str, Any],
    *,
    finite: bool = True,
) -> bytes:
    """Write channels of one size to an OpenEXR file that appears whole or not at all, and prove that it reads back.

    Args:
        path: the final name; its folder must exist. An existing file is replaced.
        channels: float32 arrays ``(rows, columns)`` by channel name, finite, any memory layout; not changed.
        metadata: JSON-serialisable; comes back exactly from ``read_exr``; not changed.
        finite: refuse NaN and inf; without, NaN may stand for what is unknown.

    Returns:
        The bytes of the file, for hashing.

    Raises:
        InputError: a channel or the metadata cannot be stored exactly.
        StorageError: the folder cannot be written to, or the disk is full.
    """
    path = Path(path)
    clean = _checked_channels(path, channels, finite=finite)
    data = _encode(clean, _attribute(path, clean, metadata))
    decoded, _ = decode_exr(data, path, max_pixels=sum(values.size for values in clean.values()), finite=finite)
    for name, values in clean.items():
        if decoded[name].tobytes() != values.tobytes():
            msg = f"OpenEXR changed channel {name!r} of {path} while encoding it: this OpenEXR package cannot be used"
            raise RuntimeError(msg)

    def check(written: Path) -> None:
        if written.read_bytes() != data:
            raise StorageError(path, "the disk gave back other bytes than it was given. Check the disk.")

    write_atomic(path, data, check)
    return data


def read_exr(
    path: Path | str, *, max_pixels: int = MAX_VALUES, require_checksums: bool = False, finite: bool = True
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Read every channel of a single-part OpenEXR file; half floats of other programs become float32 exactly.

    Args:
        path: the file.
        max_pixels: largest rows x columns x channels that may be decoded: a tiny file can claim terabytes.
        require_checksums: refuse files that ``write_exr`` did not write.
        finite: refuse NaN and inf; renderers write inf as the depth of what they did not hit.

    Returns:
        Writable arrays ``(rows, columns)`` by channel name, and the metadata.

    Raises:
        InputError: missing, truncated, corrupt, too big, not OpenEXR, not single-part, or with values that are not finite.
    """
    path = Path(path)
    with read_errors(path):
        data = path.read_bytes()
    return decode_exr(data, path, max_pixels=max_pixels, require_checksums=require_checksums, finite=finite)


def decode_exr(
    data: bytes, path: Place, *, max_pixels: int = MAX_VALUES, require_checksums: bool = False, finite: bool = True
) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """Do what ``read_exr`` does on a file's bytes that were read already; ``path`` only names it in errors."""
    import OpenEXR

    header = _header(data, path)
    rows, columns = header.shape
    values = rows * columns * len(header.channels)
    if values > max_pixels:
        raise InputError(
            path,
            f"claims {rows} x {columns} x {len(header.channels)} values, more than max_pixels = {max_pixels}",
        )
    if require_checksums and header.checksums is None:
        raise InputError(path, f"no attribute {ATTRIBUTE!r}: not written by flatlight, or its header is damaged")
    with quiet():
        try:
            parts = OpenEXR.File(io.BytesIO(data), separate_channels=True, num_threads=0).parts
            found = dict(parts[0].channels) if len(parts) == 1 else {}
        except Exception as error:
            raise _damaged(path, str(error)) from error
    if sorted(found) != sorted(header.channels):  # OpenEXR drops what it cannot decode, without raising
        raise _damaged(path, f"channels {list(header.channels)} announced, {list(found)} readable")
    result = {name: _decoded_channel(path, header, name, channel.pixels) for name, channel in found.items()}
    for name, values in result.items():
        if finite and not np.isfinite(values).all():
            raise InputError(path, f"channel {name!r} holds NaN or inf")
    return result, header.metadata


def _checked_channels(
    path: Place, channels: Mapping[str, NDArray[np.float32]], *, finite: bool
) -> dict[str, NDArray[np.float32]]:
    if not channels:
        raise InputError(path, "cannot be written: no channels given")
    clean: dict[str, NDArray[np.float32]] = {}
    shape: tuple[int, ...] | None = None
    for name, values in channels.items():
        if not isinstance(name, str) or not name or "\0" in name or len(name.encode()) > _MAX_NAME_BYTES:
            raise InputError(path, f"got the channel name {name!r}, expected text of 1 to {_MAX_NAME_BYTES} bytes")
        if not isinstance(values, np.ndarray) or values.dtype != np.float32:
            kind = values.dtype if isinstance(values, np.ndarray) else type(values).__name__
            raise InputError(path, f"channel {name!r}: got {kind}, expected a float32 array; convert it knowingly")
        if values.ndim != 2 or values.size == 0:
            raise InputError(path, f"channel {name!r}: got {values.shape}, expected (rows, columns), not empty")
        if shape is not None and values.shape != shape:
            raise InputError(path, f"channel {name!r} is {values.shape}, the others {shape}; one file has one size")
        if finite and not np.isfinite(values).all():
            raise InputError(path, f"channel {name!r} holds NaN or inf; store finite values and a validity channel")
        shape = values.shape
        clean[name] = np.ascontiguousarray(values, dtype="<f4")  # other layouts are written WRONG, silently
    return clean


def _attribute(path: Place, channels: Mapping[str, NDArray[np.float32]], metadata: Mapping[str, Any]) -> str:
    try:
        text = json.dumps(dict(metadata), sort_keys=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InputError(path, f"metadata must be plain JSON (text, numbers, lists, dicts; no NaN): {error}") from error
    if json.loads(text) != dict(metadata):
        raise InputError(path, "metadata would not come back as given; use lists for tuples and text for keys")
    checksums = {name: zlib.crc32(values.data) for name, values in channels.items()}
    content = {"crc32": checksums, "metadata": text, "metadata_crc32": zlib.crc32(text.encode())}
    return json.dumps(content, sort_keys=True)


def _encode(channels: Mapping[str, NDArray[np.float32]], attribute: str) -> bytes:
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, ATTRIBUTE: attribute}
    stream = io.BytesIO()
    OpenEXR.File(header, dict(channels), num_threads=0).write(stream)  # both dicts are ours: it changes them
    return stream.getvalue()


def _header(data: bytes, path: Place) -> Header:
    import OpenEXR

    if data[:4] != b"\x76\x2f\x31\x01":
        raise InputError(path, f"not an OpenEXR file ({len(data)} bytes, wrong first bytes)")
    with quiet():
        try:
            parts = OpenEXR.File(io.BytesIO(data), separate_channels=True, header_only=True, num_threads=0).parts
            headers = [dict(part.header) for part in parts]
            sizes = [_size_and_names(header) for header in headers]
        except Exception as error:
            raise _damaged(path, str(error)) from error
    if len(headers) != 1:
        raise InputError(path, f"has {len(headers)} parts; only single-part files are read")
    header = headers[0]
    if header.get("type", OpenEXR.scanlineimage) not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise InputError(path, f"got type {header['type']}; only flat scanline or tiled images are read")
    shape, names = sizes[0]
    metadata, checksums = _parsed_attribute(path, header.get(ATTRIBUTE), names)
    return Header(shape, names, metadata, checksums)


def _size_and_names(header: dict[str, Any]) -> tuple[tuple[int, int], tuple[str, ...]]:
    (left, top), (right, bottom) = ((int(x), int(y)) for x, y in header["dataWindow"])
    return (bottom - top + 1, right - left + 1), tuple(channel.name for channel in header["channels"])


def _parsed_attribute(
    path: Place, attribute: object, names: tuple[str, ...]
) -> tuple[dict[str, Any], dict[str, int] | None]:
    if attribute is None:
        return {}, None
    try:
        content = json.loads(attribute if isinstance(attribute, str) else "")
        text, checksums = content["metadata"], content["crc32"]
        if zlib.crc32(text.encode()) != content["metadata_crc32"]:
            raise _damaged(path, "the metadata do not match their checksum")
        metadata = json.loads(text)
    except (KeyError, TypeError, AttributeError, json.JSONDecodeError, RecursionError) as error:
        raise _damaged(path, f"unreadable {ATTRIBUTE!r} attribute") from error
    if set(checksums) != set(names):
        raise _damaged(path, f"channels {list(names)} in the header, {sorted(checksums)} written")
    return metadata, checksums


def _decoded_channel(path: Place, header: Header, name: str, pixels: NDArray[Any]) -> NDArray[np.float32]:
    if pixels.dtype not in (np.float32, np.float16):
        raise InputError(path, f"channel {name!r} holds {pixels.dtype}; only float32 and float16 are read")
    if pixels.shape != header.shape:
        raise _damaged(path, f"channel {name!r} is {pixels.shape}, the header says {header.shape}")
    values = np.ascontiguousarray(pixels, dtype=np.float32)
    if header.checksums is not None and zlib.crc32(values.data) != header.checksums[name]:
        raise _damaged(path, f"channel {name!r} does not match its checksum")
    return values


def _damaged(path: Place, detail: str) -> InputError:
    return InputError(path, f"truncated or corrupt ({detail}); make it again or restore it from a copy")
