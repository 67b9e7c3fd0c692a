"""Every preset is a valid configuration whose scenes its camera can see and its sensor can hold."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset import generate, open_dataset
from simulator.dataset.clips import check_parameters
from simulator.errors import InputError
from simulator.presets import preset_names, preset_text
from simulator.seeds import generator

NAMES = preset_names()
SMALL = [name for name in NAMES if name.endswith("_64")]
IMPORTED = ["something_something_v2", "youtube_vos"]
THESIS = ["video_thesis", "youtube_vos"]
CLIPS = ["activity_64", "high_speed_64", *IMPORTED, "video_thesis"]
SHADOWS = [name for name in NAMES if name != "two_sensors"]  # whose lens casts a spot
LARGE = [
    "activity_64",
    "flying_things",
    "flying_things_64",
    "high_speed_64",
    "moving_3d_64",
]  # masks take seconds to design
WITH_MASKS = [pytest.param(name, marks=pytest.mark.slow if name in LARGE else []) for name in SHADOWS]
COARSE_MASK = ["camera.mask.iterations=2"]  # as wide as after all of them: what can be seen is the same


@pytest.fixture
def preset(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    path = tmp_path / f"{request.param}.yaml"
    path.write_text(preset_text(request.param), encoding="utf-8")
    return path


def test_names() -> None:
    assert NAMES[0] == "flying_things"
    assert {"flying_things_64", "endoscopy", "endoscopy_64", *CLIPS} <= set(NAMES)
    with pytest.raises(InputError, match="did you mean 'endoscopy_64'"):
        preset_text("endoscopy64")


@pytest.mark.parametrize("preset", NAMES, indirect=True)
def test_a_preset_says_what_it_is_and_how_to_use_it(preset: Path) -> None:
    lines = preset.read_text().splitlines()
    assert lines[0].startswith("# ")
    assert max(map(len, lines)) <= 120
    assert any("flatlight " in line for line in lines[1:5])
    assert "# Run it:" in preset.read_text()
    config = load_config(preset)
    Assembly(config).scene_plugin.bind(config.scene.params)  # every parameter is one that its scenes take


@pytest.mark.parametrize("preset", WITH_MASKS, indirect=True)
def test_the_whole_psf_and_scene_fit_the_sensor(preset: Path) -> None:
    """Along its longer side the sensor takes in what a mask casts from the picture's edges at the nearest depth."""
    config = load_config(preset, [] if preset.stem == "rolling_diffusercam" else COARSE_MASK)
    view = Assembly(config).view
    assert config.camera.mask is not None
    cast_m = config.camera.mask.params["width_mm"] * 1e-3 * (1 + view.distance_m / view.near_m)
    needed = cast_m / view.pixel_pitch_m + view.shape[1]
    assert needed <= config.camera.sensor.shape[1] * 1.001
    wide = np.degrees(2 * np.arctan(view.tan_half_width))
    # As wide as the default camera; 160 pixels of 19.2 um at 1.9 mm see 78 degrees, 128 of 52 um at 10 mm 37 degrees.
    least = {**dict.fromkeys(THESIS, 77), "rolling_diffusercam": 36}.get(preset.stem, 60)
    assert least < wide < least + (10 if least == 60 else 2)


@pytest.mark.parametrize("preset", CLIPS, indirect=True)
def test_the_shutter_takes_in_the_whole_clip_and_its_slivers_come_out_even(preset: Path) -> None:
    """The last row closes within the last frame: none is dropped, none is missing."""
    config = load_config(preset)
    params, rows, chosen = config.scene.params, config.camera.sensor.shape[0], config.dataset
    shutter = Assembly(config).shutter
    assert check_parameters(params, shutter, rows, chosen)
    frame_s = 1 / params["frames_per_second"]
    assert 0 <= params["frames"] * frame_s - shutter.duration_s(rows) < frame_s
    assert chosen.slivers == 10
    assert shutter.separable_frames(rows) == 10
    sizes = {"frames": 60, "size": (160, 160), "shape": (320, 384)}
    if preset.stem in THESIS:
        assert sizes == {"frames": params["frames"], "size": config.scene.size, "shape": config.camera.sensor.shape}
        assert config.camera.noise.std == 0.005  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("preset", ["rolling_diffusercam"], indirect=True)
