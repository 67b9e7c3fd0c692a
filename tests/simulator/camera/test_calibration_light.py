"""The light of a calibration: every error alone against geometry or analysis, and none of them against the nominal stack."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.camera.calibration import CalibrationSource, SourcePlaces, captured_light
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, compute_psf_stack, depth_images, stack_size
from simulator.optics.spectra import quantile_lines
from simulator.types import CameraGeometry, SpectralResponse

D = 1.9e-3
RESPONSE = SpectralResponse(
    np.linspace(500e-9, 620e-9, 61), np.stack([np.linspace(0, 1, 61), np.linspace(1, 0, 61)]), ("R", "G"), "ramps"
)
CAMERA = CameraGeometry(D, 20e-6, RESPONSE)
CONFIG = PsfConfig((0.04, 0.05, np.inf), wavelengths_per_channel=2, accept_error=1.0)


@pytest.fixture(scope="module")
def mask() -> Mask:
    """Open squares at random places: no flip or turn leaves it as it is; float64."""
    amplitude = np.zeros((100, 100))
    for row, column in np.random.default_rng(3).integers(5, 90, (6, 2)):
        amplitude[row : row + 6, column : column + 6] = 1
    return Mask(np.zeros_like(amplitude), amplitude, 4e-6, name="squares")


def places(depths=CONFIG.depths_m, shift=(0.0, 0.0), blur=0.0) -> SourcePlaces:
    count = len(depths)
    return SourcePlaces(np.array(depths, float), np.tile(np.asarray(shift, float), (count, 1)), np.full(count, blur))


def captured(mask, where, config=CONFIG):
    """On the nominal stack's grid."""
    return captured_light(mask, CAMERA, config, where, stack_size(mask, CAMERA, config))


def middle(values, size):
    """The central (size, size) samples."""
    first = (values.shape[-1] - size) // 2
    return values[..., first : first + size, first : first + size]


