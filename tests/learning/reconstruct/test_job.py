"""Reconstruction through files: the same as with the arrays, whatever the file; the right camera; clear refusals."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image, ImageSequence

from learning import checkpoint as checkpoint_module
from learning.camera import CaptureModel, capture_model, measure_reference_white, plain_capture, typical_white
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.classical.by_name import build_method
from learning.classical.method import DEFAULTS, ConstrainedLeastSquares, PlanarMethod, build_classical
from learning.method import linear_to_srgb, srgb_to_linear
from learning.models import build_network, named
from learning.models.flatnet import LearnedMethod
from learning.reconstruct import job
from learning.reconstruct.choice import Request, choose_method
from learning.reconstruct.inputs import load_measurement
from learning.reconstruct.job import Options, reconstruct, reconstruct_file, write_reconstruction
from learning.tune.study import Study
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack
from simulator.plots.drawing import depth_colours

NETWORK = {"network": "flatnet3d", "size": "tiny"}


@pytest.fixture(scope="session")
def sample(tiny_dataset: Path) -> Path:
    return open_dataset(tiny_dataset, "test").folder(2)


@pytest.fixture(scope="session")
def checkpoint(checkpoints: list[Path]) -> Path:
    """A network with random weights for the tiny camera, whose white is the training set's."""
    return checkpoints[0]


def test_a_file_gives_what_the_arrays_give(tiny_dataset: Path, sample: Path, tmp_path: Path) -> None:
    values = load_measurement(sample).values
    tifffile.imwrite(tmp_path / "m.tif", np.moveaxis(values, 0, -1), photometric="rgb")
    measurement = load_measurement(tmp_path / "m.tif")
    # The camera's numbers come from the data set that the stack is of, by which the image was taken.
    setup = choose_method(measurement, Request(method="cls", stack=str(tiny_dataset)))
    white = setup.method.capture.white
    from_file = reconstruct(measurement.values, setup.method, white=white)
    method = build_classical(capture_model(open_dataset(tiny_dataset, "test"), white=white), "cls", DEFAULTS["cls"])
    estimate = method.reconstruct(torch.from_numpy(values)[None])
    assert np.allclose(from_file.image, estimate.image[0].clamp(0, 1).numpy(), rtol=0, atol=1e-6)  # float32
    assert from_file.depth_m is not None
    assert np.array_equal(from_file.depth_m, estimate.depth_m(method.capture)[0, 0].numpy())


def test_a_sample_takes_its_data_sets_camera_and_white(tiny_dataset: Path, sample: Path) -> None:
    train = open_dataset(tiny_dataset, "train")
    for stack, called in ((None, "nominal"), ("captured", "captured")):
        setup = choose_method(load_measurement(sample), Request(method="cls", stack=stack))
        expected = capture_model(train, called, white=measure_reference_white(train))
        assert setup.method.capture.stack.fingerprint == expected.stack.fingerprint
        for name in ("gain", "white"):
            assert getattr(setup.method.capture, name) == getattr(expected, name)
        assert setup.record["parameters"] == DEFAULTS["cls"]


def test_a_subtracted_background_replaces_the_cameras_offset(tiny_dataset: Path, sample: Path, tmp_path: Path) -> None:
    path = tmp_path / "m.npy"
    values = load_measurement(sample).values
    np.save(path, values + np.float32(0.25))
    setup = choose_method(load_measurement(path, background=0.25), Request(method="cls", stack=str(tiny_dataset)))
    assert setup.method.capture.offset.tolist() == [0.0, 0.0, 0.0]


def test_parameters_come_from_defaults_then_tuning_then_the_user(sample: Path, tmp_path: Path) -> None:
    tuned = write_tuned(tmp_path / "tuned.json", 0.6, {20.0: 0.5, 40.0: 0.25})
    measurement = load_measurement(sample)
    chosen = choose_method(measurement, Request(method="cls", tuned=tuned))  # the data set's noise is 40 dB
    assert chosen.record["parameters"]["regularisation_lambda"] == 0.25
    assert chosen.method.capture.white == 0.6
    assert "tuned at 40 dB for 40 dB" in chosen.record["parameters_from"]
    chosen = choose_method(measurement, Request(method="cls", tuned=tuned, noise_db=25, parameters={"pairwise": 2.0}))
    assert chosen.record["parameters"] == {**DEFAULTS["cls"], "regularisation_lambda": 0.5, "pairwise": 2.0}
    loose = tmp_path / "m.npy"
    np.save(loose, measurement.values)
    with pytest.raises(InputError, match=r"^--noise-db: "):
        choose_method(load_measurement(loose), Request(method="cls", tuned=tuned, stack=str(sample.parents[2])))
    with pytest.raises(InputError, match=r"tuned\.json: got the method 'admm', expected one that was tuned \(cls\)"):
        choose_method(load_measurement(loose), Request(method="admm", tuned=tuned, stack=str(sample.parents[2])))


