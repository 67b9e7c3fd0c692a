"""The field of view: light by direction, stops, responses; how much arrives from beside an image, by explicit sums."""

import numpy as np
import pytest

from simulator.camera.field import (
    AngularTable,
    Arrival,
    CosinePower,
    FieldOfView,
    automatic_margin,
    check_margin,
    field_from_record,
    margin_of_angle,
    read_angular_response,
    stop_tangents,
)
from simulator.errors import InputError
from simulator.render.lensless import shadow_psfs
from simulator.types import View

VIEW = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)  # of the default camera: 65.8 degrees
SMALL = View((4, 6), 1e-3, 2e-3, 0.036, 0.2)


def test_a_stop_passes_the_part_of_each_pixel_inside_it():
    # In tangents a pixel is 0.5 wide: the rows' edges are -1, -0.5 .. 1, the columns' -1.5 .. 1.5.
    passed = FieldOfView(False, stop=(0.6, 1.5)).irradiance(SMALL) / FieldOfView(False).irradiance(SMALL)
    np.testing.assert_allclose(passed, np.repeat([[0.2], [1], [1], [0.2]], 6, axis=1), rtol=1e-6)
    passed = FieldOfView(stop=(2, 0.75)).irradiance(SMALL) / FieldOfView().irradiance(SMALL)
    np.testing.assert_allclose(passed, np.tile([0, 0.5, 1, 1, 0.5, 0], (4, 1)), rtol=1e-6)


def test_a_stop_right_around_the_image_leaves_the_image_as_it_is_and_nothing_beside_it():
    stop = FieldOfView(stop=stop_tangents(VIEW, "image"))
    wide = View((256, 256), VIEW.pixel_pitch_m, VIEW.distance_m, 0.036, 0.2)
    light = stop.irradiance(wide)
    np.testing.assert_allclose(light[64:-64, 64:-64], FieldOfView().irradiance(VIEW), rtol=1e-6)
    light[64:-64, 64:-64] = 0
    np.testing.assert_allclose(light, 0, atol=1e-9 * light.max() + 1e-12)


def test_stops_are_full_angles():
    assert stop_tangents(VIEW, (90, 120)) == pytest.approx((1, np.sqrt(3)))
    assert stop_tangents(VIEW, 90.0) == pytest.approx((1, 1))
    with pytest.raises(InputError, match=r"^field_stop_deg: .*65\.79"):
        stop_tangents(VIEW, 60.0)


def test_responses_to_oblique_light_multiply_by_the_angle_to_the_axis(tmp_path):
    tangent = np.hypot(*np.meshgrid(SMALL.tangents[1], SMALL.tangents[0]))
    expected = np.cos(np.arctan(tangent)) ** 3
    power = FieldOfView(angular_response=CosinePower(3.0)).irradiance(SMALL) / FieldOfView().irradiance(SMALL)
    np.testing.assert_allclose(power, expected, rtol=1e-6)
    path = tmp_path / "response.csv"
    path.write_text("# measured\nangle_deg,response\n0,0.9\n45, 0.5\n90,0\n")
    table = read_angular_response(path)
    assert table == AngularTable((0.0, 45.0, 90.0), (0.9, 0.5, 0.0))
    measured = FieldOfView(angular_response=table).irradiance(SMALL) / FieldOfView().irradiance(SMALL)
    angle = np.degrees(np.arctan(tangent))
    np.testing.assert_allclose(measured, np.where(angle < 45, 0.9 - 0.4 * angle / 45, 1 - angle / 90), rtol=1e-6)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", ""),
        ("0,1\n80,0.5\n", ""),
        ("5,1\n90,0\n", ""),
        ("0,1\n90,0.5\n45,0.1\n", ""),
        ("0,1\n90,-0.5\n", ""),
        ("0,1\n90,nan\n", ":2"),
        ("0,1\nfourty,0.5\n90,0\n", ":2"),
        ("angle,response\n0,1\n90,0,3\n", ":3"),
        ("0.0,1,x\n0,1\n90,0\n", ":1"),
    ],
)
def test_tables_that_are_no_response_are_refused(tmp_path, text, named):
    path = tmp_path / "response.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"^.*response\.csv{named}: "):
        read_angular_response(path)


@pytest.mark.parametrize(
    "field",
    [
        FieldOfView(),
        FieldOfView(False, (0.7, 1.2), CosinePower(2.0)),
        FieldOfView(angular_response=AngularTable((0, 90), (1, 0))),
    ],
)
def test_a_record_gives_the_field_back(field):
    assert field_from_record(field.record()) == field


