"""`flatlight reconstruct`: from one measurement to image, depth map and volume, or to frames, and the files of these."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from learning.camera import CaptureModel
from learning.classical.clips import ClipMethod
from learning.classical.method import ClassicalMethod, PlanarMethod
from learning.confidence.calibration import DARK, UNKNOWN, DepthConfidence, mean_light
from learning.confidence.files import find_confidence
from learning.labels import spoken
from learning.method import Clock, Method, Progress, choose_device, linear_to_srgb, srgb_to_linear, threads_for
from learning.models.activitynet import ActivityMethod
from learning.models.flatnet import LearnedMethod
from learning.reconstruct.choice import Setup, choose_method
from learning.reconstruct.inputs import Frame, Measurement, Mirror, Request, load_measurement
from learning.reconstruct.orientation import check_frame_fits
from simulator import __version__
from simulator.arrays import to_numpy
from simulator.config.yaml import parse_scalar
from simulator.errors import InputError
from simulator.io.exr import write_exr
from simulator.io.files import committed_folder, is_own_folder, write_atomic
from simulator.io.json import plain, readable_json
from simulator.plots import drawing
from simulator.plots.drawing import LEGEND_WIDTH, PAPER, animation_webp, centimetres, depth_colours, png_bytes
from simulator.plots.psf import GRID, INK, style
from simulator.types import FARTHEST_M

if TYPE_CHECKING:
    from PIL import Image

RECORD = "reconstruction.json"
_WHITE_PERCENTILE = 99.5  # of the lit values, as in all images that the simulator shows
_LEAST_HEIGHT, _MARGIN, _GAP = 240, 12, 6
_LIKELY = 5  # classes that are told of


@dataclass(frozen=True, kw_only=True)
class Options(Request):
    """What the command was given; see its help."""

    measurement: Path
    output: Path | None = None
    volume: bool = False
    bits: int | None = None
    background: str | None = None
    mirror: Mirror = "none"
    frame: Frame | None = None
    accept_frame: bool = False
    white: float | None = None
    confidence: str | None = None
    least_confidence: float | None = None
    seconds: float | None = None
    device: str = "auto"


def reconstruct_file(options: Options, *, progress: Progress = lambda *_: None) -> str:
    """Reconstruct a measurement, write the result, and return some lines about it.

    A method that is fitted to the capture keeps its state beside the result until it is done: the same call goes on from it.

    Raises:
        InputError: an option, a file, or a camera that does not fit.
        StorageError: the result cannot be written.
    """
    for option, value, what in (("--white", options.white, "radiance"), ("--seconds", options.seconds, "time")):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(option, f"got {value}, expected a positive {what}")
    least = UNKNOWN if options.least_confidence is None else options.least_confidence
    if not 0 <= least <= 1:
        raise InputError("--least-confidence", f"got {least}, expected a probability, 0 to 1")
    device = choose_device(options.device)
    of_file = {
        name: getattr(options, name) for name in ("bits", "background", "cfa", "crop", "binning", "mirror", "frame")
    }
    measurement = load_measurement(options.measurement, **of_file)
    # The FFT has a period up to twice as long per axis.
    with threads_for(4 * measurement.values.size):
        setup = choose_method(measurement, options)
        # The sample's split and name, or the file's, and the method's, e.g. test_s00000002_cls.
        place = measurement.path.absolute()
        split = "" if measurement.dataset is None else f"{place.parents[1].name}_"
        folder = options.output or Path(f"{split}{place.stem}_{setup.name}")
        replaces = is_own_folder(folder, RECORD, "reconstruction", "--output")
        if measurement.frame is None or options.frame is not None:  # an image's file
            evidence = check_frame_fits(measurement, setup.method.capture, options, accept=options.accept_frame)
            measurement.record["frame_evidence"] = round(evidence, 4)
        confidence, confidence_from = _confidence(setup, options)
        method = setup.method.to(device)
        fitting = method.fitting if isinstance(method, ClipMethod) else None
        states = folder.absolute().with_name(f"{folder.absolute().name}.fit")
        if fitting is not None:
            fitting.states, fitting.progress = states, partial(progress, method.name)
            fitting.seconds = math.inf if options.seconds is None else options.seconds
        elif options.seconds is not None:
            raise InputError(
                "--seconds", f"{method.name} is not fitted to the capture; leave it out, or take udn or nstm"
            )
        told: dict[str, Any] = {"volume": options.volume, "white": options.white, "device": device}
        told |= {"confidence": confidence, "least_confidence": least, "known_white": setup.known_white}
        result = reconstruct(measurement.values, method, **told)
    record = {
        "measurement": measurement.record,
        **setup.record,
        "white_from": result.white_from,
        "confidence_from": confidence_from,
        "device": str(device),
        "version": __version__,
    }
    files = write_reconstruction(folder, result, method.capture, record)
    wrote = f"{folder}: {', '.join(files)}{'; replaced an earlier reconstruction' if replaces else ''}"
    if fitting is not None:
        if len(fitting.curve) < fitting.iterations:
            wrote += f"; {len(fitting.curve)} of {fitting.iterations} iterations: with more --seconds it goes on"
        elif fitting.state is not None:
            fitting.state.unlink(missing_ok=True)
            with suppress(OSError):  # other fits, or files of the user's, are in it
                states.rmdir()
    return _report(measurement, setup.method.name, record, result, wrote)


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Return the rows and columns of ``--scene ROWSxCOLUMNS``."""
    found = re.fullmatch(r"(\d+)x(\d+)", text or "")
    if text is not None and not found:
        raise InputError("--scene", f"got {text!r}, expected ROWSxCOLUMNS, e.g. 256x256")
    return (int(found[1]), int(found[2])) if found else None


