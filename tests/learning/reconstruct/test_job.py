"""Reconstruction through files: the same as with the arrays, whatever the file; the right camera; clear refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

from learning import checkpoint as checkpoint_module
from learning.camera import CaptureModel, capture_model, measure_reference_white, plain_capture, typical_white
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.classical.method import DEFAULTS, ConstrainedLeastSquares, PlanarMethod, build_classical
from learning.models import build_network
from learning.models.flatnet import LearnedMethod
from learning.reconstruct import job
from learning.reconstruct.choice import Request, choose_method
from learning.reconstruct.inputs import load_measurement
from learning.reconstruct.job import reconstruct, write_reconstruction
from learning.tune.study import Study
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack

NETWORK = {"network": "flatnet3d", "size": "tiny"}


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
    with pytest.raises(InputError, match=r"^--psf-binning: "):
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
        assert str(recorded["background"]).startswith(Path(background).name)
    with pytest.raises(InputError, match=r"^--psf-crop: "):
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
        np.save(tmp_path / "m.npy", 0.1 + np.arange(np.prod(shape)).reshape(shape) / 1e6)
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
    two = PsfStack(
        np.asarray(tiny_capture.stack.values)[:, :2], tiny_capture.stack.depths_m, 2e-5, ("X", "Y"), "0" * 64
    )
    write_psf_stack(tmp_path / "two", two)
    with pytest.raises(InputError, match=r"m\.npy: .*channels R, G, B"):
        chosen((3, 48, 48), method="cls", stack=str(tmp_path / "two"))


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
