"""Sensor noise: means, variances, PSNR and limits on a million values each (PHYSICS section 9)."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.camera.forward import ForwardModel
from simulator.camera.noise import GaussianNoise, NoNoise, PhysicalNoise
from simulator.camera.sensor import MODELS, Sensor, full_scale_from_pilots
from simulator.camera.shutter import RowShutter
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

SHAPE = (600, 600)  # times three channels: more than 10^6 values


def _sensor(**changes) -> Sensor:
    return replace(Sensor(name="imx183", binning=1, shape=SHAPE, **MODELS["imx183"]), **changes)


def _ramp(low=0.05, high=0.9):
    return np.broadcast_to(np.linspace(low, high, SHAPE[1], dtype=np.float32), (3, *SHAPE)).copy()


@pytest.mark.parametrize("psnr_db", [20.0, 40.0])
@pytest.mark.parametrize("peak", ["sample", "full_scale"])
def test_gaussian_noise_has_the_asked_psnr_and_no_bias(psnr_db, peak):
    sensor = _sensor(noise=GaussianNoise(psnr_db=psnr_db, peak=peak), full_scale=2.0)
    signal = _ramp(high=0.6)
    noise = sensor.expose(2 * signal, np.random.default_rng(0)).astype(np.float64) - signal
    measured = 20 * np.log10((0.6 if peak == "sample" else 1.0) / noise.std())
    assert measured == pytest.approx(psnr_db, abs=0.05)
    assert abs(noise.mean()) < 4 * noise.std() / np.sqrt(noise.size)


def test_gaussian_noise_by_standard_deviation_is_neither_clipped_nor_quantised_unless_asked():
    sensor = _sensor(noise=GaussianNoise(std=0.1))
    noisy = sensor.expose(np.zeros((3, *SHAPE), np.float32), np.random.default_rng(0))
    assert noisy.std() == pytest.approx(0.1, rel=5e-3)
    assert noisy.min() < -0.3
    asked = _sensor(noise=GaussianNoise(std=0.1, clip=True, quantise=True))
    assert asked.expose(np.ones((3, *SHAPE), np.float32), np.random.default_rng(0)).max() == np.float32(4095 / 4096)
    clipped = asked.expose(np.zeros((3, *SHAPE), np.float32), np.random.default_rng(0))
    assert clipped.min() == 0
    np.testing.assert_array_equal(clipped * 4096, np.round(clipped * 4096))


@pytest.mark.parametrize("binning", [1, 2, 6])
def test_physical_noise_has_the_photon_transfer_curve(binning):
    """Mean without bias, and variance = shot + dark + read + row + quantisation, at several levels (EMVA 1288)."""
    sensor = _sensor(
        noise=PhysicalNoise(), prnu=0.0, dsnu_e=0.0, binning=binning, exposure_s=2.0, dark_current_e_per_s=20.0
    )
    for level in (0.0, 0.02, 0.5):
        signal = np.full((3, *SHAPE), level, np.float32)
        numbers = sensor.expose(signal, np.random.default_rng(1)).astype(np.float64) * 4096
        gain, pixels = sensor.dn_per_electron, {1: (1, 1, 1), 2: (1, 2, 1), 6: (9, 18, 9)}[binning]
        electrons = level * sensor.full_well_e + 40.0
        mean = sensor.black_level_dn + gain * electrons
        each = (electrons + sensor.read_noise_e**2) * gain**2 + 1 / 12
        for channel in range(3):
            # Red and blue pixels lie on every other row of a Bayer bin, green ones on all of them.
            row = (sensor.row_noise_e * gain) ** 2 / (binning / 2 if binning > 1 and channel != 1 else binning)
            values = numbers[channel]
            variance = each / pixels[channel] + row
            # The row error does not average over columns: 600 rows decide how well the mean is known.
            uncertainty = np.sqrt(each / pixels[channel] / values.size + row / SHAPE[0])
            assert abs(values.mean() - mean) < 4 * uncertainty
            assert values.var() == pytest.approx(variance, rel=0.02)  # 4.6e5 values: 0.2 %; row noise of 600 rows adds


def test_physical_noise_clips_at_full_well_and_quantises():
    sensor = _sensor(noise=PhysicalNoise())
    numbers = sensor.expose(np.full((3, *SHAPE), 3.0, np.float32), np.random.default_rng(0)) * 4096
    assert numbers.min() == numbers.max() == 4095
    dim = sensor.expose(_ramp(), np.random.default_rng(0)) * 4096
    np.testing.assert_array_equal(dim, np.round(dim))


@pytest.mark.parametrize("binning", [8, 3])
@pytest.mark.parametrize("level", [0.97, 1.0, 1.02])
def test_every_pixel_of_a_bin_is_clipped_by_itself(binning, level):
    """Against all physical pixels, drawn one by one: at full well half of them are clipped, their mean lies below."""
    sensor = _sensor(noise=PhysicalNoise(), binning=binning, shape=(150, 150), row_noise_e=0.0)
    numbers = sensor.expose(np.full((1, 150, 150), level, np.float32), np.random.default_rng(0))[0] * 4096
    rng = np.random.default_rng(1)
    shape = (150, binning, 150, binning)
    light = level * sensor.full_well_e * (1 + sensor.prnu * rng.standard_normal(shape))
    electrons = rng.poisson(light) + sensor.dsnu_e * rng.standard_normal(shape)
    electrons += sensor.read_noise_e * rng.standard_normal(shape)
    each = np.clip(np.round(electrons * sensor.dn_per_electron + sensor.black_level_dn), 0, 4095)
    expected = each.mean((1, 3))
    uncertainty = expected.std() / 150
    assert numbers.mean() == pytest.approx(expected.mean(), abs=6 * uncertainty)
    assert numbers.std() == pytest.approx(expected.std(), rel=0.05)


def test_a_full_well_without_fixed_pattern_reads_4082():
    """The mean of a clipped half of a Gaussian: 0.4 standard deviations of one pixel's 122 electrons below the top."""
    sensor = _sensor(noise=PhysicalNoise(), binning=8, shape=(150, 150), row_noise_e=0.0, prnu=0.0, dsnu_e=0.0)
    numbers = sensor.expose(np.ones((1, 150, 150), np.float32), np.random.default_rng(0)) * 4096
    one = np.sqrt(sensor.full_well_e + sensor.read_noise_e**2) * sensor.dn_per_electron
    assert numbers.mean() == pytest.approx(4095 - one / np.sqrt(2 * np.pi), abs=0.15)
    assert numbers.mean() == pytest.approx(4081.9, abs=0.2)
    assert numbers.std() == pytest.approx(one * np.sqrt((0.5 - 0.5 / np.pi) / 64), rel=0.03)