def parse_changes(texts: Iterable[str]) -> dict[str, Any]:
    """Return the parameters of ``--set KEY=VALUE``."""
    parameters = {}
    for text in texts:
        name, _, value = text.partition("=")
        if not name or not value:
            raise InputError("--set", f"got {text!r}, expected KEY=VALUE, e.g. pairwise=0.5")
        parameters[name.strip()] = parse_scalar(value.strip())
    return parameters


def _report(measurement: Measurement, name: str, record: dict[str, Any], result: Reconstruction, wrote: str) -> str:
    rows, columns = measurement.sensor_shape
    how = record.get("checkpoint") or ", ".join(
        f"{key} {value:g}" if isinstance(value, float) else f"{key} {value}"
        for key, value in record["parameters"].items()
    )
    scale = f"numbers / {measurement.record['divided_by']:g} ({measurement.record['scale']})"
    depth = "none: the PSFs are of one depth"
    if result.depth_m is not None:
        depth = "unknown everywhere"
        if (known := np.isfinite(result.depth_m)).any():
            depth = " to ".join(centimetres(float(end(result.depth_m[known]))) for end in (np.min, np.max))
            if not known.all():
                depth += f", unknown at {1 - known.mean():.1%} of the pixels"
        depth += f"; confidence: {record['confidence_from']}"
    size = " x ".join(map(str, result.image.shape[-2:]))
    if result.image.ndim == 4:
        size = f"{len(result.image)} frames of {size}"
    frame = "rotated by 180 degrees" if measurement.frame == "physical" else "in the stored frame"
    taken = [frame, *measurement.record.get("notes", ()), scale]
    lines = {
        "measurement": f"{rows} x {columns}, {', '.join(measurement.channels)}; {'; '.join(taken)}",
        "method": f"{name} ({how})",
        "camera": record["camera"]["numbers_from"],
        "PSFs": record["camera"]["psfs"],
        "image": f"{size}, white = {result.white:.4g} ({record['white_from']})",
        "depth": depth,
        "time": ", ".join(f"{stage} {seconds:.2g} s" for stage, seconds in result.seconds.items()),
        "wrote": wrote,
    }
    if result.classes:
        likely = ", ".join(f"{spoken(name)} {chance:.1%}" for name, chance in list(result.classes.items())[:_LIKELY])
        label = measurement.record.get("label")
        lines = {"shows": likely + (f"; its label is {spoken(label)}" if label else ""), **lines}
    width = max(map(len, lines))
    return "\n".join(f"{name:>{width}}  {text}" for name, text in lines.items())


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What was made of a measurement.

    Attributes:
        radiance: ``(3, h, w)`` float32 linear sRGB, not clipped, of clips ``(N, 3, h, w)``. Of PSFs without a scale of their
            own, in the unit measurement / PSF.
        image: the same in sRGB codes 0..1; 1 is ``white``.
        white: the radiance that the image shows as 1.
        white_from: why this one.
        depth_m: ``(h, w)`` float32 metres, of clips ``(N, h, w)``, at most `FARTHEST_M`, NaN where it is unknown; None of
            PSFs of one depth.
        confidence: like it, the probability that the depth, also where it is given as unknown, is right; None where no
            confidence of the method is known.
        volume: ``(K, C, h, w)`` float32 radiance in the camera's channels; None where it was not asked for.
        volume_depths_m: of its planes, ``(K,)``, nearest first: all of the stack's, or those that a network inverts at.
        seconds: by stage.
        convergence: see `ClipMethod.convergence`.
        classes: of a network that tells what is done, the probability of each class, the most likely one first.
    """

    radiance: NDArray[np.float32]
    image: NDArray[np.float32]
    white: float
    white_from: str
    depth_m: NDArray[np.float32] | None
    confidence: NDArray[np.float32] | None
    volume: NDArray[np.float32] | None
    volume_depths_m: NDArray[np.float64]
    seconds: dict[str, float]
    convergence: dict[str, list[float]]
    classes: dict[str, float] = field(default_factory=dict)


def _confidence(setup: Setup, options: Options) -> tuple[DepthConfidence | None, str]:
    """Return the confidence of the method's depths, where there is one, and where it is from, in words."""
    asked = options.confidence not in (None, "none") or options.least_confidence is not None
    if len(setup.method.capture.stack.depths_m) == 1:
        if asked:
            option = "--confidence" if options.least_confidence is None else "--least-confidence"
            raise InputError(option, "these PSFs have one depth, so none is reconstructed; leave it out")
        return None, "no depth"
    confidence, origin = find_confidence(setup.record, options.confidence)
    if confidence is None and options.least_confidence is not None:
        raise InputError("--least-confidence", f"the confidence is {origin}; leave it out, or calibrate one")
    return confidence, origin


