"""Tiny films for the tests of importers."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

LOWEST, STEP = 20, 5
"""Grey code of frame 0, and how much brighter each next one is: so a frame shows its number whatever codec wrote it."""


def _numbered(count: int, size: tuple[int, int] = (48, 64)) -> list[np.ndarray]:
    """Grey RGB pictures, each as bright as its number says; the left upper quarter is black, to tell a turn."""
    pictures = []
    for number in range(count):
        picture = np.full((*size, 3), LOWEST + STEP * number, np.uint8)
        picture[: size[0] // 2, : size[1] // 2] = 0
        pictures.append(picture)
    return pictures


def _number_of(linear: np.ndarray) -> int:
    """The number that a frame of linear light shows in its right lower part."""
    encoded = 255 * (1.055 * float(linear[-8:, -8:].mean()) ** (1 / 2.4) - 0.055)
    return round((encoded - LOWEST) / STEP)


def _write(
    path: Path,
    pictures: list[np.ndarray],
    *,
    codec: str = "libvpx-vp9",
    rate: int = 12,
    pixels: str = "yuv420p",
    key_every: int | None = None,
    picture_format: str = "rgb24",
    times_ms: list[int] | None = None,
    options: dict[str, str] | None = None,
    container: str | None = None,
    colour: dict[str, int] | None = None,
) -> Path:
    """Encode pictures ``(H, W, 3)`` with PyAV."""
    av = pytest.importorskip("av")
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w", format=container) as film:
        stream = film.add_stream(codec, rate=rate, options=options or {})
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt = pixels
        stream.codec_context.thread_count = 1
        if key_every is not None:
            stream.codec_context.gop_size = key_every
        for name, value in (colour or {}).items():
            setattr(stream.codec_context, name, value)
        packets: list[Any] = []
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format=picture_format)
            if colour and "colorspace" in colour:
                frame = frame.reformat(format=pixels, dst_colorspace=colour["colorspace"])
                frame.colorspace = colour["colorspace"]
            frame.pts = number if times_ms is None else times_ms[number]
            frame.time_base = Fraction(1, rate) if times_ms is None else Fraction(1, 1000)
            packets += stream.encode(frame)
        if times_ms is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        packets += stream.encode()
        for packet in packets:
            film.mux(packet)
    return path


def _edit_packet(path: Path, number: int, change: Callable[[int], int]) -> None:
    """Change the first byte of a packet where it lies in the file."""
    av = pytest.importorskip("av")
    with av.open(str(path)) as film:
        packets = [bytes(packet) for packet in film.demux(video=0) if packet.size]
    content = bytearray(path.read_bytes())
    place = 0
    for packet in packets[:number]:  # one after the other, as packets may be alike
        place = content.index(packet, place) + len(packet)
    place = content.index(packets[number], place)
    content[place] = change(content[place])
    path.write_bytes(content)


@pytest.fixture(scope="session")
def films() -> SimpleNamespace:
    """Functions that make films and read numbers off frames: ``write``, ``numbered``, ``number_of``, ``edit_packet``."""
    return SimpleNamespace(write=_write, numbered=_numbered, number_of=_number_of, edit_packet=_edit_packet)
