"""Python values as plain JSON, the same value always as the same bytes; and checks of what was read.

Configurations and metadata hold paths, tuples, NumPy numbers and infinite depths; JSON knows none of them.
"""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Callable, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from simulator.errors import InputError
from simulator.text import show


def plain(value: Any, where: str = "value") -> Any:
    """Return ``value`` in text, numbers, booleans, None, lists and dicts only, ready for strict JSON.

    Paths become text, tuples and arrays lists, NumPy numbers Python numbers, infinities the text ``inf`` or ``-inf``.

    Args:
        value: anything nested.
        where: how errors name the value.

    Raises:
        InputError: NaN, keys that are not text, or a type that has no JSON form; the place is named.

    Example:
        >>> plain({"depths_m": (0.036, float("inf")), "count": np.int64(3)})
        {'depths_m': [0.036, 'inf'], 'count': 3}
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, enum.Enum):
        value = value.value
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        if math.isnan(value):
            raise InputError(where, "got NaN, which JSON cannot hold; leave it out or use None")
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise InputError(where, f"has the key {key!r}; keys must be text")
        return {str(key): plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, f"{where}[{index}]") for index, item in enumerate(value)]
    raise InputError(where, f"got a {type(value).__name__}, which has no JSON form; use text, numbers, lists and dicts")


def canonical_json(value: Any) -> bytes:
    """Return the shortest JSON with sorted keys, for hashing.

    Example:
        >>> canonical_json({"b": (1, 2), "a": 0.1})
        b'{"a":0.1,"b":[1,2]}'
    """
    return json.dumps(plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def readable_json(value: Any) -> bytes:
    r"""Return indented JSON with sorted keys and a newline at the end, for files that people read.

    Example:
        >>> readable_json({"b": None, "a": 1})
        b'{\n "a": 1,\n "b": null\n}\n'
    """
    return (json.dumps(plain(value), sort_keys=True, indent=1, allow_nan=False) + "\n").encode()


_MOST_LEVELS = 100  # ours have ten


def parse_json(data: bytes) -> Any:
    """Return the content of JSON that somebody else may have written.

    Raises:
        ValueError: not JSON, nested so deeply that whatever walks through it would fail, or with text that has no UTF-8.
    """
    too_deep = f"nested deeper than {_MOST_LEVELS} levels"
    try:
        content = json.loads(data)
    except RecursionError:
        raise ValueError(too_deep) from None
    if b"\\ud" in data.lower() or b"\xed" in data:  # the halves of surrogate pairs
        json.dumps(content, ensure_ascii=False).encode()
    level = [content]
    for _ in range(_MOST_LEVELS):
        below = (
            value.values() if isinstance(value, dict) else value for value in level if isinstance(value, dict | list)
        )
        level = [item for values in below for item in values]
        if not level:
            return content
    raise ValueError(too_deep)


def check_keys(path: object, content: Any, checks: Mapping[str, Callable[[Any], object]], cure: str) -> None:
    """Refuse content of a file where a key is missing, or its value fails the check: is false, or raises.

    Raises:
        InputError: naming the file and the first such key.

    Example:
        >>> check_keys("a.json", {"gain": -2}, {"gain": lambda gain: gain > 0}, "restore it")
        Traceback (most recent call last):
        simulator.errors.InputError: a.json: gain: got -2, which makes no sense; restore it
    """
    if not isinstance(content, Mapping):
        raise InputError(path, f"{', '.join(checks)}: missing, got {show(content)}; {cure}")
    for key, fits in checks.items():
        if key not in content:
            raise InputError(path, f"{key}: missing; {cure}")
        try:
            good = bool(fits(content[key]))
        except (TypeError, ValueError, OverflowError, AttributeError, KeyError, RecursionError):
            good = False
        if not good:
            raise InputError(path, f"{key}: got {show(content[key])}, which makes no sense; {cure}")


def is_shape(value: Any) -> bool:
    """Whether a value is a list of two whole numbers from 1."""
    return len(value) == 2 and all(type(size) is int and size > 0 for size in value)


def is_positive(value: Any) -> bool:
    """Whether a value is a positive number that float32 can hold."""
    return type(value) in (int, float) and 1e-37 < value < 1e37


def are_names(value: Any) -> bool:
    """Whether a value is a list of different texts, at least one."""
    return (
        isinstance(value, list) and all(isinstance(name, str) for name in value) and 0 < len(set(value)) == len(value)
    )
