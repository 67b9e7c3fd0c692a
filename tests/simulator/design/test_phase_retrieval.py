"""The retrieved phase puts the light where it was asked for; the propagation that judges it is another one."""

import numpy as np
import pytest

from simulator import arrays as memory
from simulator.design.patterns import contours
from simulator.design.phase_retrieval import retrieve_phase
from simulator.errors import InputError
from simulator.optics.propagation import angular_spectrum

PITCH, GREEN, D = 2e-6, 532e-9, 1.869e-3
SAMPLES = 200


@pytest.fixture(scope="module")
def target():
    return contours(SAMPLES, 120, 6, 1)


def _intensity(phase, distance_m=D):
    """|U|^2 in the sensor plane in float64; the mask's power is 1."""
    field = np.exp(1j * np.asarray(phase, np.float64)) / phase.shape[0]
    return np.abs(angular_spectrum(field, PITCH, GREEN, distance_m)) ** 2


def _inside(phase, target):
    return _intensity(phase)[target > 0].sum()


def test_the_light_gathers_in_the_target(target):
    """Share of the mask's light inside the target: it grows with the iterations and beats chance many times.

    A random phase spreads its light: what it puts inside is the target's share of the area at most.
    """
    phases = {n: retrieve_phase(target, PITCH, GREEN, D, n).phase for n in (1, 4, 16)}
    shares = {n: _inside(phase, target) for n, phase in phases.items()}
    assert shares[1] < shares[4] < shares[16]
    random = np.random.default_rng(0).uniform(-np.pi, np.pi, target.shape)
    assert _inside(random, target) < 1.1 * target.mean()
    assert shares[16] > 0.85  # measured 0.82, 0.86, 0.87 on a tenth of the area; chance 0.05
    assert shares[16] > 10 * _inside(random, target)


def test_the_pattern_is_neither_turned_nor_mirrored():
    """One dot off the middle: the phase is a lens that focuses there."""
    target = np.zeros((96, 80), np.float32)
    target[20:23, 50:53] = 1
    phase = retrieve_phase(target, PITCH, GREEN, 0.5e-3, 5).phase
    image = np.abs(angular_spectrum(np.exp(1j * phase.astype(float)), PITCH, GREEN, 0.5e-3)) ** 2
    row, column = np.unravel_index(np.argmax(image), image.shape)
    assert max(abs(row - 21), abs(column - 51)) <= 1


def test_the_scale_of_the_target_does_not_matter(target):
    """Up to rounding, which phase retrieval spreads: the result's quality, not its bits, is the same."""
    shares = [
        _inside(retrieve_phase(target * np.float32(scale), PITCH, GREEN, D, 3).phase, target) for scale in (1, 1000)
    ]
    assert shares[0] == pytest.approx(shares[1], rel=1e-3)


def test_the_result_is_deterministic_and_single_precision(target):
    before = target.copy()
    first, second = (retrieve_phase(target, PITCH, GREEN, D, 2).phase for _ in range(2))
    np.testing.assert_array_equal(target, before)
    np.testing.assert_array_equal(first, second)
    assert first.dtype == np.float32
    assert first.shape == target.shape
    assert np.abs(first).max() <= np.float32(np.pi)


def test_the_overlap_is_what_it_says_and_never_falls(target):
    """Sum |U| sqrt(target) over the mask's light, with a propagation in float64; error reduction (Fienup 1982)."""
    overlap = np.array(retrieve_phase(target, PITCH, GREEN, D, 12).overlap)
    assert len(overlap) == 12
    assert np.all(np.diff(overlap) > -1e-5)  # float32
    assert overlap[0] > 0.7
    assert overlap[-1] < 1
    for n in (3, 7):
        # The phase after n passes, sent to the sensor, is what pass n + 1 starts by measuring.
        phase = retrieve_phase(target, PITCH, GREEN, D, n).phase
        share = np.sum(np.sqrt(_intensity(phase) * target / target.sum()))
        assert overlap[n] == pytest.approx(share, abs=1e-4)


def test_it_stops_when_a_pass_gains_too_little(target):
    every = retrieve_phase(target, PITCH, GREEN, D, 30)
    stopped = retrieve_phase(target, PITCH, GREEN, D, 30, tolerance=1e-3)
    passes = len(stopped.overlap)
    assert stopped.overlap == every.overlap[:passes]
    gains = np.diff(every.overlap)
    assert passes == 2 + int(np.argmax(gains < 1e-3))  # the first pass that gains too little is the last
    assert 4 < passes < 20
    np.testing.assert_array_equal(stopped.phase, retrieve_phase(target, PITCH, GREEN, D, passes).phase)


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_not_change_the_result(threads):
    wide = contours(500, 120, 6, 1)
    one, many = (retrieve_phase(wide, PITCH, GREEN, D, 2, threads=n) for n in (1, threads))
    assert one.overlap == many.overlap
    np.testing.assert_array_equal(one.phase, many.phase)


@pytest.mark.parametrize(
    ("target", "iterations", "tolerance", "words"),
    [
        (np.zeros((8, 8), np.float32), 3, 0, "^target: "),
        (np.full((8, 8), -1, np.float32), 3, 0, "^target: "),
        (np.full((8, 8), np.nan, np.float32), 3, 0, "^target: "),
        (np.ones(8, np.float32), 3, 0, "^target: "),
        (np.ones((8, 8), np.float32), 0, 0, "^iterations: "),
        (np.ones((8, 8), np.float32), 2, -0.1, "^tolerance: "),
    ],
)
def test_senseless_requests_are_refused(target, iterations, tolerance, words):
    with pytest.raises(InputError, match=words):
        retrieve_phase(target, PITCH, GREEN, D, iterations, tolerance=tolerance)


def test_a_grid_that_exceeds_the_memory_is_refused(target, monkeypatch):
    """Light that spreads far doubles both sides of the grid."""
    monkeypatch.setattr(memory, "machine_bytes", lambda: 10**6)
    with pytest.raises(InputError, match=r"^pixel_um: "):
        retrieve_phase(target, PITCH, GREEN, 1.0, 1)
