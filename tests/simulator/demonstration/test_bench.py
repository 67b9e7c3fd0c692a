"""The test bench: what its pictures must be, by linearity and by hand."""

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.planes import mask_irradiance
from simulator.config import load_config
from simulator.plots.shutter_bench import SAMPLES, Bench, Spot

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

SHUTTERS = {
    "global": {"exposure_ms": 5},
    "rolling": {"type": "rolling", "exposure_ms": 1, "line_time_us": 11},
    "dual": {"type": "dual_rolling", "exposure_ms": 1, "line_time_us": 17, "order": "centre_out"},
}


def _spot(sample, row=0.4, column=0.7):
    return Spot(row, column, sample, (1.0, 1.0, 1.0), "white")


@pytest.fixture(params=SHUTTERS)
def config(request, trial):
    return load_config(trial.write(camera={"shutter": SHUTTERS[request.param]}))


@pytest.mark.parametrize("sample", [1, 37, SAMPLES])
def test_what_the_shutter_lets_through_are_the_rows_that_are_open(config, sample):
    bench = Bench(Assembly(config))
    spot = _spot(sample)
    convolved = bench.convolved(spot)
    # One lit frame gives its own picture, row by row as far as each is open; float32 and its transforms.
    tolerance = {"rtol": 1e-5, "atol": 1e-6 * convolved.max()}
    np.testing.assert_allclose(bench.exposed(spot), convolved * bench.share(spot)[:, None], **tolerance)
    np.testing.assert_allclose(bench.exposed_globally(spot), convolved, **tolerance)


def test_shares_are_those_of_the_stored_rows(trial):
    bench = Bench(Assembly(load_config(trial.write(camera={"shutter": SHUTTERS["rolling"]}))))
    lasts = 1e-3 + 11e-6 * (48 * 8 - 1)
    assert bench.duration_s == pytest.approx(lasts)
    first, last = 19 / SAMPLES * lasts, 20 / SAMPLES * lasts
    for row in (0, 20, 47):
        opening = np.arange(8 * (47 - row), 8 * (48 - row)) * 11e-6  # the picture's last row is the sensor's first
        inside = np.clip(np.minimum(last, opening + 1e-3) - np.maximum(first, opening), 0, None)
        assert bench.share(_spot(20))[row] == pytest.approx(inside.mean() / (last - first), abs=1e-6)


def test_a_lens_shows_the_scene_on_the_rows_that_are_open(config):
    bench = Bench(Assembly(config))
    irradiance = mask_irradiance(Assembly(config).view, config.forward.vignetting)
    seen = set()
    for sample in (10, 50, 90):
        spot = _spot(sample)
        top = (48 - 16) // 2
        expected = bench.picture(spot) * irradiance
        always = bench.exposed_behind_lens(spot, always=True)
        np.testing.assert_allclose(always, expected, rtol=1e-4, atol=1e-5 * expected.max())
        under = expected * bench.share(spot)[top : top + 16, None]
        np.testing.assert_allclose(bench.exposed_behind_lens(spot), under, rtol=1e-4, atol=1e-5 * expected.max())
        seen.add(bool(under.max() > 0.5 * expected.max()))
    assert seen == ({True} if bench.is_global else {True, False})


def test_points_have_the_psfs_of_the_configuration_s_own_ends(trial):
    config = load_config(trial.write())
    bench, stack = Bench(Assembly(config)), Assembly(config).psf_stack
    assert bench.ends.depths_m == pytest.approx([stack.depths_m[0], stack.depths_m[-1]])
    np.testing.assert_allclose(bench.ends.values, np.asarray(stack.values)[[0, -1]], rtol=1e-5, atol=1e-9)
    near, far = (bench.point(0.5, 0.5, depth) for depth in bench.ends.depths_m)
    rows = [np.flatnonzero(image.max(axis=1) > 0.3 * image.max()) for image in (near, far)]
    assert np.ptp(rows[0]) > np.ptp(rows[1])  # the mask's shadow grows as the point comes near


def test_one_depth_is_enough(trial):
    config = load_config(trial.write(psf={"depths_cm": [20], "wavelengths_per_channel": 1, "accept_error": 1}))
    assert len(Bench(Assembly(config)).ends.depths_m) == 1


def test_infinity_is_a_depth(trial):
    psf = {"depths_cm": [5, 10, float("inf")], "wavelengths_per_channel": 1, "accept_error": 1}
    bench = Bench(Assembly(load_config(trial.write(psf=psf))))
    assert bench.ends.depths_m.tolist() == [0.05, np.inf]
    assert bench.convolved(_spot(5)).max() > 0
