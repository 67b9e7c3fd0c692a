"""Truth found again from frames: mask distance, shifts and exposures of three kinds of masks, and what went wrong."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from simulator.calibrate.calibration import calibrate
from simulator.errors import InputError
from simulator.optics.interpolation import left_out_errors
from simulator.plots.calibration import calibration_html, describe_calibration


def names(depths_m) -> list[str]:
    return [f"z{depth * 1e3:g}mm" for depth in depths_m]


PEAKS = [0.7, 0.5, 0.8, 0.35, 0.6, 0.75]


@pytest.fixture(scope="module", params=["phlatcam", pytest.param("diffusercam", marks=pytest.mark.slow), "flatcam"])
def simulated(request, truth, recorded, tmp_path_factory):
    true = truth(request.param)
    folder = recorded(tmp_path_factory.mktemp(request.param) / "set", true.light, names(true.depths_m), PEAKS)
    return true, calibrate(folder, true.pitch_m, bits=12, nominal_m=1.1 * true.distance_m)


@pytest.mark.slow
class TestTruth:
    def test_mask_distance(self, simulated) -> None:
        true, found = simulated
        g = found.geometry
        # Noise and hands leave 0.2 %; the mean power of a random phase mask adds 0.5 to 1 %.
        assert g.distance.distance_m == pytest.approx(true.distance_m, rel=0.02)
        assert g.distance.distance_std_m < 0.01 * true.distance_m
        both = g.with_offset
        assert abs(both.offset_m) < 4 * both.offset_std_m
        assert both.offset_std_m > 1e-4  # a set that does not tell it better says so

    def test_lateral_shifts(self, simulated) -> None:
        true, found = simulated
        off = found.geometry.shifts_px - true.places.shifts_m / true.pitch_m
        m = (1 + true.distance_m / true.places.depths_m)[:, None]
        # Which mask point is the centre is open: b m for one b. 0.2 pixels are asked for, 0.01 to 0.03 are found.
        assert np.abs(off - m * (m * off).sum(0) / (m**2).sum()).max() < 0.05
        assert np.ptp(found.geometry.shifts_px, axis=0).max() > 3

    def test_distances_set_by_hand(self, simulated) -> None:
        true, found = simulated
        hidden = true.places.depths_m - true.depths_m
        near = slice(0, 4)  # farther out a pair's own error is as large
        assert np.abs(found.geometry.depth_errors_m - hidden)[near].max() < 2e-4
        assert not found.geometry.misplaced

    def test_exposures(self, simulated) -> None:
        true, found = simulated
        light = true.light.sum((1, 2, 3))
        given = np.array(PEAKS) / true.light.max((1, 2, 3)) * light
        ratio = np.array([plane.exposure for plane in found.planes]) / given
        np.testing.assert_allclose(ratio / ratio.mean(), 1, atol=0.01)

    def test_the_stack_predicts_its_own_planes(self, simulated) -> None:
        true, found = simulated
        assert max(left_out_errors(found.stack, found.geometry.distance.distance_m)) < 0.35
        assert found.stack.provenance["registration"]["unlike_neighbours"] == []
        # The stored frame, upright: the pictures were rotated.
        image, light = found.stack.values[2, 0], true.light[2, 0]
        image = image[tuple(slice((n - 1) // 2 - 20, (n - 1) // 2 + 21) for n in image.shape)]
        light = light[tuple(slice(n // 2 - 20, n // 2 + 21) for n in light.shape)]
        assert np.corrcoef(image.ravel(), light.ravel())[0, 1] > 0.8  # moved by parts of a pixel; 0.1 if not rotated

    def test_nothing_is_to_be_measured_again(self, simulated) -> None:
        assert [plane.faults for plane in simulated[1].planes] == [()] * 6
        assert "nothing needs to be measured again" in describe_calibration(simulated[1])


@pytest.fixture(scope="module")
def faulty(truth, recorded, tmp_path_factory):
    """The second plane saturates, the third is at another place than its name says, the last is dark."""
    true = truth("flatcam")
    stated = list(true.depths_m)
    stated[2] *= 1.04
    peaks = [0.7, 1.6, 0.7, 0.7, 0.7, 0.05]
    folder = recorded(tmp_path_factory.mktemp("faulty") / "set", true.light, names(stated), peaks)
    return true, calibrate(folder, true.pitch_m, bits=12, nominal_m=2.1e-3)


class TestFaults:
    def test_each_is_told_where_it_is(self, faulty) -> None:
        found = faulty[1]
        assert [bool(plane.faults) for plane in found.planes] == [False, True, True, False, False, True]
        assert found.planes[1].saturated > 1e-4
        assert found.planes[5].peak < 0.1
        assert found.geometry.misplaced == (2,)
        text, page = describe_calibration(found), calibration_html(found, "a < b")
        for words in ("4.5 cm: ", "6.24 cm: ", "20 cm: "):
            assert words in text
        assert "a &lt; b" in page
        assert found.stack.provenance["warnings"][1].startswith("6.24 cm: ")

    def test_a_misplaced_plane_does_not_pull_the_others(self, faulty) -> None:
        true, found = faulty
        assert found.geometry.distance.distance_m == pytest.approx(true.distance_m, rel=0.02)
        assert found.geometry.depth_errors_m[2] == pytest.approx(true.places.depths_m[2] - 0.0624, abs=2e-4)

    def test_numbers_are_strict_json(self, faulty) -> None:
        record = faulty[1].record()
        assert json.loads(json.dumps(record, allow_nan=False)) == record


def test_a_zero_of_the_scale_beside_the_mask_is_told_not_assumed(truth, recorded, tmp_path) -> None:
    """Distances from a housing 4 mm in front of the mask: the images say so, and --offset-mm mends it."""
    true = truth("flatcam")
    stated = [round(depth - 4e-3, 6) for depth in true.depths_m]
    folder = recorded(tmp_path / "set", true.light, names(stated), PEAKS)
    found = calibrate(folder, true.pitch_m, bits=12, nominal_m=2e-3)
    both = found.geometry.with_offset
    assert both.offset_m == pytest.approx(4e-3, abs=3 * both.offset_std_m)
    assert "--offset-mm" in describe_calibration(found)
    np.testing.assert_allclose(found.stack.depths_m, stated)  # as they were stated
    mended = calibrate(folder, true.pitch_m, bits=12, nominal_m=2e-3, offset_m=4e-3)
    np.testing.assert_allclose(mended.stack.depths_m, true.depths_m)
    assert mended.geometry.distance.distance_m == pytest.approx(true.distance_m, rel=0.005)
    assert "--offset-mm" not in describe_calibration(mended)


@pytest.mark.slow
def test_few_distances_say_what_they_cannot(truth, recorded, tmp_path) -> None:
    true = truth("flatcam")
    one = calibrate(
        recorded(tmp_path / "one", true.light[:1], names(true.depths_m[:1]), PEAKS[:1]), true.pitch_m, bits=12
    )
    assert one.geometry.distance is None
    assert "one distance does not tell" in describe_calibration(one)
    ends = true.light[[0, 5]], names([true.depths_m[0], true.depths_m[5]]), PEAKS[:2]
    two = calibrate(recorded(tmp_path / "two", *ends), true.pitch_m, bits=12)
    assert two.geometry.distance.distance_m == pytest.approx(true.distance_m, rel=0.02)
    assert two.geometry.with_offset is None
    assert not np.isfinite(two.geometry.depth_errors_m).any()
    assert two.record()["depth_scatter_m"] is None
    for found in (one, two):
        assert calibration_html(found, "few").startswith("<!doctype html>")


def test_pictures_of_another_size_are_named(truth, recorded, tmp_path) -> None:
    true = truth("flatcam")
    folder = recorded(tmp_path / "set", true.light[:2], names(true.depths_m[:2]), PEAKS[:2])
    np.save(folder / "z500mm.npy", np.ones((20, 20)))
    with pytest.raises(InputError, match=r"(z500mm\.npy|dark_0\.tif): "):
        calibrate(folder, true.pitch_m)


# ---- dots in a mask, cast by interpolation alone: upright as they are stored, x = m u + (m - 1) X, and 1 / m^2 as bright

DISTANCE_M, PITCH_M, SIZE = 2e-3, 1e-5, 128
DEPTHS_M = (0.04, 0.05, 0.07, 0.1, 0.2)


def cast(depth_m: float, source_m: tuple[float, float] = (0, 0)) -> np.ndarray:
    """Return the light ``(H, W)`` of a point source through dots in the middle of a mask, stored frame, 1 at most."""
    rng = np.random.default_rng(5)
    dots = np.zeros((SIZE, SIZE))
    dots[34:94, 34:94] = rng.random((60, 60)) > 0.97
    m = 1 + DISTANCE_M / depth_m
    y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
    u, v = ((axis - (m - 1) * at / PITCH_M) / m + SIZE // 2 for axis, at in zip((x, y), source_m, strict=True))
    pattern = gaussian_filter(dots, 1.5)
    return map_coordinates(pattern / pattern.max(), [v, u], order=3).clip(0) / m**2


def lab(folder: Path, *, depths_m=DEPTHS_M, sources_m=None, noise=4.0, frames=2, kind=np.uint16) -> Path:
    """Write pictures of up to 2500 DN over a level of 300 DN, stored frame, and dark frames."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    for number in range(frames):
        for k, depth_m in enumerate(depths_m):
            light = 300 + 2500 * cast(depth_m, sources_m[k] if sources_m else (0, 0))
            light += rng.normal(0, noise, light.shape)
            np.save(folder / f"{depth_m * 100:g}cm_{number}.npy", (np.round(light) if noise else light).astype(kind))
        np.save(folder / f"dark_{number}.npy", (300 + rng.normal(0, noise, (SIZE, SIZE))).astype(kind))
    return folder


