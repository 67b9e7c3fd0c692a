"""Captures of real cameras as people have them: grey, mosaics, PSFs of another size, cut PSFs; simulated by SciPy alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.signal import fftconvolve

from learning.reconstruct.inputs import Request, load_measurement
from learning.reconstruct.job import Options, reconstruct_file
from learning.reconstruct.psfs import psfs_of_capture
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.measured import load_measured_psf
from simulator.optics.stack_files import write_psf_stack

SENSOR = (96, 120)
COLOURS = np.array([[1.0, 0.2, 0.1], [0.1, 1.0, 0.3], [0.2, 0.3, 1.0]])


def speckle(size: int, seed: int = 0) -> NDArray[np.float64]:
    """Return a diffuser's PSF: light almost everywhere within a square, and caustics."""
    rng = np.random.default_rng(seed)
    return gaussian_filter(rng.exponential(1, (size, size)) ** 2, 1)


def boxes() -> NDArray[np.float64]:
    """Return three coloured boxes without any symmetry, ``(3, 40, 50)``."""
    scene = np.zeros((3, 40, 50))
    for colour, (top, left, height, width) in zip(
        COLOURS, ((4, 5, 12, 9), (20, 8, 9, 20), (10, 33, 22, 8)), strict=True
    ):
        scene[:, top : top + height, left : left + width] = colour[:, None, None]
    return scene


