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


def pictures(trial) -> dict:
    """A patch of spots at three depths, each moved by hand and exposed anew, as images of a configuration."""
    rng = np.random.default_rng(2)
    light = np.zeros((3, 61, 61))
    for y, x in rng.integers(-18, 18, (25, 2)):
        light[:, 30 + y : 33 + y, 30 + x : 33 + x] += 1
    moved = [
        e * np.roll(plane, s, (0, 1)) for plane, e, s in zip(light, (1, 2, 0.5), ((0, 0), (5, -3), (0, 0)), strict=True)
    ]
    np.save(trial.folder / "moved.npy", np.stack(moved))
    return {
        "measured": ["moved.npy"],
        "depths_cm": [500, 600, 700],  # so far away that nothing is magnified
        "frame": "stored",
        "background": "none",
        "throughput_mm2": 1,
    }


def test_measured_planes_are_registered_and_their_exposures_made_equal(trial) -> None:
    images = pictures(trial)
    found = build(trial, **images, planes={"depths_cm": [500, 600, 650]})
    record = found.provenance["registration"]
    # Between planes 1 m apart m changes by 6e-5: a thousandth of a pixel here.
    np.testing.assert_allclose(record["shifts_px"], [[0, 0], [-3, 5], [0, 0]], atol=5e-3)
    np.testing.assert_allclose(np.divide(record["exposures"], record["exposures"][0]), [1, 2, 0.5], rtol=2e-3)
    assert max(plane["error"] for plane in found.provenance["interpolation"]["planes"]) < 0.03
    still = build(trial, **images, planes={"depths_cm": [500], "registration": False, "equal_exposure": False})
    assert "registration" not in still.provenance


def test_a_plane_that_is_of_no_use_is_refused_unless_asked_for(trial) -> None:
    raw = {"depths_cm": [550], "registration": False, "equal_exposure": False}
    with pytest.raises(InputError, match=r"^accept_error: .*psf\.planes\.accept_error"):
        build(trial, **pictures(trial), planes=raw)
    (plane,) = build(trial, **pictures(trial), planes=raw | {"accept_error": 5}).provenance["interpolation"]["planes"]
    assert plane["error"] > 1


@pytest.mark.parametrize(("kind", "registered"), [("computed", False), ("captured", True)])
def test_stored_stacks_are_registered_only_where_they_were_measured(trial, stored, kind, registered) -> None:
    write_psf_stack(trial.folder / "other", replace(stored, provenance=stored.provenance | {"kind": kind}))
    found = build(trial, measured="other", planes={"depths_cm": [5]})
    assert ("registration" in found.provenance) == registered


def test_a_stack_is_registered_only_once(trial, stored) -> None:
    told = {"kind": "measured", "registration": {"by": "hand"}}
    write_psf_stack(trial.folder / "other", replace(stored, provenance=stored.provenance | told))
    assert build(trial, measured="other", planes={"depths_cm": [5]}).provenance["registration"] == {"by": "hand"}


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
