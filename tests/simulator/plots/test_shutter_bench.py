"""The test bench: what its images must be, by linearity and by hand."""

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.field import FieldOfView
from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, RowShutter
from simulator.config import load_config
from simulator.plots.shutter_bench import SAMPLES, Bench, Spot, shutter_facts

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
@pytest.mark.slow
def test_what_the_shutter_lets_through_are_the_rows_that_are_open(config, sample):
    bench = Bench(Assembly(config))
    spot = _spot(sample)
    convolved = bench.convolved(spot)
    # One lit frame gives its own image, row by row as far as each is open; float32 and its transforms.
    tolerance = {"rtol": 1e-5, "atol": 1e-6 * convolved.max()}
    np.testing.assert_allclose(bench.exposed(spot), convolved * bench.share(spot)[:, None], **tolerance)
    np.testing.assert_allclose(bench.exposed_globally(spot), convolved, **tolerance)


def test_shares_are_those_of_the_stored_rows(trial):
    bench = Bench(Assembly(load_config(trial.write(camera={"shutter": SHUTTERS["rolling"]}))))
    lasts = 1e-3 + 11e-6 * (48 * 8 - 1)
    assert bench.duration_s == pytest.approx(lasts)
    first, last = 19 / SAMPLES * lasts, 20 / SAMPLES * lasts
    for row in (0, 20, 47):
        opening = np.arange(8 * (47 - row), 8 * (48 - row)) * 11e-6  # the image's last row is the sensor's first
        inside = np.clip(np.minimum(last, opening + 1e-3) - np.maximum(first, opening), 0, None)
        assert bench.share(_spot(20))[row] == pytest.approx(inside.mean() / (last - first), abs=1e-6)


def test_a_lens_shows_the_scene_on_the_rows_that_are_open(config):
    bench = Bench(Assembly(config))
    irradiance = FieldOfView(config.forward.vignetting).irradiance(Assembly(config).view)
    seen = set()
    for sample in (10, 50, 90):
        spot = _spot(sample)
        top = (48 - 16) // 2
        expected = bench.scene(spot) * irradiance
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


@pytest.mark.slow
@pytest.mark.parametrize(("depths_cm", "ends_m"), [([20], [0.2]), ([5, 10, float("inf")], [0.05, np.inf])])
def test_one_depth_is_enough_and_infinity_is_a_depth(trial, depths_cm, ends_m):
    psf = {"depths_cm": depths_cm, "wavelengths_per_channel": 1, "accept_error": 1}
    bench = Bench(Assembly(load_config(trial.write(psf=psf))))
    assert bench.ends.depths_m.tolist() == ends_m
    assert bench.convolved(_spot(5)).max() > 0


# What the command says of a shutter, worked out by hand.


ALL = "12, one per frame seen; 1, 2, 3, 4, 6, 12 come out even"


def _facts(shutter, rows, **scene):
    return dict(shutter_facts(shutter, rows, scene))


def test_a_global_shutter():
    facts = _facts(GlobalShutter(0.01, 8), 100)
    assert facts["shutter"] == "global shutter"
    assert facts["exposure"] == "10 ms per row"
    assert facts["rows"] == "100 in the image, each the mean of 8 physical rows"
    assert facts["capture"] == "10 ms until the last row closes; all rows are open from 0 ms to 10 ms"
    assert facts["frames told apart"].startswith("1: all rows see the same time")
    assert "line time" not in facts
    assert "scenes" not in facts


def test_windows_that_open_late_leave_frames_out_at_the_front():
    """Six rows, row r open from 4 + r to 6 + r ms: frames of 1 ms from the 5th to the 11th are seen."""
    shutter = RowShutter(np.stack([np.arange(4.0, 10), np.arange(6.0, 12)], axis=1) * 1e-3)
    facts = _facts(shutter, 6, frames=14, frames_per_second=1000)
    assert facts["scenes"] == "14 frames at 1000 per second last 14 ms; the shutter sees frames 5 to 11"
    assert facts["slivers"].startswith("7, one per frame seen")
    assert "too short, the shutter needs 11 frames" in _facts(shutter, 6, frames=10, frames_per_second=1000)["scenes"]


