"""Reading films through PyAV (libav): which frames there are, and exactly those that are asked for.

A frame's number is its place in the order of showing. A film is first read without decoding, for its packets' times; frames
are then found by seeking to the key frame before them and comparing every time that comes out with the list. Where times are
missing (AVI has none) or do not fit, frames are counted from the start instead.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_image
from simulator.errors import InputError
from simulator.io.files import read_errors


class MissingPackageError(InputError):
    """A package that importers need is not installed: no fault of any file."""


def load_extra(module: str, package: str, extra: str = "import") -> ModuleType:
    """Import a package of an extra.

    Raises:
        MissingPackageError: when it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        cure = f"pip install 'flatlight[{extra}]', or in a clone uv run --extra {extra}"
        raise MissingPackageError(package, f"this importer needs it ({error}): {cure}") from error


_HDR = {16: "PQ (SMPTE ST 2084)", 18: "HLG (ARIB STD-B67)"}  # transfer characteristics of ITU-T H.273, table 3
# Its table 4: those that libav converts to RGB.
_MATRICES = {1: "BT.709", 4: "FCC", 5: "BT.601", 6: "BT.601", 7: "SMPTE 240M", 9: "BT.2020"}
_UNSPECIFIED = 2
_HD_UNTAGGED, _SD_UNTAGGED = "BT.709 (untagged)", "BT.601 (untagged)"
"""What players take untagged films for: those of high definition (720 rows or 1280 columns) follow its standard, BT.709."""
_EARLY_END = 1.5
"""Intervals by which a film may end before its header says: one is often due to rounding or to the last frame's length."""
_SOUND_S = 0.12
"""The longest packet of Opus, seconds (RFC 6716, section 2.1.4): by so much more a film with sound may end early."""
_UNEVEN = 1.5
"""Longest interval between frames in middle ones, beyond which the frame rate is called variable."""


@dataclass(frozen=True)
class FilmIndex:
    """What a film's packets say.

    Attributes:
        frames: how many images it holds.
        frames_per_second: its frame rate; of a variable one the mean.
        variable: the frames are not evenly spaced.
        times: when each frame is shown, in the stream's own units, increasing; None where the film does not say.
        keys: ``(n, 3)`` number, time of showing and time of decoding of each key frame; empty where times are None.
        square_pixels: whether a pixel is as wide as high.
        matrix: from its luma and chroma to RGB: ``BT.709`` and so on as the film says, ``BT.709 (untagged)`` or ``BT.601
            (untagged)`` by its size where it does not, or ``RGB`` where there is none.
    """

    frames: int
    frames_per_second: float
    variable: bool
    times: NDArray[np.int64] | None
    keys: NDArray[np.int64]
    square_pixels: bool
    matrix: str


def index_film(path: Path) -> FilmIndex:
    """Read a film's packets, without decoding them. The last few films are remembered as long as their files stay the same.

    Raises:
        InputError: naming the file, when it is missing, not a film, damaged, cut short or of high dynamic range.
    """
    with read_errors(path):
        state = path.stat()
    return _index(path, state.st_mtime_ns, state.st_size)


