"""Films read through PyAV: each frame shows its own number, whatever the container, and damage is told by the file's name."""

import shutil
import socket
import struct
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.importers import video_decoding as reader
from simulator.importers.film import survey
from simulator.importers.film_files import open_films
from simulator.importers.video_decoding import count_decodable, index_film, read_film

av = pytest.importorskip("av")

COUNT = 30
# Containers and codecs with times of showing, of decoding only (AVI), with pictures out of order, with open groups.
FILMS = {
    "one_key.webm": {},
    "vp9.webm": {"key_every": 10},
    "vp8.webm": {"codec": "libvpx", "key_every": 10},
    "h264.mp4": {"codec": "libx264", "key_every": 10, "options": {"bf": "2"}},
    "h264.mkv": {"codec": "libx264", "key_every": 10, "options": {"bf": "3"}},
    "h264.avi": {"codec": "libx264", "key_every": 10, "options": {"bf": "2"}},
    "h264.ts": {"codec": "libx264", "key_every": 10},
    "open.mp4": {"codec": "libx264", "key_every": 10, "options": {"bf": "3", "x264-params": "open-gop=1"}},
    "open.mkv": {"codec": "libx264", "key_every": 10, "options": {"bf": "3", "x264-params": "open-gop=1"}},
    "mpeg4.avi": {"codec": "mpeg4", "key_every": 10, "options": {"bf": "2", "qmin": "1", "qmax": "1"}},
    "mjpeg.avi": {"codec": "mjpeg", "pixels": "yuvj420p"},
    "ffv1.mkv": {"codec": "ffv1", "pixels": "bgr0"},
    "webm_by_content.mp4": {"container": "webm", "key_every": 10},
}


@pytest.fixture(scope="module")
def written(films, tmp_path_factory):
    folder = tmp_path_factory.mktemp("films")
    pictures = films.numbered(COUNT)
    return {name: films.write(folder / name, pictures, **options) for name, options in FILMS.items()}


@pytest.mark.parametrize("name", FILMS)
def test_every_range_gives_the_frames_of_these_numbers(films, written, name):
    path = written[name]
    index = index_film(path)
    assert (index.frames, index.frames_per_second, index.variable) == (COUNT, 12.0, False)
    assert index.square_pixels
    for start, stop in ((0, COUNT), (0, 1), (7, 12), (10, 11), (13, 14), (25, 28), (29, 30)):
        assert [films.number_of(frame) for frame in read_film(path, start, stop)] == list(range(start, stop))
    assert count_decodable(path) == (COUNT, {(48, 64)})


def test_late_frames_are_found_by_seeking_where_times_can_be_trusted(films, written, monkeypatch):
    decoded = []
    original = reader._opened

    class Counted:
        def __init__(self, container):
            self.container = container
            self.seek = container.seek

        def decode(self, stream):
            for frame in self.container.decode(stream):
                decoded.append(frame.pts)
                yield frame

    @contextmanager
    def counting(path):
        with original(path) as (container, stream):
            yield Counted(container), stream

    for name in FILMS:
        index_film(written[name])
    monkeypatch.setattr(reader, "_opened", counting)
    for name in ("vp9.webm", "h264.mp4", "h264.mkv", "ffv1.mkv"):
        decoded.clear()
        assert [films.number_of(frame) for frame in read_film(written[name], 28, 30)] == [28, 29]
        assert len(decoded) <= 15  # from the key frame at 20 or 24 and, with pictures out of order, some before it
    decoded.clear()
    assert [films.number_of(frame) for frame in read_film(written["h264.avi"], 28, 30)] == [28, 29]
    assert len(decoded) >= 30  # it has no times, so frames are counted


def encode(light):
    return 255 * (1.055 * np.asarray(light, np.float64) ** (1 / 2.4) - 0.055)


def test_grey_codes_become_linear_light_in_either_range(written):
    (lossless,) = read_film(written["ffv1.mkv"], 16, 17)
    assert lossless.dtype == np.float32
    # Code 20 + 5 * 16 = 100: sRGB's curve by hand.
    np.testing.assert_allclose(lossless[40, 40], ((100 / 255 + 0.055) / 1.055) ** 2.4, rtol=1e-6)
    # Code 20 is Y = 33 of limited range and 20 of full range: mistaken for each other, they would come out as 33 or 5.
    for name in ("mjpeg.avi", "h264.mp4", "vp9.webm"):
        (frame,) = read_film(written[name], 0, 1)
        np.testing.assert_allclose(encode(frame[40, 40]), 20, atol=2.5)  # rounded Y, Cb and Cr, and the codecs' loss