def test_the_published_shutter_reads_all_of_its_sensor(preset: Path) -> None:
    """2160 rows, 27.52 us per pair, 1320 us open, dark level 103: 140 frames at 4500 per second (Antipa et al. 2019)."""
    config = load_config(preset)
    shutter, rows = Assembly(config).shutter, config.camera.sensor.shape[0]
    windows = shutter.physical_windows_s(2160)
    assert rows * shutter.binning == 2160
    assert windows[[0, 1, 1079, 1080, 2159], 0] == pytest.approx([0, 27.52e-6, 1079 * 27.52e-6, 1079 * 27.52e-6, 0])
    assert np.ptp(windows, axis=1) == pytest.approx(np.full(2160, 1320e-6))
    params = config.scene.params
    assert params["frames"] == 140
    assert params["frames_per_second"] == pytest.approx(4500, rel=0.01)
    assert check_parameters(params, shutter, rows, config.dataset)
    assert config.dataset.slivers == shutter.separable_frames(rows) == 20
    assert Assembly(config).sensor.black_level_dn == 103


@pytest.mark.slow
def test_two_sensors_see_the_same_scene_at_the_same_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = []
    for name in ("high_speed_64", "two_sensors"):
        (tmp_path / f"{name}.yaml").write_text(preset_text(name), encoding="utf-8")
        cameras.append(Assembly(load_config(tmp_path / f"{name}.yaml", COARSE_MASK if not cameras else [])))
    lensless, lens = cameras
    assert lens.view == lensless.image_view  # a lens brings no light from beside the image to it
    durations = [each.shutter.duration_s(each.config.camera.sensor.shape[0]) for each in cameras]
    assert durations[0] == pytest.approx(durations[1], abs=1e-6)
    windows = lens.shutter.windows_s(64)
    assert np.ptp(windows[..., 0]) == np.ptp(windows[..., 1]) == 0
    counts = [each.config.dataset for each in cameras]
    assert [(each.train, each.validation, each.test, each.slivers, each.ground_truth) for each in counts] == [
        (4000, 200, 200, 10, "frames")
    ] * 2
    psf = np.asarray(lens.psf_stack.values)[0]
    middle = slice(psf.shape[-1] // 2 - 1, psf.shape[-1] // 2 + 2)
    # The Airy pattern of 0.2 mm is 12 um wide, a third of a pixel: all but a few per cent falls on three by three.
    assert psf[:, middle, middle].sum(axis=(1, 2)) == pytest.approx(psf.sum(axis=(1, 2)), rel=0.05)

    monkeypatch.chdir(tmp_path)
    one = ["dataset.train=1", "dataset.validation=0", "dataset.test=0"]
    changes = {"high_speed_64": ["camera.exposure.full_scale=1e-5", *COARSE_MASK, *one], "two_sensors": one}
    sets = [generate(f"{name}.yaml", told).path for name, told in changes.items()]
    both = [open_dataset(path, "train")[0] for path in sets]
    assert [sample.measurement.shape for sample in both] == [(3, 160, 192), (3, 64, 64)]
    for values in ("rgb", "depth_m", "frame_edges_s"):
        np.testing.assert_array_equal(getattr(both[0], values), getattr(both[1], values))
    # What the lens sees is the mean frame, upright, in the camera's colours and dimmer at the edges.
    mean = both[0].rgb.mean(axis=(0, -1))
    assert np.corrcoef(both[1].measurement.mean(axis=0).ravel(), mean.ravel())[0, 1] > 0.95


@pytest.mark.slow
@pytest.mark.parametrize("preset", SMALL, indirect=True)
def test_its_scenes_are_rendered_for_learning(preset: Path) -> None:
    """The documented size, samples and frames; one clip, here in tiny pictures, lies between near and far."""
    config = load_config(preset, ["scene.samples_per_pixel=1", *COARSE_MASK])
    assert config.scene.size == (64, 64)
    assert load_config(preset).scene.params["samples_per_pixel"] == (16 if preset.stem == "endoscopy_64" else 4)
    frames = config.scene.params.get("frames", 1)
    assert frames == (20 if preset.stem in ("high_speed_64", "activity_64", "moving_3d_64") else 1)
    view = Assembly(config).view
    tiny = replace(view, shape=(8, 8), pixel_pitch_m=view.pixel_pitch_m * 8)
    source = replace(Assembly(config, "scalar_rgb").source, view=tiny)  # pyright: ignore[reportArgumentType]
    clip = source.clip(0, generator(config.seed, "train", 0, "scene"))
    assert len(clip.rgb) == frames
    seen = clip.depth_m[clip.valid]
    assert seen.size > 0.05 * clip.depth_m.size
    assert view.near_m <= seen.min()
    assert seen.max() <= view.far_m
    assert Assembly(config).scene_plugin.takes_renderer