def on_sensor(scene: NDArray[np.float64], psf: NDArray[np.float64], shape: tuple[int, int] = SENSOR) -> NDArray[Any]:
    """Return the light of a scene in the middle of the view ``(h, w)`` through a PSF, full scale 1."""
    canvas = np.zeros(shape)
    top, left = ((n - m) // 2 for n, m in zip(shape, scene.shape, strict=True))
    canvas[top : top + scene.shape[0], left : left + scene.shape[1]] = scene
    rows, columns = (n // 2 for n in psf.shape)
    return fftconvolve(canvas, psf)[rows : rows + shape[0], columns : columns + shape[1]]


def codes(light: NDArray[Any], full: float, noise: float = 0.002) -> NDArray[np.uint16]:
    """Return what a camera of 16 bits stores."""
    noisy = light / full * 0.9 + np.random.default_rng(9).normal(0, noise, light.shape) + 0.01
    return np.round(noisy.clip(0, 1) * 65535).astype(np.uint16)


def likeness(folder: Path, scene: NDArray[np.float64], enlarged: int = 1) -> list[float]:
    """Return the correlation of each channel of a result's middle with the scene's."""
    image = read_exr(folder / "image.exr")[0]
    rows, columns = (size // enlarged for size in scene.shape[-2:])
    found = []
    for channel, truth in zip("RGB", scene, strict=True):
        values = image[channel]
        top, left = ((n - m) // 2 for n, m in zip(values.shape, (rows, columns), strict=True))
        small = truth.reshape(rows, enlarged, columns, enlarged).mean(axis=(1, 3))
        found.append(float(np.corrcoef(values[top : top + rows, left : left + columns].ravel(), small.ravel())[0, 1]))
    return found


@pytest.mark.parametrize("channels", [("Y",), ("R", "G", "B")])
def test_a_grey_capture_with_a_stack_of_three_depths(tmp_path: Path, channels: tuple[str, ...]) -> None:
    """The stack may be stored in grey or as three equal channels; the depth is that of the scene."""
    depths_m = [0.04, 0.08, 0.2]
    psfs = np.stack([np.pad(speckle(31, seed), ((30, 30), (42, 42))) for seed in range(3)])
    np.save(tmp_path / "psf.npy", psfs)
    told: dict[str, Any] = {"frame": "stored", "background": "none", "throughput_m2": 1e-6, "channels": channels}
    write_psf_stack(tmp_path / "stack", load_measured_psf([tmp_path / "psf.npy"], depths_m, 1e-5, **told))
    scene = boxes().mean(axis=0)
    light = on_sensor(scene, psfs[1])
    tifffile.imwrite(tmp_path / "raw.tif", codes(light, light.max()))
    job = {"method": "admm", "stack": str(tmp_path / "stack"), "frame": "stored", "output": tmp_path / "out"}
    report = reconstruct_file(Options(measurement=tmp_path / "raw.tif", background="655", **job))
    assert "96 x 120, grey" in report
    assert min(likeness(tmp_path / "out", np.stack([scene] * 3))) > 0.9
    depth = read_exr(tmp_path / "out" / "depth.exr", finite=False)[0]["Z"]
    lit, known = np.pad(scene, ((28, 28), (35, 35))) > 0, np.isfinite(depth)
    assert np.median(depth[lit & known]) == pytest.approx(0.08, rel=0.1)


def test_a_mosaic_with_a_mosaic_of_the_psf_gives_the_scenes_colours(tmp_path: Path) -> None:
    psf = np.pad(speckle(61), ((66, 65), (90, 89)))
    shape = (2 * SENSOR[0], 2 * SENSOR[1])
    scene = np.kron(boxes(), np.ones((2, 2)))
    light = np.stack([on_sensor(channel, psf, shape) for channel in scene])
    response = np.array([0.7, 1.0, 0.6])  # of the sensor's channels to white
    full = light.max()
    for name, image, top in (("raw", light, full), ("psf", np.stack([psf] * 3), psf.max())):
        seen = image * response[:, None, None]
        mosaic = np.zeros(image.shape[1:])
        for place, colour in zip(((0, 0), (0, 1), (1, 0), (1, 1)), (1, 0, 2, 1), strict=True):  # GRBG
            mosaic[place[0] :: 2, place[1] :: 2] = seen[colour][place[0] :: 2, place[1] :: 2]
        cv2.imwrite(str(tmp_path / f"{name}.png"), codes(mosaic, top))
    job = {"method": "admm", "stack": str(tmp_path / "psf.png"), "frame": "stored", "output": tmp_path / "out"}
    with pytest.raises(InputError, match=r"^--cfa: missing"):
        reconstruct_file(Options(measurement=tmp_path / "raw.png", **job))
    report = reconstruct_file(Options(measurement=tmp_path / "raw.png", cfa="GRBG", **job))
    assert "mosaic GRBG" in report
    assert min(likeness(tmp_path / "out", scene, 2)) > 0.9
    wrong = {**job, "output": tmp_path / "wrong"}
    reconstruct_file(Options(measurement=tmp_path / "raw.png", cfa="BGGR", **wrong))
    assert max(likeness(tmp_path / "wrong", scene, 2)) < 0.9
    with pytest.raises(InputError, match=r"^--cfa: "):
        reconstruct_file(Options(measurement=tmp_path / "raw.png", cfa="RGBW", **job))  # pyright: ignore[reportArgumentType]


def files_of(folder: Path, psf: NDArray[Any], light: NDArray[Any]) -> tuple[Path, Path]:
    tifffile.imwrite(folder / "raw.tif", codes(light, light.max()))
    tifffile.imwrite(folder / "psf.tif", codes(psf, psf.max()))
    return folder / "raw.tif", folder / "psf.tif"


def test_a_psf_on_other_pixels_is_refused_with_two_candidates_and_each_of_them_goes_on(tmp_path: Path) -> None:
    fine = np.pad(speckle(93), ((50, 49), (74, 73)))
    scene = boxes()[1]
    light = on_sensor(np.kron(scene, np.ones((2, 2))), fine, (192, 240))
    small = light.reshape(96, 2, 120, 2).mean(axis=(1, 3))  # the capture was binned by the camera, the PSF was not
    raw, psf = files_of(tmp_path, fine, small)
    job = {"measurement": raw, "method": "admm", "stack": str(psf), "frame": "stored", "output": tmp_path / "out"}
    with pytest.raises(InputError, match=r"^--stack: .*--binning 1 --psf-binning 2; or .*--psf-binning 1$"):
        reconstruct_file(Options(**job))
    reconstruct_file(Options(psf_binning=2, **job))
    assert likeness(tmp_path / "out", np.stack([scene] * 3))[1] > 0.9
    reconstruct_file(Options(psf_binning=1, accept_frame=True, **job))
    assert likeness(tmp_path / "out", np.stack([scene] * 3))[1] < 0.5


def test_a_capture_that_is_a_part_of_the_sensor_names_the_same_part_of_the_psf(tmp_path: Path) -> None:
    psf = np.pad(speckle(31), ((33, 32), (45, 44)))
    scene = boxes()[1]
    raw, file = files_of(tmp_path, psf, on_sensor(scene, psf))
    job = {"measurement": raw, "method": "admm", "stack": str(file), "frame": "stored", "output": tmp_path / "out"}
    with pytest.raises(InputError, match=r"^--stack: .*--psf-crop 90x116\+4\+2; or "):
        reconstruct_file(Options(crop="90x116+4+2", **job))
    reconstruct_file(Options(crop="90x116+4+2", psf_crop="90x116+4+2", **job))
    assert likeness(tmp_path / "out", np.stack([scene] * 3))[1] > 0.9


def test_a_sensor_on_its_side_is_said(tmp_path: Path) -> None:
    psf = np.pad(speckle(31), ((33, 32), (45, 44)))
    raw, file = files_of(tmp_path, psf.T, on_sensor(boxes()[1], psf))
    with pytest.raises(InputError, match=r"^--stack: .*90 degrees"):
        reconstruct_file(Options(measurement=raw, method="cls", stack=str(file), frame="stored"))


def test_a_measured_stack_is_binned_like_its_capture_by_an_option_of_its_own(tmp_path: Path) -> None:
    psf = np.pad(speckle(61), ((66, 65), (90, 89)))
    np.save(tmp_path / "psf.npy", psf)
    told: dict[str, Any] = {"frame": "stored", "background": "none", "throughput_m2": 1e-6, "channels": None}
    write_psf_stack(tmp_path / "stack", load_measured_psf([tmp_path / "psf.npy"], [np.inf], 1e-5, **told))
    scene = boxes()[1]
    light = on_sensor(np.kron(scene, np.ones((2, 2))), psf, psf.shape)
    tifffile.imwrite(tmp_path / "raw.tif", codes(light, light.max()))
    job = {"method": "admm", "stack": str(tmp_path / "stack"), "frame": "stored", "output": tmp_path / "out"}
    with pytest.raises(InputError, match=r"^--stack: .*--psf-binning 2"):
        reconstruct_file(Options(measurement=tmp_path / "raw.tif", binning=2, **job))
    reconstruct_file(Options(measurement=tmp_path / "raw.tif", binning=2, psf_binning=2, **job))
    assert likeness(tmp_path / "out", np.stack([scene] * 3))[1] > 0.9


def test_a_psf_larger_than_the_sensor_says_how_much_of_a_points_light_is_lost(tmp_path: Path) -> None:
    psf = speckle(241)
    scene = boxes()[1]
    raw, file = files_of(tmp_path, np.pad(psf, 8), on_sensor(scene, psf))
    job = {"measurement": raw, "method": "admm", "stack": str(file), "frame": "stored", "output": tmp_path / "out"}
    report = reconstruct_file(Options(psf_binning=1, **job))
    lost = 1 - psf[72:168, 60:180].sum() / psf.sum()
    assert f"{lost:.0%} of an on-axis point's light falls beside the sensor" in report
    assert likeness(tmp_path / "out", np.stack([scene] * 3))[1] > 0.9


def test_a_cut_psf_fades_out_is_stated_and_leaves_no_cross(tmp_path: Path) -> None:
    """The light beyond the image is missing for good; but its step, a line through the middle, is not in the picture."""
    psf, scene = speckle(322), np.kron(boxes()[1], np.ones((2, 2)))
    cut = psf[161 - 96 : 161 + 96, 161 - 120 : 161 + 120]
    raw, file = files_of(tmp_path, cut, on_sensor(scene, psf, cut.shape))
    job: dict[str, Any] = {"method": "admm", "stack": str(file), "frame": "stored", "output": tmp_path / "out"}
    report = reconstruct_file(Options(measurement=raw, psf_background="655", **job))
    assert "cut by its image" in report
    assert "is missing" in report
    edges = json.loads((tmp_path / "out" / "reconstruction.json").read_text())["camera"]["psf"]["warnings"]
    assert all(edge in edges[0] for edge in ("top", "bottom", "left", "right"))
    image = read_exr(tmp_path / "out" / "image.exr")[0]["G"]
    steps = np.abs(np.diff(image, axis=1)).mean(axis=0)
    assert steps[117:123].max() < 8 * np.median(steps)  # 113 times with the PSF as it is; no box ends there
    assert likeness(tmp_path / "out", np.stack([scene] * 3))[1] > 0.9


def test_the_mean_of_different_psfs_serves_a_grey_capture_and_one_serves_three_colours(tmp_path: Path) -> None:
    colour = np.stack([np.pad(speckle(31, seed), ((33, 32), (45, 44))) for seed in range(3)])
    np.save(tmp_path / "colour.npy", colour)
    np.save(tmp_path / "grey.npy", colour[0])
    for name, image in (("grey", colour[0]), ("colour", colour)):
        np.save(tmp_path / f"raw_{name}.npy", image / image.max() / 2)
    grey, rgb = (load_measurement(tmp_path / f"raw_{name}.npy", frame="stored") for name in ("grey", "colour"))
    stack, notes = psfs_of_capture(tmp_path / "colour.npy", grey, Request(psf_background="none"))
    mean = colour.mean(axis=0)
    np.testing.assert_allclose(stack.values[0, 0], mean / mean.sum(), rtol=1e-6)  # float32
    assert any("mean of R, G, B" in note for note in notes)
    stack, notes = psfs_of_capture(tmp_path / "grey.npy", rgb, Request(psf_background="none"))
    assert stack.channels == ("R", "G", "B")
    assert np.ptp(stack.values, axis=1).max() == 0
    assert any("the same for R, G, B" in note for note in notes)


def test_what_is_assumed_of_the_image_of_a_psf_is_said(tmp_path: Path) -> None:
    psf = np.pad(speckle(31), ((33, 32), (45, 44))) + 7
    raw, _ = files_of(tmp_path, psf, on_sensor(boxes()[1], psf - 7))
    for name, image in (("alpha", np.dstack([psf, np.ones_like(psf)])), ("three", np.stack([psf, psf / 2, psf]))):
        np.save(tmp_path / f"{name}.npy", image)
    job: dict[str, Any] = {"measurement": raw, "method": "cls", "frame": "stored", "output": tmp_path / "out"}
    job["accept_frame"] = True

    def said(name: str) -> str:
        report = reconstruct_file(Options(stack=str(tmp_path / name), **job))
        return next(line for line in report.splitlines() if line.strip().startswith("PSFs"))

    alpha = said("alpha.npy")
    assert "1 image, its pixels taken as the capture's" in alpha
    assert "alpha channel is left out" in alpha
    assert "background: border 7;" in f"{alpha};"
    assert "3 x 96 x 120: its first axis is taken as R, G, B" in said("three.npy")
    full = np.minimum(psf, psf.max() / 2)
    np.save(tmp_path / "full.npy", full)
    assert f"{np.mean(full == full.max()):.2%} of its pixels are full".replace("%", " %") in said("full.npy")
    np.save(tmp_path / "five.npy", np.stack([psf] * 5))
    with pytest.raises(InputError, match=r"five\.npy: .*flatlight calibrate"):
        said("five.npy")


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"psf_binning": -2}, "^--psf-binning: "),
        ({"psf_binning": 0}, "^--psf-binning: "),
        ({"psf_binning": 500}, "^--psf-binning: "),
        ({"psf_background": "-3"}, "^--psf-background: "),
        ({"psf_background": "gone.tif"}, "^--psf-background: "),
        ({"psf_crop": "9x9+999+0"}, "^--psf-crop: "),
        ({"psf_frame": "up"}, "^--psf-frame: "),
        ({"stack": "gone"}, "^--stack: gone .*exist"),
        ({"scene": (128, 128)}, "^--scene: got 128x128, .*96x120"),
        ({"scene": (95, 120)}, "^--scene: "),
    ],
)
def test_options_of_the_psfs_that_make_no_sense_are_named(
    tmp_path: Path, told: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    psf = np.pad(speckle(31), ((33, 32), (45, 44)))
    raw, file = files_of(tmp_path, psf, on_sensor(boxes()[1], psf))
    job: dict[str, Any] = {"measurement": raw, "method": "cls", "stack": str(file), "frame": "stored"}
    with pytest.raises(InputError, match=message):
        reconstruct_file(Options(**job | told))
    if "psf_binning" in told:  # of a stack's folder, too
        given: dict[str, Any] = {"frame": "stored", "background": "none", "throughput_m2": 1e-6, "channels": None}
        write_psf_stack(tmp_path / "stack", load_measured_psf([file], [np.inf], 1e-5, **given))
        job["stack"] = "stack"
        with pytest.raises(InputError, match=message):
            reconstruct_file(Options(**job | told))


def test_a_capture_of_one_row_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "row.npy", np.ones((1, 120), np.float32))
    np.save(tmp_path / "psf.npy", speckle(31))
    job: dict[str, Any] = {"method": "cls", "stack": str(tmp_path / "psf.npy"), "frame": "stored"}
    with pytest.raises(InputError, match=r"row\.npy: got 1 x 120 pixels"):
        reconstruct_file(Options(measurement=tmp_path / "row.npy", **job))


