"""Measurements written by Pillow, tifffile, NumPy and our own writer: the numbers that went in, or a clear refusal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from learning.reconstruct.inputs import load_measurement
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import write_exr

ROWS, COLUMNS = 6, 8


def numbers(kind: Any, channels: int, highest: int) -> NDArray[Any]:
    """Return different numbers up to ``highest``, which is among them, ``(C, H, W)``."""
    values = np.random.default_rng(5).integers(0, highest, (channels, ROWS, COLUMNS))
    values[0, 0, 0] = highest
    return values.astype(kind)


def write(path: Path, values: NDArray[Any]) -> Path:
    """Write ``(C, H, W)`` as the file's suffix says."""
    image = values[0] if len(values) == 1 else np.moveaxis(values, 0, -1)
    if path.suffix == ".png":
        Image.fromarray(image).save(path)
    elif path.suffix == ".tif":
        tifffile.imwrite(path, image, photometric="rgb" if image.ndim == 3 else "minisblack")
    elif path.suffix == ".npy":
        np.save(path, values if len(values) > 1 else values[0])
    else:
        names = "RGB" if len(values) == 3 else "Y"
        write_exr(path, {name: np.ascontiguousarray(v, np.float32) for name, v in zip(names, values, strict=True)}, {})
    return path


@pytest.mark.parametrize(
    ("suffix", "kind", "channels"),
    [
        (".png", np.uint8, 1),
        (".png", np.uint8, 3),
        (".png", np.uint16, 1),
        (".tif", np.uint8, 1),
        (".tif", np.uint16, 1),
        (".tif", np.uint16, 3),
        (".tif", np.uint32, 1),
        (".npy", np.uint16, 3),
    ],
)
def test_integers_become_shares_of_the_types_range(tmp_path: Path, suffix: str, kind: Any, channels: int) -> None:
    bits = 8 * np.dtype(kind).itemsize
    values = numbers(kind, channels, 2**bits - 1)
    found = load_measurement(write(tmp_path / f"m{suffix}", values))
    assert found.values.dtype == np.float32
    assert np.array_equal(found.values, (values.astype(np.float64) / 2**bits).astype(np.float32))
    assert (found.channels, found.dataset) == (("grey",) if channels == 1 else ("R", "G", "B"), None)
    assert found.record["divided_by"] == 2**bits
    assert found.record["scale"] == f"assumed from the file's type, {np.dtype(kind)}"


@pytest.mark.parametrize(("suffix", "kind"), [(".tif", np.uint16), (".npy", np.int64), (".npy", np.float64)])
def test_twelve_bits_in_a_larger_container_are_told(tmp_path: Path, suffix: str, kind: Any) -> None:
    values = numbers(kind, 1, 4095)
    found = load_measurement(write(tmp_path / f"m{suffix}", values), bits=12)
    assert np.array_equal(found.values, (values / 4096).astype(np.float32))
    assert found.record["scale"] == "as told"


@pytest.mark.parametrize("suffix", [".exr", ".tif", ".npy"])
def test_floats_are_shares_already(tmp_path: Path, suffix: str) -> None:
    values = np.random.default_rng(0).normal(0.2, 0.2, (3, ROWS, COLUMNS)).astype(np.float32)  # negative ones too
    assert np.array_equal(load_measurement(write(tmp_path / f"m{suffix}", values)).values, values)


def test_background_crop_and_binning_in_this_order(tmp_path: Path) -> None:
    values = numbers(np.uint16, 3, 4095)
    values[0, 1:3, 2:4] = 7
    dark = numbers(np.uint16, 1, 200)
    path, dark_path = write(tmp_path / "m.tif", values), write(tmp_path / "dark.png", dark)
    clean = (values.astype(np.float64) - dark) / 4096
    part = clean[:, 1:5, 2:8]
    by_hand = np.array(
        [[[part[c, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2].mean() for x in range(3)] for y in range(2)] for c in range(3)]
    )
    found = load_measurement(path, bits=12, background=str(dark_path), crop="4x6+1+2", binning=2)
    assert np.allclose(found.values, by_hand, rtol=0, atol=1e-7)  # float32
    assert found.values[0, 0, 0] < 0  # noise about the background is not cut off
    assert found.record["background"] == str(dark_path)
    assert (found.record["crop"], found.record["binning"]) == ("4x6+1+2", 2)
    assert np.allclose(load_measurement(path, bits=12, background=100).values, (values / 4096 - 100 / 4096), atol=1e-7)
    centre = load_measurement(path, bits=12, crop="2x4").values
    assert np.array_equal(centre, (values[:, 2:4, 2:6] / 4096).astype(np.float32))