def reconstruct(
    measurement: NDArray[Any],
    method: Method,
    *,
    volume: bool = False,
    white: float | None = None,
    confidence: DepthConfidence | None = None,
    least_confidence: float = UNKNOWN,
    known_white: bool = True,
    device: torch.device | str = "cpu",
) -> Reconstruction:
    """Reconstruct a still or clip of one measurement ``(C, H, W)``, DN / 2^bits, by a method on ``device``.

    The volume is given where it is wanted.

    ``white`` is the radiance that the image shows as 1, None shows its brightest half per cent as white; the radiance itself
    is never clipped. With a calibrated ``confidence``, depths of less than ``least_confidence`` are unknown; where the
    method's white is a guess (not ``known_white``), so that the calibration does not know what is dark, also those of less
    light than `DARK` of the image's own white.

    Raises:
        InputError: NaN or infinite numbers, a shape that is not the camera's, or a method that has no volume to show.
    """
    capture = method.capture
    expected = (len(capture.stack.channels), *capture.sensor_shape)
    if tuple(measurement.shape) != expected:
        wanted = f"expected the camera's {expected}: channels, rows, columns"
        raise InputError("measurement", f"got shape {tuple(measurement.shape)}, {wanted}")
    if not np.isfinite(measurement).all():
        raise InputError("measurement", "got NaN or infinite numbers, expected finite ones; repair these pixels first")
    batch = torch.from_numpy(np.array(measurement, np.float32))[None].to(device)
    clock = Clock(device)
    planes, depths_m = None, np.asarray(capture.stack.depths_m, np.float64)
    classes: dict[str, float] = {}
    if isinstance(method, ClassicalMethod | PlanarMethod):
        with clock.stage(method.stage):
            planes = method.volume(batch)
        estimate = method.estimate(planes, clock)
    elif isinstance(method, ActivityMethod) and not volume:
        estimate, chances = method.recognise(batch, clock)
        likely = sorted(
            zip(chances[0].tolist(), method.network.classes, strict=True), key=lambda pair: (-pair[0], pair[1])
        )
        classes = {name: chance for chance, name in likely}
    elif isinstance(method, LearnedMethod) or not volume:
        estimate = method.reconstruct(batch, clock)
        if isinstance(method, LearnedMethod) and volume:
            network = method.network
            with torch.no_grad():
                planes = network.inversion(batch)[network.image]
            depths_m = depths_m[list(network.inversion.planes)]
    else:
        raise InputError("volume", f"{method.name} has none to show; leave it out")
    radiance = to_numpy(srgb_to_linear(estimate.image, capture.white, clip=False))[0]
    lit = radiance[radiance > 0]
    own_white = float(np.percentile(lit, _WHITE_PERCENTILE)) if lit.size else 1.0
    reason = "as told"
    if white is None:
        white, reason = own_white, f"{_WHITE_PERCENTILE}th percentile of the image's positive values"
    depth_m = np.minimum(to_numpy(estimate.clamped().depth_m(capture))[0, ..., 0, :, :], FARTHEST_M)
    sure = None
    if confidence is not None and len(capture.stack.depths_m) > 1:
        sure = to_numpy(confidence.of(estimate, batch, capture))[0, ..., 0, :, :]
        if not known_white:
            sure = np.where(mean_light(torch.from_numpy(radiance)).numpy()[..., 0, :, :] < DARK * own_white, 0, sure)
        depth_m = np.where(sure < least_confidence, np.float32(np.nan), depth_m)
    return Reconstruction(
        radiance=radiance,
        image=to_numpy(linear_to_srgb(torch.from_numpy(radiance), white)),
        white=white,
        white_from=reason,
        depth_m=depth_m if len(capture.stack.depths_m) > 1 else None,
        confidence=sure,
        volume=to_numpy(planes)[0] * np.float32(capture.white) if volume and planes is not None else None,
        volume_depths_m=depths_m,
        seconds=clock.seconds,
        convergence=method.convergence if isinstance(method, ClipMethod) else {},
        classes=classes,
    )


