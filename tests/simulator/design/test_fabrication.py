"""Fabrication: steps and their straight-through gradient, and tolerances against what they must do to a height map."""

import numpy as np
import pytest
from scipy.special import erf

from simulator.design.fabrication import fabricate, quantise
from simulator.errors import InputError
from simulator.optics.mask import Mask

STEP = 0.2e-6


def _mask(height_m, pitch_m=2e-6, **changes):
    return Mask(height_m, np.ones_like(height_m), pitch_m, name="trial", **changes)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_heights_are_rounded_down_to_steps(dtype):
    height = np.random.default_rng(0).uniform(-1e-6, 1e-6, (50, 40)).astype(dtype)
    steps = np.asarray(quantise(height, STEP), np.float64) / STEP
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)  # float32 holds a step of five to 5e-7
    lost = height.astype(float) - np.rint(steps) * STEP
    assert lost.min() > -1e-5 * STEP
    assert lost.max() < STEP
    assert quantise(height, STEP).dtype == dtype


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_steps_stay_where_they_are(dtype):
    """0.6 um / 0.2 um is 2.9999998 in float32: rounding down must not take a step away, either side of zero."""
    height = (np.arange(-20, 21) * STEP).astype(dtype)
    once = quantise(height, STEP)
    np.testing.assert_allclose(once, height, rtol=3e-7)
    np.testing.assert_array_equal(quantise(once, STEP), once)


def test_the_gradient_passes_straight_through():
    """Values are those of NumPy to the last bit, the Jacobian is one, and so a loss on steps moves free heights.

    The chain rule: d/dh sum w quantise(h)^2 = 2 w quantise(h), with the rounded height and not the free one in it.
    """
    torch = pytest.importorskip("torch")
    rng = np.random.default_rng(1)
    height, weight = rng.uniform(0, 1e-6, (2, 30))
    free = torch.tensor(height, requires_grad=True)
    stepped = quantise(free, STEP)
    np.testing.assert_array_equal(stepped.detach().numpy(), quantise(height, STEP))
    (torch.tensor(weight) * stepped**2).sum().backward()
    assert free.grad is not None
    np.testing.assert_allclose(free.grad.numpy(), 2 * weight * quantise(height, STEP), rtol=1e-15)
    without = torch.tensor(height, requires_grad=True)
    quantise(without, 0).sum().backward()
    assert torch.all(without.grad == 1)


def test_a_perfect_machine_changes_nothing():
    mask = _mask(np.random.default_rng(0).uniform(0, 1e-6, (8, 9)).astype(np.float32))
    assert fabricate(mask).digest() == mask.digest()


def test_the_height_error_comes_after_the_steps():
    """The steps of a machine whose dose is 5 % too high are 0.21 um."""
    height = np.random.default_rng(0).uniform(0, 1e-6, (20, 20))
    made = fabricate(_mask(height), step_m=STEP, height_error=0.05)
    np.testing.assert_allclose(made.height_m, np.floor(height / STEP) * 0.21e-6, rtol=1e-12, atol=1e-20)
    assert made.profile == "staircase"
    assert made.name == "trial"
    assert made.provenance()["notes"]["fabrication"]["height_error"] == 0.05


def test_roughness_has_the_asked_strength_and_no_memory():
    """20 nm from 40 000 pixels: its standard deviation is known to 0.4 % (one sigma), neighbours' correlation to 0.5 %."""
    flat = _mask(np.zeros((200, 200)))
    rough = fabricate(flat, roughness_m=20e-9, seed=1).height_m
    assert rough.std() == pytest.approx(20e-9, rel=0.015)
    assert abs(rough.mean()) < 0.4e-9
    for a, b in ((rough[1:], rough[:-1]), (rough[:, 1:], rough[:, :-1])):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.02
    np.testing.assert_array_equal(rough, fabricate(flat, roughness_m=20e-9, seed=1).height_m)
    assert not np.array_equal(rough, fabricate(flat, roughness_m=20e-9, seed=2).height_m)


@pytest.mark.parametrize("rounding_um", [0.5, 1.0, 3.0])
def test_rounded_edges_follow_the_error_function(rounding_um):
    """A Gaussian turns a step into h / 2 (1 + erf(x / (sqrt(2) s))).

    Summing samples D apart is the midpoint rule, wrong by D^2 g' / 24 where the Gaussian's slope g' is at most 0.242 / s^2;
    the filter ends at 4 s, which leaves out 6e-5.
    """
    height = np.zeros((30, 40))
    height[:, 20:] = 1e-6
    made = fabricate(_mask(height), rounding_m=rounding_um * 1e-6)
    sample = made.pitch_m * 1e6
    x_um = (np.arange(made.shape[1]) + 0.5) * sample - 40
    expected = 0.5e-6 * (1 + erf(x_um / (np.sqrt(2) * rounding_um)))
    tolerance = 1e-6 * (0.0101 * (sample / rounding_um) ** 2 * 1.1 + 1e-4)
    np.testing.assert_allclose(made.height_m[15], expected, atol=tolerance)
    assert made.profile == "smooth"
    assert sample <= rounding_um
    np.testing.assert_allclose(made.height_m, np.tile(made.height_m[15], (made.shape[0], 1)), atol=1e-12)


def test_rounding_is_isotropic_and_keeps_the_volume():
    height = np.zeros((41, 41))
    height[20, 20] = 1e-6
    made = fabricate(_mask(height, 1e-6), rounding_m=2e-6)
    for other in (made.height_m[::-1], made.height_m[:, ::-1], made.height_m.T):
        np.testing.assert_allclose(made.height_m, other, rtol=1e-12, atol=1e-22)
    assert made.height_m.sum() * made.pitch_m**2 == pytest.approx(1e-6 * 1e-12, rel=1e-6)  # the filter ends at 4 sigma
    assert made.shape[0] * made.pitch_m == pytest.approx(41e-6)


def test_a_rounded_staircase_can_be_propagated_as_smooth():
    """Phase steps of one turn and more become slopes below the half turn per sample that a smooth mask is allowed."""
    height = np.random.default_rng(0).integers(0, 2, (40, 40)) * 1e-6
    for rounding_um in (0.4, 1.0, 2.0, 2.5, 2.6):
        made = fabricate(_mask(height), rounding_m=rounding_um * 1e-6)
        steepest = max(np.abs(np.diff(made.height_m, axis=axis)).max() for axis in (0, 1))
        assert steepest * 0.55 / 430e-9 < 0.5


def test_amplitudes_stay_sharp():
    mask = Mask(np.zeros((6, 6)), np.eye(6), 2e-6)
    made = fabricate(mask, rounding_m=1e-6)
    np.testing.assert_array_equal(made.amplitude, np.kron(np.eye(6), np.ones((3, 3))))
    assert made.transmitted_area_m2 == pytest.approx(mask.transmitted_area_m2)


@pytest.mark.parametrize(
    ("tolerance", "words"),
    [
        ({"step_m": -1e-7}, "^step_m: "),
        ({"roughness_m": -1e-9}, "^roughness_m: "),
        ({"rounding_m": np.nan}, "^rounding_m: "),
        ({"height_error": -1.0}, "^height_error: "),
    ],
)
def test_senseless_tolerances_are_refused(tolerance, words):
    with pytest.raises(InputError, match=words):
        fabricate(_mask(np.zeros((4, 4))), **tolerance)
