"""Stacks at other depths: own planes stay, magnification is exact, the stated error holds, no extrapolation unasked."""

import json

import numpy as np
import pytest
from scipy.special import erf

from simulator.camera.calibration import CalibrationSource, Recording, captured_light
from simulator.camera.noise import PhysicalNoise
from simulator.camera.sensor import Sensor
from simulator.errors import InputError
from simulator.optics.interpolation import interpolate_stack, left_out_errors
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.resample import magnified
from simulator.optics.stack import PsfStack, depth_planes
from simulator.types import CameraGeometry, SpectralResponse

D = 1.9e-3


def spots(depths_m, dtype=np.float64) -> PsfStack:
    """Gaussian spots that only magnify, integrated exactly over pixels of 10 um: sum H p^2 is the same at every depth."""
    depths = np.asarray(depths_m, float)
    places, sigma, p = np.array([[-250e-6, 120e-6], [90e-6, 310e-6], [330e-6, -280e-6]]), 25e-6, 10e-6
    edges = (np.arange(102) - 50.5) * p
    values = np.zeros((len(depths), 1, 101, 101))
    for k, m in enumerate(1 + D / depths):
        for place in places:
            y, x = (np.diff(erf((edges - m * c) / (np.sqrt(2) * m * sigma))) / 2 for c in place)
            values[k, 0] += y[:, None] * x[None]
    return PsfStack(values.astype(dtype) / p**2 * 1e-6, depths, p, ("G",), "spots")


def error(found, reference) -> np.ndarray:
    """Relative L2 error per depth."""
    return np.array([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in zip(found, reference, strict=True)])


class TestOwnDepths:
    @pytest.mark.parametrize("dtype", [np.float32, np.float64])
    def test_own_depths_give_own_values_bit_by_bit(self, dtype) -> None:
        stack = spots([0.036, 0.05, 0.2, np.inf], dtype)
        found = interpolate_stack(stack, stack.depths_m.tolist(), D)
        assert found.values.dtype == dtype
        np.testing.assert_array_equal(found.values, stack.values)
        assert [plane["error"] for plane in found.provenance["interpolation"]["planes"]] == [0.0] * 4

    def test_a_depth_that_differs_by_rounding_is_the_same(self) -> None:
        stack = spots([0.07, 0.2])
        found = interpolate_stack(stack, [7 * 1e-2, 0.19999999999999998], D)
        np.testing.assert_array_equal(found.values, stack.values)


