"""Mosaics: which colour lies where, in whose frame, and that the noise is that of its own pixels."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from simulator.camera.noise import GaussianNoise, NoNoise, PhysicalNoise
from simulator.camera.readout import PATTERNS, BayerReadout
from simulator.camera.sensor import MODELS, Sensor
from simulator.errors import InputError

RGB = ("R", "G", "B")


def _sensor(shape, **changes):
    sensor = Sensor(name="imx183", binning=1, shape=shape, readout="bayer", **MODELS["imx183"])
    return replace(sensor, **changes)


@pytest.mark.parametrize("shape", [(8, 10), (7, 10), (8, 9), (7, 9)])
@pytest.mark.parametrize("cfa", PATTERNS)
def test_a_mosaic_picks_from_the_image_as_the_physical_filter_array_does(shape, cfa):
    sensor = _sensor(shape, cfa=cfa, noise=PhysicalNoise(), responsivity=(0.5, 1.0, 0.75))
    light = np.random.default_rng(0).random((3, *shape), np.float32)
    physical = replace(sensor, readout="binned_rgb").noiseless(light)[:, ::-1, ::-1]
    picked = [[physical["RGB".index(cfa[2 * (r % 2) + c % 2]), r, c] for c in range(shape[1])] for r in range(shape[0])]
    mosaic = sensor.noiseless(light)
    assert mosaic.dtype == np.float32
    np.testing.assert_array_equal(mosaic[0], np.array(picked)[::-1, ::-1])
    # What is stored says itself where its colours are.
    stored = sensor.stored_cfa
    assert stored is not None
    corner = ["RGB".index(colour) for colour in stored]
    image = replace(sensor, readout="binned_rgb").noiseless(light)
    assert mosaic[0, :2, :2].ravel().tolist() == [image[c, i // 2, i % 2] for i, c in enumerate(corner)]


def _scene(rows, columns):
    """A smooth scene whose colours are far from grey, ``(3, H, W)``."""
    y, x = np.mgrid[:rows, :columns] / 40
    return np.stack([0.6 + 0.2 * np.sin(x), 0.35 + 0.1 * np.cos(x + y), 0.15 + 0.1 * np.sin(y)]).astype(np.float32)


@pytest.mark.parametrize(("cfa", "stored"), [("RGGB", "BGGR"), ("GRBG", "GBRG"), ("BGGR", "RGGB"), ("GBRG", "GRBG")])
def test_opencv_recovers_the_colours_with_the_stored_pattern_and_with_no_other(cfa, stored):
    cv2 = pytest.importorskip("cv2")
    sensor, scene = _sensor((60, 80), cfa=cfa, noise=NoNoise()), _scene(60, 80)
    assert sensor.stored_cfa == stored
    raw = np.round(sensor.expose(scene, None)[0] * 65535).astype(np.uint16)

    def error(pattern):
        image = cv2.cvtColor(raw, getattr(cv2, f"COLOR_Bayer{pattern}2RGB")).astype(np.float64) / 65535
        return np.abs(np.moveaxis(image, -1, 0) - scene)[:, 2:-2, 2:-2].max()

    # A pixel's neighbours average to it up to the scene's curvature, 0.2 / 40^2 / 2 for each step of one pixel.
    assert error(stored) < 3e-4
    assert min(error(other) for other in PATTERNS if other != stored) > 0.1


def test_bins_of_one_colour_average_all_their_pixels_and_rows():
    """Of 3 x 3 pixels in three physical rows: shot, read and row noise are those of nine and three."""
    sensor = _sensor((600, 900), binning=3, noise=PhysicalNoise(), prnu=0.0, dsnu_e=0.0, row_noise_e=20.0)
    light = np.full((3, 600, 900), 0.4, np.float32)
    numbers = sensor.expose(light, np.random.default_rng(0))[0].astype(np.float64) * 4096
    gain = sensor.dn_per_electron
    rows = numbers.mean(1)
    expected = (6000 * gain**2 + (2.7 * gain) ** 2 + 1 / 12) / 9
    assert (numbers - rows[:, None]).var() == pytest.approx(expected, rel=0.01)  # 5.4e5 values: 0.2 %
    assert rows.std() == pytest.approx(20 * gain / 3**0.5, rel=0.15)  # 600 rows: 3 %
    # A row's pixels of both colours share its error.
    even, odd = (numbers[:, start::2].mean(1) for start in (0, 1))
    assert np.corrcoef(even, odd)[0, 1] > 0.99


def test_gaussian_noise_of_a_mosaic_counts_its_own_peak():
    light = np.zeros((3, 600, 900), np.float32)
    light[0], light[1], light[2] = 0.2, 0.8, 0.4
    sensor = _sensor((600, 900), noise=GaussianNoise(psnr_db=30))
    error = sensor.expose(light, np.random.default_rng(0)) - sensor.noiseless(light)
    assert error.shape == (1, 600, 900)
    assert 20 * np.log10(0.8 / error.std()) == pytest.approx(30, abs=0.05)


@pytest.mark.parametrize("noise", [GaussianNoise(std=0.01), PhysicalNoise()])
def test_torch_reads_the_same_mosaic(noise):
    torch = pytest.importorskip("torch")
    sensor = _sensor((61, 80), noise=noise, responsivity=(0.6, 1.0, 0.7), exposure_s=tuple(np.linspace(0.1, 9, 61)))
    light = _scene(61, 80)
    numpy, tensor = (sensor.expose(array, np.random.default_rng(3)) for array in (light, torch.from_numpy(light)))
    assert tensor.dtype == torch.float32
    # A half-way case may round to the other digital number.
    assert np.mean(np.abs(tensor.numpy() - numpy) > 1e-6) < 1e-3
    again = sensor.expose(light, np.random.default_rng(3))
    assert again.dtype == np.float32
    np.testing.assert_array_equal(again, numpy)


def test_what_has_no_three_colours_is_no_mosaic():
    sensor = _sensor((6, 6))
    assert sensor.channels(RGB) == ("mosaic",)
    assert replace(sensor, readout="binned_rgb").channels(("Y",)) == ("Y",)
    assert replace(sensor, readout="binned_rgb").stored_cfa is None
    for key, ask in (
        *((r"camera\.sensor\.readout", partial(sensor.channels, n)) for n in (("Y",), ("B", "G", "R"), (*RGB, "N"))),
        (r"camera\.sensor\.readout", lambda: sensor.expose(np.zeros((1, 6, 6), np.float32), None)),
        ("cfa", lambda: replace(sensor, cfa="RGBG")),
        ("readout", lambda: replace(sensor, readout="foveon")),
    ):
        with pytest.raises(InputError, match=rf"^{key}: "):
            ask()


def test_an_odd_number_of_mosaic_bins_reaches_further():
    """Two bins of one colour interleave; the last of an odd number has gaps that nothing fills."""
    assert [BayerReadout(4, "RGGB", (3, 3)).extent(n) for n in (2, 3, 4)] == [8, 15, 16]
    with pytest.raises(InputError, match=r"^shape: "):
        _sensor((3, 2), binning=4, physical_shape=(12, 8))