@pytest.mark.parametrize(
    ("size", "colour", "matrix", "luma"),
    [
        ((720, 960), None, "BT.709 (untagged)", (0.2126, 0.7152, 0.0722)),
        ((480, 640), None, "BT.601 (untagged)", (0.299, 0.587, 0.114)),
        ((720, 960), {"colorspace": 5}, "BT.601", (0.299, 0.587, 0.114)),
        ((480, 640), {"colorspace": 1}, "BT.709", (0.2126, 0.7152, 0.0722)),
    ],
)
def test_films_have_their_own_matrix_and_untagged_ones_that_of_their_size(films, tmp_path, size, colour, matrix, luma):
    """A grey of Y 120, Cb 90, Cr 170 by the formulas of BT.709 and BT.601, limited range."""
    planes = np.concatenate([np.full(size[0] * size[1], 120), np.full(size[0] * size[1] // 4, 90)])
    codes = np.concatenate([planes, np.full(size[0] * size[1] // 4, 170)]).astype(np.uint8)
    path = tmp_path / "film.mkv"
    with av.open(str(path), "w") as film:
        stream = film.add_stream("libx264", rate=12, options={"crf": "0", "preset": "ultrafast"})
        stream.height, stream.width = size
        stream.pix_fmt = "yuv420p"
        for name, value in (colour or {}).items():
            setattr(stream.codec_context, name, value)
        frame = av.VideoFrame.from_ndarray(codes.reshape(size[0] * 3 // 2, size[1]), format="yuv420p")
        frame.colorspace = (colour or {}).get("colorspace", 2)
        for packet in [*stream.encode(frame), *stream.encode()]:
            film.mux(packet)
    assert index_film(path).matrix == matrix
    y, blue, red = (120 - 16) / 219, (90 - 128) / 224, (170 - 128) / 224
    r, b = y + 2 * (1 - luma[0]) * red, y + 2 * (1 - luma[2]) * blue
    g = (y - luma[0] * r - luma[2] * b) / luma[1]
    (picture,) = read_film(path, 0, 1)
    # Two steps of 8 bits; the other matrix is off by 8 codes or more.
    np.testing.assert_allclose(encode(picture[100, 100]), 255 * np.array([r, g, b]), atol=2)


def test_sixteen_bits_are_kept(films, tmp_path):
    levels = [0, 1000, 33000, 65535]
    pictures = [np.full((16, 16, 3), level, np.uint16) for level in levels]
    options = {"codec": "ffv1", "pixels": "gbrp16le", "picture_format": "rgb48le"}
    path = films.write(tmp_path / "deep.mkv", pictures, **options)
    for frame, level in zip(read_film(path, 0, 4), levels, strict=True):
        code = level / 65535
        light = code / 12.92 if code < 0.04045 else ((code + 0.055) / 1.055) ** 2.4
        np.testing.assert_allclose(frame, light, rtol=1e-6)


def test_a_film_is_turned_as_its_display_matrix_says(films, tmp_path):
    path = films.write(tmp_path / "turned.mp4", films.numbered(3), codec="libx264", options={"crf": "0"})
    content = path.read_bytes()
    # ISO/IEC 14496-12, 8.3.2: (x', y') = (x, y) times the matrix a b u, c d v, ...; here x' = -y, y' = x with y downwards:
    # what pointed to the right points down, a quarter clockwise.
    upright = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    turned = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, 0, 0, 1 << 30)
    place = content.index(upright, content.index(b"tkhd"))
    path.write_bytes(content[:place] + turned + content[place + 36 :])
    (frame,) = read_film(path, 0, 1)
    assert frame.shape == (64, 48, 3)
    dark = frame.max(axis=2) < 1e-3
    assert dark[:32, 24:].mean() > 0.95  # the black quarter was at the upper left, and comes to the upper right
    assert not dark[:, :22].any()
    assert not dark[34:].any()


def test_a_variable_rate_is_told_and_its_mean_taken(films, tmp_path):
    times_ms = [0, 83, 167, 400, 450, 700, 800, 900, 1000, 1100]
    path = films.write(tmp_path / "varies.webm", films.numbered(10), rate=1000, times_ms=times_ms)
    index = index_film(path)
    assert index.variable
    assert index.frames_per_second == pytest.approx(9 / 1.1, rel=1e-3)
    assert [films.number_of(frame) for frame in read_film(path, 4, 9)] == [4, 5, 6, 7, 8]


def test_hidden_vp8_packets_are_no_frames(films, tmp_path):
    path = films.write(tmp_path / "hidden.webm", films.numbered(COUNT), codec="libvpx", key_every=10)
    films.edit_packet(path, 12, lambda byte: byte & ~0x10)
    assert index_film(path).frames == COUNT - 1
    shown = [number for number in range(COUNT) if number != 12]
    assert [films.number_of(frame) for frame in read_film(path, 0, COUNT - 1)] == shown
    assert count_decodable(path)[0] == COUNT - 1


def test_a_frame_that_packets_promise_and_decoding_does_not_give_is_told(films, tmp_path):
    path = films.write(tmp_path / "hidden.webm", films.numbered(COUNT), key_every=10)
    films.edit_packet(path, 12, lambda byte: byte & ~0x02)  # VP9's show_frame
    assert index_film(path).frames == COUNT
    assert count_decodable(path)[0] == COUNT - 1
    for start, stop in ((0, COUNT), (11, 14), (13, 15)):
        with pytest.raises(InputError, match=r"hidden\.webm: "):
            list(read_film(path, start, stop))
    # What lies before it and after the next key frame keeps its number.
    for start, stop in ((0, 12), (10, 12), (20, 30)):
        assert [films.number_of(frame) for frame in read_film(path, start, stop)] == list(range(start, stop))


def test_the_last_frames_may_be_missing(films, tmp_path):
    path = films.write(tmp_path / "end.webm", films.numbered(5))
    films.edit_packet(path, 4, lambda byte: byte & ~0x02)
    with pytest.raises(InputError, match=r"end\.webm: "):
        list(read_film(path, 2, 5))


def test_frames_beyond_the_end_are_refused(written):
    with pytest.raises(InputError, match=r"vp9\.webm: "):
        list(read_film(written["vp9.webm"], 28, 31))


def test_a_file_that_changes_is_read_again(films, tmp_path):
    path = films.write(tmp_path / "film.webm", films.numbered(5))
    assert index_film(path).frames == 5
    films.write(path, films.numbered(7))
    assert index_film(path).frames == 7


@pytest.mark.parametrize("name", ["vp9.webm", "h264.mp4", "h264.avi", "ffv1.mkv"])
@pytest.mark.parametrize("kept", [0, 40, 0.5, 0.9])
def test_a_film_cut_short_is_told(written, tmp_path, name, kept):
    content = written[name].read_bytes()
    path = tmp_path / name
    path.write_bytes(content[: kept if kept in (0, 40) else int(kept * len(content))])
    with pytest.raises(InputError, match=name.replace(".", r"\.")):
        index_film(path)


@pytest.mark.parametrize(
    ("name", "codec", "sound"),
    [("a.webm", "libvpx-vp9", "libopus"), ("b.webm", "libvpx", "libopus"), ("c.mkv", "mpeg4", "pcm_s16le")],
)
def test_a_film_with_sound_cut_short_is_told(films, tmp_path, name, codec, sound):
    mute = films.write(tmp_path / f"mute_{name}", films.numbered(COUNT), codec=codec)
    path = with_sound(mute, tmp_path / name, sound)
    assert index_film(path).frames == COUNT
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=rf"{name}: ends after \d\.\d+ s of the \d\.\d+ s "):
        index_film(path)


@pytest.mark.parametrize("seconds", [1.0, 4.0])
def test_sound_may_be_shorter_or_longer_than_the_pictures(films, tmp_path, seconds):
    mute = films.write(tmp_path / "mute.webm", films.numbered(COUNT))
    assert index_film(with_sound(mute, tmp_path / "a.webm", "libopus", seconds)).frames == COUNT
    mp4 = films.write(tmp_path / "mute.mp4", films.numbered(COUNT), codec="libx264")
    assert index_film(with_sound(mp4, tmp_path / "a.mp4", "aac", seconds)).frames == COUNT


def with_sound(mute, path, codec, seconds=COUNT / 12):
    """Write a film again with noise beside its pictures."""
    rate = 48000
    noise = np.random.default_rng(1).integers(-9000, 9000, (1, int(seconds * rate)), np.int16)
    with av.open(str(mute)) as source, av.open(str(path), "w") as film:
        pictures = film.add_stream_from_template(source.streams.video[0])
        stream = film.add_stream(codec, rate=rate, layout="mono")
        packets = []
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = pictures
                packets.append(packet)
        resampler = av.AudioResampler(
            stream.codec_context.format, "mono", rate, stream.codec_context.frame_size or 1024
        )
        frame = av.AudioFrame.from_ndarray(noise, format="s16", layout="mono")
        frame.sample_rate, frame.pts = rate, 0
        for piece in (*resampler.resample(frame), *resampler.resample(None)):
            packets += stream.encode(piece)
        packets += stream.encode()
        for packet in sorted(packets, key=lambda packet: packet.dts * packet.time_base):
            film.mux(packet)
    return path


def test_overwritten_bytes_are_told(films, written, tmp_path):
    path = tmp_path / "damaged.webm"
    path.write_bytes(written["vp9.webm"].read_bytes())
    films.edit_packet(path, 10, lambda byte: byte ^ 0xC0)  # VP9's frame marker, of a key frame
    with pytest.raises(InputError, match=r"damaged\.webm: "):
        list(read_film(path, 12, 15))
    with pytest.raises(InputError, match=r"damaged\.webm: "):
        count_decodable(path)


def test_high_dynamic_range_other_files_and_missing_ones_are_refused(films, tmp_path):
    films.write(tmp_path / "hdr.mkv", films.numbered(3), codec="libx264", colour={"color_trc": 16})
    films.write(tmp_path / "ycgco.mkv", films.numbered(3), codec="libx264", colour={"colorspace": 8})
    (tmp_path / "text.mp4").write_text("no film at all, but some text in a file with a film's name")
    for name in ("hdr.mkv", "ycgco.mkv", "text.mp4", "none.mp4"):
        with pytest.raises(InputError, match=f"{name}: "):
            index_film(tmp_path / name)


def test_a_playlist_sends_nobody_into_the_network(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0)
        playlist = tmp_path / "list.m3u8"
        address = f"http://127.0.0.1:{server.getsockname()[1]}/a.ts"
        playlist.write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{address}\n#EXT-X-ENDLIST\n")
        with pytest.raises(InputError, match=r"list\.m3u8: "):
            index_film(playlist)
        with pytest.raises(BlockingIOError):  # nobody has connected
            server.accept()


def test_a_sound_file_is_no_video(tmp_path):
    path = tmp_path / "sound.mka"
    with av.open(str(path), "w", format="matroska") as film:
        stream = film.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.sample_rate = 8000
        for packet in [*stream.encode(frame), *stream.encode()]:
            film.mux(packet)
    with pytest.raises(InputError, match=r"sound\.mka: "):
        index_film(path)


def test_missing_pyav_is_told_with_its_cure(written, tmp_path, monkeypatch):
    unread = Path(shutil.copy(written["vp9.webm"], tmp_path))  # not known yet to the cache of indices
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"^PyAV: .*pip install 'flatlight\[import\]'"):
        next(read_film(written["vp9.webm"], 0, 1))
    # It is no problem of the films, one by one: opening and surveying a folder of them say it once.
    for look in (lambda: open_films(tmp_path, [("vp9.webm", None)]), lambda: survey(unread)):
        with pytest.raises(InputError, match=r"^PyAV: "):
            look()


@pytest.mark.shared
def test_real_clips_have_the_frames_that_are_known(shared_data):
    clips = shared_data / "ssv2" / "clips"
    # The data set's note: decoded by others.
    for name, frames in {"166766": 49, "closing_0": 52, "moving_away_1": 58}.items():
        path = clips / f"{name}.webm"
        index = index_film(path)
        assert (index.frames, index.frames_per_second) == (frames, 12.0)
        assert count_decodable(path) == (frames, {(240, 427)})
        with av.open(str(path)) as film:
            expected = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)][frames - 3]
        (last,) = read_film(path, frames - 3, frames - 2)
        codes = np.rint(255 * np.where(last < 0.0031308, 12.92 * last, 1.055 * last ** (1 / 2.4) - 0.055))
        np.testing.assert_array_equal(codes, expected)
