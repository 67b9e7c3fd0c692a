"""`flatlight calibrate`: pictures of a point source at known distances become a PSF stack, with a report."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from simulator.commands.shared import check_output_folder


def calibrate(
    folder: Annotated[
        Path,
        typer.Argument(help="pictures named by distance (12.5cm.tif, z120mm_4ms_1.png), dark frames (dark_4ms.tif)"),
    ],
    pixel_um: Annotated[
        float, typer.Option("--pixel-um", min=0.1, max=100, help="pixel pitch of the pictures, micrometres")
    ],
    output: Annotated[
        Path | None, typer.Option("--output", help="folder of stack and report; FOLDER_calibrated when left out")
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option("--table", help="CSV: file, distance_cm and perhaps exposure_ms (FOLDER/distances.csv is taken)"),
    ] = None,
    frame: Annotated[
        str, typer.Option("--frame", help="physical as the sensor reads it, or stored (rotated by 180 degrees)")
    ] = "physical",
    bits: Annotated[int | None, typer.Option("--bits", help="bit depth of the numbers, as 12 in 16-bit files")] = None,
    cfa: Annotated[
        str | None, typer.Option("--cfa", help="colours of a mosaic: RGGB, BGGR, GRBG, GBRG or none")
    ] = None,
    binning: Annotated[int, typer.Option("--binning", min=1, max=64, help="pixels per side that become one")] = 1,
    mask_to_sensor_mm: Annotated[
        float | None,
        typer.Option(
            "--mask-to-sensor-mm", min=0.01, max=1000, help="roughly, to start from; it is searched when left out"
        ),
    ] = None,
    offset_mm: Annotated[
        float, typer.Option("--offset-mm", help="added to the stated distances so that they count from the mask")
    ] = 0.0,
    throughput_mm2: Annotated[
        float | None,
        typer.Option("--throughput-mm2", min=1e-6, max=1e6, help="the mask's open area times its transmittance"),
    ] = None,
) -> None:
    """Turn pictures of a point source at known distances into a registered PSF stack, and say what to measure again."""
    from simulator.calibrate.calibration import calibrate as run
    from simulator.calibrate.calibration import is_record
    from simulator.console import Bar
    from simulator.errors import InputError
    from simulator.io.files import is_own_folder, make_folder, write_atomic
    from simulator.io.json import readable_json
    from simulator.optics.stack_files import PSF_FOLDER, check_replaceable, write_psf_stack
    from simulator.plots.calibration import calibration_html, describe_calibration

    if frame not in ("physical", "stored"):
        raise InputError("--frame", f"got {frame!r}, expected physical or stored")
    place = output or folder.absolute().with_name(f"{folder.absolute().name}_calibrated")
    check_output_folder("--output", place)
    stack_place, record = place / PSF_FOLDER, place / "calibration.json"
    if is_own_folder(place, record.name, "calibration", "--output") and not is_record(record):
        raise InputError("--output", f"{record} is not that of a calibration; choose another folder")
    check_replaceable(stack_place)
    with Bar() as bar:
        found = run(
            folder,
            pixel_um * 1e-6,
            table=table,
            frame=frame,
            bits=bits,
            cfa=cfa,  # pyright: ignore[reportArgumentType]
            binning=binning,
            nominal_m=None if mask_to_sensor_mm is None else mask_to_sensor_mm * 1e-3,
            offset_m=offset_mm * 1e-3,
            throughput_m2=None if throughput_mm2 is None else throughput_mm2 * 1e-6,
            progress=bar.update,
        )
    print(describe_calibration(found))
    make_folder(place)
    write_atomic(record, readable_json(found.record()))  # first: it says whose the folder is
    write_psf_stack(stack_place, found.stack)
    write_atomic(place / "report.html", calibration_html(found, folder.absolute().name).encode())
    print(f"\nwrote {place}; look at {place / 'report.html'}")
    # What holds of the pictures holds of captures by the same camera.
    options = ["--frame", frame, *(["--bits", str(bits)] * bool(bits)), *(["--cfa", str(cfa)] * bool(cfa))]
    options += ["--binning", str(binning)] * (binning > 1)
    print(f"use it: flatlight reconstruct CAPTURE --method cls --stack {shlex.join([str(place), *options])}")
    print(f"or psf: {{measured: {place}}} in a configuration without a mask")