def test_a_sample_is_read_by_its_folder_or_its_file_and_knows_its_data_set(tiny_dataset: Path) -> None:
    dataset = open_dataset(tiny_dataset, "test")
    measurement, _ = dataset.stored(1).measurement()
    for path in (dataset.folder(1), dataset.folder(1) / "measurement.exr"):
        found = load_measurement(path)
        assert np.array_equal(found.values, measurement)
        assert (found.channels, found.dataset, found.path) == (("R", "G", "B"), tiny_dataset, dataset.folder(1))


def test_full_pixels_are_noted(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 3000, (1, 40, 50)).astype(np.uint16)
    values[0, :4, :10] = 4095
    path = write(tmp_path / "m.tif", values)
    for bits in (12, None):  # 12 bits in 16 are told, or seen by how many share the brightest value
        (note,) = load_measurement(path, bits=bits).record["notes"]
        assert note.startswith("2 % of its pixels are full")
    (note,) = load_measurement(write(tmp_path / "m.npy", values / 4095)).record["notes"]
    assert note.startswith("2 % of its pixels are full")


def test_a_sample_says_its_bits_itself(tiny_dataset: Path) -> None:
    with pytest.raises(InputError, match=r"^--bits: "):
        load_measurement(open_dataset(tiny_dataset, "test").folder(1), bits=12)


@pytest.mark.parametrize(
    ("suffix", "values", "options", "message"),
    [
        (".npy", np.full((4, 4), np.nan), {}, r"m\.npy: "),
        (".npy", np.ones((2, 4, 5)), {}, r"m\.npy: "),
        (".npy", np.ones((4, 4), np.int32), {}, r"m\.npy: "),
        (".npy", np.ones((4, 4), complex), {}, r"m\.npy: "),
        (".tif", np.full((1, 4, 4), 4096, np.uint16), {"bits": 12}, r"m\.tif: "),
        (".npy", np.full((4, 4), 255.0), {}, r"m\.npy: "),
        (".exr", np.full((3, 4, 4), 2.5), {}, r"m\.exr: "),
        (".tif", np.ones((1, 4, 4), np.uint16), {"bits": 0}, "^--bits: "),
        (".tif", np.ones((1, 4, 4), np.uint8), {"bits": 12}, "^--bits: "),
        (".npy", np.full((4, 4), 0.5), {"bits": 12}, "^--bits: "),
        (".npy", np.ones((4, 4), np.uint64), {}, r"m\.npy: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"binning": 3}, "^--binning: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"binning": 0}, "^--binning: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"binning": 9}, "^--binning: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"crop": "6x8"}, "^--crop: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"crop": "5x8+1+0"}, "^--crop: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"crop": "0x5"}, "^--crop: got 0x5, which is empty"),
        (".tif", np.ones((1, 5, 8), np.uint16), {"frame": "up"}, "^--frame: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"crop": "all"}, "^--crop: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"background": "nan"}, "^--background: "),
        (".tif", np.ones((1, 5, 8), np.uint16), {"background": "no.tif"}, r"^no\.tif: "),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path: Path, suffix: str, values: Any, options: Any, message: str) -> None:
    path = tmp_path / f"m{suffix}"
    if suffix == ".npy":
        np.save(path, values)
    else:
        write(path, values)
    with pytest.raises(InputError, match=message):
        load_measurement(path, **options)


def test_a_background_of_another_size_is_refused(tmp_path: Path) -> None:
    path, dark = tmp_path / "m.npy", tmp_path / "dark.npy"
    np.save(path, np.ones((3, 4, 4)))
    np.save(dark, np.ones((4, 5)))
    with pytest.raises(InputError, match=r"^--background: "):
        load_measurement(path, background=str(dark))


def test_folders_without_a_sample_are_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="out: "):
        load_measurement(tiny_dataset)
    with pytest.raises(InputError, match=f"{tmp_path.name}: "):
        load_measurement(tmp_path)
    with pytest.raises(InputError, match=r"s00000099: there is no such file or folder"):
        load_measurement(tmp_path / "s00000099")
    with pytest.raises(InputError, match=r"gone\.tif: "):
        load_measurement(tmp_path / "gone.tif")
    (tmp_path / "text.txt").write_text("x", encoding="utf-8")
    with pytest.raises(InputError, match=r"text\.txt: expected \.tif"):
        load_measurement(tmp_path / "text.txt")


@pytest.mark.shared
def test_the_diffuser_cameras_hand_has_the_numbers_that_its_note_says(shared_data: Path) -> None:
    found = load_measurement(shared_data / "diffusercam" / "tutorial" / "rawdata_hand_sample.tif")
    assert (found.sensor_shape, found.channels) == ((1200, 1600), ("grey",))
    # NOTE.txt beside it: 144 to 37184, mean 16035.
    assert (found.values.min() * 65536, found.values.max() * 65536) == (144, 37184)
    assert float(found.values.mean(dtype=np.float64)) * 65536 == pytest.approx(16035, abs=0.5)
