"""A capture in the wrong frame is found, whatever the mask, and the option that cures it is named."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from learning.camera import plain_capture
from learning.reconstruct.job import Options, reconstruct_file
from learning.reconstruct.orientation import CLEAR, frame_evidence
from psf_library.reference import load as load_pinned
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.measured import load_measured_psf
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import write_psf_stack

SENSOR, SCENE = (90, 110), (50, 60)


def drawn(kind: str) -> NDArray[np.float64]:
    """Return a scene without any symmetry."""
    rng = np.random.default_rng(4)
    scene = np.full(SCENE, 0.2 if kind == "boxes" else 0.0)
    for _ in range(12):
        row, column, height, width = rng.integers(0, 50), rng.integers(0, 60), *rng.integers(3, 14, 2)
        scene[row : row + height, column : column + width] = rng.random()
    if kind == "points":
        scene = np.where(rng.random(SCENE) < 0.01, rng.random(SCENE), 0)
    return scene


def captured(scene: NDArray[np.float64], psf: NDArray[np.floating], noise_db: float) -> NDArray[np.float64]:
    """Return a scene in the middle through a PSF, by a full convolution, with noise."""
    full = np.pad(fftconvolve(scene, psf.astype(np.float64)), 60)
    top, left = ((n // 2 + 60 - (s - m) // 2) for n, s, m in zip(psf.shape, SENSOR, scene.shape, strict=True))
    light = full[top : top + SENSOR[0], left : left + SENSOR[1]]
    noise = np.random.default_rng(1).normal(0, 10 ** (-noise_db / 20), SENSOR)
    return light / light.max() + 0.05 + noise


def flipped(image: NDArray[Any], flips: tuple[bool, bool]) -> NDArray[Any]:
    return np.flip(image, [axis for axis, flip in zip((-2, -1), flips, strict=True) if flip])


@pytest.mark.parametrize("kind", ["boxes", "points"])
@pytest.mark.parametrize("design", ["amplitude_image", "diffusercam", "flatcam", "phlatcam", "random_lenslets"])
def test_the_frame_is_clear_from_the_capture_alone(design: str, kind: str) -> None:
    stack = load_pinned(design)
    capture = plain_capture(stack, SENSOR)
    light = np.stack([captured(drawn(kind), plane, 40) for plane in np.asarray(stack.values)[1]])
    for flips in product((False, True), repeat=2):
        evidence = frame_evidence(flipped(light, flips), capture)
        assert max(evidence, key=lambda each: evidence[each]) == flips  # which flips it back
        assert all(evidence[flips] - gain > CLEAR for each, gain in evidence.items() if each != flips)


@pytest.mark.parametrize("design", ["fresnel_zone", "pinhole", "spiral", "vortex"])
def test_psfs_that_look_the_same_rotated_say_nothing(design: str) -> None:
    stack = load_pinned(design)
    light = np.stack([captured(drawn("boxes"), plane, 40) for plane in np.asarray(stack.values)[1]])
    evidence = frame_evidence(light, plain_capture(stack, SENSOR))
    assert abs(evidence[True, True]) < CLEAR
    assert max(evidence.values()) < CLEAR  # a vortex's are not the same mirrored


@pytest.mark.parametrize("size", [383, 384, 400])
def test_a_large_sensor_is_judged_at_low_resolution(size: int) -> None:
    rng = np.random.default_rng(0)
    psf = np.zeros((121, 121))
    psf[rng.integers(0, 120, 30), rng.integers(0, 120, 30)] = 1
    scene = np.kron(drawn("boxes"), np.ones((3, 3)))
    full = fftconvolve(scene, fftconvolve(psf, np.ones((3, 3)), "same"))
    light = np.zeros((1, size, size))
    light[0, 40 : 40 + full.shape[0], 40 : 40 + full.shape[1]] = full
    stack = PsfStack(psf[None, None], np.array([np.inf]), 1e-5, ("Y",), "0" * 64)
    capture = plain_capture(stack, (size, size))
    assert sorted(frame_evidence(light, capture).values())[-2] < -CLEAR
    assert frame_evidence(light[:, ::-1, ::-1], capture)[True, True] > CLEAR


@pytest.mark.shared
def test_the_diffuser_cameras_hand_is_clear(shared_data: Path) -> None:
    folder = shared_data / "diffusercam" / "tutorial"
    names = ("psf_sample.tif", "rawdata_hand_sample.tif")
    psf, raw = (tifffile.imread(folder / name).reshape(300, 4, 400, 4).mean(axis=(1, 3)) for name in names)
    stack = PsfStack((psf - 31).clip(0)[None, None], np.array([np.inf]), 1e-5, ("Y",), "0" * 64)
    capture = plain_capture(stack, (300, 400))
    for flips in product((False, True), repeat=2):
        evidence = frame_evidence(flipped(raw[None], flips), capture)
        assert all(evidence[flips] - gain > 10 * CLEAR for each, gain in evidence.items() if each != flips)


class Physical:
    """Files as read from a sensor: raw.tif and psf.tif; and stack, the folder that `flatlight psf` writes of psf.tif."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.scene = folder, drawn("boxes")
        psf = np.zeros((33, 33))
        psf[np.random.default_rng(0).integers(4, 29, 9), np.random.default_rng(1).integers(4, 29, 9)] = 1
        # Seen from the sensor, scene and PSF are rotated; a pinhole's image is upside down there.
        light = captured(self.scene[::-1, ::-1], psf, 50)
        tifffile.imwrite(folder / "raw.tif", (light / light.max() * 60000).clip(0).astype(np.uint16))
        tifffile.imwrite(folder / "psf.tif", (psf * 60000).astype(np.uint16))
        told: dict[str, Any] = {"frame": "physical", "throughput_m2": 1e-6, "channels": ("Y",), "background": "none"}
        write_psf_stack(folder / "stack", load_measured_psf([folder / "psf.tif"], [np.inf], 1e-5, **told))

    def likeness(self, stack: str, **options: Any) -> float:
        """Reconstruct the raw capture and return how much the middle of the image correlates with the scene."""
        (where, to) = (self.folder / name for name in ("raw.tif", "out"))
        reconstruct_file(Options(measurement=where, method="cls", stack=str(self.folder / stack), output=to, **options))
        image = read_exr(to / "image.exr")[0]["G"][20:70, 25:85]
        return float(np.corrcoef(image.ravel(), self.scene.ravel())[0, 1])


