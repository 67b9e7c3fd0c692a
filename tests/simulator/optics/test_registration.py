"""Shifts, magnification and exposure found again: in spots that are drawn where they belong, with noise, without a match."""

import numpy as np
import pytest
from scipy.special import erf

from simulator.errors import InputError
from simulator.optics.interpolation import interpolate_stack, left_out_errors
from simulator.optics.registration import Registration, match, register_stack
from simulator.optics.stack import PsfStack

D, PITCH, SIDE = 1.9e-3, 10e-6, 161
DEPTHS = np.array([0.02, 0.03, 0.05, 0.2, np.inf])
SHIFTS = np.array([[4.31, -2.6], [-1.2, 0.75], [0.0, 0.0], [0.4, -6.2], [-0.55, 0.35]])
EXPOSURES = np.array([1.0, 0.6, 1.7, 1.2, 0.9])


def spots(m: float, shift=(0.0, 0.0), seed=3, side=SIDE) -> np.ndarray:
    """Gaussian spots of one total light, magnified about the origin and shifted by (x, y) pixels: drawn, not resampled."""
    rng = np.random.default_rng(seed)
    edges = np.arange(side + 1) - 0.5 - side // 2
    image = np.zeros((side, side))
    for place, light in zip(rng.uniform(-50, 50, (40, 2)) * side / SIDE, rng.uniform(0.5, 1, 40), strict=True):
        x, y = (np.diff(erf((edges - m * p - s) / (np.sqrt(2) * m * 2))) / 2 for p, s in zip(place, shift, strict=True))
        image += light * y[:, None] * x
    return image


def stack(shifts=SHIFTS, exposures=EXPOSURES, noise=0.0) -> PsfStack:
    planes = [e * spots(m, s) for m, s, e in zip(1 + D / DEPTHS, shifts, exposures, strict=True)]
    values = np.stack(planes)[:, None] + noise * np.random.default_rng(0).standard_normal((len(DEPTHS), 1, SIDE, SIDE))
    return PsfStack(np.maximum(values, 0), DEPTHS, PITCH, ("G",), "spots", {"kind": "measured"})


class TestMatch:
    @pytest.mark.parametrize(("start", "side"), [(1.05, 161), (1.065, 160)])
    def test_shift_and_magnification(self, start, side) -> None:
        found = match(spots(1.095, (3.3, -7.4), side=side), spots(1.04, (-1.1, 0.2), side=side), start, free_scale=True)
        scale = 1.095 / 1.04
        # Spots 2 pixels wide, interpolated by cubic splines, their band chosen by the scale to start from: 1e-5 to 3e-5.
        assert found.scale == pytest.approx(scale, abs=6e-5)
        np.testing.assert_allclose(found.shift_px, [3.3 + scale * 1.1, -7.4 - scale * 0.2], atol=2e-3)
        assert found.correlation > 0.999

    def test_standard_errors_are_those_of_noise(self) -> None:
        rng = np.random.default_rng(1)
        fixed, moving = spots(1.06, (1.4, 0.3)), spots(1.0)
        noise = 0.1 * fixed.max()
        found = [
            match(
                *(image + noise * rng.standard_normal(image.shape) for image in (fixed, moving)), 1.06, free_scale=True
            )
            for _ in range(40)
        ]
        told = np.mean([[f.log_scale_std, *f.shift_std_px] for f in found], axis=0)
        spread = np.std([[np.log(f.scale), *f.shift_px] for f in found], axis=0)
        np.testing.assert_allclose(told, spread, rtol=0.4)  # a spread of 40 numbers is known to 11 %
        assert np.abs(np.mean([f.shift_px for f in found], axis=0) - (1.4, 0.3)).max() < 3 * spread[1:].max() / np.sqrt(
            40
        )

    def test_a_large_image_is_binned_and_keeps_its_origin(self) -> None:
        found = match(spots(1.05, (11.3, -8.1), side=1501), spots(1.0, side=1501), 1.05)
        np.testing.assert_allclose(found.shift_px, (11.3, -8.1), atol=0.02)

    def test_unlike_images_are_not_found(self) -> None:
        assert not match(spots(1.05), spots(1.0, seed=4), 1.05).found
        assert not match(spots(1.05), np.ones((SIDE, SIDE)), 1.05).found