def test_a_rolling_shutter():
    facts = _facts(RollingShutter(0.001, 1e-5, "up", 2), 1000)
    assert facts["shutter"] == "rolling shutter, up"
    assert facts["line time"] == "10 µs per physical row"
    assert facts["capture"].startswith("20.99 ms until the last row closes; at no time are all rows open")
    # A row of the image is open for 1.01 ms; one opens every 0.02 ms, so every 51st is apart: 1 + 999 // 51.
    assert facts["frames told apart"].startswith("20: ")


def test_a_dual_rolling_shutter():
    facts = _facts(DualRollingShutter(0.02, 1e-5), 1000)
    assert facts["shutter"] == "dual rolling shutter, from the outside in"
    assert facts["line time"] == "10 µs per physical pair of rows"
    assert "all rows are open from 4.99 ms to 20 ms" in facts["capture"]
    assert facts["frames told apart"].startswith("1: any two rows are open together")


def test_rows_of_their_own():
    facts = _facts(RowShutter(np.array([(0, 0.001), (0.001, 0.004)])), 2)
    assert facts["exposure"] == "1 ms to 3 ms per row, 2 ms on average"


@pytest.mark.parametrize(
    ("shutter", "height", "said"),
    [
        # Rows 6 to 13 of 20: in pairs from the outside the seventh to the last, 6 to 9 ms and 2 ms of exposure.
        (
            DualRollingShutter(0.002, 0.001),
            8,
            "8 of 20 rows see it, open from 6 ms to 11 ms; what moves there before is",
        ),
        (DualRollingShutter(0.002, 0.001, order="centre_out"), 8, "open from 0 ms to 5 ms; what moves there after is"),
        (RollingShutter(0.002, 0.001), 8, "open from 6 ms to 15 ms; what moves there before and after is not recorded"),
        (RollingShutter(0.002, 0.001), 20, "all rows see it, open from 0 ms to 21 ms"),
        (RollingShutter(0.002, 0.001), 30, "all rows see it, open from 0 ms to 21 ms"),
    ],
)
def test_rows_that_a_point_in_the_middle_shines_on(shutter, height, said):
    light = np.ones((height, 5))
    seen = dict(shutter_facts(shutter, 20, {}, light=light))["light from the middle"]
    assert said in seen
    assert ("a larger mask" in seen) == (height < 20)
    faint = np.pad(light, ((40, 40), (0, 0)), constant_values=1e-5)  # less than 1 % of the light says nothing
    assert dict(shutter_facts(shutter, 20, {}, light=faint))["light from the middle"] == seen
    assert "light from the middle" not in dict(shutter_facts(GlobalShutter(0.01), 20, {}, light=light))


@pytest.mark.parametrize(
    ("frames", "rate", "scenes", "slivers"),
    [
        (1, 25.0, "stand still", None),
        (12, 1000, "12 frames at 1000 per second last 12 ms; the shutter sees all", ALL),
        (30, 1000, "30 frames at 1000 per second last 30 ms; the shutter sees frames 1 to 12", ALL),
        (11, 1000, "last 11 ms: too short, the shutter needs 12 frames, or at most 916.6 per second", None),
    ],
)
def test_scenes_that_suit_the_shutter_and_such_that_do_not(frames, rate, scenes, slivers):
    facts = _facts(RollingShutter(0.010, 1e-4), 21, frames=frames, frames_per_second=rate)
    assert scenes in facts["scenes"]
    assert (facts.get("slivers") or "").startswith(slivers or "")
    assert ("slivers" in facts) == (slivers is not None)


@pytest.mark.parametrize(
    ("slivers", "words"),
    [
        (4, "4 of 3 frames each; 1, 2, 3, 4, 6, 12 come out even"),
        (12, "12 of 1 frame each"),
        (5, "5 of 12 frames seen do not come out even; 1, 2"),
        (24, "24 of 12 frames seen do not come out even"),
    ],
)
def test_slivers_that_come_out_even_and_such_that_do_not(slivers, words):
    scene = {"frames": 12, "frames_per_second": 1000}
    assert dict(shutter_facts(RollingShutter(0.010, 1e-4), 21, scene, slivers))["slivers"].startswith(words)


def test_films_at_a_rate_of_their_own():
    facts = _facts(GlobalShutter(0.1), 4, frames=20, frames_per_second=None)
    assert facts["scenes"] == "20 frames at a rate of their own; at more than 200 per second they are too short"