def test_a_reason_by_which_several_networks_do_not_fit_is_said_once(tmp_path: Path) -> None:
    raw, _ = files_of(tmp_path, speckle(96), speckle(96))
    with pytest.raises(InputError, match=r"flatnet3d.*, .*: got the channels grey") as refused:
        reconstruct_file(Options(measurement=raw, frame="stored"))
    assert refused.value.reason.count("got the channels") == 1


@pytest.mark.shared
def test_the_hand_before_the_diffuser_camera_by_the_documented_command(shared_data: Path, tmp_path: Path) -> None:
    """Bright where the publication's own algorithm has the hand, which rotates neither file: the fingers to the right."""
    folder = shared_data / "diffusercam" / "tutorial"
    raw, psf = folder / "rawdata_hand_sample.tif", folder / "psf_sample.tif"
    job = {"method": "admm", "stack": str(psf), "frame": "stored", "binning": 8, "output": tmp_path / "out"}
    report = reconstruct_file(Options(measurement=raw, **job))
    assert "150 x 200, grey" in report
    assert "0.01 % of its pixels are full" in report  # 192 of the PSF's, as the note beside it says
    image = read_exr(tmp_path / "out" / "image.exr")[0]["G"]
    hand, around = image[40:100, 75:170], np.r_[image[:20].ravel(), image[115:].ravel()]
    assert hand.mean() > 10 * around.mean()
    np.save(tmp_path / "mirrored.npy", tifffile.imread(raw)[:, ::-1])
    with pytest.raises(InputError, match=r"^--frame: .*--mirror left-right"):
        reconstruct_file(Options(measurement=tmp_path / "mirrored.npy", **job))
