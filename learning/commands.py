"""The commands that learning adds to `flatlight`: train, tune, evaluate, swap masks, reconstruct."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from simulator.commands.shared import Overrides

if TYPE_CHECKING:
    from learning.config import EvaluateConfig, RecognitionConfig
    from learning.training_loop import TrainResult


def train(
    config: Annotated[
        Path, Argument(help="training (YAML); `flatlight init --preset flatnet3d_64` writes one", show_default=False)
    ],
    set_: Overrides = None,
) -> None:
    """Train a network on a data set, or resume an interrupted training."""
    from learning.config import (
        ActivityTrainConfig,
        TrainConfig,
        Video3DTrainConfig,
        VideoTrainConfig,
        load_file,
        training_kind,
    )
    from learning.train import train as run
    from learning.train_activity import train_activity
    from learning.train_video import train_video
    from learning.train_video_3d import train_video_3d

    runs: dict[type, Callable[..., TrainResult]] = {
        TrainConfig: run,
        VideoTrainConfig: train_video,
        Video3DTrainConfig: train_video_3d,
        ActivityTrainConfig: train_activity,
    }
    settings = load_file(training_kind, config, set_ or [])
    folder = _train(partial(runs[type(settings)], settings))
    print(f"look at {folder / 'validation.png'}, or at the curves: tensorboard --logdir {folder}")


def train_denoiser(
    config: Annotated[
        Path, Argument(help="training (YAML); `flatlight init --preset denoiser_64` writes one", show_default=False)
    ],
    set_: Overrides = None,
) -> None:
    """Train the denoiser of plug-and-play ADMM on a data set's clean images, or resume an interrupted training."""
    from learning.config import DenoiserConfig, load_file
    from learning.train_denoiser import train_denoiser as run

    settings = load_file(DenoiserConfig, config, set_ or [])
    folder = _train(partial(run, settings))
    print(f"use it: flatlight reconstruct SAMPLE --method pnp --set denoiser={folder / 'best.safetensors'}")


def _train(run: Callable[..., TrainResult]) -> Path:
    """Run a training, say what became of it, with its best scores, and return its folder."""
    from learning.validation import errors_in_words
    from simulator.console import Bar

    with Bar() as bar:
        result = run(progress=bar.update, say=bar.say)
    best, folder, done = result.best, result.folder, f"{result.steps} steps, {result.seconds:.0f} s in all"
    print(f"{folder}: {done if result.steps else 'was finished before; raise steps to go on'}")
    print(f"best after step {best['step']:.0f}: {errors_in_words(best)} on validation; {folder / 'best.safetensors'}")
    return folder


def tune(
    config: Annotated[Path, Argument(help="YAML file: data, methods, noise levels, objective", show_default=False)],
    set_: Overrides = None,
) -> None:
    """Tune the classical methods on validation scenes, each noise level separately; an interrupted run resumes."""
    from learning.config import TuneConfig, load_file
    from learning.tune.job import table, tune_file
    from learning.tune.study import load_tuned
    from simulator.console import Bar

    loaded = load_file(TuneConfig, config, set_ or [])
    with Bar() as bar:
        path = tune_file(loaded, progress=bar.update, say=bar.say)
    print(table(load_tuned(path).content))
    print(f"wrote {path}")


def evaluate(
    config: Annotated[Path, Argument(help="what is compared, on which scenes (YAML)", show_default=False)],
    set_: Overrides = None,
) -> None:
    """Compare networks and classical methods, or classifiers, on test scenes; an interrupted run resumes."""
    from learning.config import RecognitionConfig, evaluation_kind, load_file

    settings = load_file(evaluation_kind, config, set_ or [])
    report = _recognise(settings) if isinstance(settings, RecognitionConfig) else _evaluate(settings)
    print(f"look at {report}")


