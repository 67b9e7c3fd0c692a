"""Images resampled to the view: against block means, OpenCV's undistortion and real checkerboards."""

import numpy as np
import pytest
from PIL import Image
from scipy.sparse import csr_array

from simulator.colour import decode_srgb_image, linear_to_srgb
from simulator.errors import InputError
from simulator.importers.camera_models import OpencvFisheye, Pinhole, Scaramuzza
from simulator.importers.undistortion import build_lookup
from simulator.types import View

# EndoSLAM's own calibrations, MATLAB's numbers (first pixel 1).
MIRO_PINHOLE = Pinhole(
    fx=159.59060167, fy=159.22405216, cx=161.92969024, cy=163.16857089, distortion=(-0.23212007, 0.03774762),
    first_pixel=1,
)  # fmt: skip
MIRO_FISHEYE = Scaramuzza(
    mapping=(135.999364, -5.68730971e-3, 5.81750636e-5, -2.27853502e-7), cx=163.24233245,
    cy=161.53438158, first_pixel=1,
)  # fmt: skip


def view_of(shape, focal_px):
    """A view whose pixels are those of a pinhole camera with this focal length."""
    return View(shape, 1e-6, focal_px * 1e-6, 0.01, 0.1)


class TestLookup:
    def test_the_same_camera_changes_nothing(self):
        picture = np.random.default_rng(0).random((9, 12, 3), np.float32)
        lens = Pinhole(fx=20.0, fy=20.0, cx=5.5, cy=4.0)
        lookup = build_lookup(lens, (9, 12), view_of((9, 12), 20.0), "angles", None)
        # Bilinear weights differ from 0 and 1 by a few roundings of the coordinates.
        np.testing.assert_allclose(lookup.colour(picture), picture, rtol=0, atol=1e-6)
        assert np.array_equal(lookup.nearest.reshape(-1), np.arange(9 * 12))
        assert lookup.seen.all()

    def test_shrinking_is_the_mean_over_each_footprint(self):
        picture = np.random.default_rng(0).random((12, 20, 3), np.float32)
        lens = Pinhole(fx=40.0, fy=40.0, cx=9.5, cy=5.5)
        lookup = build_lookup(lens, (12, 20), view_of((3, 5), 10.0), "angles", None)
        expected = picture.reshape(3, 4, 5, 4, 3).mean((1, 3))
        np.testing.assert_allclose(lookup.colour(picture), expected, rtol=0, atol=1e-6)

    def test_fill_takes_all_of_the_picture_that_the_view_can_use(self):
        """The view is 3:4; of a 12 x 20 picture around its centre 12 x 16 pixels fill it."""
        lens = Pinhole(fx=40.0, fy=40.0, cx=9.5, cy=5.5)
        lookup = build_lookup(lens, (12, 20), view_of((3, 4), 33.0), "fill", None)
        assert lookup.scale == pytest.approx((6 / 40) / (1.5 / 33), rel=1e-9)
        picture = np.random.default_rng(0).random((12, 20, 3), np.float32)
        expected = picture[:, 2:18].reshape(3, 4, 4, 4, 3).mean((1, 3))
        np.testing.assert_allclose(lookup.colour(picture), expected, rtol=0, atol=1e-6)

    def test_fill_stays_inside_the_circle(self):
        lens = Pinhole(fx=40.0, fy=40.0, cx=49.5, cy=49.5)
        lookup = build_lookup(lens, (100, 100), view_of((6, 8), 10.0), "fill", (49.5, 49.5, 40.0))
        assert np.hypot(4, 3) * lookup.scale / 10 * 40 == pytest.approx(40.0, rel=1e-9)  # the corner of a 3:4 view

    def test_fill_stops_at_70_degrees(self):
        """A fisheye of 50 px focal length sees 90 degrees 79 px from the axis, well inside its picture."""
        lens = OpencvFisheye(fx=50.0, fy=50.0, cx=99.5, cy=99.5)
        lookup = build_lookup(lens, (200, 200), view_of((6, 8), 10.0), "fill", None)
        assert lookup.seen.all()
        assert np.degrees(np.arctan(0.5 * lookup.scale)) == pytest.approx(70, rel=1e-12)  # corners at hypot(4, 3) / 10

    @pytest.mark.parametrize("field", ["fill", "angles"])
    def test_a_pinhole_s_weights_are_those_of_any_lens(self, field):
        """A distortion too small to move a sample by a rounding takes the way of all lenses."""
        picture = np.random.default_rng(0).random((31, 43, 3), np.float32)
        lenses = (Pinhole(fx=50.0, fy=47.0, cx=20.3, cy=14.1, distortion=each) for each in ((), (1e-14, 0.0)))
        fast, slow = (build_lookup(lens, (31, 43), view_of((7, 11), 12.0), field, None) for lens in lenses)
        assert (type(fast.weights), type(slow.weights)) == (tuple, csr_array)
        np.testing.assert_allclose(fast.colour(picture), slow.colour(picture), rtol=0, atol=1e-6)
        assert np.array_equal(fast.nearest, slow.nearest)

    def test_what_the_picture_does_not_show_is_black_and_not_seen(self):
        lens = Pinhole(fx=10.0, fy=10.0, cx=3.5, cy=3.5)
        lookup = build_lookup(lens, (8, 8), view_of((12, 12), 10.0), "angles", None)
        expected = np.zeros((12, 12))
        expected[2:10, 2:10] = 1
        assert np.array_equal(lookup.seen, expected > 0)
        np.testing.assert_allclose(lookup.colour(np.ones((8, 8, 3), np.float32))[..., 1], expected, rtol=0, atol=1e-6)

    def test_undistorted_pictures_are_opencvs(self):
        cv2 = pytest.importorskip("cv2")
        rows, columns = np.indices((90, 120))
        smooth = (0.5 + 0.25 * np.sin(rows / 9) + 0.25 * np.cos(columns / 7)).astype(np.float32)
        matrix = np.array([[90.0, 0, 61.0], [0, 88.0, 43.0], [0, 0, 1]])
        distortion = (-0.25, 0.06, 0.001, -0.002)
        target = np.array([[100.0, 0, 29.5], [0, 100.0, 19.5], [0, 0, 1]])  # the view: 40 x 60, centred
        maps = cv2.initUndistortRectifyMap(matrix, np.array(distortion), None, target, (60, 40), cv2.CV_32FC1)
        lens = Pinhole(fx=90.0, fy=88.0, cx=61.0, cy=43.0, distortion=distortion)
        lookup = build_lookup(lens, (90, 120), view_of((40, 60), 100.0), "angles", None)
        found = lookup.colour(np.repeat(smooth[..., None], 3, 2))[..., 0]
        expected = cv2.remap(smooth, *maps, cv2.INTER_LINEAR)
        # OpenCV rounds coordinates to 1/32 pixel: at most 1/64 px x the steepest slope (0.046 per pixel) off per axis.
        assert lookup.samples == 1
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)
        nearest = np.rint(maps[1]).astype(int) * 120 + np.rint(maps[0]).astype(int)
        assert (lookup.nearest == nearest).mean() > 0.999  # float32 maps round a tie or two the other way

    def test_an_axis_outside_the_picture_is_refused(self):
        with pytest.raises(InputError, match=r"^intrinsics: "):
            build_lookup(Pinhole(fx=9.0, fy=9.0, cx=200.0, cy=4.0), (9, 12), view_of((3, 4), 9.0), "fill", None)


