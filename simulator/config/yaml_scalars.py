"""What an unquoted YAML scalar means: YAML 1.2's core rules, without the numbers that people misread."""

from __future__ import annotations

import re
from typing import Any

from simulator.errors import InputError

MAX_DIGITS = 40  # of an integer: no setting needs more, and Python's own limit would end in a traceback

_INTEGER = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_INFINITY = re.compile(r"([-+]?)\.(inf|Inf|INF)")
_WORDS = {"": None, "~": None}
_WORDS |= dict.fromkeys(("null", "Null", "NULL"))
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True)
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)


def parse_scalar(text: str) -> Any:
    """Return what an unquoted YAML scalar means.

    Raises:
        InputError: for leading zeros, NaN and numbers out of range.

    Example:
        >>> [parse_scalar(text) for text in ("10", "1e3", "off", "true", "-.inf", "2026-11-21")]
        [10, 1000.0, 'off', True, -inf, '2026-11-21']
    """
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        digits = text.lstrip("+-")
        if len(digits) > 1 and digits[0] == "0":
            plain = digits.lstrip("0") or "0"
            msg = f"{text} has a leading zero, which some read as octal; write {plain}, or '{text}' for text"
            raise InputError(msg)
        if len(digits) > MAX_DIGITS:
            msg = f"the number {text[:12]}... has {len(digits)} digits; expected at most {MAX_DIGITS}"
            raise InputError(msg)
        return int(text)
    if _FLOAT.fullmatch(text):
        value = float(text)
        if value in (float("inf"), float("-inf")):
            msg = f"{text[:40]} is too large for a number; write .inf if infinity is meant"
            raise InputError(msg)
        return value
    if match := _INFINITY.fullmatch(text):
        return float(f"{match[1]}inf")
    if text in (".nan", ".NaN", ".NAN"):
        msg = f"{text} is not a number, and no setting takes it; leave the key out for its default"
        raise InputError(msg)
    return text