def test_a_converter_without_black_level_has_no_numbers_below_zero():
    sensor = _sensor(noise=PhysicalNoise(), black_level_dn=0, dark_current_e_per_s=0.0, read_noise_e=20.0)
    numbers = sensor.expose(np.zeros((3, *SHAPE), np.float32), np.random.default_rng(0))
    assert numbers.min() == 0
    assert np.mean(numbers == 0) > 0.45  # read noise without light: half the pixels lie below zero


def test_fixed_pattern_is_the_same_in_every_image_and_has_the_asked_strength():
    sensor = _sensor(noise=PhysicalNoise(), prnu=0.02, row_noise_e=0.0)
    flat = np.full((3, *SHAPE), 0.5, np.float32)
    first, second = (sensor.expose(flat, np.random.default_rng(seed)) for seed in (0, 1))
    covariance = np.cov(first.ravel(), second.ravel())[0, 1]
    expected = (0.02 * (first.mean() - sensor.black_level_dn / 4096)) ** 2
    assert covariance == pytest.approx(expected, rel=0.03)


def test_a_pixels_responsivity_scales_its_photons_before_they_are_drawn():
    """EMVA 1288: photo-electrons of any pixel have Poisson's variance, and the dark current knows no PRNU."""
    quiet = {"dsnu_e": 0.0, "read_noise_e": 0.0, "row_noise_e": 0.0, "bit_depth": 20, "black_level_dn": 0.0}
    sensor = _sensor(noise=PhysicalNoise(), prnu=0.3, exposure_s=1.0, dark_current_e_per_s=2000.0, **quiet)
    response = sensor.response_map((3, *SHAPE))
    electrons = 2**20 / sensor.dn_per_electron
    for level in (0.2, 0.0):
        flat = np.full((3, *SHAPE), level, np.float32)
        first, second = (sensor.expose(flat, np.random.default_rng(seed)) * electrons for seed in (0, 1))
        for low, high in ((0.4, 0.6), (1.4, 1.6)):
            chosen = (response > low) & (response < high)
            expected = (level * sensor.full_well_e * response[chosen] + 2000).mean()
            assert first[chosen].mean() == pytest.approx(expected, rel=1e-3)
            # 9e4 pixels or more: 0.5 %.
            assert np.var(first[chosen] - second[chosen]) / 2 == pytest.approx(expected, rel=0.02)


def test_the_dark_pattern_is_the_sensors_own():
    """The same in every image, of the asked strength after binning, and another sensor's is another."""
    sensor = _sensor(noise=PhysicalNoise(), prnu=0.0, dsnu_e=30.0, row_noise_e=0.0, binning=6)
    dark = np.zeros((3, *SHAPE), np.float32)
    first, second = (sensor.expose(dark, np.random.default_rng(seed)).astype(np.float64) * 4096 for seed in (0, 1))
    other = replace(sensor, pattern_seed=1).expose(dark, np.random.default_rng(1)).astype(np.float64) * 4096
    for channel, pixels in enumerate((9, 18, 9)):
        expected = (30 * sensor.dn_per_electron) ** 2 / pixels
        # 3.6e5 values: 0.3 %.
        assert np.cov(first[channel].ravel(), second[channel].ravel())[0, 1] == pytest.approx(expected, rel=0.02)
        assert abs(np.cov(first[channel].ravel(), other[channel].ravel())[0, 1]) < 0.02 * expected
    assert first.mean() == pytest.approx(sensor.black_level_dn, abs=0.02)
    # PRNU and DSNU of one sensor have nothing to do with each other.
    maps = sensor.dark_map((3, *SHAPE)).ravel(), replace(sensor, prnu=0.1).response_map((3, *SHAPE)).ravel()
    assert abs(np.corrcoef(*maps)[0, 1]) < 5e-3


def test_less_sensitive_channels_are_balanced_noisier_and_full_later():
    shares = (0.5, 1.0, 0.25)
    sensor = _sensor(noise=PhysicalNoise(), responsivity=shares, prnu=0.0, dsnu_e=0.0, row_noise_e=0.0)
    light = np.full((3, *SHAPE), 0.6, np.float32)
    np.testing.assert_allclose(
        sensor.noiseless(light), replace(sensor, responsivity=None).noiseless(light), rtol=1e-6, atol=1e-6
    )
    numbers = sensor.expose(light, np.random.default_rng(0)).astype(np.float64) * 4096
    gain = sensor.dn_per_electron
    for channel, share in enumerate(shares):
        variance = ((0.6 * 15000 * share + 2.7**2) * gain**2 + 1 / 12) / share**2
        assert numbers[channel].var() == pytest.approx(variance, rel=0.01)  # 3.6e5 values: 0.24 %
        error = numbers[channel].mean() - 4096 * float(sensor.noiseless(light)[channel].mean())
        assert abs(error) < 4 * np.sqrt(variance / numbers[channel].size)
    full = sensor.expose(np.full((3, *SHAPE), 9, np.float32), np.random.default_rng(0)) * 4096
    for channel, share in enumerate(shares):
        assert full[channel].min() == full[channel].max() == pytest.approx(64 + 4031 / share)


def test_saturation_counts_light_and_darkness_where_they_fill_the_well():
    light = _ramp(0, 3)
    share = [np.mean(light[0] >= at) for at in (2.0, 1.0)]
    sensor = _sensor(noise=PhysicalNoise(), responsivity=(0.5, 1.0, 0.5), dark_current_e_per_s=0.0, full_scale=1.0)
    assert sensor.shares(light).saturated == pytest.approx((2 * share[0] + share[1]) / 3)
    dark = replace(sensor, responsivity=None, dark_current_e_per_s=7500.0, exposure_s=1.0)  # half a well
    assert dark.shares(light).saturated == pytest.approx(np.mean(light[0] >= 0.5), abs=2 / 600)
    assert replace(dark, noise=GaussianNoise(std=0.1), full_scale=0.5).shares(light).saturated == pytest.approx(
        np.mean(light[0] >= 0.5)
    )
    beyond = np.full((3, *SHAPE), 1e30, np.float32)  # no Poisson number has as many photons
    assert sensor.expose(beyond, np.random.default_rng(0))[1].min() * 4096 == 4095


