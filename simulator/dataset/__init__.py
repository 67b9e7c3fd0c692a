"""Data sets on disk: samples, manifest, jobs, reading and verification."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from simulator.dataset.job import generate
    from simulator.dataset.reader import open_dataset
    from simulator.dataset.verification import verify

__all__ = ["generate", "open_dataset", "verify"]

_HOMES = {"generate": "job", "open_dataset": "reader", "verify": "verification"}


def __getattr__(name: str) -> Any:
    """Import the public functions on first use: readers need neither the renderer nor the engines."""
    if name not in _HOMES:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    import importlib

    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
