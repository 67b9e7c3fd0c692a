"""``masks`` and ``scenes``: what a configuration may name."""

from __future__ import annotations


def masks() -> None:
    """List the mask designs and their parameters."""
    from simulator.console import describe_plugins

    print(describe_plugins("mask", "camera.mask.design"))


def scenes() -> None:
    """List the scene families and imported sources with their parameters."""
    from simulator.console import describe_plugins

    print(describe_plugins("scene", "scene.family") + "\n" + describe_plugins("source", "scene.source"))