@pytest.mark.parametrize("binning", [1, 6])
@pytest.mark.parametrize("readout", ["binned_rgb", "bayer"])
def test_the_noise_floor_is_the_deviation_of_dark_images(readout, binning):
    names = {"prnu": 0.0, "row_noise_e": 2.0, "dsnu_e": 3.0, "dark_current_e_per_s": 2000.0, "exposure_s": 0.01}
    sensor = _sensor(noise=PhysicalNoise(), readout=readout, binning=binning, responsivity=(0.5, 1.0, 0.25), **names)
    dark = np.zeros((3, *sensor.shape), np.float32)
    seen = sensor.expose(dark, np.random.default_rng(0)).astype(np.float64) * 4096 - 64
    balance = np.broadcast_to(sensor.balance(dark), seen.shape)
    floor = np.broadcast_to(sensor.dark_noise(seen) * sensor.dn_range, seen.shape)
    for share in (0.5, 1.0, 0.25):
        own = balance == share
        assert (seen * balance)[own].std() == pytest.approx(floor[own][0], rel=0.04)  # 300 rows of red


def test_values_are_black_below_half_a_number_and_faint_below_the_noise():
    light = _ramp(0, 1)  # of each channel, ends included
    half = 0.5 / 4096
    silent = _sensor(noise=NoNoise(), full_scale=1.0)
    assert silent.shares(light).black == pytest.approx(np.mean(light < half), abs=1e-9)
    assert silent.shares(light).below_noise == 0
    noisy = replace(silent, noise=GaussianNoise(std=0.1)).shares(light)
    assert noisy.below_noise == pytest.approx(np.mean(light < 0.1))
    assert noisy.signal == pytest.approx(np.mean((light >= 0.1) & (light < 1)))
    for full_scale, part in ((1e-12, "saturated"), (1e15, "black")):
        assert getattr(replace(silent, full_scale=full_scale).shares(light + 1e-3), part) == 1
    errors = light * 1e-7  # of convolution: nothing of the scene, however far the scale stretches it
    errors[:, 0] = 1
    assert replace(silent, full_scale=1e-9).shares(errors).black == pytest.approx(599 / 600)
    dim = _sensor(noise=PhysicalNoise(), full_scale=1.0, dark_current_e_per_s=0.0)
    faint = dim.shares(light * 1e-3)
    floor = float(dim.dark_noise(light)[0, 0, 0])
    assert faint.below_noise == pytest.approx(np.mean(light * 1e-3 < floor), abs=1e-6)
    assert 0.05 < faint.below_noise < 0.95
    flooded = replace(dim, dark_current_e_per_s=1e6, exposure_s=1.0).shares(light)
    assert (flooded.saturated, flooded.signal) == (1, 0)


def test_every_row_has_the_noise_and_the_darkness_of_its_own_exposure():
    """A shutter whose rows differ: the top physical row, open longest, is the stored image's last."""
    rows = SHAPE[0]
    exposures_s = np.linspace(0.04, 0.01, rows)  # physical, top first
    table_s = np.stack([np.zeros(rows), exposures_s], axis=-1)
    stack = PsfStack(np.ones((1, 3, 1, 1), np.float32), np.array([0.1]), 2.4e-6, ("R", "G", "B"), "point")
    model = ForwardModel(stack, SHAPE, SHAPE, RowShutter(table_s))
    sensor = _sensor(
        noise=PhysicalNoise(),
        **{"prnu": 0.0, "dsnu_e": 0.0, "row_noise_e": 0.0, "read_noise_e": 0.0, "bit_depth": 16, "full_scale": 0.05},
        dark_current_e_per_s=20000.0,
        exposure_s=tuple(exposures_s[::-1].tolist()),
    )
    exposure = model.forward(np.ones((1, 1, 3, *SHAPE), np.float32))
    gain = sensor.dn_per_electron
    numbers = (sensor.expose(exposure, np.random.default_rng(0)).astype(np.float64) * 65536 - 64) / gain
    electrons = exposures_s[::-1] * (15000 / 0.05 + 20000)
    # 1800 values a row: the mean of 600 rows' standardised means and variances is known to 1e-3 of a deviation.
    z = (numbers - electrons[:, None]) / np.sqrt(electrons[:, None] + 1 / 12 / gain**2)
    assert abs(z.mean()) < 4e-3
    for part in np.array_split(z, 6, axis=1):
        assert part.var() == pytest.approx(1, rel=0.01)  # 1.8e5 values: 0.33 %
    expected = sensor.noiseless(exposure)[1, :, 0].astype(np.float64) * 65536 - 64
    np.testing.assert_allclose(expected / gain, electrons, rtol=1e-5)


