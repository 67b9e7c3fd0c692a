"""Lengths and shares in words."""

import pytest

from simulator.text import length, share


@pytest.mark.parametrize(
    ("metres", "words"),
    [(7.01e-3, "7.01 mm"), (1e-2, "1 cm"), (1.0, "1 m"), (532e-9, "532 nm"), (2.4e-6, "2.4 µm"), (2.77, "2.77 m")],
)
def test_lengths_in_words(metres, words):
    assert length(metres) == words


@pytest.mark.parametrize(("value", "words"), [(1.0, "100 %"), (0.99999, "100 %"), (2e-16, "0 %"), (0.00123, "0.12 %")])
def test_shares_in_words(value, words):
    assert share(value) == words
