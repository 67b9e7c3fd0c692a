"""The error of bad input: where, why, and across processes."""

import pickle
from pathlib import Path

import pytest

from simulator.errors import InputError


@pytest.mark.parametrize(
    ("arguments", "path", "text"),
    [
        (("seed", "got -1"), "seed", "seed: got -1"),
        ((Path("a.csv"), "empty"), "a.csv", "a.csv: empty"),
        (("", "nothing to write"), "", "nothing to write"),
        (("too small",), "", "too small"),  # as designs of users may raise it
    ],
)
def test_it_says_where_and_why_also_from_another_process(arguments: tuple, path: str, text: str) -> None:
    error = InputError(*arguments)
    back = pickle.loads(pickle.dumps(error))
    assert (error.path, str(error)) == (back.path, str(back)) == (path, text)
    assert back.reason == error.reason