def test_row_noise_is_common_to_a_row():
    sensor = _sensor(noise=PhysicalNoise(), prnu=0.0, row_noise_e=50.0)
    numbers = sensor.expose(np.full((3, *SHAPE), 0.3, np.float32), np.random.default_rng(0))
    assert numbers.mean(2).std(axis=1) == pytest.approx(50 * sensor.dn_per_electron / 4096, rel=0.1)
    assert numbers.mean(1).std() < 0.1 * numbers.mean(2).std()


def test_row_noise_of_red_and_blue_bins_is_independent_and_green_sees_both():
    sensor = _sensor(noise=PhysicalNoise(), prnu=0.0, row_noise_e=50.0, binning=2)
    rows = sensor.expose(np.full((3, *SHAPE), 0.3, np.float32), np.random.default_rng(0)).mean(2)
    red, green, blue = rows - rows.mean(1, keepdims=True)
    # 600 rows: correlations are known to 1 / sqrt(600) = 0.04.
    assert abs(np.corrcoef(red, blue)[0, 1]) < 0.15
    assert np.corrcoef(green, (red + blue) / 2)[0, 1] > 0.99


@pytest.mark.parametrize("noise", [GaussianNoise(psnr_db=40), PhysicalNoise()])
def test_same_generator_same_bytes_and_torch_agrees(noise):
    torch = pytest.importorskip("torch")
    sensor = _sensor(noise=noise)
    signal = _ramp()
    first, second = (sensor.expose(signal, np.random.default_rng(5)) for _ in range(2))
    assert first.dtype == np.float32
    np.testing.assert_array_equal(first, second)
    tensor = sensor.expose(torch.from_numpy(signal), np.random.default_rng(5)).numpy()
    # Half-way cases may round to the other digital number.
    assert np.mean(np.abs(tensor - first) > 1e-6) < 1e-3
    drawn = sensor.expose(torch.from_numpy(signal), torch.Generator().manual_seed(0)).numpy()
    assert drawn.mean() == pytest.approx(first.mean(), rel=1e-3)


def test_auto_exposure_puts_the_bright_end_at_80_percent():
    pilots = [np.linspace(0, peak, 10001) for peak in (1.0, 2.0)]
    full_scale = full_scale_from_pilots(pilots)
    everything = np.concatenate(pilots) / full_scale
    assert np.mean(everything > 0.8) == pytest.approx(1e-3, rel=0.1)
    with pytest.raises(InputError, match=r"^camera\.exposure\.full_scale: "):
        full_scale_from_pilots([np.zeros(4)])


@pytest.mark.parametrize(
    ("key", "make"),
    [
        ("shape", lambda: _sensor(binning=8, shape=(457, 684))),
        ("full_scale", lambda: _sensor(full_scale=0.0)),
        ("irradiance", lambda: _sensor().expose(np.zeros((3, 4, 4), np.float32), None)),
        ("exposure_s", lambda: _sensor(exposure_s=(0.1, 0.2))),
        ("responsivity", lambda: _sensor(responsivity=(1.0, 1.2, 0.5))),
        ("irradiance", lambda: _sensor(responsivity=(1.0,)).expose(_ramp(), None)),
        ("std", lambda: GaussianNoise(std=0.1, psnr_db=40)),
    ],
)
def test_bad_sensors_are_refused(key, make):
    with pytest.raises(InputError, match=rf"^{key}: "):
        make()
