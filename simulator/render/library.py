"""Mitsuba and Dr.Jit as untyped modules: their stubs describe no variant's own types, so that checkers stumble over them."""

from __future__ import annotations

import importlib
from typing import Any


def mitsuba() -> Any:
    """Return the module ``mitsuba``; heavy, so it is imported where it is used."""
    return importlib.import_module("mitsuba")


def drjit() -> Any:
    """Return the module ``drjit``."""
    return importlib.import_module("drjit")