@pytest.mark.parametrize(
    "changed",
    [
        {"angular_response": {}},
        {"angular_response": {"cosine_power": -5}},
        {"angular_response": {"cosine_power": float("inf")}},
        {"stop_tangents": [1]},
        {"stop_tangents": [float("nan"), 1]},
        {"stop_tangents": [-1, -1]},
        {"stop_tangents": "wide"},
        {"vignetting": "no"},
    ],
)
def test_a_damaged_record_is_refused(changed):
    with pytest.raises(InputError, match=r"^field: "):
        field_from_record(FieldOfView().record() | changed)


@pytest.mark.parametrize("margin", [(0, 0), (2, 0), (3, 4)])
def test_the_light_left_out_is_that_of_every_direction_times_what_of_its_psf_lands(margin):
    rng = np.random.default_rng(0)
    psf, sensor = rng.random((4, 7)), (6, 8)
    field = FieldOfView(stop=(2.4, 2.9), angular_response=CosinePower(1.0))
    total = inside = 0.0
    for i in range(-20, 20):
        for j in range(-20, 20):
            tangents = (i + 0.5) / 2, (j + 0.5) / 2
            cosine = (1 + tangents[0] ** 2 + tangents[1] ** 2) ** -0.5
            open_ = [np.clip((edge - abs(t)) * 2 + 0.5, 0, 1) for edge, t in zip((2.4, 2.9), tangents, strict=True)]
            landed = 0.0
            for a in range(4):
                for b in range(7):
                    row, column = (
                        i + 3 + a - 2,
                        j + 4 + b - 3,
                    )  # the sensor's middle is between pixels, like the scene's
                    landed += psf[a, b] * (0 <= row < 6 and 0 <= column < 8)
            light = landed * cosine**5 * open_[0] * open_[1]
            total += light
            inside += light * (-2 - margin[0] <= i < 2 + margin[0] and -3 - margin[1] <= j < 3 + margin[1])
    found = Arrival(psf[None], sensor, SMALL, field).left_out(margin)
    assert found == pytest.approx(1 - inside / total, rel=1e-4)


def test_an_automatic_margin_leaves_out_as_little_as_asked_and_no_less_would_do():
    """The default camera's aperture and sensor; 58.6, 22, 7.8 and 2.8 % are an independent brute force's."""
    shadow = shadow_psfs(np.ones((701, 701)), 10e-6, 1.9e-3, [0.036], 19.2e-6)
    arrival = Arrival(shadow, (456, 684), VIEW, FieldOfView())
    found = [100 * arrival.left_out((margin, margin)) for margin in (0, 64, 128, 192)]
    np.testing.assert_allclose(found, [58.6, 22.0, 7.8, 2.8], atol=0.1)
    rows, columns = arrival.margin()
    assert columns > rows  # the sensor is wider than high
    assert arrival.left_out((rows, columns)) <= 0.02 < arrival.left_out((rows - 4, columns - 4))
    assert automatic_margin(arrival, VIEW, stop_tangents(VIEW, "image")) == (0, 0)
    assert automatic_margin(arrival, VIEW, stop_tangents(VIEW, (70.0, 178.0))) == (6, columns)


def test_margins_in_degrees_and_how_far_they_may_reach():
    half = np.degrees(np.arctan(VIEW.tan_half_width))
    rows, columns = margin_of_angle(VIEW, 10.0)
    assert rows == columns
    assert np.tan(np.radians(half + 10)) == pytest.approx((64 + rows) * 19.2e-6 / 1.9e-3, abs=19.2e-6 / 1.9e-3)
    with pytest.raises(InputError, match=r"^margin_deg: .*47\.1"):
        margin_of_angle(VIEW, 48.0)
    most = int((np.tan(np.radians(80)) - VIEW.tan_half_width) / (19.2e-6 / 1.9e-3))
    assert check_margin(VIEW, (most, most)) == (most, most)
    with pytest.raises(InputError, match=rf"^margin: .*{most}"):
        check_margin(VIEW, (most + 1, 0))


def test_an_image_beyond_the_steepest_angle_leaves_no_room_for_a_margin():
    """Its width reaches to 82.4 degrees: no number of degrees or pixels would do, and none is named as the most."""
    wide = View((64, 1500), VIEW.pixel_pitch_m, VIEW.distance_m, 0.036, 0.2)
    assert np.degrees(np.arctan(wide.tan_half_width)) == pytest.approx(82.48, abs=0.01)
    with pytest.raises(InputError, match=r"^margin_deg: (?!.*at most).*82\.48"):
        margin_of_angle(wide, 5.0)
    with pytest.raises(InputError, match=r"^margin: (?!.*at most).*82\.48"):
        check_margin(wide, (4, 4))
    assert check_margin(wide, (4, 0)) == (4, 0)
