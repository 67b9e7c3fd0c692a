"""`flatlight reconstruct`: from its options to a folder of files."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.devices import choose_device
from learning.reconstruct import Reconstruction, reconstruct
from learning.reconstruction.camera import Request
from learning.reconstruction.files import RECORD, check_place, write_reconstruction
from learning.reconstruction.measurements import Measurement, load_measurement
from learning.reconstruction.method_choice import choose_method
from simulator import __version__
from simulator.config.yaml import parse_scalar
from simulator.errors import InputError
from simulator.plots.drawing import centimetres


@dataclass(frozen=True)
class Options:
    """What the command was given; see its help."""

    measurement: Path
    checkpoint: str | None = None
    method: str | None = None
    stack: str | None = None
    tuned: Path | None = None
    noise_db: float | None = None
    changes: tuple[str, ...] = ()
    output: Path | None = None
    volume: bool = False
    bits: int | None = None
    background: str | None = None
    psf_background: str | None = None
    psf_crop: str | None = None
    crop: str | None = None
    binning: int = 1
    scene: str | None = None
    white: float | None = None
    device: str = "auto"


def reconstruct_file(options: Options) -> str:
    """Reconstruct a measurement, write the result, and return some lines about it.

    Raises:
        InputError: an option, a file, or a camera that does not fit.
        StorageError: the result cannot be written.
    """
    if options.white is not None and not (math.isfinite(options.white) and options.white > 0):
        msg = f"--white: got {options.white}, expected a positive radiance"
        raise InputError(msg)
    device = choose_device(options.device)
    request = _request(options)
    measurement = load_measurement(
        options.measurement,
        bits=options.bits,
        background=options.background,
        crop=options.crop,
        binning=options.binning,
    )
    if options.output is not None:
        check_place(options.output)
    setup = choose_method(measurement, request)
    folder = options.output or Path(default_name(measurement, setup.name))
    check_place(folder)
    method: Any = setup.method
    (method.network if hasattr(method, "network") else method).to(device)
    result = reconstruct(measurement.values, method, volume=options.volume, white=setup.white, device=device)
    record = {
        "measurement": measurement.record,
        **setup.record,
        "white_from": result.white_from or setup.record["camera"]["white_from"],
        "device": str(device),
        "version": __version__,
    }
    replaces = (folder / RECORD).is_file()
    files = write_reconstruction(folder, result, method.capture, record)
    wrote = f"{folder}: {', '.join(files)}{'; replaced an earlier reconstruction' if replaces else ''}"
    return _report(measurement, setup.method.name, record, result, wrote)


def default_name(measurement: Measurement, method: str) -> str:
    """Return the folder's name: the sample's split and name, or the file's, and the method's, e.g. test_s00000002_cls."""
    place = measurement.path.absolute()
    split = "" if measurement.dataset is None else f"{place.parents[1].name}_"
    return f"{split}{place.stem}_{method}"


def _request(options: Options) -> Request:
    scene = None
    if options.scene is not None:
        found = re.fullmatch(r"(\d+)x(\d+)", options.scene)
        if not found:
            msg = f"--scene: got {options.scene!r}, expected ROWSxCOLUMNS, e.g. 256x256"
            raise InputError(msg)
        scene = (int(found[1]), int(found[2]))
    return Request(
        checkpoint=options.checkpoint,
        method=options.method,
        stack=options.stack,
        psf_background=options.psf_background,
        psf_crop=options.psf_crop,
        binning=options.binning,
        scene=scene,
        tuned=options.tuned,
        noise_db=options.noise_db,
        parameters=dict(_change(text) for text in options.changes),
        white=options.white,
    )


def _change(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        msg = f"--set: got {text!r}, expected KEY=VALUE, e.g. strength=0.01"
        raise InputError(msg)
    return name.strip(), parse_scalar(value.strip())


def _report(measurement: Measurement, name: str, record: dict[str, Any], result: Reconstruction, wrote: str) -> str:
    rows, columns = measurement.sensor_shape
    how = record.get("checkpoint") or ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in record["parameters"].items()
    )
    times = ", ".join(f"{stage} {seconds:.2g} s" for stage, seconds in result.seconds.items())
    scale = f"numbers / {measurement.record['divided_by']:g} ({measurement.record['scale']})"
    size = " x ".join(map(str, result.picture.shape[1:]))
    lines = {
        "measurement": f"{rows} x {columns}, {', '.join(measurement.channels)}; {scale}",
        "method": f"{name} ({how})",
        "camera": record["camera"]["numbers_from"],
        "picture": f"{size}, white = {result.white:.4g} ({record['white_from']})",
    }
    depth = "none: the PSFs are of one depth"
    if result.depth_m is not None:
        depth = f"{centimetres(result.depth_m.min())} to {centimetres(result.depth_m.max())}"
    lines |= {"depth": depth, "time": times, "wrote": wrote}
    width = max(map(len, lines))
    return "\n".join(f"{name:>{width}}  {text}" for name, text in lines.items())
