"""The laws of motion: conserved quantities, and closed-form results from textbooks or integrated numerically."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scenes.high_speed.dynamics import Balls, Billiard, Plane, Tumble, bounce, collide
from scenes.layout import random_rotation
from simulator.errors import InputError


def angular_velocity(tumble: Tumble, time: float, step: float = 1e-5) -> np.ndarray:
    """From the rotation matrices alone: w x r is the derivative of R r."""
    change = (tumble.turn(time + step) - tumble.turn(time - step)) / (2 * step) @ tumble.turn(time).T
    return np.array([change[2, 1], change[0, 2], change[1, 0]])


@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0])
def test_a_tumbling_body_keeps_its_angular_momentum(ratio: float) -> None:
    rng = np.random.default_rng(1)
    tumble = Tumble(random_rotation(rng), rng.standard_normal(3), 7.0, ratio)
    inertia = np.diag([1, 1 / ratio, 1])
    expected = 7.0 * tumble.momentum / np.linalg.norm(tumble.momentum)
    for time in (0.0, 0.3, 1.7):
        turn = tumble.turn(time)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        momentum = turn @ inertia @ turn.T @ angular_velocity(tumble, time)
        # Central differences of step 1e-5 at 20 rad/s err by (20 x 1e-5)^2 / 6.
        np.testing.assert_allclose(momentum, expected, atol=1e-6)


def test_a_fall_from_rest_lands_after_root_2h_over_g_and_rises_to_e_squared_of_its_height() -> None:
    flight = bounce(0.08, 0.0, gravity_m_s2=9.81, restitution=0.8, contact_s=1e-3, duration_s=0.5)
    landing = math.sqrt(2 * 0.08 / 9.81)
    assert flight.height(0.5 * landing) == pytest.approx(0.08 * 0.75)
    assert flight.height(landing) == pytest.approx(0, abs=1e-12)
    apex = landing + 1e-3 + 0.8 * landing
    assert flight.height(apex) == pytest.approx(0.08 * 0.64)
    around = [flight.height(apex + shift) for shift in (-0.01, 0.01)]
    assert max(around) < 0.08 * 0.64


def test_a_thrown_ball_keeps_its_energy_in_flight() -> None:
    flight = bounce(0.05, 0.9, gravity_m_s2=9.81, restitution=0.7, contact_s=2e-3, duration_s=1.0)
    heights = np.array([flight.height(time) for time in np.linspace(0, 0.1, 11)])
    expected = 0.05 + 0.9 * np.linspace(0, 0.1, 11) - 4.905 * np.linspace(0, 0.1, 11) ** 2
    np.testing.assert_allclose(heights, expected, atol=1e-12)


def test_a_contact_is_a_damped_spring_and_the_speed_never_jumps() -> None:
    contact, restitution = 2e-3, 0.6
    flight = bounce(0.05, 0.0, gravity_m_s2=9.81, restitution=restitution, contact_s=contact, duration_s=0.3)
    impact = math.sqrt(2 * 9.81 * 0.05)
    decay, beat = -math.log(restitution) / contact, math.pi / contact
    stiffness = beat**2 + decay**2

    def spring(_: float, state: np.ndarray) -> list[float]:
        return [state[1], -2 * decay * state[1] - stiffness * state[0]]

    times = np.linspace(0, contact, 9)
    truth = solve_ivp(spring, (0, contact), [0, -impact], t_eval=times, rtol=1e-10, atol=1e-14)
    start = float(flight.starts_s[1])
    np.testing.assert_allclose([flight.height(start + time) for time in times[:-1]], truth.y[0][:-1], atol=1e-10)
    assert truth.y[1][-1] == pytest.approx(restitution * impact, rel=1e-6)
    fine = np.linspace(0, 0.3, 60001)
    speed = np.diff([flight.height(time) for time in fine]) / np.diff(fine)
    # Between two steps of 5 us a spring of this stiffness changes the speed by at most impact x beat x 5 us, and a bit.
    assert np.abs(np.diff(speed)).max() < 1.5 * impact * beat * 5e-6


def balls(centres: list, velocities: list, radii: list, masses: list) -> Balls:
    return Balls(*(np.array(values, dtype=float) for values in (centres, velocities, radii, masses)))


def test_a_ball_hits_a_resting_one_head_on() -> None:
    start = balls([(-1, 0, 0), (1, 0, 0)], [(4, 0, 0), (0, 0, 0)], [0.2, 0.3], [2, 3])
    game = collide(start, duration_s=1)
    assert game.starts_s[1] == pytest.approx(1.5 / 4)
    after = game.at(1.0).velocities_m_s[:, 0]
    # v1 (m1 - m2) / (m1 + m2) and v1 2 m1 / (m1 + m2).
    np.testing.assert_allclose(after, [-0.8, 3.2])
    slowed = collide(start, duration_s=1, restitution=0.5).at(1.0).velocities_m_s[:, 0]
    assert slowed[1] - slowed[0] == pytest.approx(0.5 * 4)
    assert 2 * slowed[0] + 3 * slowed[1] == pytest.approx(8)


def test_equal_balls_part_at_right_angles() -> None:
    game = collide(balls([(-1, 0.1, 0), (0, 0, 0)], [(3, 0, 0), (0, 0, 0)], [0.1, 0.1], [1, 1]), duration_s=2)
    first, second = game.at(2.0).velocities_m_s
    assert first @ second == pytest.approx(0, abs=1e-12)
    # The struck ball leaves along the line of centres, whose sine is the offset over the sum of the radii.
    assert -second[1] / np.linalg.norm(second) == pytest.approx(0.5)


def test_newtons_cradle_passes_the_shot_on_to_the_last_ball() -> None:
    places = [(-1, 0, 0), (0, 0, 0), (0.21, 0, 0), (0.42, 0, 0)]
    game = collide(balls(places, [(2, 0, 0)] + [(0, 0, 0)] * 3, [0.1] * 4, [1] * 4), duration_s=1)
    np.testing.assert_allclose(game.at(1.0).velocities_m_s, [(0, 0, 0)] * 3 + [(2, 0, 0)], atol=1e-12)


def crowd() -> Balls:
    rng = np.random.default_rng(4)
    places = np.stack(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [0.5, 1.5]), -1).reshape(-1, 3)
    inwards = 4 * ((0, 0, 1) - places) + rng.normal(0, 1, (8, 3))
    return Balls(places, inwards, rng.uniform(0.15, 0.3, 8), rng.uniform(0.5, 2, 8))


def energy(state: Balls) -> float:
    return float(0.5 * np.sum(state.masses_kg[:, np.newaxis] * state.velocities_m_s**2))


def momentum(state: Balls) -> np.ndarray:
    return state.masses_kg @ state.velocities_m_s


def least_gap(game: Billiard, duration: float) -> float:
    gaps = []
    for time in np.linspace(0, duration, 200):
        state = game.at(time)
        offsets = np.linalg.norm(state.centres_m[:, np.newaxis] - state.centres_m, axis=-1)
        pairs = np.triu_indices(len(offsets), 1)
        gaps.append((offsets - state.radii_m - state.radii_m[:, np.newaxis])[pairs].min())
    return min(gaps)


def test_colliding_balls_keep_momentum_and_energy_and_never_overlap() -> None:
    start = crowd()
    pull = np.array([0.3, -2.0, 1.0])
    game = collide(start, duration_s=1, acceleration_m_s2=pull)
    assert len(game.starts_s) > 3
    for time in (0.2, 0.5, 1.0):
        gained = start.masses_kg.sum() * pull * time
        np.testing.assert_allclose(momentum(game.at(time)), momentum(start) + gained, rtol=1e-12)
    assert least_gap(game, 1) > -1e-12
    quiet = collide(start, duration_s=1)
    assert energy(quiet.at(1.0)) == pytest.approx(energy(start), rel=1e-12)
    assert energy(collide(start, duration_s=1, restitution=0.7).at(1.0)) < 0.99 * energy(start)


def test_walls_keep_balls_in_and_reflect_them() -> None:
    sides = [Plane(sign * np.eye(3)[axis], -1.0 + axis // 2 * sign) for axis in range(3) for sign in (1.0, -1.0)]
    game = collide(crowd(), duration_s=5, planes=sides)
    assert len(game.starts_s) > 30
    assert least_gap(game, 5) > -1e-12
    assert energy(game.at(5.0)) == pytest.approx(energy(crowd()), rel=1e-12)
    for time in np.linspace(0, 5, 100):
        state = game.at(time)
        for side in sides:
            assert np.all(state.centres_m @ side.normal - side.offset_m - state.radii_m > -1e-12)


def test_a_ball_thrown_up_lands_when_gravity_says() -> None:
    start = balls([(0, -1.1, 0)], [(0, -3, 0)], [0.1], [1])
    game = collide(start, duration_s=1.5, planes=[Plane(np.array([0.0, -1, 0]), 0.0)], acceleration_m_s2=(0, 9.81, 0))
    landing = (3 + math.sqrt(9 + 2 * 9.81 * 1.0)) / 9.81
    assert game.starts_s[1] == pytest.approx(landing)
    assert game.at(landing).velocities_m_s[0, 1] == pytest.approx(-math.sqrt(9 + 2 * 9.81))


def test_endless_bouncing_is_refused() -> None:
    start = balls([(0, -1.1, 0)], [(0, 0, 0)], [0.1], [1])
    with pytest.raises(InputError, match=r"^collide: "):
        collide(
            start,
            duration_s=100,
            restitution=0.5,
            planes=[Plane(np.array([0.0, -1, 0]), 0.0)],
            acceleration_m_s2=(0, 9.81, 0),
        )
