"""``masks`` and ``scenes``: what a configuration may name."""

from __future__ import annotations

from typing import Annotated

import typer


def masks(
    names: Annotated[list[str] | None, typer.Argument(help="designs to list; all when left out")] = None,
) -> None:
    """List the mask designs: what they are, and their parameters with range, default and meaning."""
    from simulator.plugin_listing import print_plugins

    print_plugins("mask", "camera.mask.design", names or ())


def scenes() -> None:
    """List the scene families and imported sources with their parameters."""
    from simulator.plugin_listing import print_plugins

    print_plugins("scene", "scene.family")
    print_plugins("source", "scene.source")