@pytest.mark.shared
@pytest.mark.parametrize("lens", [MIRO_PINHOLE, MIRO_FISHEYE])
@pytest.mark.parametrize("number", [1, 2])
def test_real_checkerboards_become_straight(shared_data, lens, number):
    """Rows and columns of corners lie on lines: their residual, in units of the squares' size, at least halves."""
    cv2 = pytest.importorskip("cv2")
    folder = shared_data / "endoslam/calibration/Calibration/Camera/MiroCam"
    codes = np.asarray(Image.open(folder / f"pad_Mirocam_calib_2mm__{number}.jpg").convert("RGB"))
    lookup = build_lookup(lens, (320, 320), view_of((320, 320), 110.0), "angles", None)
    linear = lookup.colour(decode_srgb_image(codes))
    straight = np.rint(255 * linear_to_srgb(linear)).astype(np.uint8)

    def residual(picture):
        grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
        found, corners = cv2.findChessboardCorners(grey, (6, 7))
        assert found
        stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
        grid = cv2.cornerSubPix(grey, corners, (4, 4), (-1, -1), stop).reshape(7, 6, 2)
        lines = [line - line.mean(0) for lines in (grid, grid.swapaxes(0, 1)) for line in lines]
        squares = [np.linalg.svd(line)[1][1] ** 2 / len(line) for line in lines]
        return np.sqrt(np.mean(squares)) / np.linalg.norm(np.diff(grid, axis=1), axis=-1).mean()

    assert residual(straight) < 0.5 * residual(codes)