class TestStack:
    def test_shifts_and_exposures(self) -> None:
        found = register_stack(stack(), D)
        m = (1 + D / DEPTHS)[:, None]
        off = found.shifts_px - SHIFTS
        # Which mask point is the centre is open: b m for one b. What lies off that is error.
        assert np.abs(off - m * (m * off).sum(0) / (m**2).sum()).max() < 3e-3
        # The light of the spots' magnified sides does not leave the grid. A pinhole's light at x = 50 pixels would lose
        # 0.1 % at 2 cm by (z / r)^3, which the spots do not: that is the tolerance.
        relative = found.exposures / EXPOSURES
        np.testing.assert_allclose(relative / relative.mean(), 1, atol=1.5e-3)

    def test_planes_that_agree_stay(self) -> None:
        shifts = np.zeros_like(SHIFTS)
        shifts[1] = (5.5, -3.25)
        found = register_stack(stack(shifts, np.ones(5)), D)
        np.testing.assert_allclose(found.shifts_px, shifts, atol=4e-3)

    def test_throughput_stays(self) -> None:
        light = stack()
        before, found = light.energy_m2().mean(), register_stack(light, D)
        after = interpolate_stack(light, DEPTHS.tolist(), D, registration=found).energy_m2()
        assert after.mean() == pytest.approx(before, rel=1e-9)
        assert np.ptp(after) / before < 3e-3

    def test_light_from_near_falls_off_over_the_mask(self) -> None:
        """One spot, 1 mm off the centre: from 1 cm its part of the mask gets (z / r)^3 = 0.985 of the centre's light."""
        edges = np.arange(262) - 0.5 - 130
        planes = []
        for depth in (0.01, np.inf):
            m = 1 + D / depth
            x = np.diff(erf((edges - 100 * m) / (np.sqrt(2) * 2 * m))) / 2
            y = np.diff(erf(edges / (np.sqrt(2) * 2 * m))) / 2
            planes.append((1 + (1e-3 / depth) ** 2) ** -1.5 * y[:, None] * x)
        near = PsfStack(np.stack(planes)[:, None], np.array([0.01, np.inf]), PITCH, ("G",), "spot")
        found = register_stack(near, D, lateral=False).exposures
        assert found[0] / found[1] == pytest.approx(1, abs=1e-4)  # 2e-5 m of the spot's own width

    def test_each_can_be_left_out(self) -> None:
        light = stack()
        assert not register_stack(light, D, lateral=False).shifts_px.any()
        assert np.all(register_stack(light, D, exposure=False).exposures == 1)

    def test_noise(self) -> None:
        found = register_stack(stack(noise=0.004), D)  # a tenth of the brightest spots
        off, m = found.shifts_px - SHIFTS, (1 + D / DEPTHS)[:, None]
        told = max(match.shift_std_px.max() for match in found.matches)
        assert 0.002 < told < 0.1
        assert np.abs(off - m * (m * off).sum(0) / (m**2).sum()).max() < 5 * told

    def test_a_plane_unlike_its_neighbours_is_told_and_not_moved_against_them(self) -> None:
        light = stack(np.zeros_like(SHIFTS), np.ones(5))
        light.values[2, 0] = spots(1.0, (9, 3), seed=8)
        found = register_stack(light, D)
        assert found.record()["unlike_neighbours"] == [[1, 2], [2, 3]]
        np.testing.assert_allclose(found.shifts_px, 0, atol=5e-3)

    def test_an_implausible_distance_is_named(self) -> None:
        with pytest.raises(InputError, match=r"^mask_to_sensor_m: "):
            register_stack(stack(), -1)


class TestInterpolation:
    def test_what_a_registered_stack_predicts(self) -> None:
        """Spots that only magnify: all that planes left out differ by is where they lay and how long they were exposed."""
        light = stack()
        found = register_stack(light, D)
        assert max(left_out_errors(light, D)) > 1  # pyright: ignore[reportArgumentType]
        assert max(left_out_errors(light, D, found)) < 0.03  # pyright: ignore[reportArgumentType]
        depths = [0.02, 0.04, 0.1, np.inf]
        planes = interpolate_stack(light, depths, D, registration=found)
        assert planes.provenance["registration"] == found.record()
        # All on one axis, all of one light: the direction of the axis is open, the same for all.
        one_axis = planes.values[:, 0] / planes.values.sum((1, 2, 3))[:, None, None]
        expected = [spots(1 + D / z, (1 + D / z) * _axis(found)) for z in depths]
        for image, true in zip(one_axis, expected, strict=True):
            assert np.linalg.norm(image - true / true.sum()) < 0.03 * np.linalg.norm(true / true.sum())

    def test_own_planes_state_what_moving_them_costs(self) -> None:
        light = stack()
        (plane,) = interpolate_stack(light, [0.02], D, registration=register_stack(light, D)).provenance[
            "interpolation"
        ]["planes"]
        assert 0 < plane["error"] < 0.02

    def test_registration_decides_the_identity(self) -> None:
        light = stack()
        moved = Registration(np.ones((5, 2)), np.ones(5))
        one, other = (interpolate_stack(light, [0.04], D, registration=r, accept_error=9) for r in (None, moved))
        assert one.fingerprint != other.fingerprint

    def test_a_useless_plane_is_refused_unless_asked_for(self) -> None:
        light = stack()
        with pytest.raises(InputError, match=r"^accept_error: .* 4 cm "):
            interpolate_stack(light, [0.02, 0.04], D)
        assert interpolate_stack(light, [0.02], D)  # a measured plane is as good as it is
        planes = interpolate_stack(light, [0.04], D, accept_error=9).provenance["interpolation"]["planes"]
        assert planes[0]["error"] > 1
        with pytest.raises(InputError, match=r"^accept_error: "):
            interpolate_stack(light, [0.04], D, registration=register_stack(light, D), accept_error=1e-4)


def _axis(found: Registration) -> np.ndarray:
    """The b of b m that registration left in the planes."""
    m = (1 + D / DEPTHS)[:, None]
    return (m * (SHIFTS - found.shifts_px)).sum(0) / (m**2).sum()
