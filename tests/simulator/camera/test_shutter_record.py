"""A shutter's record, sent through JSON, gives the same windows to the last bit; no foreign record becomes a shutter."""

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.camera.shutter import (
    DualRollingShutter,
    GlobalShutter,
    RollingShutter,
    RowShutter,
    Shutter,
    shutter_from_record,
    shutter_record,
)
from simulator.errors import InputError

SECONDS = st.floats(1e-12, 1e3, allow_subnormal=False)
BINNING = st.integers(1, 4)
ROWS = 12


@st.composite
def row_shutters(draw: st.DrawFn) -> RowShutter:
    times = st.lists(SECONDS, min_size=2, max_size=2, unique=True).map(sorted)
    table = np.array(draw(st.lists(times, min_size=ROWS, max_size=ROWS)))
    return RowShutter(
        table if draw(st.booleans()) else np.asfortranarray(table[::-1]), draw(st.sampled_from([1, 2, 3]))
    )


SHUTTERS = st.one_of(
    st.builds(GlobalShutter, SECONDS, BINNING),
    st.builds(RollingShutter, SECONDS, SECONDS, st.sampled_from(["down", "up"]), BINNING),
    st.builds(DualRollingShutter, SECONDS, SECONDS, st.sampled_from(["outside_in", "centre_out"]), BINNING),
    row_shutters(),
)


@given(SHUTTERS)
def test_every_shutter_comes_back_exactly(shutter: Shutter) -> None:
    record = json.loads(json.dumps(shutter_record(shutter), allow_nan=False))
    back = shutter_from_record(record)
    assert type(back) is type(shutter)
    assert back.binning == shutter.binning
    rows = ROWS // shutter.binning if isinstance(shutter, RowShutter) else 5
    assert back.windows_s(rows).tobytes() == shutter.windows_s(rows).tobytes()
    assert shutter_record(back) == record


def test_kinds_are_called_as_in_the_configuration() -> None:
    assert shutter_record(RollingShutter(np.float32(0.5), 1e-5, "up", np.int64(2))) == {  # type: ignore[arg-type]
        "type": "rolling",
        "exposure_s": 0.5,
        "line_time_s": 1e-5,
        "direction": "up",
        "binning": 2,
    }
    assert shutter_record(DualRollingShutter(0.5, 1e-5))["type"] == "dual_rolling"
    assert shutter_record(RowShutter(np.array([[0.0, 0.5]]))) == {
        "type": "windows",
        "table_s": [[0.0, 0.5]],
        "binning": 1,
    }


class OwnShutter(GlobalShutter):
    """Its windows need not be its parent's."""


def test_a_shutter_of_another_class_is_refused() -> None:
    with pytest.raises(InputError, match=r"^shutter: "):
        shutter_record(OwnShutter(0.01))


GLOBAL = {"type": "global", "exposure_s": 0.01, "binning": 1}
ROLLING = {"type": "rolling", "exposure_s": 0.01, "line_time_s": 1e-5, "direction": "down", "binning": 1}
WINDOWS: dict[str, Any] = {"type": "windows", "table_s": [[0.0, 1.0]], "binning": 1}


@pytest.mark.parametrize(
    ("record", "words"),
    [
        (None, "got NoneType, expected a type of global, rolling"),
        ([], "got list"),
        ({}, "got None, expected a type"),
        (GLOBAL | {"type": "curtain"}, "got 'curtain'"),
        (GLOBAL | {"type": ["global"]}, r"got \['global'\]"),
        (GLOBAL | {"line_time_s": 1e-5}, r"got \['binning', 'exposure_s', 'line_time_s'\] for 'global'"),
        ({"type": "global", "exposure_s": 0.01}, r"expected \['binning', 'exposure_s'\]"),
        (GLOBAL | {"exposure_s": "inf"}, "exposure_s"),
        (GLOBAL | {"exposure_s": True}, "exposure_s"),
        (GLOBAL | {"exposure_s": 10**30}, "exposure_s"),
        (GLOBAL | {"exposure_s": 10**400}, "exposure_s"),
        (GLOBAL | {"exposure_s": -0.01}, "exposure_s:"),
        (GLOBAL | {"exposure_s": float("nan")}, "exposure_s:"),
        (GLOBAL | {"binning": 1.0}, "binning is 1.0"),
        (GLOBAL | {"binning": 0}, "binning:"),
        (ROLLING | {"direction": "left"}, "direction:"),
        (ROLLING | {"direction": 1}, "direction is 1; expected text"),
        (WINDOWS | {"table_s": [[0.0, 1.0], [1.0]]}, "table_s"),
        (WINDOWS | {"table_s": [[0.0, None]]}, "table_s"),
        (WINDOWS | {"table_s": {"0": 1}}, "table_s"),
        (WINDOWS | {"table_s": [[1.0, 0.5]]}, "opens at 1 s and closes at 0.5 s"),
    ],
)
def test_foreign_and_damaged_records_are_refused(record: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        shutter_from_record(record)