def write_reconstruction(
    folder: Path, result: Reconstruction, capture: CaptureModel, record: dict[str, Any]
) -> list[str]:
    """Write a reconstruction and return the files' names; the folder appears whole or not at all.

    ``image.png`` (sRGB, 8 bit), ``image.exr`` (linear R, G, B), ``depth.exr`` (Z, metres, NaN where unknown, and its
    ``confidence``), ``depth.png`` (colours and what they mean, grey where unknown), ``volume.exr`` (channels ``plane00.R``
    and so on, nearest first), ``reconstruction.json`` (``record``), as far as there is something to write. Of clips, in place
    of images, ``film.webp`` (an animation, the depth beside the picture), ``film.png`` (its frames side by side, the depths
    below) and ``frames/image.0000.exr``, ``depth.0000.exr`` and so on; of methods that iterate until they converge,
    ``convergence.png``, whose numbers are in the record. An earlier reconstruction in the folder is replaced.

    Raises:
        InputError: the folder holds other things.
        StorageError: it cannot be written.
    """
    from PIL import Image

    is_own_folder(folder, RECORD, "reconstruction", "--output")
    with committed_folder(folder) as place:
        codes = np.round(np.moveaxis(result.image, -3, -1) * 255).astype(np.uint8)
        if capture.timing is not None:
            _write_film(place, result, codes, capture.timing.frame_edges_s, capture)
        else:
            write_atomic(place / "image.png", png_bytes(Image.fromarray(codes)))
            _write_radiance(place / "image.exr", result.radiance, {"white": result.white})
            if result.depth_m is not None:
                _write_depth(place / "depth.exr", result.depth_m, result.confidence)
                write_atomic(place / "depth.png", png_bytes(_depth_image(result.depth_m, capture)))
        if result.volume is not None:
            planes = {
                f"plane{k:02d}.{name}": np.ascontiguousarray(values)
                for k, plane in enumerate(result.volume)
                for name, values in zip(capture.stack.channels, plane, strict=True)
            }
            write_exr(place / "volume.exr", planes, {"depths_m": plain(result.volume_depths_m.tolist())})
        content = dict(record)
        if result.classes:
            content["classes"] = result.classes
        if result.convergence:
            write_atomic(place / "convergence.png", _curve_png(result.convergence))
            content["convergence"] = result.convergence
        files = sorted([*(path.name for path in place.iterdir()), RECORD])
        content |= {"files": files, "white": result.white, "seconds": result.seconds}
        write_atomic(place / RECORD, readable_json(content))
    return files


