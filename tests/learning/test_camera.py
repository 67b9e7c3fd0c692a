"""What a reconstruction knows of the camera, against measurements that were stored and a convolution that is SciPy's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from learning.camera import CaptureModel, capture_model, plain_capture, typical_white
from learning.layers.inversion import WienerInversion
from learning.timing import Timing
from simulator.camera.forward import ForwardModel
from simulator.camera.shutter import DualRollingShutter
from simulator.camera.surroundings import whole_frames
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import read_psf_stack, write_psf_stack

ONE = {"train": 2, "validation": 0, "test": 0}


@pytest.fixture(scope="module")
def train(tiny_dataset: Path) -> Dataset:
    return open_dataset(tiny_dataset, "train")


def light(capture: CaptureModel, rgb: NDArray[np.float32], depth_m: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return irradiance M L_k, (K, C, h, w): a pixel's light is shared in disparity by hat functions of the planes."""
    planes = 1 / capture.stack.depths_m
    hats = [np.interp(1 / depth_m.astype(float), planes[::-1], hat[::-1]) for hat in np.eye(len(planes))]
    colours = np.einsum("ca,hwa->chw", capture.scene_to_camera, rgb.astype(float)) * capture.irradiance
    return np.stack(hats)[:, None] * colours


def blurred(capture: CaptureModel, volume: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sum_k H_k (*) V_k on the sensor, (C, H, W), by SciPy in float64."""
    rows, columns = capture.sensor_shape
    sides = list(zip(capture.sensor_shape, volume.shape[-2:], strict=True))
    canvas = np.zeros((*volume.shape[:2], *(max(side) for side in sides)))  # light may come from beyond the sensor
    top, left = (max(sensor - field, 0) // 2 for sensor, field in sides)
    canvas[..., top : top + volume.shape[-2], left : left + volume.shape[-1]] = volume
    psfs = np.asarray(capture.stack.values, float)
    down, right = (
        size // 2 + max(field - sensor, 0) // 2 for size, (sensor, field) in zip(psfs.shape[-2:], sides, strict=True)
    )
    full = fftconvolve(canvas, psfs, mode="full", axes=(-2, -1)).sum(axis=0)
    return full[:, down : down + rows, right : right + columns]


ROLLING = "camera.shutter={type: rolling, exposure_ms: 2, line_time_us: 20}"
PHYSICAL = "camera.noise={type: physical}"
# Numbers that show: 100 of 4096 DN and a fifth of the full well in 2 ms.
DARK = ("camera.sensor.black_level_dn=100", "camera.sensor.dark_current_e_per_s=1e6")


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("forward.time=mean", "camera.exposure.full_scale=6e-4", ROLLING),
        (PHYSICAL, *DARK),
        (PHYSICAL, *DARK, ROLLING),
        ("camera.noise={type: none}", "forward.vignetting=false"),
        pytest.param(
            # Channels that count different numbers of electrons; counting them takes colour-science seconds to import.
            (
                PHYSICAL,
                *DARK,
                "camera.exposure={illuminance_lux: 1000000}",
                "camera.sensor.peak_quantum_efficiency=0.5",
            ),
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda overrides: " ".join(overrides),
)
def test_measurements_are_offset_plus_gain_times_convolution(
    learning_trial: Any, train: Dataset, overrides: Any
) -> None:
    dataset = train[:4]  # with Gaussian noise
    if overrides:
        dataset = open_dataset(learning_trial.generate(*overrides, dataset=ONE, psf={"as_captured": None}))
    capture = capture_model(dataset)
    model = capture.forward_model()
    for sample in dataset:
        volume = light(capture, sample.rgb[0], sample.depth_m[0])
        offset = capture.offset[:, None, None]
        peak = sample.noiseless.max()
        assert 0.01 < peak < 2
        # Float32 light, PSFs' spectra and sums: a few of its 6e-8 steps of the largest value.
        by_scipy = offset + capture.gain * blurred(capture, volume)
        assert np.abs(by_scipy - sample.noiseless).max() < 1e-6 * peak
        ours = offset + capture.gain * model.forward(volume[None].astype(np.float32))
        assert np.abs(ours - sample.noiseless).max() < 1e-6 * peak


def test_light_from_beside_the_image_is_in_the_model(wide_dataset: Path) -> None:
    """The field is 56 pixels wide, the image 16, the sensor 48."""
    dataset = open_dataset(wide_dataset, "train")
    capture = capture_model(dataset)
    assert (capture.field_shape, capture.scene_shape) == ((56, 56), (16, 16))
    model = capture.forward_model()
    for sample in dataset:
        ((rgb, depth_m),) = whole_frames(sample.clip(), (56, 56))
        assert (rgb[capture.scene_in_field] == sample.rgb[0]).all()
        volume = light(capture, rgb, depth_m)
        offset, peak = capture.offset[:, None, None], sample.noiseless.max()
        by_scipy = offset + capture.gain * blurred(capture, volume)
        assert np.abs(by_scipy - sample.noiseless).max() < 1e-6 * peak
        ours = offset + capture.gain * model.forward(volume[None].astype(np.float32))
        assert np.abs(ours - sample.noiseless).max() < 1e-6 * peak
        inside = np.zeros_like(volume)
        inside[..., 20:36, 20:36] = volume[..., 20:36, 20:36]
        assert np.abs(offset + capture.gain * blurred(capture, inside) - sample.noiseless).max() > 0.05 * peak


def test_the_image_lies_in_the_middle_of_the_field(tiny_capture: CaptureModel) -> None:
    assert tiny_capture.field_shape == (16, 16)
    assert np.array_equal(tiny_capture.scene_irradiance, tiny_capture.irradiance)
    rows, columns = np.indices((22, 60), np.float32)
    capture = replace(tiny_capture, irradiance=1 + rows + 100 * columns)
    assert capture.field_shape == (22, 60)
    assert capture.scene_irradiance.tolist() == (1 + rows + 100 * columns)[3:19, 22:38].tolist()
    assert capture.scene_in_field == (slice(3, 19), slice(22, 38))
    volume = np.random.default_rng(0).random((3, 3, 22, 60))
    got = capture.forward_model(torch.zeros(1, dtype=torch.float64)).forward(torch.from_numpy(volume)[None])
    assert got.numpy() == pytest.approx(blurred(capture, volume), abs=1e-12 * float(got.max()))


def test_a_border_is_as_wide_as_field_and_sensor_allow(tiny_capture: CaptureModel) -> None:
    """Image 16 x 16, sensor 48 x 48; a field of 22 rows and 60 columns."""
    irradiance = np.random.default_rng(0).uniform(0.6, 1, (22, 60)).astype(np.float32)
    capture = replace(tiny_capture, irradiance=irradiance)
    for pixels, shape in ((0, (16, 16)), (2, (20, 20)), (8, (22, 32)), (50, (22, 48))):
        larger = capture.with_border(pixels)
        assert larger.scene_shape == larger.field_shape == shape
        rows, columns = ((whole - part) // 2 for whole, part in zip((22, 60), shape, strict=True))
        assert (larger.irradiance == irradiance[rows : rows + shape[0], columns : columns + shape[1]]).all()
        assert (larger.scene_irradiance[larger.middle((16, 16))] == capture.scene_irradiance).all()


def test_planes_are_left_out_evenly_in_disparity(tiny_capture: CaptureModel) -> None:
    """Of depths that lie unevenly, those nearest to even steps; both ends stay."""
    disparities = np.array([1.0, 0.9, 0.7, 0.45, 0.2, 0.1, 0.0])
    depths_m = 1 / (5 + 95 * disparities)
    values = np.random.default_rng(0).random((7, 3, 9, 9)).astype(np.float32)
    capture = tiny_capture.with_stack(replace(tiny_capture.stack, values=values, depths_m=depths_m))
    for count, kept in ((2, [0, 6]), (3, [0, 3, 6]), (4, [0, 2, 3, 6]), (7, [0, 1, 2, 3, 4, 6])):
        fewer = capture.with_planes(count).stack
        assert fewer.depths_m.tolist() == depths_m[kept].tolist()
        assert (np.asarray(fewer.values) == values[kept]).all()
    assert len({capture.with_planes(count).stack.fingerprint for count in (2, 3, 4)}) == 3
    for count in (1, 8):
        with pytest.raises(InputError, match=rf"^planes: got {count}, expected 2 to 7"):
            capture.with_planes(count)


def test_a_border_ends_where_a_stop_takes_half_of_the_light(tiny_capture: CaptureModel) -> None:
    """A field of 32 x 32, its outer 3 pixels on each side behind the stop's rim."""
    image = np.random.default_rng(0).uniform(1, 3, (16, 16)).astype(np.float32)
    for rim, shape in ((0.0, 26), (0.49, 26), (0.51, 32)):
        irradiance = np.full((32, 32), rim * image.min(), np.float32)
        irradiance[3:-3, 3:-3] = 0.6 * image.min()
        irradiance[8:24, 8:24] = image
        larger = replace(tiny_capture, irradiance=irradiance).with_border(8)
        assert larger.scene_shape == larger.field_shape == (shape, shape)
        assert (larger.scene_irradiance[larger.middle((16, 16))] == image).all()


@pytest.mark.parametrize(
    "margin", [None, 20, [20], [20, 20, 0], [20.5, 20], [-1, 20], ["20", 20], [True, 20], {"rows": 20}]
)
def test_a_damaged_record_of_the_margin_is_refused(wide_dataset: Path, margin: Any) -> None:
    dataset = open_dataset(wide_dataset, "train")
    info = replace(dataset.info, field_of_view=dataset.info.field_of_view | {"margin": margin})
    with pytest.raises(InputError, match=r"field_of_view\.margin: "):
        capture_model(Dataset(dataset.root, dataset.split, dataset.ids, info))


def test_data_of_versions_that_had_no_margin_have_none(train: Dataset) -> None:
    older = {key: value for key, value in train.info.field_of_view.items() if key != "margin"}
    for record in (older, {}):
        info = replace(train.info, field_of_view=record)
        capture = capture_model(Dataset(train.root, train.split, train.ids, info))
        assert np.array_equal(capture.irradiance, capture_model(train).irradiance)


def test_gain_and_offset_are_those_of_the_sensor(learning_trial: Any) -> None:
    folder = learning_trial.generate(PHYSICAL, *DARK, ROLLING, dataset=ONE, psf={"as_captured": None})
    capture = capture_model(open_dataset(folder))
    full_well_e, top = 15000, 4095  # of the IMX183; 12 bits
    assert capture.gain == pytest.approx((top - 100) / 4096 * 2e-3 / 3e-6, rel=1e-6)
    dark_e = 1e6 * 2e-3
    assert capture.offset == pytest.approx([(100 + dark_e / full_well_e * (top - 100)) / 4096] * 3, rel=1e-6)


def test_a_damaged_record_of_the_exposure_is_refused(train: Dataset) -> None:
    for exposure in ({}, {"full_scale": "much"}, {"full_scale": 1.0, "responsivity": {"R": 1.0}}):
        info = replace(train.info, exposure=exposure)
        with pytest.raises(InputError, match=r"out/dataset\.json: exposure: "):
            capture_model(Dataset(train.root, train.split, train.ids, info))


def test_irradiance_falls_with_the_fourth_power_of_the_cosine(train: Dataset) -> None:
    capture = capture_model(train)
    pitch_m, distance_m = 8 * 2.4e-6, 1.9e-3
    y = (np.arange(16) - 7.5) * pitch_m
    cosine = distance_m / np.sqrt(distance_m**2 + y[:, None] ** 2 + y**2)
    assert capture.irradiance == pytest.approx((pitch_m / distance_m) ** 2 * cosine**4, rel=1e-5)


def test_the_forward_model_works_on_tensors(tiny_capture: CaptureModel) -> None:
    volume = np.random.default_rng(0).random((3, 3, 16, 16))
    expected = blurred(tiny_capture, volume)
    tensor = torch.from_numpy(volume)[None].requires_grad_()
    got = tiny_capture.forward_model(tensor).forward(tensor)
    assert got.dtype == torch.float64
    assert got.detach().numpy() == pytest.approx(expected, abs=1e-12 * expected.max())
    image = torch.randn(3, 48, 48, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    (got * image).sum().backward()
    assert tensor.grad is not None
    adjoint = tiny_capture.forward_model(image).adjoint(image)
    assert adjoint.numpy() == pytest.approx(tensor.grad.numpy(), abs=1e-12 * float(adjoint.abs().max()))


def test_stacks_are_chosen_by_name_folder_or_value(train: Dataset, tmp_path: Path) -> None:
    nominal, captured = capture_model(train), capture_model(train, "captured", white=0.8)
    assert nominal.white == 1.0
    assert captured.white == 0.8
    for model, folder in ((nominal, "psf"), (captured, "psf_captured")):
        assert (model.stack.values == read_psf_stack(train.root / folder).values).all()
    assert captured.stack.provenance["kind"] == "captured"
    assert captured.gain == nominal.gain
    other = replace(nominal.stack, values=nominal.stack.values[1:], depths_m=nominal.stack.depths_m[1:])
    write_psf_stack(tmp_path / "other", other)
    for stack in (other, tmp_path / "other", str(tmp_path / "other")):
        model = capture_model(train, stack)
        assert (model.stack.values == other.values).all()
        assert model.near_m == nominal.stack.depths_m[1]


def test_a_stack_of_another_camera_is_refused(train: Dataset, tmp_path: Path) -> None:
    stack = capture_model(train).stack
    with pytest.raises(InputError, match=r"^stack: "):
        capture_model(train, replace(stack, pixel_pitch_m=9.6e-6))
    with pytest.raises(InputError, match=r"^stack: "):
        capture_model(train, replace(stack, values=stack.values[:, :1], channels=("Y",)))
    with pytest.raises(InputError, match=f"{tmp_path.name}: "):
        capture_model(train, tmp_path)


def test_a_data_set_without_a_captured_stack_says_how_to_make_it(learning_trial: Any) -> None:
    dataset = open_dataset(learning_trial.generate(dataset=ONE, psf={"as_captured": None}))
    with pytest.raises(InputError, match=r"^stack: "):
        capture_model(dataset, "captured")


@pytest.mark.parametrize("override", ["camera.sensor.readout=bayer", "forward.boundary=circular"])
def test_measurements_of_other_kinds_are_refused(learning_trial: Any, override: str) -> None:
    dataset = open_dataset(learning_trial.generate(override, dataset=ONE, psf={"as_captured": None}))
    with pytest.raises(InputError, match="out: "):
        capture_model(dataset)


def test_rows_may_be_exposed_for_times_of_their_own(learning_trial: Any) -> None:
    """From 4 ms in the first physical row to 6 ms in the last, which is the first stored one."""
    rows = 48 * 8
    lines = [f"0,{0.004 + 0.002 * row / rows}" for row in range(rows)]
    (learning_trial.trial.folder / "rows.csv").write_text("\n".join(["open_s,close_s", *lines]), encoding="utf-8")
    own = "camera.shutter={type: windows, file: rows.csv}"
    dataset = open_dataset(learning_trial.generate(own, dataset=ONE, psf={"as_captured": None}))
    capture = capture_model(dataset)
    assert capture.row_exposure is not None
    assert capture.row_exposure[[0, -1]] == pytest.approx([1.2, 0.8], abs=5e-3)  # the mean of 8 physical rows
    assert capture.row_weights.shape == (1, 48)
    for sample in dataset:
        exposed = blurred(capture, light(capture, sample.rgb[0], sample.depth_m[0])) * capture.row_weights[0][:, None]
        by_scipy = capture.offset[:, None, None] + capture.gain * exposed
        assert np.abs(by_scipy - sample.noiseless).max() < 1e-6 * sample.noiseless.max()
    # An inversion sees the light as if all rows had the same exposure.
    evenly = WienerInversion(replace(capture, row_exposure=None)).light(torch.ones(3, 48, 48))
    by_rows = torch.from_numpy(capture.row_exposure).float()[:, None]
    assert torch.allclose(WienerInversion(capture).light(torch.ones(3, 48, 48)) * by_rows, evenly, rtol=1e-6)


@pytest.mark.parametrize("time", ["integral", "mean"])
def test_clips_are_what_the_shutter_lets_through(learning_trial: Any, clip_settings: Any, time: str) -> None:
    """Each frame blurred by SciPy and weighed by rows: the slivers' means of frames that do not move are exact."""
    changes = clip_settings | {
        "dataset": clip_settings["dataset"] | ONE,
        "scene": clip_settings["scene"] | {"speed": 0},
    }
    scale = ["camera.exposure.full_scale=6e-4"] if time == "mean" else []
    dataset = open_dataset(learning_trial.generate(f"forward.time={time}", *scale, **changes))
    capture = capture_model(dataset)
    assert capture.frames == 4
    assert capture.row_weights.sum(axis=0) == pytest.approx(np.ones(48))
    model = capture.space_time(np.zeros(1, np.float32))
    for sample in dataset:
        frames = np.stack([light(capture, rgb, depth) for rgb, depth in zip(sample.rgb, sample.depth_m, strict=True)])
        slivers = frames.reshape(4, 2, *frames.shape[1:]).mean(axis=1)
        seen = sum(blurred(capture, frame) * w[:, None] for frame, w in zip(slivers, capture.row_weights, strict=True))
        peak = sample.noiseless.max()
        assert np.abs(capture.offset[:, None, None] + capture.gain * seen - sample.noiseless).max() < 1e-6 * peak
        assert (
            np.abs(capture.gain * model.forward(slivers.astype(np.float32)) - capture.gain * seen).max() < 1e-6 * peak
        )
    # Batches, and the transpose
    rng = np.random.default_rng(0)
    volumes, seen = rng.random((4, 1, 2, 3, 16, 16)), rng.random((2, 3, 48, 48))
    exact = replace(capture, stack=replace(capture.stack, values=capture.stack.values.astype(float)))
    model = exact.space_time(seen)
    both, single = model.forward(volumes), model.forward(volumes[:, :, 1])
    np.testing.assert_allclose(both[1], single, rtol=1e-12)
    assert np.vdot(both, seen) == pytest.approx(np.vdot(volumes, model.adjoint(seen)), rel=1e-12)


def test_depths_and_disparities(tiny_capture: CaptureModel) -> None:
    assert (tiny_capture.near_m, tiny_capture.far_m) == (0.01, 0.2)
    # Half way in 1 / z between 100 and 5 per metre: 52.5 per metre.
    depths_m = np.array([0.001, 0.01, 1 / 52.5, 0.2, 3.0, np.inf])
    assert tiny_capture.disparity(depths_m).tolist() == pytest.approx([1, 1, 0.5, 0, 0, 0], abs=1e-12)
    disparities = np.array([-1, 0, 0.5, 1, 7])
    assert tiny_capture.depth_m(disparities).tolist() == pytest.approx([0.2, 0.2, 1 / 52.5, 0.01, 0.01])
    tensor = torch.tensor([0.0125, 0.05, 0.15])
    assert tiny_capture.depth_m(tiny_capture.disparity(tensor)).tolist() == pytest.approx(tensor.tolist(), rel=1e-6)
    assert tiny_capture.plane_disparities().tolist() == pytest.approx([1, 0.5, 0])


def test_depths_to_infinity_and_a_single_plane(tiny_capture: CaptureModel) -> None:
    stack = tiny_capture.stack
    endless = tiny_capture.with_stack(replace(stack, depths_m=np.array([0.01, 0.02, np.inf])))
    assert endless.disparity(np.array([0.01, 0.02, np.inf])).tolist() == pytest.approx([1, 0.5, 0])
    assert endless.depth_m(torch.tensor([1.0, 0.5, 0.0])).tolist() == pytest.approx([0.01, 0.02, np.inf])
    single = tiny_capture.with_stack(replace(stack, values=stack.values[:1], depths_m=np.array([0.05])))
    assert single.depth_m(np.array([0.0, 1.0]))[0] == pytest.approx(0.05)
    assert single.plane_disparities().tolist() == [0]


@pytest.mark.parametrize("channels", [3, 4])
def test_to_srgb_undoes_the_cameras_colours(tiny_capture: CaptureModel, channels: int) -> None:
    rng = np.random.default_rng(0)
    matrix, rgb = rng.random((channels, 3)), rng.random((2, 3, 16, 16))
    values = np.repeat(tiny_capture.stack.values[:, :1], channels, axis=1)
    stack = replace(tiny_capture.stack, values=values, channels=tuple("RGBE"[:channels]))
    capture = replace(tiny_capture, stack=stack, scene_to_camera=matrix, offset=np.zeros(channels))
    light = np.einsum("ca,bahw->bchw", matrix, rgb)
    assert capture.to_srgb(light) == pytest.approx(rgb, abs=1e-6)
    assert capture.to_srgb(torch.from_numpy(light)).numpy() == pytest.approx(rgb, abs=1e-6)


def test_belief_takes_psfs_and_white_from_elsewhere_and_numbers_from_here(tiny_capture: CaptureModel) -> None:
    test = replace(tiny_capture, gain=7.0, offset=np.array([0.4, 0.5, 0.6]), white=0.3)
    values = tiny_capture.stack.values[[0, 2]]
    known = tiny_capture.with_stack(PsfStack(values, np.array([0.01, 0.2]), 20e-6, ("R", "G", "B"), "1" * 64))
    assumed = test.with_assumed(known)
    assert assumed.stack is known.stack
    assert assumed.white == 0.9
    assert assumed.gain == 7.0
    assert assumed.offset.tolist() == [0.4, 0.5, 0.6]
    assert assumed.irradiance is test.irradiance
    assert assumed.scene_to_camera is test.scene_to_camera


def stack_at(capture: CaptureModel, *depths_m: float) -> CaptureModel:
    values = capture.stack.values[: len(depths_m)]
    return replace(capture, stack=replace(capture.stack, values=values, depths_m=np.array(depths_m)))


def test_belief_needs_the_same_camera_and_known_depths(tiny_capture: CaptureModel) -> None:
    known = tiny_capture
    for name, other in (("sensor_shape", (50, 48)), ("sensor_shape", (48, 46))):
        with pytest.raises(InputError, match=r"^sensor_shape: "):
            replace(known, **{name: other}).with_assumed(known)
    small = replace(known, scene_shape=(14, 16), irradiance=known.irradiance[:14])
    with pytest.raises(InputError, match=r"^scene_shape: "):
        small.with_assumed(known)
    pitch = replace(known, stack=replace(known.stack, pixel_pitch_m=19e-6))
    with pytest.raises(InputError, match=r"^stack: "):
        pitch.with_assumed(known)
    for near_m, far_m in ((0.008, 0.2), (0.01, 0.25)):
        with pytest.raises(InputError, match=r"^stack: "):
            stack_at(known, near_m, far_m).with_assumed(known)
    for near_m, far_m in ((0.01, 0.2), (0.02, 0.1), (0.01 - 1e-9, 0.2 + 1e-9)):
        assert stack_at(known, near_m, far_m).with_assumed(known).near_m == 0.01
    assert known.with_assumed(stack_at(known, 0.05)).near_m == 0.05  # a single plane says nothing of the range


def test_belief_needs_the_same_shutter(clip_capture: CaptureModel) -> None:
    """And as many slivers: a method would take rows for those of other frames."""
    assert clip_capture.with_assumed(replace(clip_capture)).timing is clip_capture.timing
    edges_s = clip_capture.timing.frame_edges_s  # pyright: ignore[reportOptionalMemberAccess]
    for timing, key in (
        (Timing(DualRollingShutter(4e-3, 0.4e-3), edges_s), "shutter"),
        (Timing(DualRollingShutter(4e-3, 0.5e-3), np.arange(4) * 16e-3 / 3), "slivers"),
        (None, r"scene\.frames"),
    ):
        with pytest.raises(InputError, match=f"^{key}: "):
            clip_capture.with_assumed(replace(clip_capture, timing=timing))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"offset": np.zeros(4)}, "^offset: "),
        ({"irradiance": np.ones((16, 17))}, "^irradiance: "),
        ({"irradiance": np.ones((14, 16))}, "^irradiance: "),
        ({"scene_to_camera": np.eye(4)}, "^scene_to_camera: "),
        ({"sensor_shape": (47, 48)}, "^scene_shape: "),
        ({"sensor_shape": (48, 14)}, "^scene_shape: "),
        ({"gain": 0.0}, "^gain: "),
        ({"gain": float("nan")}, "^gain: "),
        ({"white": -1.0}, "^white: "),
        ({"white": float("inf")}, "^white: "),
    ],
)
def test_contradictions_are_refused(tiny_capture: CaptureModel, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        replace(tiny_capture, **changes)


def random_stack(channels: tuple[str, ...], planes: int = 2) -> PsfStack:
    values = np.random.default_rng(0).random((planes, len(channels), 5, 5), np.float32)
    return PsfStack(values, np.linspace(0.1, 0.2, planes), 1e-5, channels, "random")


@pytest.mark.parametrize("channels", [("R", "G", "B"), ("Y",)])
def test_srgb_of_a_plain_capture_is_what_the_camera_saw(channels: tuple[str, ...]) -> None:
    capture = plain_capture(random_stack(channels), (12, 16), (8, 8))
    seen = np.random.default_rng(1).random((len(channels), 8, 8))
    assert plain_capture(random_stack(channels), (12, 16)).scene_shape == (12, 16)
    # One channel becomes red, green and blue alike.
    np.testing.assert_allclose(capture.to_srgb(seen), np.broadcast_to(seen, (3, 8, 8)), rtol=1e-12)


def test_white_is_twice_the_mean_of_a_uniform_scene() -> None:
    stack = random_stack(("R", "G", "B"), planes=1)
    capture = plain_capture(stack, (12, 12), (6, 6), background=0.5)
    volume = np.full((1, 1, 3, 6, 6), 0.7)
    measurement = ForwardModel(stack, (12, 12), (6, 6)).forward(volume) + 0.5  # the sensor holds all of the light
    assert typical_white(capture, measurement) == pytest.approx(1.4, rel=1e-6)
    with pytest.raises(InputError, match=r"^measurement: "):
        typical_white(capture, np.full((3, 12, 12), 0.5))  # dark
    with pytest.raises(InputError, match=r"^stack: "):
        plain_capture(random_stack(("a", "b")), (8, 8))


def test_what_counts_of_each_direction_is_the_data_sets_record(learning_trial: Any) -> None:
    """Also where the file of the response is gone."""
    folder = learning_trial.trial.folder
    response = folder / "angles.csv"
    response.write_text("0,1\n90,0\n")
    plain = learning_trial.generate(f"dataset.output={folder / 'plain'}")
    weighed = learning_trial.generate(
        f"dataset.output={folder / 'weighed'}", "camera.sensor.angular_response=angles.csv"
    )
    response.unlink()
    one, other = (capture_model(open_dataset(root, "train")).irradiance for root in (plain, weighed))
    pixel = 19.2e-6 / 1.9e-3
    tangents = (np.arange(16) - 7.5) * pixel
    angle = np.degrees(np.arctan(np.hypot(tangents[:, None], tangents)))
    np.testing.assert_allclose(other / one, 1 - angle / 90, rtol=1e-5)
