"""Stacks from folders, and measured stacks at other planes, as a configuration asks for them."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.optics.interpolation import interpolate_stack
from simulator.optics.stack import with_channels
from simulator.optics.stack_files import read_psf_stack, write_psf_stack

pytestmark = pytest.mark.filterwarnings("ignore::simulator.optics.error_budget.sampling.SamplingWarning")
NO_MASK = {"mask": None}


@pytest.fixture
def stored(trial):
    """The trial's own stack, written beside its YAML file as ``psf --output`` does."""
    stack = Assembly(load_config(trial.write())).psf_stack
    write_psf_stack(trial.folder / "stack", stack)
    return stack


def build(trial, **psf):
    return Assembly(load_config(trial.write(camera=NO_MASK, psf=psf))).psf_stack


def test_a_written_stack_comes_back_as_it_was(trial, stored) -> None:
    back = build(trial, measured="stack")
    np.testing.assert_array_equal(back.values, stored.values)
    assert (back.fingerprint, back.provenance["kind"]) == (stored.fingerprint, "computed")
    view = Assembly(load_config(trial.path)).view
    assert (view.near_m, view.far_m) == pytest.approx((0.036, 0.2))


def test_its_files_decide_a_data_set(trial, stored) -> None:
    config = load_config(trial.write(camera=NO_MASK, psf={"measured": "stack"}))
    names = [path.name for path in Assembly(config, "none").input_files]
    assert {"psf.json", "depth_0000.exr", "depth_0001.exr", "depth_0002.exr"} <= set(names)


def test_a_data_sets_folder_serves_too(trial) -> None:
    root = trial.generate()
    stack = build(trial, measured=str(root))
    assert len(stack.depths_m) == 3


def test_planes_are_interpolated_and_the_scene_follows_them(trial, stored) -> None:
    planes = {"near_cm": 4, "far_cm": 10, "depths": 4}
    found = build(trial, measured="stack", planes=planes)
    expected = interpolate_stack(stored, found.depths_m.tolist(), 1.9e-3)
    np.testing.assert_array_equal(found.values, expected.values)
    assert found.depths_m[[0, -1]] == pytest.approx([0.04, 0.1])
    view = Assembly(load_config(trial.path)).view
    assert (view.near_m, view.far_m) == pytest.approx((0.04, 0.1))


def test_images_at_other_planes(trial) -> None:
    light = np.zeros((2, 41, 41))
    light[:, 15:26, 12:20] = 1
    np.save(trial.folder / "psf.npy", light)
    images = {
        "measured": ["psf.npy"],
        "depths_cm": [5, 20],
        "frame": "stored",
        "background": "none",
        "throughput_mm2": 1,
    }
    found = build(trial, **images, planes={"depths_cm": [5, 10, 30], "extrapolate": True})
    assert found.provenance["interpolation"]["planes"][2]["extrapolated"]
    assert found.provenance["kind"] == "measured"
    with pytest.raises(InputError, match=r"^depths_m: "):
        build(trial, **images, planes={"depths_cm": [30]})


def test_mistakes_are_named(trial, stored) -> None:
    with pytest.raises(InputError, match="nowhere: "):
        build(trial, measured="nowhere")
    images = {"measured": ["no.tif"], "depths_cm": [5], "frame": "stored", "throughput_mm2": 1}
    with pytest.raises(InputError, match=r"^psf\.measured\[0\]: "):
        build(trial, **images)
    (trial.folder / "psf.tif").write_bytes(b"")
    with pytest.raises(InputError, match=r"^psf\.measured: "):
        build(trial, measured="psf.tif")
    camera = NO_MASK | {"sensor": {"binning": 4, "shape": [48, 60]}}
    with pytest.raises(InputError, match=r"^psf\.measured: "):
        _ = Assembly(load_config(trial.write(camera=camera, psf={"measured": "stack"}))).psf_stack


@pytest.mark.parametrize(
    ("made", "now", "words"),
    [
        (
            {"mask_to_sensor_mm": 1.9},
            {"mask_to_sensor_mm": 2.1},
            r"with 1\.9 mm of air.*the camera has 2\.1 mm; set camera",
        ),
        (
            {"mask_to_sensor_mm": None, "gap": [{"mm": 3, "n": 1.5}]},
            {"mask_to_sensor_mm": 1.9},
            r"with 2 mm of air.*the camera has 1\.9 mm",
        ),
        (
            {"mask_to_sensor_mm": None, "gap": [{"mm": 3, "n": 1.5}]},
            {"mask_to_sensor_mm": None, "gap": [{"mm": 1, "n": "air"}, {"mm": 1.5, "n": 1.5}]},
            r"behind a gap of 3 mm n = 1\.5, the camera's is 1 mm air \+ 1\.5 mm n = 1\.5; set camera\.gap",
        ),
        ({"mask_to_sensor_mm": 1.9}, {"mask_to_sensor_mm": None, "gap": [{"mm": 1.9, "n": "air"}]}, None),
        ({"mask_to_sensor_mm": None, "gap": [{"mm": 3, "n": 1.5}]}, {"mask_to_sensor_mm": 2}, None),
    ],
)
def test_a_stack_of_another_gap_is_refused(trial, made, now, words) -> None:
    write_psf_stack(trial.folder / "stack", Assembly(load_config(trial.write(camera=made))).psf_stack)
    config = load_config(trial.write(camera=NO_MASK | now, psf={"measured": "stack"}))
    if words is None:
        assert Assembly(config).psf_stack.provenance["kind"] == "computed"
    else:
        with pytest.raises(InputError, match=words):
            _ = Assembly(config).psf_stack


MONO = "wavelength_nm,Y\n400,0.3\n550,0.8\n700,0.2\n"


def test_a_grey_camera_measured_in_grey_makes_a_grey_data_set(trial) -> None:
    (trial.folder / "mono.csv").write_text(MONO, encoding="utf-8")
    light = np.random.default_rng(0).exponential(1, (2, 41, 41))
    np.save(trial.folder / "psf.npy", light)
    psf = {"measured": ["psf.npy"], "depths_cm": [4, 20], "frame": "stored", "background": "none", "throughput_mm2": 1}
    sensor = {"binning": 8, "shape": [24, 30], "spectral_response": "mono.csv"}
    root = trial.generate(camera=NO_MASK | {"sensor": sensor, "exposure": {}}, psf=psf)
    assert read_psf_stack(root / "psf").channels == ("Y",)
    dataset = open_dataset(root, "train")
    measurement, noiseless = dataset.stored(0).measurement()
    frame = dataset.stored(0).frame(0)
    assert measurement.shape == noiseless.shape == (1, *dataset.info.sensor_shape)
    # The rows of a fitted matrix keep white, and each grey value is a mixture of the scene's colours.
    assert np.sum(dataset.info.colour_matrix) == pytest.approx(1)
    assert frame.rgb.max() > 0


def test_channels_that_are_equal_are_one_and_one_serves_all(trial, stored) -> None:
    values = np.asarray(stored.values)
    equal = replace(stored, values=np.repeat(values[:, :1], 3, axis=1))
    grey = with_channels(equal, ("Y",), "--stack")
    np.testing.assert_array_equal(grey.values, values[:, :1])
    again = with_channels(grey, ("R", "G", "B"), "--stack")
    np.testing.assert_array_equal(again.values, equal.values)
    assert with_channels(stored, stored.channels, "--stack") is stored
    assert len({equal.fingerprint, grey.fingerprint, again.fingerprint}) == 3
    with pytest.raises(InputError, match=r"^--stack: "):
        with_channels(stored, ("Y",), "--stack")