class TestBetween:
    def test_pure_magnification_is_undone(self) -> None:
        depths = depth_planes(0.02, np.inf, 9)
        reference = spots(depths)
        stack = spots(depths[::2])
        found = interpolate_stack(stack, depths[1::2].tolist(), D).values
        ours = error(found, reference.values[1::2])
        # Third-order interpolation of spots 2.5 pixels wide; the limiter flattens their very tops.
        assert ours.max() < 5e-3
        assert ours.max() < error((stack.values[1:] + stack.values[:-1]) / 2, reference.values[1::2]).min() / 5
        assert ours.max() < error(stack.values[1:], reference.values[1::2]).min() / 20

    def test_disparity_decides_the_weights(self) -> None:
        # Flat planes cannot tell magnification: what is left is the blend.
        flat = np.ones((2, 1, 41, 41)) * np.array([1.0, 3.0])[:, None, None, None]
        stack = PsfStack(flat, np.array([0.04, np.inf]), 1e-5, ("G",), "flat")
        depth = 0.1
        middle = interpolate_stack(stack, [depth], D, accept_error=9).values[0, 0, 20, 20]
        share, m = 0.04 / 0.1, 1 + D / depth
        assert middle == pytest.approx((share * 1 * (1 + D / 0.04) ** 2 + (1 - share) * 3) / m**2, rel=1e-12)

    def test_energy_is_kept_and_light_stays_light(self) -> None:
        image = np.zeros((2, 60, 71))
        image[:, 20:40, 25:45] = np.random.default_rng(0).exponential(size=(2, 20, 20))
        for factor in (0.8, 0.99, 1.013, 1.3):
            new = magnified(image, factor)
            assert new.min() >= 0
            np.testing.assert_allclose(new.sum((1, 2)), image.sum((1, 2)), rtol=1e-12)
            rows, columns = (np.arange(n) - n // 2 for n in image.shape[1:])
            for axis, at in ((2, rows), (1, columns)):
                old, moved = (i.sum(axis) @ at / i.sum((1, 2)) for i in (image, new))
                # The origin, not the middle of the array, stays; pixels' light is redistributed within a pixel.
                np.testing.assert_allclose(moved, factor * old, atol=0.05)


class TestStatedError:
    def test_it_is_that_of_planes_left_out(self) -> None:
        stack = spots([0.03, 0.05, 0.2])
        without = PsfStack(stack.values[::2], stack.depths_m[::2], stack.pixel_pitch_m, ("G",), "two")
        predicted = interpolate_stack(without, [0.05], D).values
        assert left_out_errors(stack, D)[1] == pytest.approx(error(predicted, stack.values[1:2])[0], rel=1e-12)

    def test_light_finer_than_a_pixel_is_counted_where_planes_left_out_do_not_show_it(self) -> None:
        # Planes so near to each other that they predict one another, and a plane that needs shifts of half a pixel.
        noise = np.random.default_rng(2).exponential(size=(1, 1, 101, 101)).repeat(3, 0)
        stack = PsfStack(noise, np.array([0.2, 0.2001, 0.2002]), 1e-5, ("G",), "noise")
        found = interpolate_stack(stack, [0.1], D, extrapolate=True)
        (plane,) = found.provenance["interpolation"]["planes"]
        factor = (1 + D / 0.1) / (1 + D / 0.2)
        there_and_back = magnified(magnified(noise[0], factor), 1 / factor)
        assert plane["error"] == pytest.approx(error([there_and_back], noise[:1])[0], rel=1e-12)
        assert plane["error"] > 20 * max(left_out_errors(stack, D))

    def test_a_single_plane_says_nothing(self) -> None:
        stack = spots([0.05])
        assert left_out_errors(stack, D) == [None]
        found = interpolate_stack(stack, [0.06], D, extrapolate=True)
        (plane,) = found.provenance["interpolation"]["planes"]
        assert (plane["error"], plane["extrapolated"], plane["from_planes"]) == (None, True, [0])

    def test_provenance_is_strict_json_even_at_infinity(self) -> None:
        provenance = interpolate_stack(spots([0.05, np.inf]), [0.1, np.inf], D).provenance
        assert json.loads(json.dumps(provenance, allow_nan=False)) == provenance


class TestOutside:
    def test_it_is_refused_unless_asked_for(self) -> None:
        stack = spots([0.05, 0.2])
        with pytest.raises(InputError, match=r"^depths_m: "):
            interpolate_stack(stack, [0.04, 0.1, np.inf], D)
        found = interpolate_stack(stack, [0.04, 0.1, np.inf], D, extrapolate=True)
        # The spots only magnify, so the outermost plane magnified is right.
        assert error(found.values, spots([0.04, 0.1, np.inf]).values).max() < 5e-3
        marks = [plane["extrapolated"] for plane in found.provenance["interpolation"]["planes"]]
        assert marks == [True, False, True]

    def test_mistakes_are_named(self) -> None:
        with pytest.raises(InputError, match=r"^depths_m: "):
            interpolate_stack(spots([0.05, 0.2]), [0.1, 0.07], D)
        with pytest.raises(InputError, match=r"^mask_to_sensor_m: "):
            interpolate_stack(spots([0.05, 0.2]), [0.1], 0)


@pytest.fixture(scope="module")
def diffractive() -> tuple[PsfStack, PsfStack, np.ndarray]:
    """Nine planes as captured, the reference of them all, and their depths: a mask 2 mm wide on 8 um pixels."""
    rng = np.random.default_rng(5)
    amplitude = np.kron(rng.integers(0, 2, (50, 50)), np.ones((10, 10), int)).astype(np.float32)
    mask = Mask(np.zeros_like(amplitude), amplitude, 4e-6, name="squares")
    response = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("G",), "532 nm")
    camera = CameraGeometry(D, 8e-6, response)
    depths = depth_planes(0.036, 0.2, 9)
    config = PsfConfig(tuple(depths), wavelengths_per_channel=1)
    reference = compute_psf_stack(mask, camera, config)
    # 25 um source, stage and depths as good as a micrometre stage: what is left is noise and blur.
    places = CalibrationSource(25e-6, 0, 2e-5, 5e-6).place(config.depths_m, D, rng)
    light = captured_light(mask, camera, config, places, reference.values.shape[-1])
    sensor = Sensor("s", 2e-6, (9, 9), 4, (1, 1), 15000, 2.7, 0.3, 0.1, 0.006, 64.0, 12, noise=PhysicalNoise())
    recorded = [Recording(0.7, 10, 0.005, 0.003).record(plane, np.ones(1), sensor, rng)[0] for plane in light]
    captured = PsfStack(np.stack(recorded), reference.depths_m, 8e-6, ("G",), "captured")
    return captured, reference, depths


@pytest.mark.slow
@pytest.mark.parametrize(("step", "of_linear", "of_nearest"), [(2, 0.85, 0.5), (4, 0.5, 0.4)])
def test_a_stack_as_captured_between_its_planes(diffractive, step, of_linear, of_nearest) -> None:
    """Between measured planes, against the computed reference; the farther they are apart, the more magnification matters.

    What is left is mostly light finer than a pixel, which no resampling brings back: 8 um pixels, speckle of a few um.
    """
    captured, reference, depths = diffractive
    known, wanted = np.s_[::step], np.s_[step // 2 :: step]
    stack = PsfStack(captured.values[known], depths[known], 8e-6, ("G",), "part")
    found = interpolate_stack(stack, depths[wanted].tolist(), D)
    ours = error(found.values, reference.values[wanted])
    near, far = stack.values[:-1], stack.values[1:]
    linear = error((near + far) / 2, reference.values[wanted])
    nearest = np.minimum(error(near, reference.values[wanted]), error(far, reference.values[wanted]))
    stated = np.array([plane["error"] for plane in found.provenance["interpolation"]["planes"]])
    assert np.all(ours < stated)
    assert np.all(ours < of_linear * linear)
    assert np.all(ours < of_nearest * nearest)