def test_a_network_takes_its_own_psfs(tiny_dataset: Path, sample: Path, checkpoint: Path, tmp_path: Path) -> None:
    # A camera that was exposed twice as long, as far as the checkpoint knows.
    loaded = load_checkpoint(checkpoint)
    stack = replace(loaded.capture.stack, fingerprint="f" * 64)
    other = CaptureModel(**{**vars(loaded.capture), "stack": stack, "gain": loaded.capture.gain * 2, "white": 0.9})
    path = tmp_path / "other.safetensors"
    save_checkpoint(path, loaded.network, architecture=NETWORK, capture=other, record={})
    setup = choose_method(load_measurement(sample), Request(checkpoint=str(path)))
    assert setup.method.capture.gain == loaded.capture.gain
    assert setup.method.capture.white == 0.9
    known, own = setup.record["camera"]["psfs"].split(", those that the network was trained with; the data set has ")
    assert "(ffffffff)" in known
    assert f"({stack.fingerprint[:8]})" not in own
    loose = tmp_path / "m.npy"
    np.save(loose, load_measurement(sample).values)
    assert choose_method(load_measurement(loose), Request(checkpoint=str(path))).method.capture.gain == other.gain
    # Through the file and through the arrays.
    values = load_measurement(sample).values
    result = reconstruct(values, setup.method, volume=True, white=0.9)
    network = load_checkpoint(path, capture=setup.method.capture).network
    with torch.no_grad():
        expected = network(torch.from_numpy(values)[None])
        volume = network.inversion(torch.from_numpy(values)[None])
    assert np.allclose(result.image, expected.image[0].clamp(0, 1).numpy(), rtol=0, atol=1e-6)  # float32
    assert result.volume is not None
    assert np.allclose(result.volume, volume[0].numpy() * np.float32(0.9), rtol=1e-5, atol=1e-6)
    assert np.isfinite(result.radiance).all()


@pytest.mark.parametrize(("name", "changes"), [("flatnet3d", {"refinements": 1}), ("flatnet2d", {})])
def test_a_volume_is_of_the_image_at_the_networks_planes(
    tiny_capture: CaptureModel, tmp_path: Path, name: str, changes: dict[str, Any]
) -> None:
    capture = replace(tiny_capture, irradiance=np.full((32, 32), 1e-4, np.float32))  # refinements invert a border, too
    network = build_network(capture, name, "tiny", **changes)
    values = np.random.default_rng(0).uniform(0.2, 0.4, (3, *capture.sensor_shape)).astype(np.float32)
    result = reconstruct(values, LearnedMethod(name, network, capture), volume=True)
    planes = {"flatnet3d": [0, 1, 2], "flatnet2d": [1]}[name]
    alone = build_network(capture, name, "tiny").inversion  # all begin with the same P and lambda
    with torch.no_grad():
        expected = alone(torch.from_numpy(values)[None])[0].numpy() * np.float32(capture.white)
    assert result.volume is not None
    assert result.volume.shape == (len(planes), 3, *capture.scene_shape)
    np.testing.assert_allclose(result.volume, expected, rtol=0, atol=1e-5 * expected.std())  # float32
    write_reconstruction(tmp_path / "out", result, capture, {})
    _, metadata = read_exr(tmp_path / "out" / "volume.exr")
    assert metadata["depths_m"] == tiny_capture.stack.depths_m[planes].tolist()


def test_the_shipped_checkpoint_that_fits_is_taken(
    sample: Path, checkpoint: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr(checkpoint_module, "FOLDER", tmp_path)
    measurement = load_measurement(sample)
    with pytest.raises(InputError, match="s00000002: "):
        choose_method(measurement, Request())
    with pytest.raises(InputError, match=r"^--checkpoint: "):
        choose_method(measurement, Request(checkpoint="flatnet3d"))
    for name in ("flatnet2d", "flatnet3d"):
        (tmp_path / f"{name}.safetensors").write_bytes(checkpoint.read_bytes())
    assert choose_method(measurement, Request()).record["checkpoint"].endswith("flatnet3d.safetensors")
    named = choose_method(measurement, Request(checkpoint="flatnet2d")).record["checkpoint"]
    assert named.endswith("flatnet2d.safetensors")
    with pytest.raises(InputError, match="s00000002: "):
        choose_method(load_measurement(sample, binning=2), Request())


def test_a_fit_goes_on_from_beside_the_result(clip_dataset: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """It ends after its time, after an iteration at least; the same call with more gives what one call gives."""
    monkeypatch.chdir(tmp_path)
    sample = next((clip_dataset / "test").rglob("s0*"))
    told: dict[str, Any] = {"measurement": sample, "method": "nstm", "parameters": {"iterations": 3, "width": 8}}
    steps: list[tuple[str, int, int]] = []

    def reconstructed(name: str, seconds: float | None) -> str:
        options = Options(**told, output=Path(name), seconds=seconds)
        return reconstruct_file(options, progress=lambda *step: steps.append(step))

    assert "1 of 3 iterations: with more --seconds it goes on" in reconstructed("parts", 1e-6)
    assert [path.name for path in tmp_path.glob("parts.fit/*.pt")]
    (tmp_path / "parts.fit" / "notes.txt").write_text("of the user")
    assert "iterations" not in reconstructed("parts", None).splitlines()[-1]
    assert [path.name for path in tmp_path.glob("parts.fit/*")] == ["notes.txt"]
    assert [step for _, step, of in steps if of == 3] == [1, 2, 3]
    reconstructed("whole", None)
    assert not (tmp_path / "whole.fit").exists()
    films = [
        [path.read_bytes() for path in sorted(tmp_path.glob(f"{name}/frames/*.exr"))] for name in ("parts", "whole")
    ]
    assert len(films[0]) == 4
    assert films[0] == films[1]
    with pytest.raises(InputError, match=r"^--seconds: .*not fitted"):
        reconstruct_file(Options(measurement=sample, method="joint", seconds=1.0))
    with pytest.raises(InputError, match=r"^--seconds: got 0"):
        reconstruct_file(Options(measurement=sample, method="nstm", seconds=0.0))


def test_a_clip_gives_frames_and_an_animation(clip_dataset: Path, tmp_path: Path) -> None:
    """The frames of the method, each with its time; an image of all frames, and one that moves."""
    dataset = open_dataset(clip_dataset, "test")
    folder = tmp_path / "out"
    options = Options(measurement=dataset.folder(0), method="joint", parameters={"iterations": 3}, output=folder)
    assert "4 frames of 16 x 16" in reconstruct_file(options)
    white = measure_reference_white(open_dataset(clip_dataset, "train"))
    method = build_method(capture_model(dataset, white=white), "joint", {"iterations": 3})
    codes = method.reconstruct(torch.from_numpy(dataset[0].measurement[None])).image
    expected = srgb_to_linear(codes, white, clip=False)[0].numpy()
    for number in range(4):
        planes, about = read_exr(folder / "frames" / f"image.{number:04d}.exr")
        # float32; codes of dark noise below zero go through the curve's straight end
        for name, plane in zip("RGB", expected[number], strict=True):
            np.testing.assert_allclose(planes[name], plane, atol=1e-5 * white)
        assert [about["begins_s"], about["ends_s"]] == pytest.approx([number * 4e-3, (number + 1) * 4e-3])
    with Image.open(folder / "film.webp") as film:
        width, height = film.size
        pages = [np.asarray(page.convert("RGB"), np.float64) for page in ImageSequence.Iterator(film)]
    sheet = np.asarray(Image.open(folder / "film.png"))
    gap = (sheet.shape[1] - 4 * width) // 3
    assert gap > 0
    shown = np.round(linear_to_srgb(torch.from_numpy(expected), about["white"]).numpy().transpose(0, 2, 3, 1) * 255)
    enlarged = shown.repeat(height // 16, axis=1).repeat(width // 16, axis=2)
    assert [int(np.argmin([np.abs(page - frame).mean() for frame in enlarged])) for page in pages] == [0, 1, 2, 3]
    for number, frame in enumerate(enlarged):
        place = sheet[:, number * (width + gap) :]
        np.testing.assert_allclose(place[:, :width], frame, atol=1)  # of a code, where it lies half-way
        assert len(np.unique(place[:, width : width + gap].reshape(-1, 3), axis=0)) <= 1  # paper
    assert not {"image.png", "convergence.png"}.intersection(path.name for path in folder.iterdir())


def test_a_clip_with_depth_gives_each_frames(moving_dataset: Path, tmp_path: Path) -> None:
    """In files, below the frames in the image of all, and beside each in the animation, in the colours of the range."""
    sample, folder = open_dataset(moving_dataset, "test").folder(0), tmp_path / "out"
    few = {"iterations": 3, "planes": 2}
    text = reconstruct_file(Options(measurement=sample, method="joint3d", parameters=few, output=folder))
    setup = choose_method(load_measurement(sample), Request(method="joint3d", parameters=few))
    wanted = reconstruct(load_measurement(sample).values, setup.method)
    assert wanted.depth_m is not None
    assert wanted.depth_m.shape == (4, 16, 16)
    ends_cm = [f"{100 * depth:.3g} cm" for depth in (wanted.depth_m.min(), wanted.depth_m.max())]
    assert f"depth  {ends_cm[0]} to {ends_cm[1]}" in text
    files = {path.name for path in (folder / "frames").iterdir()}
    assert files == {f"{what}.{number:04d}.exr" for what in ("image", "depth") for number in range(4)}
    for number in range(4):
        planes, about = read_exr(folder / "frames" / f"depth.{number:04d}.exr")
        np.testing.assert_allclose(planes["Z"], wanted.depth_m[number], rtol=1e-5)
        assert about["unit"] == "m"
    assert not {"depth.exr", "depth.png"}.intersection(path.name for path in folder.iterdir())
    sheet = np.asarray(Image.open(folder / "film.png"))
    every = np.ones((16, 16), bool)
    capture = setup.method.capture
    colours = [depth_colours(depth_m, every, capture.near_m, capture.far_m) for depth_m in wanted.depth_m]
    with Image.open(folder / "film.webp") as film:
        pages = [np.asarray(page.convert("RGB"), np.float64) for page in ImageSequence.Iterator(film)]
    side = (sheet.shape[1] + 6) // 4 - 6  # four of them, and paper between
    zoom = side // 16
    for number, colour in enumerate(colours):
        large = colour.repeat(zoom, axis=0).repeat(zoom, axis=1)
        place = np.s_[side + 6 : 2 * side + 6, number * (side + 6) : number * (side + 6) + side]
        np.testing.assert_array_equal(sheet[place], large)
        # Lossy, with colours at half the resolution: most of it is as told
        assert np.median(np.abs(pages[number][:side, side + 6 : 2 * side + 6] - large)) < 12


@pytest.mark.parametrize(
    ("method", "parameters", "what"),
    [("fista", {"iterations": 5, "initial_estimate": "dark"}, "objective"), ("udn", {"iterations": 4}, "residual")],
)
def test_how_it_converged_is_told(
    clip_dataset: Path, tmp_path: Path, method: str, parameters: dict[str, Any], what: str
) -> None:
    sample = open_dataset(clip_dataset, "test").folder(0)
    reconstruct_file(Options(measurement=sample, method=method, parameters=parameters, output=tmp_path / "out"))
    record = json.loads((tmp_path / "out" / "reconstruction.json").read_bytes())
    (values,) = record["convergence"].values()
    assert [*record["convergence"]] == [what]
    assert len(values) == parameters["iterations"]
    assert min(values) < values[0]
    assert "convergence.png" in record["files"]
    with Image.open(tmp_path / "out" / "convergence.png") as figure:
        assert figure.size == (720, 432)


@pytest.mark.parametrize("copied", [False, True])
def test_a_network_names_what_is_done(labelled_dataset: Path, tmp_path: Path, copied: bool) -> None:
    """With its probabilities, the likeliest first, and the label where the sample has one; beside the frames it looked at."""
    train = open_dataset(labelled_dataset)
    capture = capture_model(train, white=measure_reference_white(train))
    architecture = {"network": "activitynet", "size": "tiny", "filters": 4, "joint_iterations": 3}
    architecture |= {"classes": ["down", "leftwards", "rightwards"]}
    torch.manual_seed(1)
    network: Any = build_network(capture, **named(architecture)).eval()
    path = tmp_path / "net.safetensors"
    save_checkpoint(path, network, architecture=architecture, capture=capture, record={})
    given = open_dataset(labelled_dataset, "test").folder(1)
    values = torch.from_numpy(load_measurement(given).values)[None]
    if copied:
        given = Path(shutil.copy(given / "measurement.exr", tmp_path / "m.exr"))
    report = reconstruct_file(Options(measurement=given, checkpoint=str(path), output=tmp_path / "out"))
    with torch.no_grad():
        chances = network(values).logits.softmax(dim=1)[0]
    expected = {network.classes[at]: float(chances[at]) for at in chances.argsort(descending=True).tolist()}
    record = json.loads((tmp_path / "out" / job.RECORD).read_bytes())
    assert record["classes"] == pytest.approx(expected, abs=1e-5)
    told = ", ".join(f"{name} {chance:.1%}" for name, chance in expected.items())
    line = next(line for line in report.splitlines() if line.lstrip().startswith("shows"))
    assert line.split("shows  ")[1] == told + ("" if copied else "; its label is leftwards")
    assert {"film.png", "film.webp"} <= set(record["files"])
    with torch.no_grad():
        frames = network.looked_at(network.begun(values))[0]
    first = read_exr(tmp_path / "out" / "frames" / "image.0000.exr")[0]
    radiance = srgb_to_linear(frames, capture.white, clip=False)[0].numpy()
    np.testing.assert_allclose(np.stack([first[name] for name in "RGB"]), radiance, rtol=1e-4, atol=1e-5)


@pytest.fixture(scope="session")
def video_checkpoint(clip_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An untrained VideoNet for the tiny data set of clips."""
    train = open_dataset(clip_dataset, "train")
    capture = capture_model(train, white=measure_reference_white(train))
    architecture = {"network": "videonet", "size": "tiny", "joint_iterations": 3}
    path = tmp_path_factory.mktemp("video") / "video.safetensors"
    network = build_network(capture, "videonet", "tiny", joint_iterations=3)
    save_checkpoint(path, network, architecture=architecture, capture=capture, record={})
    return path


def test_a_network_gives_the_frames_of_a_clip(clip_dataset: Path, video_checkpoint: Path, tmp_path: Path) -> None:
    """Untrained, those that it begins with."""
    sample, folder = open_dataset(clip_dataset, "test").folder(1), tmp_path / "out"
    text = reconstruct_file(Options(measurement=sample, checkpoint=str(video_checkpoint), output=folder))
    assert "4 frames of 16 x 16" in text
    assert "joint " in text
    assert "network " in text
    setup = choose_method(load_measurement(sample), Request(method="joint", parameters={"iterations": 3}))
    wanted = reconstruct(load_measurement(sample).values, setup.method)
    for number in range(4):
        planes, _ = read_exr(folder / "frames" / f"image.{number:04d}.exr")
        found = np.stack([planes[name] for name in "RGB"])
        # Radiance that colours make negative is taken for none; float32, behind a curve and back.
        expected = wanted.radiance[number].clip(0)
        np.testing.assert_allclose(found, expected, atol=1e-3 * wanted.radiance.max())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dataset.slivers": 2}, r"^{net}: was trained for another camera .*slivers: got 2, the method was made for 4"),
        ({"camera.shutter.exposure_ms": 4.5}, r"^{net}: was trained for another camera .*shutter: got .*dual_rolling"),
        ({"scene.size": [12, 16]}, r"^{net}: .*scene_shape: got 12 x 16 pixels, expected 16 x 16"),
        ({"camera.sensor.shape": [48, 44]}, r"got 48 x 44 pixels, the network of video\.safetensors is for 48 x 48"),
    ],
)
def test_captures_of_another_camera_are_refused(
    learning_trial: Any,
    clip_settings: dict[str, dict[str, Any]],
    video_checkpoint: Path,
    tmp_path: Path,
    changes: dict[str, Any],
    message: str,
) -> None:
    counts = {"train": 1, "validation": 0, "test": 1}
    settings = clip_settings | {"dataset": clip_settings["dataset"] | counts}
    overrides = [f"{key}={json.dumps(value)}" for key, value in changes.items()]
    other = learning_trial.generate(*overrides, **settings)
    sample = open_dataset(other, "test").folder(0)
    with pytest.raises(InputError, match=message.format(net=re.escape(str(video_checkpoint)))):
        reconstruct_file(Options(measurement=sample, checkpoint=str(video_checkpoint), output=tmp_path / "film"))
    assert not (tmp_path / "film").exists()


def test_methods_of_the_other_kind_are_refused(
    clip_dataset: Path, sample: Path, checkpoint: Path, video_checkpoint: Path, tmp_path: Path
) -> None:
    clip = open_dataset(clip_dataset, "test").folder(0)
    np.save(tmp_path / "raw.npy", load_measurement(clip).values)
    stack = {"measurement": tmp_path / "raw.npy", "stack": str(clip_dataset / "psf"), "accept_frame": True}
    for options, message in (
        (
            {"measurement": clip, "method": "cls"},
            r"^--method: got cls, which is for stills, of a clip; take one of static",
        ),
        ({"measurement": clip, "method": "joint", "volume": True}, r"^volume: "),
        ({"measurement": clip, "checkpoint": str(checkpoint)}, r"got clips, the method is for stills"),
        ({"measurement": sample, "checkpoint": str(video_checkpoint)}, r"got stills, the method is for clips"),
        ({"measurement": sample, "method": "joint"}, r"^--method: got joint, which is for clips, of a still; take cls"),
        (stack | {"method": "joint"}, r"^--method: got joint, .* not the shutter; give a data set of clips"),
    ):
        with pytest.raises(InputError, match=message):
            reconstruct_file(Options(**options, output=tmp_path / "out"))
        assert not (tmp_path / "out").exists()


def test_a_small_measurement_has_one_thread(sample: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """From the choice of the method on: two threads that waited for each other took twice the command's CPU time."""
    seen = []
    for name in ("choose_method", "reconstruct"):
        own = getattr(job, name)
        monkeypatch.setattr(job, name, lambda *a, own=own, **b: (seen.append(torch.get_num_threads()), own(*a, **b))[1])
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        job.reconstruct_file(job.Options(measurement=sample, method="cls", output=tmp_path / "out"))
        assert (seen, torch.get_num_threads()) == ([1, 1], 2)
    finally:
        torch.set_num_threads(before)


def planar_scene(tmp_path: Path, channels: int) -> tuple[Path, Path, np.ndarray]:
    """Write a PSF and the measurement of a letter through it, a direct sum; return both paths and the scene."""
    rng = np.random.default_rng(0)
    psf = np.zeros((33, 33))
    psf[rng.integers(8, 25, 9), rng.integers(8, 25, 9)] = rng.uniform(0.5, 1, 9)
    scene = np.zeros((40, 40))
    scene[12:28, 14:18] = scene[24:28, 14:26] = 1
    light = np.zeros((72, 72))
    for row, column in np.argwhere(psf):
        light[row : row + 40, column : column + 40] += psf[row, column] * scene
    light = light[16:56, 16:56]  # the origin is sample 16 of the PSF
    codes = np.round(light / light.max() * 60000).astype(np.uint16) + 1000
    np.save(tmp_path / "psf.npy", np.round(psf * 4000).astype(np.uint16) + 200)
    if channels == 1:
        tifffile.imwrite(tmp_path / "m.tif", codes)
    else:
        tifffile.imwrite(tmp_path / "m.tif", np.stack([codes, codes // 2, codes // 4], axis=-1), photometric="rgb")
    return tmp_path / "m.tif", tmp_path / "psf.npy", scene


@pytest.mark.parametrize("method", ["cls", "admm", "pnp"])
@pytest.mark.parametrize("channels", [1, 3])
def test_the_image_of_one_psf_gives_a_image_and_no_depth(tmp_path: Path, method: str, channels: int) -> None:
    path, psf, scene = planar_scene(tmp_path, channels)
    background = 1000 if channels == 1 else 0
    measurement = load_measurement(path, background=background)
    setup = choose_method(measurement, Request(method=method, stack=str(psf)))
    result = reconstruct(measurement.values, setup.method, volume=True)
    assert result.depth_m is None
    assert "percentile" in result.white_from
    assert np.corrcoef(result.image[0].ravel(), scene.ravel())[0, 1] > 0.9
    # Shown white is the 99.5th percentile of what is lit, by NumPy.
    assert result.white == pytest.approx(np.percentile(result.radiance[result.radiance > 0], 99.5), rel=1e-6)
    ratio = result.radiance[:, 16:24, 15:17].mean(axis=(1, 2))
    expected = [1, 1, 1] if channels == 1 else [1, 0.5, 0.25]
    assert (ratio / ratio[0]).tolist() == pytest.approx(expected, abs=0.03)
    whiter = reconstruct(measurement.values, setup.method, white=3.0)
    assert whiter.white == 3.0
    assert np.array_equal(whiter.radiance, result.radiance)  # white is for the image that is shown only


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("method", ["cls", "admm", "pnp"])
def test_a_sparse_bright_target_is_not_clipped(tmp_path: Path, tiny_capture: Any, method: str, several: bool) -> None:
    """Two points, one five times as bright: far above twice the mean radiance, which once was the brightest of the EXR."""
    stack = tiny_capture.stack
    if not several:
        stack = replace(stack, values=stack.values[1:2], depths_m=stack.depths_m[1:2])
    psf = np.asarray(stack.values)[-1]
    light = np.zeros((3, 48, 48))
    for row, column, power in ((20, 20, 1.0), (26, 27, 5.0)):  # the PSF's origin is its sample 16
        light[:, row - 16 : row + 17, column - 16 : column + 17] += power * psf[:, : 48 - row + 16, : 48 - column + 16]
    np.save(tmp_path / "m.npy", light / light.max() / 2)
    write_psf_stack(tmp_path / "stack", stack)
    measurement = load_measurement(tmp_path / "m.npy")
    request = Request(method=method, stack=str(tmp_path / "stack"), scene=(16, 16))
    setup = choose_method(measurement, request)
    result = reconstruct(measurement.values, setup.method)
    write_reconstruction(tmp_path / "out", result, setup.method.capture, {})
    green = read_exr(tmp_path / "out" / "image.exr")[0]["G"]
    assert np.unravel_index(green.argmax(), green.shape) == (10, 11)
    assert green.max() > 5 * setup.method.capture.white
    assert green[10, 11] > 3 * green[4, 4]
    lit = result.radiance[result.radiance > 0]
    assert result.white == pytest.approx(np.percentile(lit, 99.5), rel=1e-6)


def test_one_plane_is_inverted_by_the_shared_least_squares(tmp_path: Path) -> None:
    path, psf, _ = planar_scene(tmp_path, 1)
    measurement = load_measurement(path, background=1000)
    request = Request(method="cls", stack=str(psf), parameters={"regularisation_lambda": 0.05})
    setup = choose_method(measurement, request)
    stack = setup.method.capture.stack
    assert float(stack.values.sum()) == pytest.approx(1, rel=1e-6)  # of a PSF whose exposure is unknown
    capture = plain_capture(stack, (40, 40))
    method = ConstrainedLeastSquares(capture, regularisation_lambda=0.05, tikhonov=0.0)
    expected = method(torch.from_numpy(measurement.values)[None])[0, 0, 0].numpy()
    found = reconstruct(measurement.values, setup.method).radiance[0]
    assert np.allclose(found, expected, rtol=1e-4, atol=1e-5 * expected.max())  # another white on the way


def test_a_stacks_folder_without_a_data_set_gives_depth_too(tmp_path: Path, tiny_capture: CaptureModel) -> None:
    write_psf_stack(tmp_path / "stack", tiny_capture.stack)
    np.save(tmp_path / "m.npy", np.random.default_rng(0).uniform(0.2, 0.4, (3, 48, 48)))
    measurement = load_measurement(tmp_path / "m.npy")
    setup = choose_method(measurement, Request(method="cls", stack=str(tmp_path / "stack"), scene=(16, 16)))
    result = reconstruct(measurement.values, setup.method, volume=True)
    assert result.depth_m is not None
    assert result.depth_m.shape == (16, 16)
    assert 0.01 * (1 - 1e-6) <= result.depth_m.min() <= result.depth_m.max() <= 0.2 * (1 + 1e-6)
    files = write_reconstruction(tmp_path / "out", result, setup.method.capture, {"why": "test"})
    assert files == ["depth.exr", "depth.png", "image.exr", "image.png", "reconstruction.json", "volume.exr"]
    planes, metadata = read_exr(tmp_path / "out" / "volume.exr")
    assert np.array_equal(planes["plane02.G"], result.volume[2, 1])  # type: ignore[index]
    assert metadata["depths_m"] == tiny_capture.stack.depths_m.tolist()
    assert np.array_equal(read_exr(tmp_path / "out" / "depth.exr")[0]["Z"], result.depth_m)
    assert np.array_equal(read_exr(tmp_path / "out" / "image.exr")[0]["B"], result.radiance[2])
    shown = np.asarray(Image.open(tmp_path / "out" / "image.png"))
    assert np.abs(shown - np.moveaxis(result.image, 0, -1) * 255).max() <= 0.5 + 1e-4
    # The nearest depth is yellow, the farthest violet, in whole pixels: 240 rows are 15 for each.
    depth = np.asarray(Image.open(tmp_path / "out" / "depth.png"))
    assert depth.shape[0] == 240
    row, column = np.unravel_index(result.depth_m.argmin(), (16, 16))
    assert result.depth_m.min() > 0.0101 or depth[row * 15 + 7, column * 15 + 7].tolist() == [253, 231, 37]


def write_tuned(path: Path, white: float, lambdas: dict[float, float]) -> Path:
    """Write a tuning of CLS: lambda by noise level."""
    study = Study(path, {"white": white}, {})
    for level, chosen in lambdas.items():
        parameters = DEFAULTS["cls"] | {"regularisation_lambda": chosen}
        study.add_result({"method": "cls", "noise_db": level, "parameters": parameters, "score": 1.0})
    return path


def test_white_goes_with_the_cameras_numbers(
    tiny_dataset: Path, sample: Path, tiny_capture: Any, tmp_path: Path
) -> None:
    tuned = write_tuned(tmp_path / "tuned.json", 1e4, {40.0: 0.1})
    values = load_measurement(sample).values
    np.save(tmp_path / "m.npy", values)
    loose = load_measurement(tmp_path / "m.npy")
    write_psf_stack(tmp_path / "stack", tiny_capture.stack)
    plain = choose_method(loose, Request(method="cls", stack=str(tmp_path / "stack"), tuned=tuned, scene=(16, 16)))
    expected = typical_white(plain_capture(tiny_capture.stack, (48, 48), (16, 16)), values)
    assert plain.method.capture.white == pytest.approx(expected, rel=1e-12)
    assert 0.1 < reconstruct(values, plain.method).image.mean() < 0.9  # by a white of 1e4 it was black
    known = choose_method(loose, Request(method="cls", stack=str(tiny_dataset), tuned=tuned))
    assert known.method.capture.white == 1e4


def test_a_sample_and_its_measurement_as_a_file_give_the_same(tiny_dataset: Path, sample: Path, tmp_path: Path) -> None:
    values = load_measurement(sample).values
    np.save(tmp_path / "m.npy", values)
    setups = [
        choose_method(load_measurement(sample), Request(method="cls")),
        choose_method(load_measurement(tmp_path / "m.npy"), Request(method="cls", stack=str(tiny_dataset))),
    ]
    assert setups[1].method.capture.white == measure_reference_white(open_dataset(tiny_dataset, "train"))
    one, other = (reconstruct(values, setup.method) for setup in setups)
    assert np.array_equal(one.image, other.image)
    assert np.array_equal(one.radiance, other.radiance)


def test_a_measurement_without_light_is_refused(tiny_dataset: Path, checkpoint: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "m.npy", np.zeros((3, 48, 48)))
    by_classical, by_network = Request(method="cls", stack=str(tiny_dataset)), Request(checkpoint=str(checkpoint))
    for request in (by_classical, by_network):
        with pytest.raises(InputError, match=r"m\.npy: "):
            choose_method(load_measurement(tmp_path / "m.npy"), request)


def test_the_image_of_a_psf_is_cropped_and_binned_by_the_measurements_rule(tmp_path: Path) -> None:
    path, psf, _ = planar_scene(tmp_path, 1)
    values = np.load(psf).astype(np.float64)
    measurement = load_measurement(path, background=1000, binning=2)
    with pytest.raises(InputError, match=r"^binning: "):
        choose_method(measurement, Request(method="cls", stack=str(psf), binning=2))
    np.save(tmp_path / "dark.npy", np.pad(np.full((30, 28), 200), ((1, 2), (3, 2))))
    for background in ("200", str(tmp_path / "dark.npy")):
        request = Request(method="cls", stack=str(psf), binning=2, psf_crop="30x28+1+3", psf_background=background)
        setup = choose_method(measurement, request)
        cut = values[1:31, 3:31] - 200
        by_hand = cut.reshape(15, 2, 14, 2).mean(axis=(1, 3))
        stack = setup.method.capture.stack
        assert np.allclose(stack.values[0, 0], by_hand / by_hand.sum(), rtol=1e-6, atol=0)  # float32
        recorded = setup.record["camera"]["psf"]
        assert (recorded["crop"], recorded["binning"]) == ("30x28+1+3", 2)
        assert recorded["images"][0]["file"] == "psf.npy"
        assert str(recorded["background"]).startswith(background)
    with pytest.raises(InputError, match=r"^psf-crop: "):
        choose_method(measurement, Request(method="cls", stack=str(psf), psf_crop="40x8"))


def test_parameters_for_one_plane_are_checked_too(tmp_path: Path) -> None:
    path, psf, _ = planar_scene(tmp_path, 1)
    measurement = load_measurement(path, background=1000)
    with pytest.raises(InputError, match=r"^--set: "):
        choose_method(measurement, Request(method="cls", stack=str(psf), parameters={"regularisation_lambda": True}))
    whole = choose_method(measurement, Request(method="cls", stack=str(psf), parameters={"regularisation_lambda": 1}))
    assert whole.record["parameters"] == {"regularisation_lambda": 1, "tikhonov": 0.0}
    tuned = write_tuned(tmp_path / "tuned.json", 0.5, {40.0: 0.1})
    with pytest.raises(InputError, match=r"^--tuned: "):
        choose_method(measurement, Request(method="cls", stack=str(psf), tuned=tuned))


def test_an_earlier_reconstruction_is_replaced_and_nothing_else(tmp_path: Path) -> None:
    path, psf, _ = planar_scene(tmp_path, 1)
    measurement = load_measurement(path)
    setup = choose_method(measurement, Request(method="cls", stack=str(psf)))
    first = reconstruct(measurement.values, setup.method, volume=True)
    write_reconstruction(tmp_path / "out", first, setup.method.capture, {})
    second = reconstruct(measurement.values, setup.method)
    write_reconstruction(tmp_path / "out", second, setup.method.capture, {})
    assert not (tmp_path / "out" / "volume.exr").exists()
    with pytest.raises(InputError, match=r"^--output: "):
        write_reconstruction(tmp_path, second, setup.method.capture, {})
    assert path.exists()


@pytest.mark.parametrize(
    ("path", "options"),
    [
        ("--checkpoint", {"checkpoint": "x", "method": "cls"}),
        ("--method", {"stack": "nominal"}),
        ("--method", {"method": "wiener"}),
        ("--stack", {"method": "cls", "stack": "nowhere"}),
        ("--set", {"method": "cls", "parameters": {"tv": 1.0}}),
        ("--noise-db", {"method": "cls", "noise_db": 30.0}),
        ("--set", {"method": "cls", "parameters": {"regularisation_lambda": "abc"}}),
        ("--set", {"method": "admm", "parameters": {"iterations": 2.5}}),
        ("--psf-crop", {"method": "cls", "psf_crop": "8x8"}),
        ("--psf-background", {"method": "cls", "psf_background": "0"}),
        ("--scene", {"method": "cls", "scene": (8, 8)}),
        ("nowhere.json", {"method": "cls", "tuned": Path("nowhere.json")}),
    ],
)
def test_options_that_make_no_sense_are_refused(sample: Path, path: str, options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"^{path}: "):
        choose_method(load_measurement(sample), Request(**options))


def test_another_camera_is_refused_with_the_cure(
    tiny_dataset: Path, tmp_path: Path, checkpoint: Path, tiny_capture: Any
) -> None:
    def chosen(shape: tuple[int, ...], **options: Any) -> None:
        np.save(tmp_path / "m.npy", np.full(shape, 0.1))
        choose_method(load_measurement(tmp_path / "m.npy"), Request(**options))

    own = {"method": "cls", "stack": str(tiny_dataset)}
    with pytest.raises(InputError, match=r"m\.npy: "):
        chosen((3, 96, 96), **own)
    with pytest.raises(InputError, match=r"m\.npy: .*; add --crop 48x48"):
        chosen((3, 50, 48), checkpoint=str(checkpoint))
    with pytest.raises(InputError, match=r"m\.npy: .*; it is of another camera"):
        chosen((3, 40, 48), **own)
    with pytest.raises(InputError, match=r"m\.npy: .*channels grey"):
        chosen((48, 48), checkpoint=str(checkpoint))
    with pytest.raises(InputError, match=r"^--stack: "):
        chosen((3, 48, 48), method="cls")
    grey = PsfStack(np.asarray(tiny_capture.stack.values)[:, :1], tiny_capture.stack.depths_m, 2e-5, ("Y",), "0" * 64)
    write_psf_stack(tmp_path / "grey", grey)
    with pytest.raises(InputError, match=r"m\.npy: .*channels R, G, B"):
        chosen((3, 48, 48), method="cls", stack=str(tmp_path / "grey"))


@pytest.mark.parametrize("values", [np.zeros((3, 40, 48)), np.full((3, 48, 48), np.nan)])
def test_nan_and_other_shapes_are_refused(tiny_capture: CaptureModel, values: Any) -> None:
    with pytest.raises(InputError, match=r"^measurement: "):
        reconstruct(values, build_classical(tiny_capture, "cls"))


def test_one_plane_only(tiny_capture: CaptureModel) -> None:
    with pytest.raises(InputError, match=r"^stack: "):
        PlanarMethod(tiny_capture, "cls", {})
    stack = PsfStack(np.ones((1, 3, 3, 3)), np.array([np.inf]), 1e-5, ("R", "G", "B"), "0" * 64)
    capture = plain_capture(stack, (8, 8))
    with pytest.raises(InputError, match=r"^method: "):
        PlanarMethod(capture, "wiener", {})
    with pytest.raises(InputError, match=r"^parameters: "):
        PlanarMethod(capture, "cls", {"tv": 1})
    estimate = PlanarMethod(capture, "cls", {}).reconstruct(torch.ones(2, 3, 8, 8))
    assert (tuple(estimate.image.shape), tuple(estimate.disparity.shape)) == ((2, 3, 8, 8), (2, 1, 8, 8))
