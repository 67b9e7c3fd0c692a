"""``masks``, ``scenes`` and ``materials``: what a configuration may name."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.outputs import check_output_file


def masks(
    names: Annotated[list[str] | None, typer.Argument(help="designs to list; all when left out")] = None,
) -> None:
    """List the mask designs: what they are, and their parameters with range, default and meaning."""
    from simulator.plugin_listing import print_plugins

    print_plugins("mask", "camera.mask.design", names or ())


def scenes(
    names: Annotated[list[str] | None, typer.Argument(help="families and sources to list; all when left out")] = None,
    thumbnails: Annotated[
        Path | None, typer.Option("--thumbnails", help="picture to write: a few samples of each family (.png)")
    ] = None,
) -> None:
    """List the scene families and imported sources with their parameters; --thumbnails shows them too."""
    from simulator.plugin_listing import print_plugins
    from simulator.plugins import available, resolve

    if thumbnails is not None:
        check_output_file("--thumbnails", thumbnails, (".png",))
    sources = available("source")
    wanted = {
        "scene": [name for name in names if name not in sources] if names else available("scene"),
        "source": [name for name in names if name in sources] if names else sources,
    }
    plugins = [resolve(kind, name) for kind, chosen in wanted.items() for name in chosen]
    for kind, key in (("scene", "scene.family"), ("source", "scene.source")):
        if wanted[kind]:
            print_plugins(kind, key, wanted[kind])
    if thumbnails is not None:
        from simulator.commands.thumbnails import draw_thumbnails
        from simulator.console import Bar

        with Bar() as bar:
            left_out = draw_thumbnails(plugins, thumbnails, bar)
        if left_out:
            print(f"not drawn: {'; '.join(left_out)}")
        print(f"look at {thumbnails}")


def materials() -> None:
    """List the built-in materials: refractive index, range of wavelengths and source; a file's path names another."""
    from simulator.optics.materials import MATERIALS

    print(f"{'name':<16} {'n at 532 nm':<12} {'range in nm':<14} source")
    for name, material in sorted(MATERIALS.items()):
        low, high = (f"{wavelength_m * 1e9:.0f}" for wavelength_m in material.range_m)
        print(f"{name:<16} {material.index(532e-9):<12.5f} {f'{low}-{high}':<14} {material.source}")
    print("or a file: a table .csv (wavelength_nm,n or wavelength_um,n,k) or a page .yml of refractiveindex.info")
