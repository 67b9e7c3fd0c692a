"""PhlatCam keeps what it promises: fabricable heights, the asked size, and the contours that it was made to cast."""

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import distance_transform_edt

from psf_library.designs.phlatcam import phlatcam
from simulator.design.patterns import contours, contours_of_image
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.materials import PHLATCAM_RESIST


@pytest.fixture(scope="module")
def small() -> Mask:
    return phlatcam(width_mm=0.8, iterations=8)


def test_phlatcam_heights_are_fabricable_steps(small):
    """Multiples of 0.2 um from 0 to the floor of one wave (532 nm / 0.5103 = 1.04 um), all of them used."""
    steps = np.asarray(small.height_m, float) / 0.2e-6
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-5)
    assert set(np.rint(steps).astype(int).ravel()) == {0, 1, 2, 3, 4, 5}
    assert small.profile == "staircase"
    assert small.material is PHLATCAM_RESIST
    assert np.all(small.amplitude == 1)


def test_phlatcam_has_the_size_that_was_asked_for(small):
    assert small.shape == (400, 400)
    assert small.pitch_m == 2e-6
    coarse = phlatcam(width_mm=0.9, pixel_um=3.0, iterations=1)
    assert (coarse.shape, coarse.pitch_m) == ((300, 300), 3e-6)


def test_phlatcam_without_steps_is_continuous():
    mask = phlatcam(width_mm=0.3, iterations=1, step_um=0)
    assert len(np.unique(mask.height_m)) > 1000
    assert 0 <= mask.height_m.min() < mask.height_m.max() < 532e-9 / 0.5103


def test_the_contours_are_lines_of_the_asked_width():
    """The largest inscribed radius along a line 6 to 7 samples wide is 3 to 4; junctions are a little wider."""
    target = contours(600, 120, 6, 1)
    assert set(np.unique(target)) == {0.0, 1.0}
    assert 0.05 < target.mean() < 0.35
    depth = distance_transform_edt(target)
    ridge = depth[depth >= 3]
    assert 3 <= np.median(ridge) <= 4


def test_a_mask_smaller_than_a_cell_is_still_a_camera():
    assert phlatcam(width_mm=0.06, iterations=1).transmitted_area_m2 == pytest.approx(3.6e-9)


# --- a pattern from a picture


@pytest.fixture
def letter(tmp_path):
    """A white L of two grey levels, not symmetric in any way, and its picture file."""
    pattern = np.zeros((100, 100), np.uint8)
    pattern[20:80, 30:40] = 1
    pattern[70:80, 30:60] = 1
    path = tmp_path / "letter.png"
    Image.fromarray(pattern * 200).save(path)
    return pattern, path


def test_a_picture_of_two_levels_is_the_pattern(letter):
    pattern, path = letter
    np.testing.assert_array_equal(contours_of_image(path, 100, 6), pattern)
    fine = contours_of_image(path, 300, 6)
    assert set(np.unique(fine)) == {0, 1}
    assert np.mean(fine != np.kron(pattern, np.ones((3, 3)))) < 0.005  # corners only


def test_a_grey_picture_gives_its_edges(tmp_path):
    """A grey disc on a grey ramp, and a faint one in it: a ring of the asked width on its rim and nowhere else."""
    y, x = np.mgrid[:150, :150] - 74.5
    image = (100 + 60 * (np.hypot(x, y) < 40) + 0.1 * x + 4 * (np.hypot(x, y) < 20)).astype(np.uint8)
    Image.fromarray(image).save(tmp_path / "disc.tif")
    found = contours_of_image(tmp_path / "disc.tif", 150, 6)
    away = np.abs(np.hypot(x, y) - 40)
    assert np.all(found[away < 1.5] == 1)
    assert np.all(found[away > 5.5] == 0)
    assert found.sum() == pytest.approx(2 * np.pi * 40 * 7, rel=0.1)  # 6 to 7 samples wide


def test_the_picture_is_what_the_mask_casts(letter, psf_at_infinity):
    """Upright as seen from behind the sensor, at its distance; the helper rotates the stored PSF back."""
    pattern, path = letter
    mask = phlatcam(width_mm=0.4, image=path, iterations=10)

    def cast(distance_m):
        psf = psf_at_infinity(mask, distance_m, 4e-6)
        middle = len(psf) // 2
        return psf[middle - 50 : middle + 50, middle - 50 : middle + 50]

    def likeness(image):
        return np.corrcoef(image.ravel(), pattern.ravel())[0, 1]

    psf = cast(1869e-6)
    assert likeness(psf) > 0.85
    for other in (psf[::-1], psf[:, ::-1], psf[::-1, ::-1], psf.T, cast(900e-6)):
        assert likeness(other) < likeness(psf) - 0.15
    print(
        [likeness(np.roll(psf, s, a)) - likeness(psf) for s in (-1, 1) for a in (0, 1)],
        likeness(psf),
        likeness(cast(900e-6)),
    )


def test_pictures_that_are_no_pattern_are_refused(tmp_path):
    Image.fromarray(np.eye(30, 40, dtype=np.uint8)).save(tmp_path / "wide.png")
    Image.fromarray(np.full((30, 30), 7, np.uint8)).save(tmp_path / "flat.png")
    for name in ("wide.png", "flat.png", "none.png"):
        with pytest.raises(InputError, match=f"{name}"):
            phlatcam(width_mm=0.1, image=tmp_path / name)


# --- phase retrieval that stops, and fabrication


def test_the_retrieval_stops_when_it_gains_no_more_and_says_so():
    """Of at most 1000 passes a coarse tolerance makes a few; the mask is that of so many, and they are recorded."""
    stopped = phlatcam(width_mm=0.3, iterations=1000, tolerance=5e-3)
    passes = stopped.notes["retrieval"]["passes"]
    assert 3 <= passes < 10
    assert stopped.digest() == phlatcam(width_mm=0.3, iterations=passes, tolerance=0).digest()
    further = phlatcam(width_mm=0.3, iterations=passes + 3, tolerance=0).notes["retrieval"]
    assert further["passes"] == passes + 3
    assert 0.7 < stopped.notes["retrieval"]["overlap"] < further["overlap"] < 1


def test_tolerances_reach_the_mask(small):
    """5 % too high, 20 nm rough, rounded by 1 um; without them the mask is the design."""
    high = phlatcam(width_mm=0.8, iterations=8, height_error_percent=5)
    np.testing.assert_allclose(high.height_m, 1.05 * small.height_m, rtol=1e-6)
    rough = phlatcam(width_mm=0.8, iterations=8, roughness_nm=20, fabrication_seed=3)
    assert np.std(rough.height_m - small.height_m) == pytest.approx(20e-9, rel=0.02)
    round_ = phlatcam(width_mm=0.8, iterations=8, rounding_um=1)
    assert (round_.profile, round_.shape) == ("smooth", (1200, 1200))
    assert round_.height_m.mean() == pytest.approx(small.height_m.mean(), rel=1e-3)
    assert round_.height_m.std() < 0.95 * small.height_m.std()