@pytest.fixture
def physical(tmp_path: Path) -> Physical:
    return Physical(tmp_path)


@pytest.mark.parametrize(
    ("stack", "options"),
    [("stack", {}), ("psf.tif", {}), ("psf.tif", {"psf_frame": "physical"}), ("stack", {"background": "10"})],
)
def test_raw_captures_are_rotated_like_their_psfs(physical: Physical, stack: str, options: dict[str, Any]) -> None:
    assert physical.likeness(stack, frame="physical", **options) > 0.9


@pytest.mark.parametrize(
    ("stack", "options", "message"),
    [
        ("stack", {}, r"^--frame: missing.*it is physical"),
        ("psf.tif", {}, r"^--frame: missing"),
        ("stack", {"frame": "stored"}, r"^--frame: .*--frame physical.*--accept-frame"),
        ("psf.tif", {"frame": "physical", "psf_frame": "stored"}, r"^--frame: "),
        ("stack", {"frame": "upright"}, "^--frame: "),
        ("psf.tif", {"frame": "stored", "psf_frame": "upright"}, "^--psf-frame: "),
        ("stack", {"frame": "physical", "psf_frame": "physical"}, "^--psf-frame: "),
    ],
)
def test_other_frames_are_refused(physical: Physical, stack: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        physical.likeness(stack, **options)
    assert not (physical.folder / "out").exists()


@pytest.mark.parametrize("mirror", ["left-right", "up-down"])
@pytest.mark.parametrize("frame", ["physical", "stored"])
def test_a_mirrored_capture_is_refused_with_the_options_that_mend_it(
    physical: Physical, mirror: str, frame: str
) -> None:
    raw = tifffile.imread(physical.folder / "raw.tif")
    raw = raw[:, ::-1] if mirror == "left-right" else raw[::-1]
    tifffile.imwrite(physical.folder / "raw.tif", raw)
    # A mirror and a rotation make the other mirror.
    cure = mirror if frame == "physical" else {"left-right": "up-down", "up-down": "left-right"}[mirror]
    with pytest.raises(InputError, match=rf"^--frame: .*give --mirror {cure};"):
        physical.likeness("stack", frame=frame)
    assert physical.likeness("stack", frame=frame, mirror=cure) > 0.9
    with pytest.raises(InputError, match=rf"^--frame: .*give --frame {frame}"):
        physical.likeness("stack", frame="stored" if frame == "physical" else "physical", mirror=cure)


def test_who_knows_better_goes_on(physical: Physical) -> None:
    assert physical.likeness("stack", frame="stored", accept_frame=True) < 0.5


def test_a_stack_in_another_frame_is_not_taken_for_ours(physical: Physical) -> None:
    path = physical.folder / "stack" / "psf.json"
    path.write_text(path.read_text().replace('"frame": "stored"', '"frame": "physical"', 1))
    with pytest.raises(InputError, match=r"psf\.json: "):
        physical.likeness("stack", frame="physical")


def test_samples_and_their_files_say_their_frame_themselves(tiny_dataset: Path, tmp_path: Path) -> None:
    sample = tiny_dataset / "test" / "0000" / "s00000000"
    with pytest.raises(InputError, match=r"^--frame: "):
        reconstruct_file(Options(measurement=sample, method="cls", frame="stored"))
    copied = tmp_path / "copy.exr"
    copied.write_bytes((sample / "measurement.exr").read_bytes())
    reconstruct_file(Options(measurement=copied, method="cls", stack=str(tiny_dataset), output=tmp_path / "out"))


def test_an_empty_capture_says_nothing(tiny_capture: Any) -> None:
    assert set(frame_evidence(np.ones((3, 48, 48)), tiny_capture).values()) == {0}


def test_a_network_is_given_stored_images_too(tiny_dataset: Path, checkpoints: list[Path], tmp_path: Path) -> None:
    values, _ = read_exr(tiny_dataset / "test" / "0000" / "s00000001" / "measurement.exr")
    np.save(tmp_path / "m.npy", np.stack([values[name] for name in "RGB"])[:, ::-1, ::-1])
    with pytest.raises(InputError, match=r"^--frame: missing"):
        reconstruct_file(Options(measurement=tmp_path / "m.npy", checkpoint=str(checkpoints[0])))
    told = Options(measurement=tmp_path / "m.npy", checkpoint=str(checkpoints[0]), output=tmp_path / "out")
    reconstruct_file(replace(told, frame="physical"))
    from_sample = replace(told, measurement=tiny_dataset / "test/0000/s00000001", output=tmp_path / "sample")
    reconstruct_file(from_sample)
    images = [read_exr(tmp_path / name / "image.exr")[0]["G"] for name in ("out", "sample")]
    assert np.corrcoef(images[0].ravel(), images[1].ravel())[0, 1] > 0.9
