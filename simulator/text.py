"""Words for messages: paths of keys, values, near misses, lengths and shares; and what docstrings say."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from typing import Any

KeyPath = tuple[str | int, ...]


def dotted(path: KeyPath) -> str:
    """Return a path as people write it.

    Example:
        >>> dotted(("psf", "depths_cm", 2))
        'psf.depths_cm[2]'
    """
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).removeprefix(".")


def key_path(text: str) -> KeyPath:
    """Return the path that people write so; the other way round is `dotted`.

    Example:
        >>> key_path("psf.depths_cm[2]")
        ('psf', 'depths_cm', 2)
    """
    found = re.findall(r"\[(\d+)\]|([^.\[\]]+)", text)
    return tuple(int(index) if index else step for index, step in found)


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``"; did you mean 'x'?"`` for the known name that is most like this one, or nothing."""
    matches = difflib.get_close_matches(name.lower(), list(known), n=1, cutoff=0.6)
    return f"; did you mean {matches[0]!r}?" if matches else ""


def show(value: Any) -> str:
    """Return a value as it would stand in YAML, shortened."""
    if isinstance(value, Mapping):
        return f"a mapping ({', '.join(map(str, value)) or 'empty'})"[:80]
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def described(error: BaseException) -> str:
    """Return an exception's type and message.

    Example:
        >>> described(ValueError("too long")), described(KeyboardInterrupt())
        ('ValueError: too long', 'KeyboardInterrupt')
    """
    return f"{type(error).__name__}: {said(error)}".removesuffix(": ")


def said(error: BaseException) -> str:
    """Return an exception's message, also where a user's own class fails to make one."""
    try:
        return str(error)
    except Exception:
        return "(its message cannot be shown)"


_METRE_UNITS = ((1.0, "m"), (1e-2, "cm"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"))


def length(value_m: float) -> str:
    """Return a length with the unit that people would use.

    Example:
        >>> length(0.036), length(1.92e-5), length(float("inf"))
        ('3.6 cm', '19.2 µm', '∞')
    """
    if math.isinf(value_m):
        return "∞"
    factor, unit = next(((f, u) for f, u in _METRE_UNITS if abs(value_m) >= f * (1 - 1e-9)), _METRE_UNITS[-1])
    return f"{float(f'{value_m / factor:.3g}'):g} {unit}"


def counted(count: int, what: str) -> str:
    """Return a number of things.

    Example:
        >>> counted(1, "sample"), counted(4000, "sample")
        ('1 sample', '4,000 samples')
    """
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def share(value: float) -> str:
    """Return a share in percent with two digits where it is small, three where it is near the whole.

    Example:
        >>> share(0.0273), share(0.9876), share(0.0)
        ('2.7 %', '98.8 %', '0 %')
    """
    percent = 100 * value if value > 1e-9 else 0.0  # rounding is not light
    return f"{float(f'{percent:.3g}' if percent >= 10 else f'{percent:.2g}'):g} %"


_TIME_UNITS = ((365.25 * 86400, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min"), (1.0, "s"))
_BYTE_UNITS = ((1e15, "PB"), (1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"), (1.0, "bytes"))


def duration(seconds: float) -> str:
    """Return a time with the unit that people would use.

    Example:
        >>> duration(0.26), duration(95), duration(7.2e6)
        ('0.26 s', '1.58 min', '83.3 days')
    """
    return _in_units(seconds, _TIME_UNITS)


def size(count: float) -> str:
    """Return a number of bytes with the unit that people would use.

    Example:
        >>> size(512), size(4.7e12)
        ('512 bytes', '4.7 TB')
    """
    return _in_units(count, _BYTE_UNITS)


def _in_units(value: float, units: tuple[tuple[float, str], ...]) -> str:
    factor, unit = next(((f, u) for f, u in units if value >= f), units[-1])
    return f"{float(f'{value / factor:.3g}'):g} {unit}"


def documented(docstring: str, section: str) -> dict[str, str]:
    """Return the meaning of each entry of a section (``Args``, ``Attributes``) of a Google-style docstring, in one line each.

    Example:
        >>> documented('''Do it.
        ...
        ... Args:
        ...     width_mm: side of the mask,
        ...         without its frame.
        ...     seed: of the noise.
        ...
        ... Raises:
        ...     InputError: never.''', "Args")
        {'width_mm': 'side of the mask, without its frame', 'seed': 'of the noise'}
    """
    found = re.search(rf"^{section}:\n((?:[ \t]+.*\n?|\n)+)", docstring, re.MULTILINE)
    if found is None:
        return {}
    entries = re.findall(r"^ {4}(\w+):((?:.*\n?)(?: {5,}.*\n?|\n)*)", found[1], re.MULTILINE)
    return {name: " ".join(text.split()).removesuffix(".").replace("``", "") for name, text in entries}