def _evaluate(settings: EvaluateConfig) -> Path:
    """Evaluate reconstructions, print the tables, and return the report."""
    from learning.evaluate.job import evaluate as run
    from learning.evaluate.tables import terminal_table, terminal_verdicts
    from simulator.console import Bar

    with Bar() as bar:
        evaluation, files = run(settings, progress=bar.update, say=bar.say)
    for name, found in evaluation.findings.items():
        table = terminal_table([*found.main, *found.naive], {one.method: one for one in found.times})
        print(f"{name}:\n{table}" if name else table)
        if found.differences:
            print(f"\n{terminal_verdicts(found.differences)}\n")
    if evaluation.differences:
        print("+ the first is better (95 % interval excludes zero); - the second is; . undecided")
    return files[0]


def _recognise(settings: RecognitionConfig) -> Path:
    """Evaluate classifiers, print the table, and return the report."""
    from learning.recognition.job import recognise
    from learning.recognition.report import terminal_tables
    from simulator.console import Bar

    with Bar() as bar:
        found, files = recognise(settings, progress=bar.update, say=bar.say)
    print(terminal_tables(found))
    return files[0]


def swap_masks(
    config: Annotated[
        Path, Argument(help="masks, scenes and methods (YAML); the preset masks_64 is one", show_default=False)
    ],
    set_: Overrides = None,
) -> None:
    """Judge masks by what is reconstructed through them, beside the merits of their PSFs; an interrupted run resumes."""
    from learning.config import SwapConfig, load_file
    from learning.method import aligned
    from learning.swap import swap_masks as run
    from simulator.console import Bar

    settings = load_file(SwapConfig, config, set_ or [])
    with Bar() as bar:
        found = run(settings, progress=bar.update, say=bar.say)
    print("\n".join([*aligned(found.table), "", found.light, f"look at {found.report}"]))


Sample = Argument(help="a sample's folder, or a linear image: EXR, TIFF, PNG, npy, raw", show_default=False)
Network = Option(help="a trained network: file, or name of a shipped one; default: the shipped one that fits")
Stack = Option(help="its PSFs: folder of a stack or data set, image of one PSF; a sample's own: nominal, captured")
Parameter = Option("--set", metavar="KEY=VALUE", help="one of its parameters, e.g. regularisation_lambda=0.01")
Output = Option(help="folder for the result; default: SPLIT_NAME_METHOD here", show_default=False)

_FILES = "An image's file, in this order"
Bits = Option(
    help="the sensor's bit depth, where the file's type is wider, e.g. 12 in 16 bit files", rich_help_panel=_FILES
)
Background = Option(help="to subtract: a number in the file's units, or a dark frame", rich_help_panel=_FILES)
Mosaic = Option(
    help="colours of a raw mosaic's upper left 2 x 2 pixels (RGGB, BGGR, GRBG, GBRG), of which each becomes a pixel; or "
    "none: it is grey",
    rich_help_panel=_FILES,
)
Crop = Option(help="ROWSxCOLUMNS about the centre, or ROWSxCOLUMNS+TOP+LEFT", rich_help_panel=_FILES)
Binning = Option(help="pixels per side that become one, of the image of a PSF too", rich_help_panel=_FILES)
Mirrored = Option(help="how it is mirrored against the PSFs: none, left-right, up-down", rich_help_panel=_FILES)
InFrame = Option(
    help="its orientation: physical, as read from the sensor, or stored, rotated by 180 degrees so that a pinhole's image "
    "is upright; samples record theirs",
    rich_help_panel=_FILES,
)
_PSF = "The PSFs of a capture from a file"
PsfBackground = Option(
    help="as --background; or border (the median of the image's frame), none; default: border", rich_help_panel=_PSF
)
PsfCrop = Option(help="as --crop; the centre of what is left is the PSF's origin", rich_help_panel=_PSF)
PsfBinning = Option(help="another binning; default: --binning for an image, 1 for a stack", rich_help_panel=_PSF)
PsfFrame = Option(help="as --frame; default: the same", rich_help_panel=_PSF)
Accept = Option("--accept-frame", help="proceed even if the frames seem mixed up", rich_help_panel=_PSF)
Classical = (
    "a classical method: cls, admm or pnp; of clips joint, joint3d, fista, pnp_clips, static, slivers, udn or nstm"
)
Scene = Option(help="ROWSxCOLUMNS of the result where no data set or network sets it; default: the sensor's")
Confidence = Option(
    help="of its depths: what `flatlight confidence` wrote, or none; default: the one beside the checkpoint, or the shipped "
    "one of a classical method"
)
Least = Option(
    help="depths of a lower confidence are unknown: NaN in depth.exr, grey in depth.png; 0 keeps all; default: 0.5",
    show_default=False,
)