def calibrated(folder: Path, **options):
    return calibrate(folder, PITCH_M, **{"frame": "stored", "bits": 12} | options)


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory):
    """The middle source was 0.3 mm off the others' line; the line is slanted and beside the axis."""
    sources = [(1e-4 + 2e-3 * depth, -2e-4) for depth in DEPTHS_M]
    sources[2] = (sources[2][0] + 3e-4, sources[2][1])
    folder = lab(tmp_path_factory.mktemp("known") / "lab", sources_m=sources)
    return folder, sources, calibrated(folder)


class TestKnownLight:
    def test_the_distance_is_searched(self, by_hand) -> None:
        g = by_hand[2].geometry
        assert g.distance.distance_m == pytest.approx(DISTANCE_M, abs=5 * g.distance.distance_std_m)
        assert g.distance.distance_std_m < 5e-3 * DISTANCE_M

    def test_a_start_that_is_far_off_is_not_believed(self, by_hand) -> None:
        folder, _, found = by_hand
        other = calibrated(folder, nominal_m=0.05)
        assert other.geometry.distance.distance_m == pytest.approx(found.geometry.distance.distance_m, rel=1e-3)
        assert [plane.faults for plane in other.planes] == [()] * 5

    def test_a_source_off_the_line(self, by_hand) -> None:
        g = by_hand[2].geometry
        assert g.off_the_line == (2,)
        np.testing.assert_allclose(g.off_line_m[2], [3e-4, 0], atol=3e-5)  # 0.01 px of its shift are 4 um
        assert sum("off the others" in note for plane in by_hand[2].planes for note in plane.notes) == 1

    def test_centroids_are_those_of_the_light(self, by_hand) -> None:
        _, sources, found = by_hand
        for plane, depth_m, source_m in zip(found.planes, DEPTHS_M, sources, strict=True):
            light = cast(depth_m, source_m)
            y, x = np.mgrid[:SIZE, :SIZE] - SIZE // 2
            expected = [(axis * light).sum() / light.sum() for axis in (x, y)]
            np.testing.assert_allclose(plane.centroid_px, expected, atol=0.05)

    def test_the_wrong_zero_is_found_from_whatever_was_given(self, by_hand) -> None:
        folder = by_hand[0]
        text = describe_calibration(calibrated(folder, offset_m=0.01))
        assert "nearer" in text
        found = re.search(r"run again with --offset-mm (-?[\d.]+)", text)
        assert found
        assert float(found[1]) == pytest.approx(0, abs=0.5)
        assert "--offset-mm" not in describe_calibration(calibrated(folder, offset_m=float(found[1]) * 1e-3))