def _write_film(
    place: Path, result: Reconstruction, codes: NDArray[np.uint8], edges_s: NDArray[np.float64], capture: CaptureModel
) -> None:
    """Write the frames ``codes`` ``(N, h, w, 3)`` of a clip, that are between the times ``edges_s``, and their depths."""
    frames = [_enlarged(frame) for frame in codes]
    rows, shown = [frames], frames
    (place / "frames").mkdir()
    for number, radiance in enumerate(result.radiance):
        about = {"white": result.white, "begins_s": edges_s[number], "ends_s": edges_s[number + 1]}
        _write_radiance(place / "frames" / f"image.{number:04d}.exr", radiance, plain(about))
        if result.depth_m is not None:
            sure = None if result.confidence is None else result.confidence[number]
            _write_depth(place / "frames" / f"depth.{number:04d}.exr", result.depth_m[number], sure)
    if result.depth_m is not None:
        rows.append([_enlarged(_depth_codes(depth_m, capture)) for depth_m in result.depth_m])
        pairs = zip(frames, result.depth_m, strict=True)
        shown = [_tiled([[frame, _depth_image(depth_m, capture)]]) for frame, depth_m in pairs]
    write_atomic(place / "film.png", png_bytes(_tiled(rows)))
    write_atomic(place / "film.webp", animation_webp(shown))


def _write_depth(path: Path, depth_m: NDArray[np.float32], confidence: NDArray[np.float32] | None) -> None:
    channels = {"Z": depth_m} if confidence is None else {"Z": depth_m, "confidence": confidence}
    content = {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}
    write_exr(path, content, {"unit": "m", "z": "from the mask plane"}, finite=False)


def _write_radiance(path: Path, radiance: NDArray[np.float32], about: dict[str, Any]) -> None:
    write_exr(path, {name: np.ascontiguousarray(values) for name, values in zip("RGB", radiance, strict=True)}, about)


def _enlarged(pixels: NDArray[np.uint8]) -> Image.Image:
    """Return pixels as an image, small ones enlarged by a whole number."""
    rows = len(pixels)
    return drawing.resized(pixels, rows * max(1, -(-_LEAST_HEIGHT // rows)))


def _tiled(rows: Sequence[Sequence[Image.Image]]) -> Image.Image:
    """Return rows of images, those of a row of one height, on paper that shows between them."""
    from PIL import Image

    width = sum(one.width + _GAP for one in rows[0]) - _GAP
    paper = Image.new("RGB", (width, sum(row[0].height + _GAP for row in rows) - _GAP), PAPER)
    y = 0
    for row in rows:
        x = 0
        for one in row:
            paper.paste(one, (x, y))
            x += one.width + _GAP
        y += row[0].height + _GAP
    return paper


def _curve_png(convergence: Mapping[str, Sequence[float]]) -> bytes:
    """Return values after each iteration as a figure with logarithmic axes."""
    figure = drawing.new_figure((6, 3.6), 120)
    axes = figure.subplots()
    for name, values in convergence.items():
        axes.loglog(range(1, len(values) + 1), values, color=INK, lw=1.6)
        style(axes, "iteration", name)
    axes.grid(color=GRID, which="both")
    return drawing.figure_png(figure)


def _depth_codes(depth_m: NDArray[np.float32], capture: CaptureModel) -> NDArray[np.uint8]:
    known = np.isfinite(depth_m)
    return depth_colours(np.where(known, depth_m, np.float32(1)), known, capture.near_m, min(capture.far_m, FARTHEST_M))


def _depth_image(depth_m: NDArray[np.float32], capture: CaptureModel) -> Image.Image:
    """Return the depth in colours beside their legend, small ones enlarged by a whole number."""
    from PIL import Image, ImageDraw

    shown = _enlarged(_depth_codes(depth_m, capture))
    paper = Image.new("RGB", (shown.width + LEGEND_WIDTH + _MARGIN, shown.height), PAPER)
    paper.paste(shown, (0, 0))
    top, ends_m = 8, (capture.near_m, min(capture.far_m, FARTHEST_M))
    unseen = None if np.isfinite(depth_m).all() else "unknown"
    height = shown.height - 2 * top - (24 if unseen else 0)
    drawing.draw_depth_legend(ImageDraw.Draw(paper), shown.width + _MARGIN, top, height, *ends_m, unseen=unseen)
    return paper
