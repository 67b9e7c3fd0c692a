"""The PSF explorer says where a point source's light falls and what it weighs: checked against the forward model."""

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from simulator.camera.field import FieldOfView, field_from_record
from simulator.camera.forward import ForwardModel
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.plots.report.psfs import explorer, point_sources
from simulator.types import View

SENSOR, SCENE, MARGIN = (24, 36), (10, 12), (4, 10)
PITCH_M, DISTANCE_M = 1e-4, 1.9e-3
RECORD = FieldOfView(stop=(0.4, 0.6)).record() | {"margin": list(MARGIN)}


def make_stack(depths: int = 3, **provenance: Any) -> PsfStack:
    values = np.random.default_rng(2).random((depths, 3, 9, 14), dtype=np.float32)
    return PsfStack(values, np.linspace(0.04, 0.2, depths), PITCH_M, ("R", "G", "B"), "a" * 64, provenance)


@pytest.fixture
def info(samples: ModuleType):
    return samples.make_info(sensor_shape=SENSOR, scene_shape=SCENE, field_of_view=RECORD)


def drawn(data: dict, psf: np.ndarray, row: int, column: int) -> np.ndarray:
    """What page.js draws: the PSF at columns - origin and rows - origin, cropped by the sensor."""
    image = np.zeros((3, *data["sensor"]))
    top, left = data["rows"][row] - data["origin"][0], data["columns"][column] - data["origin"][1]
    for y, x in np.ndindex(*data["size"]):
        if 0 <= top + y < image.shape[1] and 0 <= left + x < image.shape[2]:
            image[:, top + y, left + x] = psf[:, y, x]
    return image * data["weights"][row][column]


@pytest.mark.parametrize(("row", "column"), [(1, 26), (13, 6), (9, 16)])
def test_shift_and_weight_are_the_measurement_s(info, row: int, column: int) -> None:
    """Points in the margin, whose light is cropped and partly stopped, and one in the image; an asymmetric PSF."""
    stack = make_stack(mask_to_sensor_m=DISTANCE_M)
    _, data = explorer(info, stack)
    view = View(SCENE, PITCH_M, DISTANCE_M, 0.04, 0.2, MARGIN).field
    light = field_from_record(RECORD).irradiance(view)
    volume = np.zeros((1, 3, 3, *view.shape), np.float32)
    volume[0, 1, :, row, column] = light[row, column]
    measured = ForwardModel(stack, SENSOR, view.shape).forward(volume)
    expected = drawn(data, np.asarray(stack.values[1]), row, column)  # every pixel of so small a field is a step
    assert expected.max() > 0.05
    np.testing.assert_allclose(measured / light.max(), expected, atol=1e-4)


def test_places_are_told_in_words(info) -> None:
    _, data = explorer(info, make_stack(mask_to_sensor_m=DISTANCE_M))
    right = np.degrees(np.arctan(15.5 * PITCH_M / DISTANCE_M))
    assert data["columnNames"][-1] == f"{right:.1f}° right, column 22, beside the image"
    assert data["columnNames"][10].endswith("left, column 1 of 12")
    assert data["rowNames"][0].split("°")[1] == " above, row -3, beside the image"
    assert data["rowNames"][13].endswith("below, row 10 of 10")
    assert data["depths"] == ["4 cm", "12 cm", "20 cm"]


def test_large_fields_and_many_depths_are_chosen_from_evenly(samples: ModuleType) -> None:
    field = FieldOfView().record() | {"margin": [300, 0]}
    info = samples.make_info(sensor_shape=(24, 36), scene_shape=(10, 12), field_of_view=field)
    html, data = explorer(info, make_stack(40, mask_to_sensor_m=DISTANCE_M))
    assert len(data["rows"]) == 101
    assert (data["rows"][0], data["rows"][-1]) == (7 - 300, 16 + 300)
    assert (data["depths"][0], data["depths"][-1], len(data["depths"])) == ("4 cm", "20 cm", 32)
    assert "32 of 40 depths" in html


def test_without_a_known_distance_there_is_no_weight(samples: ModuleType, info) -> None:
    assert point_sources(info, make_stack()).weights is None
    config = info.config | {"camera": {"mask_to_sensor_mm": 1.9, "gap": None, "substrate": None}}
    known = point_sources(replace(info, config=config), make_stack())
    asked = point_sources(info, make_stack(mask_to_sensor_m=DISTANCE_M))
    assert known.weights is not None
    assert asked.weights is not None
    np.testing.assert_allclose(known.weights, asked.weights)
    behind_glass = {"camera": {"mask_to_sensor_mm": 1.9, "gap": [{"mm": 1.9, "n": 1.5}], "substrate": None}}
    assert point_sources(replace(info, config=behind_glass), make_stack()).weights is None


@pytest.mark.parametrize("margin", [[1], "ab", [-1, 2], [1e9, 1], [True, True]])
def test_damaged_margins_are_refused(info, margin: object) -> None:
    with pytest.raises(InputError, match="margin"):
        point_sources(replace(info, field_of_view=RECORD | {"margin": margin}), make_stack())
