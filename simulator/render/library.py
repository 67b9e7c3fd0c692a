"""Mitsuba and Dr.Jit as untyped modules: their stubs describe no variant's own types, so that checkers stumble over them."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ALIGNMENT = 64


def mitsuba() -> Any:
    """Return the module ``mitsuba``; heavy, so it is imported where it is used."""
    return importlib.import_module("mitsuba")


def drjit() -> Any:
    """Return the module ``drjit``."""
    return importlib.import_module("drjit")


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous copy that begins at a multiple of 64 bytes.

    Dr.Jit takes NumPy's memory as it lies, and compiles other kernels for arrays that happen to be aligned than for those
    that are not: one in a few dozen scenes would be compiled anew.
    """
    memory = np.empty(values.nbytes + _ALIGNMENT, np.uint8)
    start = -memory.ctypes.data % _ALIGNMENT
    copy = memory[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy
