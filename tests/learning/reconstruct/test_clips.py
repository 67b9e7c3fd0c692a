"""Clips: frames, depth maps and classes from one capture; the films of them, and what was meant for stills."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence

from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import save_checkpoint
from learning.classical.by_name import build_method
from learning.method import linear_to_srgb, srgb_to_linear
from learning.models import build_network, named
from learning.reconstruct import job
from learning.reconstruct.choice import Request, choose_method
from learning.reconstruct.inputs import load_measurement
from learning.reconstruct.job import Options, reconstruct, reconstruct_file
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.plots.drawing import depth_colours


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
    architecture |= {"classes": ["down_again", "leftwards", "rightwards"]}
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
    told = ", ".join(f"{name} {chance:.1%}" for name, chance in expected.items()).replace("_", " ")
    line = next(line for line in report.splitlines() if line.lstrip().startswith("shows"))
    assert line.split("shows  ")[1] == told + ("" if copied else "; its label is leftwards")
    assert {"film.png", "film.webp"} <= set(record["files"])
    with torch.no_grad():
        frames = network.frame_estimates(network.invert(values))[0]
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


def test_a_network_tells_its_own_number_of_frames_apart(
    learning_trial: Any, clip_settings: dict[str, dict[str, Any]], video_checkpoint: Path, tmp_path: Path
) -> None:
    """Whatever number the data set keeps of the same capture."""
    counts, films = {"train": 1, "validation": 0, "test": 1}, []
    for slivers in (2, 4):
        told = {"slivers": slivers, "output": str(tmp_path / f"data_{slivers}")}
        root = learning_trial.generate(**clip_settings | {"dataset": clip_settings["dataset"] | counts | told})
        sample, folder = open_dataset(root, "test").folder(0), tmp_path / str(slivers)
        text = reconstruct_file(Options(measurement=sample, checkpoint=str(video_checkpoint), output=folder))
        assert "4 frames of 16 x 16" in text
        films.append([path.read_bytes() for path in sorted((folder / "frames").iterdir())])
    assert len(films[0]) == 4
    assert films[0] == films[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"scene.frames": 9, "dataset.slivers": 3, "camera.shutter.exposure_ms": 6},
            r"^{net}: was trained for another camera .*slivers: got 3, the method was made for 4",
        ),
        ({"camera.shutter.exposure_ms": 4.5}, r"^{net}: was trained for another camera .*shutter: got .*dual_rolling"),
        ({"scene.size": [12, 16]}, r"^{net}: .*scene_shape: got 12 x 16 pixels, expected 16 x 16"),
        ({"camera.sensor.shape": [48, 44]}, r"got 48 x 44 pixels, the network is for 48 x 48"),
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
