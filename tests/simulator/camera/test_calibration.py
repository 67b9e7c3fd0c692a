"""Recording a PSF: what averaging, background and gains do, against the statistics of the sensor's own numbers."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.camera.calibration import GLOW_REACH, Recording
from simulator.camera.noise import NoNoise, PhysicalNoise
from simulator.camera.sensor import Sensor
from simulator.errors import InputError

FULL_WELL, READ = 10000.0, 5.0
SENSOR = Sensor("plain", 5e-6, (8, 8), 1, (8, 8), FULL_WELL, READ, 0.0, 0.0, 0.0, 64.0, 14, noise=PhysicalNoise())
ONE = np.ones(1)


@pytest.fixture
def light() -> np.ndarray:
    """A smooth spot far from the border, 30 irradiances bright, on an almost dark image."""
    y, x = (np.arange(81) - 40 for _ in range(2))
    return 30 * np.exp(-(y[:, None] ** 2 + x[None] ** 2) / 50)[None].repeat(2, 0)


def record(light, recording, gains=None, noise=None, seed=0):
    gains = np.ones(len(light)) if gains is None else np.asarray(gains, float)
    sensor = replace(SENSOR, noise=noise or PhysicalNoise())
    return recording.record(light, gains, sensor, np.random.default_rng(seed))


def test_a_perfect_camera_gives_the_light_back_whatever_the_stray_light(light) -> None:
    found, facts = record(light, Recording(0.5, 3, 0.1, 0.2), [1.0, 0.3], NoNoise())
    np.testing.assert_allclose(found, light, rtol=0, atol=1e-13 * light.max())
    assert facts["negative_share"] < 1e-13
    assert facts["snr_db"] == 150


@pytest.mark.parametrize("frames", [1, 4, 16])
def test_noise_falls_with_the_root_of_the_frames(frames) -> None:
    flat = np.full((1, 150, 150), 3.0)
    found, facts = record(flat, Recording(0.7, frames))
    # Photons, read noise and rounding of the image; read noise and rounding of the dark one. Electrons squared.
    rounding = (FULL_WELL / (2**14 - 1 - 64)) ** 2 / 12
    variance = 0.7 * FULL_WELL + 2 * (READ**2 + rounding)
    expected = np.sqrt(variance / frames) / (0.7 * FULL_WELL)
    assert found.std() / 3.0 == pytest.approx(expected, rel=0.03)  # 22500 pixels tell a deviation to 0.5 %
    assert facts["snr_db"] == pytest.approx(-20 * np.log10(expected), abs=0.2)
    assert found.mean() == pytest.approx(3.0, rel=5 * expected / 150)


def test_dark_images_remove_glow_and_pedestal_the_border_only_the_pedestal(light) -> None:
    pedestal, glow = 0.02, 0.05
    left = {
        name: record(light, Recording(0.5, 1, pedestal, glow, name), noise=NoNoise())[0]
        for name in ("dark", "border", "none")
    }
    scale = 0.5 / light.max()
    np.testing.assert_allclose(left["dark"], light, atol=1e-12)
    column = np.exp(-np.arange(81) / (GLOW_REACH * 81))
    np.testing.assert_allclose(left["none"] - light, (pedestal + glow * column) / scale + 0 * light, atol=1e-12)
    frame = np.ones((81, 81), bool)
    frame[2:-2, 2:-2] = False  # 2 % of 81
    level = np.median((glow * np.broadcast_to(column, (81, 81)) + scale * light[0])[frame])
    residue = (left["border"] - light)[0, 40]
    lit = light[0, 40] > 2  # not clipped at zero
    np.testing.assert_allclose(residue[lit], (glow * column - level)[lit] / scale, atol=1e-12)


def test_the_brightest_pixel_of_all_channels_reaches_the_share_asked_for(light, monkeypatch) -> None:
    seen = []
    monkeypatch.setattr(Sensor, "expose", lambda self, signal, rng: seen.append(signal.max()) or signal)
    record(light * 1e-7, Recording(0.6), [0.2, 0.9], NoNoise())
    assert seen == [pytest.approx(0.6), 0]


def test_a_channel_that_sees_little_of_the_light_is_noisier(light) -> None:
    weak = 0.04
    found, _ = record(np.full((2, 100, 100), 1.0), Recording(0.7, 1), [1.0, weak])
    ratio = found[1].std() / found[0].std()
    shot = 0.7 * FULL_WELL
    expected = np.sqrt((shot * weak + 2 * READ**2) / (shot + 2 * READ**2)) / weak
    assert ratio == pytest.approx(expected, rel=0.05)


def test_what_is_darker_than_the_dark_becomes_zero_and_is_told(light) -> None:
    found, facts = record(light, Recording(0.7, 1))
    assert found.min() == 0
    assert 0.001 < facts["negative_share"] < 0.2


def test_up_to_full_scale_nothing_is_cut_off(light) -> None:
    """0.6 + 0.3 + 0.1 is 1 but for rounding: the brightest recording that is accepted still gives the light back."""
    found, _ = record(light, Recording(0.6, 1, 0.3, 0.1), noise=NoNoise())
    np.testing.assert_allclose(found, light, rtol=0, atol=1e-13 * light.max())


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"peak": 0.0}, "^peak: "),
        ({"peak": 70}, "^peak: "),
        ({"peak": 1.0, "pedestal": 0.3}, r"^peak \+ pedestal \+ glow: "),
        ({"peak": 0.9, "glow": 0.11}, r"^peak \+ pedestal \+ glow: "),
        ({"frames": 0}, "^frames: "),
        ({"background": "median"}, "^background: "),
    ],
)
def test_mistakes_are_named(wrong, words) -> None:
    with pytest.raises(InputError, match=words):
        Recording(**wrong)


def test_what_a_data_set_does_to_colours_is_no_part_of_a_calibration(light) -> None:
    """Gains are already those of the channels, and a mosaic's calibration is taken to see all colours everywhere."""
    image = np.concatenate([light, light[:1]])
    plain = replace(SENSOR, exposure_s=0.02, dark_current_e_per_s=50.0)
    odd = replace(plain, readout="bayer", responsivity=(0.5, 1.0, 0.2), exposure_s=tuple(np.linspace(0.01, 0.03, 8)))
    found = [Recording().record(image, np.ones(3), sensor, np.random.default_rng(0))[0] for sensor in (plain, odd)]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
