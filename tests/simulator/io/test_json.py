"""JSON: plain values come back as they were; what has no JSON form is named by its place."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.errors import InputError
from simulator.io.json import canonical_json, parse_json, plain, readable_json

SIMPLE = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()


NESTED = st.recursive(SIMPLE, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner))


@given(NESTED, NESTED)
def test_canonical_json_tells_values_apart_and_loads_back(one: object, other: object) -> None:
    assert plain(one) == one
    assert json.loads(canonical_json(one)) == json.loads(readable_json(one)) == one
    if one != other:
        assert canonical_json(one) != canonical_json(other)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"a": [1, float("nan")]}, r"^config\.a\[1\]: "),
        ({"a": {1: 2}}, r"^config\.a: "),
        ({"a": {"b": {3}}}, r"^config\.a\.b: "),
        ({"a": np.array([1.0, np.nan])}, r"^config\.a\[1\]: "),
    ],
)
def test_values_without_json_form_are_named(value: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        plain(value, "config")


@given(NESTED)
def test_parsing_gives_back_what_was_written(value: object) -> None:
    assert parse_json(canonical_json(value)) == value
    assert parse_json(json.dumps(value, ensure_ascii=False).encode()) == value


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "Expecting value"),
        (b"\xff", "decode"),
        (b"[" * 101 + b"]" * 101, "100 levels"),
        (b"[" * 100_000 + b"]" * 100_000, "100 levels"),
        (b'{"a":' * 101 + b"1" + b"}" * 101, "100 levels"),
        (rb'["\ud800"]', "surrogates"),
        (rb'{"\uDC00": 1}', "surrogates"),
        (b'["\xed\xa0\x80"]', "surrogates"),
        (b"9" * 5000, "digits"),
    ],
)
def test_what_would_fail_later_is_not_parsed(data: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_json(data)