def read_film(path: Path, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
    """Give the frames ``start`` to ``stop - 1``, one after the other, upright.

    Yields:
        Linear light ``(H, W, 3)``; the film's codes are taken for sRGB, in libav's conversion from its colour matrix (see
        ``FilmIndex.matrix``) and range.

    Raises:
        InputError: naming the file, when it is damaged or holds fewer frames than its packets promise.
    """
    load_extra("av", "PyAV")
    from av.video.reformatter import Colorspace, VideoReformatter

    converter = VideoReformatter()
    index = index_film(path)
    matrix = Colorspace.ITU709 if index.matrix == _HD_UNTAGGED else None
    for frame in _frames(path, index, start, stop):
        deep = max(component.bits for component in frame.format.components) > 8
        shown = converter.reformat(frame, format="rgb48le" if deep else "rgb24", src_colorspace=matrix)
        image = shown.to_ndarray()
        yield decode_srgb_image(_upright(image, frame.rotation, path))


def count_decodable(path: Path) -> tuple[int, set[tuple[int, int]]]:
    """Decode a whole film and return how many frames came out, and their sizes (rows, columns, before any turn).

    Raises:
        InputError: naming the file, when it is damaged.
    """
    sizes: set[tuple[int, int]] = set()
    count = 0
    with _opened(path) as (container, stream):
        for frame in container.decode(stream):
            _refuse_corrupt(frame, count, path)
            sizes.add((frame.height, frame.width))
            count += 1
    return count, sizes


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a film and its video stream, and turn libav's errors into messages that name the file."""
    av = load_extra("av", "PyAV")
    try:
        with av.open(str(path)) as container:
            stream = container.streams.best("video")
            if stream is None or stream.codec_context is None:
                raise InputError(path, "holds no video that can be read: check the file")
            stream.codec_context.thread_count = 1  # jobs run one process per core already
            yield container, stream
    except av.FFmpegError as error:
        raise InputError(path, f"not a film, or is damaged or cut short ({error.strerror}): fetch it again") from error


@functools.lru_cache(maxsize=64)
def _index(path: Path, _changed_ns: int, _size: int) -> FilmIndex:
    shown: list[int | None] = []
    keys: list[tuple[int, int]] = []  # times of showing and of decoding
    seen = 0
    with _opened(path) as (container, stream):
        transfer = stream.codec_context.color_trc
        if transfer in _HDR:
            raise InputError(path, f"got high dynamic range, {_HDR[transfer]}; convert it to BT.709 or sRGB")
        avi = container.format.name == "avi"
        vp8 = stream.codec_context.name == "vp8"
        first_s, last_s = 0.0, 0.0
        for packet in container.demux():  # sound too: the film's length is that of its longest stream
            if packet.pts is not None and packet.time_base is not None:
                first_s = min(first_s, float(packet.pts * packet.time_base))
                last_s = max(last_s, float((packet.pts + (packet.duration or 0)) * packet.time_base))
            if packet.stream.index != stream.index:
                continue
            seen += packet.size > 0 or packet.dts is not None  # the last one, of no size and time, is PyAV's own
            # A VP8 packet that only serves to predict others has show_frame unset (RFC 6386, section 9.1).
            hidden = vp8 and packet.size and not memoryview(packet)[0] & 0x10
            if packet.size and not packet.is_discard and not hidden:
                shown.append(packet.pts)
                if packet.is_keyframe and packet.pts is not None:
                    keys.append((packet.pts, packet.pts if packet.dts is None else packet.dts))
        promised, rate, unit = stream.frames, stream.average_rate or stream.guessed_rate, stream.time_base
        alone = len(container.streams) == 1
        duration_s = container.duration / 1e6 if container.duration else None  # microseconds
        matrix = _matrix(stream.codec_context, path)
        square = stream.codec_context.sample_aspect_ratio in (None, 0, 1)
    if not shown:
        raise InputError(path, "holds no frames: fetch it again")
    if seen < promised:
        raise InputError(path, f"holds {seen} of the {promised} frames that its header promises: fetch it again")
    # AVI holds no times of showing: what libav makes up is the order of decoding, wrong where images are out of order.
    times = np.unique(np.array([time for time in shown if time is not None], np.int64))
    times = times if len(times) == len(shown) and not avi else None
    variable = False
    if times is not None and len(times) > 1:
        intervals = np.diff(times)
        middle = float(np.median(intervals))
        variable = float(intervals.max()) > _UNEVEN * middle
        mean = float(1 / (unit * (int(times[-1] - times[0])) / (len(times) - 1)))
        if not rate or abs(mean / float(rate) - 1) > 0.01:
            rate = mean
        ends_s = float(unit) * (float(times[-1]) + middle)
        late_s = _EARLY_END * middle * float(unit)
        if not alone:
            ends_s, late_s = max(ends_s, last_s) - first_s, late_s + _SOUND_S
        if duration_s is not None and duration_s - ends_s > late_s:
            raise InputError(path, f"ends after {ends_s:.2f} s of the {duration_s:.2f} s in its header: fetch it again")
    if not rate:
        raise InputError(path, "does not say how many frames per second it has: convert it to a film that does")
    rows = [] if times is None else [(int(np.searchsorted(times, pts)), pts, min(pts, dts)) for pts, dts in keys]
    key_table = np.array(sorted(rows), np.int64).reshape(-1, 3)
    return FilmIndex(len(shown), float(rate), variable, times, key_table, square, matrix)


def _matrix(codec: Any, path: Path) -> str:
    if codec.pix_fmt is not None and codec.format.is_rgb:
        return "RGB"
    if codec.colorspace in _MATRICES:
        return _MATRICES[int(codec.colorspace)]
    if codec.colorspace != _UNSPECIFIED:
        raise InputError(
            path,
            f"unsupported colour matrix {int(codec.colorspace)} (ITU-T H.273): convert to BT.709",
        )
    return _HD_UNTAGGED if codec.height >= 720 or codec.width >= 1280 else _SD_UNTAGGED


def _frames(path: Path, index: FilmIndex, start: int, stop: int) -> Iterator[Any]:
    """Decode frames by number: after seeking where every time fits, else counted from the start."""
    if not 0 <= start < stop <= index.frames:
        raise InputError(path, f"frames {start} to {stop - 1} were asked of {index.frames}: the file has changed")
    wanted = start
    before = index.keys[index.keys[:, 0] <= start]
    if index.times is not None and len(before) and before[-1, 0] > 0:
        number, shown, decoded = (int(value) for value in before[-1])
        with _opened(path) as (container, stream):
            container.seek(decoded, stream=stream)
            for frame in container.decode(stream):
                if number == before[-1, 0] and frame.pts is not None and frame.pts < shown:
                    continue
                if frame.pts != index.times[number]:
                    break
                if number == wanted:
                    _refuse_corrupt(frame, number, path)
                    yield frame
                    wanted += 1
                    if wanted == stop:
                        return
                number += 1
    with _opened(path) as (container, stream):
        number = -1
        for number, frame in enumerate(container.decode(stream)):
            if index.times is not None and (number >= index.frames or frame.pts != index.times[number]):
                raise InputError(path, f"frame {number} comes at another time: it is damaged, fetch it again")
            if number == wanted:
                _refuse_corrupt(frame, number, path)
                yield frame
                wanted += 1
                if wanted == stop:
                    return
    raise InputError(path, f"gives only {number + 1} of its {index.frames} frames: it is damaged, fetch it again")


def _refuse_corrupt(frame: Any, number: int, path: Path) -> None:
    if frame.is_corrupt:
        raise InputError(path, f"frame {number} is damaged: fetch the film again")


def _upright(image: NDArray[Any], degrees: float, path: Path) -> NDArray[Any]:
    """Rotate an image anticlockwise as the film's display matrix says."""
    quarters = degrees / 90
    if quarters != round(quarters):
        raise InputError(path, f"to be rotated by {degrees:g} degrees; expected a multiple of 90: convert it")
    return np.rot90(image, round(quarters))