def moments(image):
    """Energy, centroid (x, y) and variances (x, y), pixels."""
    y, x = (np.arange(n) - n // 2 for n in image.shape)
    energy = image.sum()
    column, row = image.sum(0) / energy, image.sum(1) / energy
    cx, cy = column @ x, row @ y
    return energy, np.array([cx, cy]), np.array([column @ (x - cx) ** 2, row @ (y - cy) ** 2])


class TestLight:
    @pytest.mark.parametrize("model", ["scaled_distance", "exact"])
    def test_a_perfect_source_gives_the_nominal_stack(self, mask, model) -> None:
        config = replace(CONFIG, model=model, wavelengths_per_channel=1, depths_m=(0.05, np.inf))
        small = mask.crop((40, 40))
        found = captured(small, places(config.depths_m), config)
        nominal = compute_psf_stack(small, CAMERA, config).values
        np.testing.assert_allclose(found, nominal, rtol=0, atol=1e-14 * nominal.max())

    def test_depth_errors_are_computed_not_resampled_and_may_swap_neighbours(self, mask) -> None:
        true = (0.0502, 0.0471, np.inf)
        found = captured(mask, places(true))
        there = replace(CONFIG, depths_m=(0.0471, 0.0502, np.inf))
        nominal = compute_psf_stack(mask, CAMERA, there).values[[1, 0, 2]]
        size = min(found.shape[-1], nominal.shape[-1])
        np.testing.assert_allclose(middle(found, size), middle(nominal, size), rtol=0, atol=1e-14 * nominal.max())

    def test_a_shift_by_parts_of_a_pixel_is_that_of_finer_pixels(self, mask) -> None:
        # 8 um and -12 um are 2 and -3 of five samples per pixel, which are summed here without any transform.
        found = captured(mask, places(shift=(8e-6, -12e-6)))
        size = found.shape[-1]
        fine = replace(CAMERA, pixel_pitch_m=4e-6)
        expected = np.zeros_like(found)
        for line in quantile_lines(RESPONSE, 2):
            for k, image in enumerate(depth_images(mask, fine, CONFIG, line.wavelength_m, 5 * (size + 2))):
                window = image[5 + 3 : 5 + 3 + 5 * size, 5 - 2 : 5 - 2 + 5 * size]
                expected[k, line.channel] += line.weight * window.reshape(size, 5, size, 5).mean((1, 3))
        # What wraps around the transform's grid comes from its outermost rim.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * expected.max())

    def test_a_source_to_the_right_is_where_rays_say(self) -> None:
        """The ray from (X, Y, z) through (a, b, 0) meets the sensor at a - (X - a) d/z; the stored frame is rotated."""
        amplitude = np.zeros((101, 101))
        row, column = 70, 35
        amplitude[row - 5 : row + 6, column - 5 : column + 6] = 1
        hole = Mask(np.zeros_like(amplitude), amplitude, 4e-6)
        a = np.array([column - 50, row - 50]) * 4e-6
        depth, offset = 0.04, np.array([900e-6, -400e-6])
        config = PsfConfig((depth,), wavelengths_per_channel=1, accept_error=1.0)
        light = captured(hole, places((depth,), offset * D / depth), config)[0, 1]
        expected = -(a - (offset - a) * D / depth) / CAMERA.pixel_pitch_m
        # The square's diffraction is symmetric: only what falls off the grid moves the centroid.
        np.testing.assert_allclose(moments(light)[1], expected, atol=0.02)

    def test_a_disc_widens_the_psf_by_a_sixteenth_of_its_diameter_squared(self, mask) -> None:
        blur = 60e-6
        sharp, blurred = (captured(mask, places(blur=b)) for b in (0.0, blur))
        for k in range(3):
            before, after = moments(sharp[k, 0]), moments(blurred[k, 0])
            assert after[0] == pytest.approx(before[0], rel=2e-3)  # a little leaves the grid
            np.testing.assert_allclose(after[1], before[1], atol=0.02)
            widened = (after[2] - before[2]) * CAMERA.pixel_pitch_m**2
            np.testing.assert_allclose(widened, blur**2 / 16, rtol=0.1)  # the tails beyond the grid


class TestPlaces:
    def test_errors_have_the_sizes_asked_for(self) -> None:
        depths = tuple(np.linspace(0.1, 0.2, 20000))
        source = CalibrationSource(50e-6, 1e-3, 0.2e-3, 30e-6)
        found = source.place(depths, D, np.random.default_rng(0))
        error = found.depths_m - depths
        # Standard errors of a mean and of a standard deviation over 20000 draws: 0.7 %, 0.5 % of the deviation.
        assert error.mean() == pytest.approx(1e-3, abs=0.2e-3 * 0.03)
        assert error.std() == pytest.approx(0.2e-3, rel=0.02)
        scaled = found.shifts_m / (D / found.depths_m)[:, None]
        np.testing.assert_allclose(scaled.std(0), 30e-6, rtol=0.02)
        np.testing.assert_allclose(found.blurs_m, 50e-6 * D / found.depths_m)

    def test_one_error_switched_off_leaves_the_others(self) -> None:
        def draw(**errors: float) -> SourcePlaces:
            return CalibrationSource(**errors).place((0.05, 0.1), D, np.random.default_rng(4))

        both, depth_only = draw(depth_std_m=1e-3, shift_std_m=1e-4), draw(depth_std_m=1e-3)
        np.testing.assert_array_equal(both.depths_m, depth_only.depths_m)
        np.testing.assert_array_equal(depth_only.shifts_m, 0)
        np.testing.assert_array_equal(draw().depths_m, [0.05, 0.1])

    def test_a_tilted_stage_is_right_where_it_was_aligned_and_leaves_an_angle_at_infinity(self) -> None:
        tilt = (0.01, -0.02)
        found = CalibrationSource(tilt_rad=tilt).place((0.05, 0.1, np.inf), D, np.random.default_rng(0))
        off = np.tan(tilt) * np.array([[0.0], [0.05], [0.0]])  # across the axis, metres
        expected = np.array([0, D / 0.1, 0])[:, None] * off
        expected[2] = D * np.tan(tilt)
        np.testing.assert_allclose(found.shifts_m, expected, atol=1e-18)

    def test_infinity_has_angles_only(self) -> None:
        source = CalibrationSource(1e-3, 1e-3, 1e-3, 1e-3)
        found = source.place((0.05, np.inf), D, np.random.default_rng(0))
        assert found.depths_m[1] == np.inf
        assert found.blurs_m[1] == 0
        np.testing.assert_array_equal(found.shifts_m[1], 0)

    def test_a_source_behind_the_mask_is_refused(self) -> None:
        with pytest.raises(InputError, match=r"^depth_offset_m, depth_std_m: "):
            CalibrationSource(depth_offset_m=-0.02).place((0.01, 0.1), D, np.random.default_rng(0))
