"""``reconstruct``: picture, depth and volume of one measurement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def reconstruct(
    measurement: Annotated[
        Path,
        typer.Argument(
            help="a sample's folder, or a linear picture: EXR, TIFF, PNG (8 bit, or 16 bit grey), npy",
            show_default=False,
        ),
    ],
    checkpoint: Annotated[
        str | None,
        typer.Option(help="a trained network: file, or name of a shipped one; default: the shipped one that fits"),
    ] = None,
    method: Annotated[str | None, typer.Option(help="a classical method instead: cls or admm")] = None,
    stack: Annotated[
        str | None,
        typer.Option(
            help="its PSFs: folder of a stack or data set, picture of one PSF; a sample's own: nominal, captured"
        ),
    ] = None,
    tuned: Annotated[Path | None, typer.Option(help="its parameters: what `flatlight tune` wrote")] = None,
    noise_db: Annotated[
        float | None, typer.Option(help="PSNR of the measurement, which chooses among the tuned")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="one of its parameters, e.g. strength=0.01")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="folder for the result; default: SPLIT_NAME_METHOD here", show_default=False)
    ] = None,
    volume: Annotated[bool, typer.Option("--volume", help="write the volume too, a plane per depth")] = False,
    bits: Annotated[
        int | None, typer.Option(help="the sensor's bit depth, where the file's type is wider, e.g. 12 in 16 bit files")
    ] = None,
    background: Annotated[
        str | None, typer.Option(help="to subtract: a number in the file's units, or a picture of darkness")
    ] = None,
    psf_background: Annotated[
        str | None,
        typer.Option(help="the same for the picture of a PSF; or border (its frame's median), none  [border]"),
    ] = None,
    psf_crop: Annotated[str | None, typer.Option(help="the same as --crop for the picture of a PSF")] = None,
    crop: Annotated[
        str | None, typer.Option(help="ROWSxCOLUMNS about the centre, or ROWSxCOLUMNS+TOP+LEFT, of the file's pixels")
    ] = None,
    binning: Annotated[int, typer.Option(help="pixels per side that become one, of the PSF's picture too")] = 1,
    scene: Annotated[
        str | None, typer.Option(help="ROWSxCOLUMNS of the result without data set or network  [the sensor's]")
    ] = None,
    white: Annotated[
        float | None, typer.Option(help="radiance to show as white  [the camera's, or the picture's]")
    ] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda")] = "auto",
) -> None:
    """Reconstruct picture and depth from one measurement, by a network or a classical method."""
    from learning.reconstruction.job import Options, reconstruct_file

    options = Options(
        measurement=measurement,
        checkpoint=checkpoint,
        method=method,
        stack=stack,
        tuned=tuned,
        noise_db=noise_db,
        changes=tuple(set_ or ()),
        output=output,
        volume=volume,
        bits=bits,
        background=background,
        psf_background=psf_background,
        psf_crop=psf_crop,
        crop=crop,
        binning=binning,
        scene=scene,
        white=white,
        device=device,
    )
    print(reconstruct_file(options))