def reconstruct(
    measurement: Annotated[Path, Sample],
    checkpoint: Annotated[str | None, Network] = None,
    method: Annotated[str | None, Option(help=Classical)] = None,
    stack: Annotated[str | None, Stack] = None,
    tuned: Annotated[Path | None, Option(help="its parameters: what `flatlight tune` wrote")] = None,
    noise_db: Annotated[float | None, Option(help="PSNR of the measurement, to choose tuned parameters")] = None,
    set_: Annotated[list[str] | None, Parameter] = None,
    output: Annotated[Path | None, Output] = None,
    volume: Annotated[bool, Option("--volume", help="write the volume too, a plane per depth")] = False,
    bits: Annotated[int | None, Bits] = None,
    background: Annotated[str | None, Background] = None,
    cfa: Annotated[str | None, Mosaic] = None,
    crop: Annotated[str | None, Crop] = None,
    binning: Annotated[int, Binning] = 1,
    mirror: Annotated[str, Mirrored] = "none",
    frame: Annotated[str | None, InFrame] = None,
    psf_background: Annotated[str | None, PsfBackground] = None,
    psf_crop: Annotated[str | None, PsfCrop] = None,
    psf_binning: Annotated[int | None, PsfBinning] = None,
    psf_frame: Annotated[str | None, PsfFrame] = None,
    accept_frame: Annotated[bool, Accept] = False,
    scene: Annotated[str | None, Scene] = None,
    white: Annotated[float | None, Option(help="radiance shown as white in image.png; default: from the image")] = None,
    confidence: Annotated[str | None, Confidence] = None,
    least_confidence: Annotated[float | None, Least] = None,
    seconds: Annotated[
        float | None,
        Option(help="limit of time for udn and nstm, all calls together; with more it goes on"),
    ] = None,
    device: Annotated[str, Option(help="auto, cpu or cuda")] = "auto",
) -> None:
    """Reconstruct image and depth, or the frames of a clip, from one measurement, by a network or a classical method."""
    given = locals()  # an option of the command is a field of Options, but for the two that are parsed
    from learning.reconstruct.job import Options, parse_changes, parse_size, reconstruct_file
    from simulator.console import Bar

    parsed = {"parameters": parse_changes(given.pop("set_") or ()), "scene": parse_size(scene)}
    with Bar() as bar:
        report = reconstruct_file(Options(**given | parsed), progress=bar.update)
    print(report)


def confidence(
    dataset: Annotated[Path, Argument(help="data set with validation and test scenes", show_default=False)],
    checkpoint: Annotated[str | None, Network] = None,
    method: Annotated[str | None, Option(help=Classical)] = None,
    stack: Annotated[str | None, Stack] = None,
    tuned: Annotated[Path | None, Option(help="its parameters: what `flatlight tune` wrote")] = None,
    noise_db: Annotated[float | None, Option(help="PSNR, to choose tuned parameters")] = None,
    set_: Annotated[list[str] | None, Parameter] = None,
    output: Annotated[
        Path | None,
        Option(
            help="file to write; default: beside the checkpoint, or METHOD.confidence.json here", show_default=False
        ),
    ] = None,
    scenes: Annotated[int | None, Option(help="of each split, the first so many; default: all")] = None,
    device: Annotated[str, Option(help="auto, cpu or cuda")] = "auto",
) -> None:
    """Calibrate how likely a method's depths are right, on a data set whose depths are known, and show that it is so."""
    given = locals()
    from learning.confidence.job import Options, confidence_file
    from learning.reconstruct.job import parse_changes
    from simulator.console import Bar

    changes = parse_changes(given.pop("set_") or ())
    with Bar() as bar:
        report = confidence_file(Options(**given, parameters=changes), progress=bar.update)
    print(report)
