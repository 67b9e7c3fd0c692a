"""`masks`, `materials` and `export-mask`: what masks there are, of what, and the files that fabrication takes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulator.commands.shared import ConfigPath, Overrides, check_distinct, check_output_file, check_output_folder
from simulator.errors import InputError

if TYPE_CHECKING:
    from simulator.optics.mask import Mask


LARGE_BYTES = 20e6
"""Size of a body from which its user is told of the smaller height map."""


def masks(names: Annotated[list[str] | None, typer.Argument(help="designs to list; all when left out")] = None) -> None:
    """List the mask designs: what they are, and their parameters with range, default and meaning."""
    from simulator.plugin_listing import print_plugins

    print_plugins("mask", "camera.mask.design", names or ())


def materials() -> None:
    """List the built-in materials: refractive index, range of wavelengths and source; a file's path names another."""
    from simulator.optics.materials import MATERIALS

    print(f"{'name':<16} {'n at 532 nm':<12} {'range in nm':<14} source")
    for name, material in sorted(MATERIALS.items()):
        low, high = (f"{wavelength_m * 1e9:.0f}" for wavelength_m in material.range_m)
        print(f"{name:<16} {material.index(532e-9):<12.5f} {f'{low}-{high}':<14} {material.source}")
    print("or a file: a table .csv (wavelength_nm,n or wavelength_um,n,k) or a page .yml of refractiveindex.info")


def export_mask(
    config: ConfigPath,
    set_: Overrides = None,
    stl: Annotated[Path | None, typer.Option("--stl", help="solid body, in millimetres")] = None,
    tiff: Annotated[Path | None, typer.Option("--tiff", help="height map of 16 bits")] = None,
    layers: Annotated[
        Path | None, typer.Option("--layers", help="folder of black-and-white images, one per height step")
    ] = None,
    base_um: Annotated[float, typer.Option(min=0.01, help="thickness of the body's plate")] = 500.0,
    tolerance_nm: Annotated[
        float, typer.Option(min=0, help="height by which the body of a smooth mask may be off, to be a smaller file")
    ] = 10.0,
    step_um: Annotated[float, typer.Option(min=0, help="height step of the layers, for masks without steps")] = 0.0,
    crop_mm: Annotated[float | None, typer.Option(min=1e-3, help="only the central square of this side")] = None,
    force: Annotated[bool, typer.Option("--force", help="overwrite earlier exports")] = False,
) -> None:
    """Write the mask of a configuration as a body (STL), a height map (TIFF) or layers, for fabrication."""
    from simulator.assembly import Assembly
    from simulator.config import load_config
    from simulator.design.export import binary_layers, height_tiff, write_layers
    from simulator.design.solid import stl_bytes
    from simulator.io.files import write_atomic

    if not (stl or tiff or layers):
        raise InputError("--stl, --tiff, --layers", "nothing to write; give --stl FILE, --tiff FILE or --layers FOLDER")
    numbers = {"--base-um": base_um, "--tolerance-nm": tolerance_nm, "--step-um": step_um, "--crop-mm": crop_mm}
    for option, number in numbers.items():
        if number is not None and not math.isfinite(number):
            raise InputError(option, f"got {number}, expected a finite number")
    for option, path, suffixes in (("--stl", stl, (".stl",)), ("--tiff", tiff, (".tif", ".tiff"))):
        if path is not None:
            check_output_file(option, path, suffixes)
            if path.exists() and not force:
                raise InputError(option, f"{path} exists already; choose another name, or --force to overwrite it")
    _check_folder(layers, force)
    check_distinct({"--stl": stl, "--tiff": tiff, "--layers": layers})
    loaded = load_config(config, set_ or [])
    mask = Assembly(loaded).mask
    if mask is None or loaded.camera.mask is None:
        raise InputError(config, "has a measured PSF and no mask to export; set camera.mask")
    if crop_mm is not None:
        mask = _cropped(mask, crop_mm)
    # A material of the user's own is named as the configuration names it, by its file.
    material = str(loaded.camera.mask.params.get("material", mask.material.name))
    # Whatever is refused is refused before anything is written.
    body = stl_bytes(mask, base_um * 1e-6, tolerance_nm * 1e-9) if stl else b""
    image = height_tiff(mask) if tiff else b""
    stack = binary_layers(mask, step_um * 1e-6) if layers else None
    if stl:
        write_atomic(stl, body)
        exact = mask.profile == "staircase" or not tolerance_nm
        size = f"{len(body) / 1e6:.1f} MB, heights {'exact' if exact else f'within {tolerance_nm:g} nm'}"
        print(f"wrote {stl} ({size}), in millimetres; to use it:\n  {_as_design(mask, stl, material)}")
        if len(body) > LARGE_BYTES and not tiff:
            print(f"note: a height map of the same heights (--tiff) takes {mask.height_m.size * 2e-6:.1f} MB")
    if tiff:
        write_atomic(tiff, image)
        height_um = float(mask.height_m.max() - mask.height_m.min()) * 1e6
        print(f"wrote {tiff}; to use it:\n  {_as_design(mask, tiff, material, height_um)}")
    if layers and stack:
        names = write_layers(layers, stack)
        print(f"wrote {layers}: {', '.join(names[:1] + ['...'] * (len(names) > 2) + names[1:][-1:])}")
    if (stl or tiff) and not mask.amplitude.all() and not layers:
        print("note: the mask's opaque parts have no height; --layers writes them as aperture.png")


def _cropped(mask: Mask, crop_mm: float) -> Mask:
    side, pixel_mm = round(crop_mm * 1e-3 / mask.pitch_m), mask.pitch_m * 1e3
    if not 1 <= side <= min(mask.shape):
        rows, columns = (n * pixel_mm for n in mask.shape)
        raise InputError(
            "--crop-mm", f"got {crop_mm:g}, expected {pixel_mm:g} to {min(rows, columns):.4g}, the mask's size"
        )
    return mask.crop((side, side))


def _check_folder(folder: Path | None, force: bool) -> None:
    from simulator.design.export import APERTURE_FILE, LAYERS_FILE

    if folder is None:
        return
    check_output_folder("--layers", folder)
    if not folder.exists():
        return
    own = ("layer_*.png", APERTURE_FILE, LAYERS_FILE)
    foreign = not folder.is_dir() or any(not any(path.match(name) for name in own) for path in folder.iterdir())
    if foreign or (not force and any(folder.iterdir())):
        cure = "choose another name" + ("" if foreign else ", or --force to overwrite these layers")
        raise InputError("--layers", f"{folder} exists already{' and holds other things' if foreign else ''}; {cure}")


def _as_design(mask: Mask, path: Path, material: str, max_height_um: float | None = None) -> str:
    """Return the line of a configuration that uses the exported file."""
    scale = f"max_height_um: {max_height_um:.7g}, " if max_height_um is not None else ""
    return (
        f"mask: {{design: height_map, file: {path}, pixel_um: {mask.pitch_m * 1e6:.7g}, {scale}"
        f"material: {material}, profile: {mask.profile}}}"
    )
