"""Margins, field stops and angular responses of a configuration: what the parts get, and what is refused in one line."""

import re

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.errors import InputError
from simulator.types import Clip

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")
PIXEL = 19.2e-6 / 1.9e-3  # tangent of the trial camera's pixel; its image is 16 x 20 of 48 x 60 pixels


SCENE = {"family": "./plugins.py:boxes", "size": [16, 20]}


def assembly(trial, scene=None, camera=None) -> Assembly:
    return Assembly(load_config(trial.write(scene=SCENE | (scene or {}), camera=camera or {})))


@pytest.mark.parametrize(
    ("scene", "camera", "margin"),
    [
        ({}, {}, (0, 0)),
        ({"margin": 7}, {}, (7, 7)),
        # Half of 20 pixels ends 5.77 degrees beside the axis, 36.02 pixels 20 degrees; half of 16 at 4.62, 33.8 at 18.85.
        ({"margin_deg": 20 - 5.7692}, {}, (26, 27)),
        ({"margin": "auto"}, {"field_stop_deg": "image"}, (0, 0)),
        ({"margin": "auto"}, {"field_stop_deg": 20.0}, (10, 8)),
        ({"margin": "auto"}, {"field_stop_deg": [10.0, 20.0]}, (1, 8)),
    ],
)
def test_margins_reach_as_far_as_they_are_asked_to(trial, scene, camera, margin) -> None:
    view = assembly(trial, scene={"surroundings": "black"} | scene if scene else {}, camera=camera).view
    assert view.margin == margin
    assert view.field.shape == (16 + 2 * margin[0], 20 + 2 * margin[1])


ROUGH = """

def rough() -> Mask:
    heights = np.random.default_rng(0).uniform(0, 1.2e-6, (150, 150))
    return Mask(heights, np.ones(heights.shape), pitch_m=2e-6)
"""


def outside(built: Assembly, *, simulated: bool = True) -> float:
    return built.simulated_field.light_from_outside(built.psf_stack, simulated=simulated)


@pytest.mark.slow
def test_what_an_automatic_margin_leaves_out_is_little_and_said(trial) -> None:
    trial.plugins.write_text(trial.plugins.read_text() + ROUGH)
    # A mask that throws most of its light beyond its shadow; the margin is found from one of its PSFs, of one wavelength.
    wide = assembly(trial, {"margin": "auto", "surroundings": "black"}, {"mask": {"design": "./plugins.py:rough"}})
    assert outside(wide) < 0.025
    bare = assembly(trial, scene={"margin": "auto", "surroundings": "black"})
    assert outside(bare) < 0.025
    assert wide.view.margin > bare.view.margin
    without = assembly(trial)
    assert outside(without) == outside(bare, simulated=False) > 0.5
    assert outside(assembly(trial, camera={"field_stop_deg": "image"})) == pytest.approx(0, abs=1e-6)
    record = without.simulated_field.record(without.psf_stack)
    assert (record["margin"], record["light_from_outside"]) == ([0, 0], outside(without))


def test_the_model_takes_the_whole_field_and_weighs_it_by_direction(trial) -> None:
    (trial.folder / "response.csv").write_text("0,0.8\n90,0\n")
    camera = {
        "field_stop_deg": [12.0, 40.0],
        "sensor": {"shape": [48, 60], "binning": 8, "angular_response": "response.csv"},
    }
    built = assembly(trial, scene={"margin": 10, "surroundings": "black"}, camera=camera)
    model, field = built.forward_model, built.view.field
    assert model.scene_shape == field.shape == (36, 40)
    volume = np.zeros((1, *model.stack.values.shape[:2], 36, 40), np.float32)
    seen = Clip(
        np.ones((1, 36, 40, 3), np.float32),
        np.full((1, 36, 40), 0.2, np.float32),
        np.ones((1, 36, 40), bool),
        np.array([0.0, 1]),
    )
    y, x = (np.abs(np.arange(size) - (size - 1) / 2) * PIXEL for size in (36, 40))
    angle = np.degrees(np.arctan(np.hypot(y[:, None], x)))
    stopped = np.clip((np.tan(np.radians(6)) - y) / PIXEL + 0.5, 0, 1)[:, None] * np.ones(40)
    light = PIXEL**2 * np.cos(np.radians(angle)) ** 4 * 0.8 * (1 - angle / 90) * stopped
    volume[0, -1] = light * built.camera_colour(model.stack.channels).matrix.sum(axis=1)[:, None, None]
    np.testing.assert_allclose(model.forward_clip(seen), model.forward(volume), rtol=2e-4, atol=1e-9)
    assert [path.name for path in built.input_files].count("response.csv") == 1


@pytest.mark.parametrize(
    ("scene", "camera", "key"),
    [
        ({}, {"field_stop_deg": 9.0}, "camera.field_stop_deg"),
        ({"margin": 4000, "surroundings": "black"}, {}, "scene.margin"),
        ({"margin_deg": 79.0, "surroundings": "black"}, {}, "scene.margin_deg"),
    ],
)
def test_fields_that_cannot_be_are_refused_in_one_line(trial, scene, camera, key) -> None:
    with pytest.raises(InputError, match=rf"^{re.escape(key)}: ") as caught:
        _ = assembly(trial, scene=scene, camera=camera).view
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("sections", "key"),
    [
        ({"scene": {"family": None, "source": "./plugins.py:frames", "margin": 4}}, "scene.surroundings"),
        ({"scene": {"margin": 4, "margin_deg": 3.0, "surroundings": "black"}}, "scene.margin_deg"),
        ({"scene": {"margin": -1}}, "scene.margin"),
        ({"scene": {"margin": "wide"}}, "scene.margin"),
        ({"scene": {"surroundings": "no_such.png", "margin": 4}}, "scene.surroundings"),
        ({"scene": {"surroundings": "black"}}, "scene.surroundings"),
        ({"camera": {"field_stop_deg": 180.0}}, "camera.field_stop_deg"),
        ({"camera": {"field_stop_deg": "picture"}}, "camera.field_stop_deg"),
        ({"camera": {"sensor": {"shape": [48, 60], "angular_response": "none.csv"}}}, "camera.sensor.angular_response"),
        (
            {"camera": {"sensor": {"shape": [48, 60], "angular_response": {"power": 2}}}},
            "camera.sensor.angular_response",
        ),
    ],
)
def test_sections_that_make_no_sense_are_refused_at_load_with_their_place(trial, sections, key) -> None:
    trial.plugins.write_text(trial.plugins.read_text() + "\n\ndef frames(view):\n    return None\n")
    with pytest.raises(InputError, match=rf"yaml:\d+:\d+: {re.escape(key)}\b"):
        load_config(trial.write(**sections | {"scene": SCENE | sections.get("scene", {})}))


def test_no_margin_goes_round(trial) -> None:
    path = trial.write(scene=SCENE | {"margin": 4, "surroundings": "black"})
    with pytest.raises(InputError, match=r"forward\.boundary: "):
        load_config(path, ["forward.boundary=circular"])