def test_sources_on_a_line_are_not_said_to_be_off_it_without_noise(tmp_path) -> None:
    found = calibrated(lab(tmp_path / "lab", noise=0, frames=1, kind=np.float64))
    assert found.geometry.off_the_line == ()


def test_files_of_more_bits_than_the_sensor_are_not_too_dark(tmp_path) -> None:
    found = calibrated(lab(tmp_path / "lab", depths_m=DEPTHS_M[:2]), bits=None)
    assert [plane.faults for plane in found.planes] == [(), ()]
    assert "--bits" in found.notes[0]
    for words in (describe_calibration(found), calibration_html(found, "lab")):
        assert found.notes[0] in words


def test_noise_does_not_become_light(tmp_path) -> None:
    """A brightest pixel 47 times the noise: cut off at zero, noise beside the PSF would be 11 % of the stack's light."""
    found = calibrated(lab(tmp_path / "lab", depths_m=(0.05,), noise=50 / np.sqrt(2), frames=1))
    light = cast(0.05)
    beside = gaussian_filter(light, 8) < 1e-3 * light.max()
    values = found.stack.values[0, 0] / found.stack.values.sum()
    assert values[beside].sum() < 0.01
    assert found.planes[0].faults == ()
    assert found.planes[0].negative_share > 0.05


