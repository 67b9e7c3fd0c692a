"""Random streams must not depend on order and must not collide."""

import itertools

import numpy as np

from simulator.seeds import PURPOSES, SPLITS, generator


def test_streams_of_different_keys_differ_and_equal_keys_agree():
    keys = list(itertools.product([0, 1], SPLITS, [0, 1, 2**20], PURPOSES))
    first = {key: generator(*key).integers(2**63) for key in keys}
    again = {key: generator(*key).integers(2**63) for key in reversed(keys)}
    assert first == again
    assert len(set(first.values())) == len(keys)


def test_stream_is_numpys_seed_sequence_so_that_others_can_reproduce_it():
    expected = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(2, 5, 1))).normal(size=4)
    np.testing.assert_array_equal(generator(7, "test", 5, "noise").normal(size=4), expected)
