"""``masks``, ``scenes`` and ``materials``: what a configuration may name."""

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


def materials() -> None:
    """List the built-in materials: refractive index, range of wavelengths and source; a file's path names another."""
    from simulator.optics.materials import MATERIALS

    print(f"{'name':<16} {'n at 532 nm':<12} {'range in nm':<14} source")
    for name, material in sorted(MATERIALS.items()):
        low, high = (f"{wavelength_m * 1e9:.0f}" for wavelength_m in material.range_m)
        print(f"{name:<16} {material.index(532e-9):<12.5f} {f'{low}-{high}':<14} {material.source}")
    print("or a file: a table .csv (wavelength_nm,n or wavelength_um,n,k) or a page .yml of refractiveindex.info")
