"""Truth found again from frames: mask distance, shifts and exposures of three kinds of masks, and what went wrong."""

import json

import numpy as np
import pytest

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


def test_the_command_writes_a_stack_that_is_of_use_at_once(truth, recorded, tmp_path, command) -> None:
    from simulator.optics.stack_files import read_psf_stack, stack_folder

    true = truth("flatcam")
    folder = recorded(tmp_path / "lab", true.light[:3], names(true.depths_m[:3]), PEAKS[:3])
    done = command("calibrate", folder, "--pixel-um", 9.6, "--bits", 12, "--mask-to-sensor-mm", 2)
    assert done.returncode == 0, done.stderr
    assert "mask to sensor" in done.stdout
    made = tmp_path / "lab_calibrated"
    stack = read_psf_stack(stack_folder(made))
    assert (stack.channels, stack.pixel_pitch_m) == (("grey",), pytest.approx(9.6e-6))
    assert json.loads((made / "calibration.json").read_text())["mask_to_sensor"]["distance_m"] > 0
    assert "<img" in (made / "report.html").read_text()
    refused = command("calibrate", tmp_path / "nowhere", "--pixel-um", 9.6)
    assert (refused.returncode, "nowhere" in refused.stderr) == (2, True)
