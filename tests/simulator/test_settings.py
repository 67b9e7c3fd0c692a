"""Parts that are sections of the configuration: units, keys and refusals."""

import json
from dataclasses import dataclass, field
from typing import Annotated

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import BaseModel, TypeAdapter

from simulator.camera.shutter import RollingShutter
from simulator.errors import InputError
from simulator.settings import NO_KEY, Quantity, Range, Settings, fields_from, keys_of
from simulator.validation import find_problems, validate


@dataclass(frozen=True)
class Lamp(Settings):
    """A lamp.

    Attributes:
        pulse_s: how long it is on.
        count: how many there are.
        place: decided elsewhere.
        dim: whether it is dimmed.
    """

    pulse_s: Annotated[float, Quantity(1e-3, 1e3, "us", key="pulse_us", below="light takes time")]
    count: Annotated[int, Range(1, 9)] = 1
    place: int = field(default=0, metadata=NO_KEY)
    dim: bool = False

    def __post_init__(self) -> None:
        if self.dim and self.count > 1:
            raise InputError("count", "several lamps cannot be dimmed")


class Room(BaseModel):
    lamp: Lamp


def problems_of(data: object) -> list[str]:
    with pytest.raises(ValueError, match="Room") as caught:
        validate(Room, {"lamp": data})
    return [str(problem) for problem in find_problems(caught.value, Room, {"lamp": data})]  # pyright: ignore[reportArgumentType]


@given(st.floats(1e-3, 1e3))
@example(494.6764426824202)
def test_a_quantity_comes_back_as_the_shortest_number_that_means_the_same(pulse_us: float) -> None:
    room = validate(Room, {"lamp": {"pulse_us": pulse_us}})
    assert room.lamp == Lamp(pulse_us * 1e-6)
    shown = room.model_dump(mode="json")["lamp"]["pulse_us"]
    assert shown * 1e-6 == pulse_us * 1e-6
    assert len(repr(shown)) <= len(repr(pulse_us))


def test_the_keys_are_the_fields_in_their_units_and_what_the_docstring_says() -> None:
    found = {key: (entry.name, entry.description) for key, entry in keys_of(Lamp).items()}
    assert found == {
        "pulse_us": ("pulse_s", "how long it is on, microseconds"),
        "count": ("count", "how many there are"),
        "dim": ("dim", "whether it is dimmed"),
    }
    assert fields_from(Lamp, {"pulse_us": 3, "dim": True}) == {"pulse_s": 3e-6, "dim": True}
    schema = TypeAdapter(Lamp).json_schema()
    assert list(schema["properties"]) == list(found)
    assert schema["required"] == ["pulse_us"]
    assert json.loads(json.dumps(schema))["additionalProperties"] is False


@pytest.mark.parametrize(
    ("data", "place", "words"),
    [
        ({}, "lamp.pulse_us", "how long it is on, microseconds"),
        ({"pulse_us": 1e-4}, "lamp.pulse_us", "light takes time"),
        ({"pulse_us": "1"}, "lamp.pulse_us", "a number"),
        ({"pulse_us": 1.0, "place": 3}, "lamp.place", "unknown key"),
        ({"pulse_us": 1.0, "pulse_s": 3}, "lamp.pulse_s", "pulse_us"),
        ({"pulse_us": 1.0, "count": 3, "dim": True}, "lamp.count", "cannot be dimmed"),
        (3, "lamp", "a mapping of keys to values"),
    ],
)
def test_faults_are_named_by_their_key(data: object, place: str, words: str) -> None:
    (problem,) = problems_of(data)
    assert problem.startswith(f"{place}: ")
    assert words in problem


def test_a_default_of_the_section_is_given_in_the_unit_of_its_key() -> None:
    assert validate(Shutters, {"shutter": {"type": "rolling", "line_time_us": 10.0}}).shutter == RollingShutter(
        10.0 * 1e-3, 10.0 * 1e-6
    )


class Shutters(BaseModel):
    shutter: RollingShutter
