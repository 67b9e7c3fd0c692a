"""OpenEXR: any array in, the same bits out; other programs read the same; damage is never returned as pixels."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from simulator.errors import InputError
from simulator.io import files
from simulator.io.exr import ATTRIBUTE, decode_exr, read_exr, write_exr
from simulator.io.files import StorageError

FINITE = st.floats(width=32, allow_nan=False, allow_infinity=False)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@st.composite
def views(draw: st.DrawFn) -> list[np.ndarray]:
    """Two float32 views of one shape with arbitrary strides: sliced, reversed, transposed, broadcast, Fortran."""
    shape = draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    result = []
    for _ in range(2):
        steps = draw(st.tuples(*[st.sampled_from([-3, -2, -1, 1, 2, 3])] * 2))
        full = tuple(size * abs(step) for size, step in zip(shape, steps, strict=True))
        kind = draw(st.sampled_from(["C", "F", "transposed", "broadcast", "channels last"]))
        if kind == "broadcast":
            base = np.broadcast_to(draw(hnp.arrays(np.float32, (1, full[1]), elements=FINITE)), full)
        elif kind == "channels last":
            base = draw(hnp.arrays(np.float32, (*full, 3), elements=FINITE))[..., 1]
        elif kind == "transposed":
            base = draw(hnp.arrays(np.float32, full[::-1], elements=FINITE)).T
        else:
            base = np.array(draw(hnp.arrays(np.float32, full, elements=FINITE)), order=kind)  # type: ignore[call-overload]
        result.append(base[:: steps[0], :: steps[1]][: shape[0], : shape[1]])
    return result


@given(views(), st.dictionaries(st.text(), JSON, max_size=4))
@settings(max_examples=100, deadline=None)
def test_any_memory_layout_and_metadata_come_back_exactly(
    tmp_path_factory: pytest.TempPathFactory, arrays: list[np.ndarray], metadata: dict
) -> None:
    path = tmp_path_factory.getbasetemp() / "property.exr"
    channels = {"Z": arrays[0], "noiseless.R": arrays[1]}
    before = {name: values.tobytes() for name, values in channels.items()}
    data = write_exr(path, channels, metadata)
    read, read_metadata = read_exr(path, require_checksums=True)
    assert path.read_bytes() == data
    assert list(channels) == ["Z", "noiseless.R"]  # the caller's dict is as it was
    assert {name: values.tobytes() for name, values in read.items()} == before  # bits: also -0.0 and subnormals
    assert read_metadata == metadata
    assert all(values.flags.writeable and values.dtype == np.float32 for values in read.values())


def example(size: tuple[int, int] = (40, 24), raw: bool = False) -> dict[str, np.ndarray]:
    """Channels that ZIP shrinks, or (``raw``) whose bits are so random that EXR stores them without any checksum."""
    rng = np.random.default_rng(3)
    if raw:
        bits = rng.integers(0, 2**32, size=(2, *size), dtype=np.uint32) & np.uint32(0xBF7FFFFF)  # no inf, no NaN
        return dict(zip("RG", bits.view(np.float32), strict=True))
    return {name: (rng.integers(0, 4096, size) / 4096).astype(np.float32) for name in ("R", "G", "B")}


def test_same_input_same_bytes(tmp_path: Path) -> None:
    channels, metadata = example(), {"b": 1, "a": [0.1]}
    first = write_exr(tmp_path / "1.exr", channels, metadata)
    reordered = dict(reversed(channels.items()))
    assert write_exr(tmp_path / "2.exr", reordered, dict(reversed(metadata.items()))) == first


def test_openimageio_reads_the_same(tmp_path: Path) -> None:
    oiio = pytest.importorskip("OpenImageIO", reason="group dev has it")
    channels = example((33, 20))
    channels |= {"noiseless.R": channels["R"][::-1, ::-1], "Z": np.asfortranarray(channels["G"] * 3)}
    write_exr(tmp_path / "x.exr", channels, {"exact": 0.1, "name": "ü"})
    image = oiio.ImageInput.open(str(tmp_path / "x.exr"))
    spec = image.spec()
    pixels = image.read_image(oiio.FLOAT)
    attribute = spec.getattribute(ATTRIBUTE)
    assert (spec.height, spec.width, spec.nchannels) == (33, 20, 5)
    assert set(spec.channelnames) == set(channels)
    assert str(spec.format) == "float"
    assert spec.getattribute("compression") == "zip"
    assert '\\"exact\\": 0.1' in attribute
    for index, name in enumerate(spec.channelnames):
        np.testing.assert_array_equal(pixels[..., index], channels[name])
    image.close()
    assert not oiio.ImageInput.open(str(tmp_path / "x.exr")).seek_subimage(1, 0)  # a single part


def test_files_of_openimageio_are_read_and_half_becomes_float32(tmp_path: Path) -> None:
    oiio = pytest.importorskip("OpenImageIO", reason="group dev has it")
    values = np.random.default_rng(1).random((12, 17, 3)).astype(np.float32)
    for kind, expected in (("float", values), ("half", values.astype(np.float16).astype(np.float32))):
        path = tmp_path / f"{kind}.exr"
        output = oiio.ImageOutput.create(str(path))
        output.open(str(path), oiio.ImageSpec(17, 12, 3, kind))
        output.write_image(values)
        output.close()
        channels, metadata = read_exr(path)
        assert metadata == {}
        for index, name in enumerate("RGB"):
            np.testing.assert_array_equal(channels[name], expected[..., index])
        with pytest.raises(InputError, match="not written by flatlight"):
            read_exr(path, require_checksums=True)


@pytest.mark.parametrize("raw", [False, True])
def test_no_flipped_bit_returns_other_pixels(tmp_path: Path, raw: bool, capfd: pytest.CaptureFixture[str]) -> None:
    channels, metadata, path = example((20, 16), raw), {"seed": 7, "label": "a"}, tmp_path / "x.exr"
    data = write_exr(path, channels, metadata)
    rng = np.random.default_rng(0)
    detected = 0
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 1 << int(rng.integers(8))
        try:
            read, read_metadata = decode_exr(bytes(damaged), path, require_checksums=True)
        except InputError:
            detected += 1
            continue
        assert read_metadata == metadata, position
        assert {name: values.tobytes() for name, values in read.items()} == {
            name: values.tobytes() for name, values in channels.items()
        }, position
    assert detected > 0.9 * len(data)  # harmless: unused header fields such as the pixel aspect ratio
    assert capfd.readouterr() == ("", "")  # OpenEXR's chatter stays off the terminal


def test_truncations_are_detected(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "x.exr"
    data = write_exr(path, example((40, 16)), {})
    for length in [*range(0, 1000, 3), *range(1000, len(data) - 50, 17), *range(len(data) - 50, len(data))]:
        with pytest.raises(InputError, match=r"x\.exr: "):
            decode_exr(data[:length], path)
    path.write_bytes(data[:-1])
    with pytest.raises(InputError, match=r"x\.exr: "):
        read_exr(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n" * 9, b"\x76\x2f\x31\x01" + b"\xff" * 60])
def test_other_files_are_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "other.exr").write_bytes(content)
    with pytest.raises(InputError, match=r"other\.exr: "):
        read_exr(tmp_path / "other.exr")
    with pytest.raises(InputError, match=r"gone\.exr: "):
        read_exr(tmp_path / "gone.exr")
    with pytest.raises(InputError, match=str(tmp_path)):
        read_exr(tmp_path)


def test_a_tiny_file_that_claims_huge_images_is_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "bomb.exr"
    data = bytearray(write_exr(path, {"R": np.zeros((16, 16), np.float32)}, {}))
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        start = data.index(name) + len(name) + 4
        data[start + 8 : start + 16] = np.array([59999, 59999], "<i4").tobytes()
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"bomb\.exr: "):
        read_exr(path)
    write_exr(path, example((40, 24)), {})
    with pytest.raises(InputError, match=r"bomb\.exr: "):
        read_exr(path, max_pixels=40 * 24 * 3 - 1)
    assert len(read_exr(path, max_pixels=40 * 24 * 3)[0]) == 3


GOOD = np.ones((4, 5), np.float32)


@pytest.mark.parametrize(
    "channels",
    [
        {},
        *({"R": GOOD.astype(kind)} for kind in (np.float64, np.float16, np.complex64, bool)),
        *({"R": values} for values in (GOOD.tolist(), GOOD * np.float32(np.nan), GOOD * np.float32(np.inf))),
        *({"R": values} for values in (GOOD[None], GOOD[:0])),
        *({name: GOOD} for name in ("", "x" * 256, "a\0b", 1)),
        {"R": GOOD, "G": GOOD[:3]},
    ],
)
def test_what_cannot_be_stored_exactly_is_refused(tmp_path: Path, channels: dict) -> None:
    with pytest.raises(InputError, match=r"x\.exr: "):
        write_exr(tmp_path / "x.exr", channels, {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bad", [{"a": float("nan")}, {"a": (1, 2)}, {1: 2}, {"a": np.float32(1)}, {"a": Path("x")}])
def test_metadata_that_would_change_are_refused(tmp_path: Path, bad: dict) -> None:
    with pytest.raises(InputError, match=r"x\.exr: "):
        write_exr(tmp_path / "x.exr", {"R": GOOD}, bad)


def test_a_disk_that_loses_bytes_is_noticed_before_the_file_appears(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "write_all", lambda descriptor, data: os.write(descriptor, data[: len(data) // 2]))
    with pytest.raises(StorageError, match=r"x\.exr"):
        write_exr(tmp_path / "x.exr", example(), {})
    assert list(tmp_path.iterdir()) == []