def test_a_glow_below_the_noise_is_kept(tmp_path) -> None:
    """Its light is that of the PSF, each pixel of it a fifth of the noise."""
    folder = lab(tmp_path / "lab", depths_m=(0.05,), noise=50.0, frames=1)
    picture = np.load(folder / "5cm_0.npy")
    np.save(folder / "5cm_0.npy", picture + np.uint16(10))
    bare, glowing = (calibrated(lab(tmp_path / "bare", depths_m=(0.05,), noise=50.0, frames=1)), calibrated(folder))
    shares = [float(found.stack.values[0, 0, :20].mean() / found.stack.values.max()) for found in (bare, glowing)]
    assert shares[1] - shares[0] == pytest.approx(10 / 2500, rel=0.3)


@pytest.mark.parametrize("told", [{"frame": "x"}, {"binning": 0}, {"throughput_m2": -1.0}])
def test_settings_are_checked_before_files_are_read(tmp_path, told) -> None:
    (tmp_path / "5cm.npy").write_bytes(b"broken")
    with pytest.raises(InputError, match=f"^{next(iter(told))}"):
        calibrated(tmp_path, **told)
    with pytest.raises(InputError, match=r"^pixel_pitch_m"):
        calibrate(tmp_path, -3e-6)


@pytest.fixture(scope="module")
def done(tmp_path_factory, command):
    folder = lab(tmp_path_factory.mktemp("command") / "my lab", depths_m=DEPTHS_M[:3])
    (folder / "notes.txt").write_text("on the bench")
    options = ("--pixel-um", 10, "--bits", 12, "--binning", 2, "--frame", "stored")
    return folder, options, command("calibrate", folder, *options)


class TestCommand:
    def test_it_writes_a_stack_and_a_report(self, done) -> None:
        from simulator.optics.stack_files import read_psf_stack, stack_folder

        folder, _, run = done
        assert run.returncode == 0, run.stderr
        assert "mask to sensor" in run.stdout
        assert "left out: 1 .txt" in run.stdout
        made = folder.with_name("my lab_calibrated")
        stack = read_psf_stack(stack_folder(made))
        assert (stack.channels, stack.pixel_pitch_m) == (("grey",), pytest.approx(20e-6))
        assert json.loads((made / "calibration.json").read_text())["mask_to_sensor"]["distance_m"] > 0
        assert "<img" in (made / "report.html").read_text()

    @pytest.mark.slow
    def test_what_it_says_to_do_next_works(self, done, command, tmp_path) -> None:
        folder, _, run = done
        (line,) = (line for line in run.stdout.splitlines() if line.startswith("use it: flatlight "))
        words = [str(folder / "7cm_0.npy") if word == "CAPTURE" else word for word in shlex.split(line)[3:]]
        again = command(*words, "--output", tmp_path / "found")
        assert again.returncode == 0, again.stderr
        assert (tmp_path / "found" / "image.png").is_file()

    @pytest.mark.slow
    def test_it_replaces_its_own_results_only(self, done, command, tmp_path) -> None:
        folder, options, _ = done
        assert command("calibrate", folder, *options).returncode == 0
        for name in ("report.html", "calibration.json"):
            place = tmp_path / name.replace(".", "_")
            place.mkdir()
            (place / name).write_text("{}")
            refused = command("calibrate", folder, *options, "--output", place)
            assert (refused.returncode, "--output" in refused.stderr) == (2, True)
            assert (place / name).read_text() == "{}"

    @pytest.mark.parametrize("pitch", [0, -3, 2400])
    def test_a_pixel_pitch_that_is_none_is_named(self, command, tmp_path, pitch) -> None:
        refused = command("calibrate", tmp_path, "--pixel-um", pitch)
        assert (refused.returncode, "--pixel-um" in refused.stderr) == (2, True)

    def test_no_such_folder(self, command, tmp_path) -> None:
        refused = command("calibrate", tmp_path / "nowhere", "--pixel-um", 9.6)
        assert (refused.returncode, "nowhere" in refused.stderr) == (2, True)
