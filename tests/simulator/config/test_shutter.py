"""``camera.shutter``: every kind, and every mistake at its line and column."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, RowShutter
from simulator.config import config_from_dict, dump, json_schema, load_config
from simulator.errors import InputError

SHUTTER = "shutter: {exposure_ms: 5}"
ROWS = 64 * 4  # of the fixture's sensor
FUNCTIONS = """
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field


def staircase(rows: int, *, steps: Annotated[int, Field(ge=1)] = 4, exposure_ms: float = 1.0, table: Path | None = None):
    opening = np.arange(rows) * steps // rows * 1e-3
    if table is not None:
        opening += float(table.read_text())
    return np.stack([opening, opening + exposure_ms * 1e-3], axis=1)


def short(rows: int):
    return np.ones((3, 2)) * [0, 1]


def words(rows: int):
    return "open"


def backwards(rows: int):
    return [(0, 1)] * (rows - 1) + [(2, 1)]


def broken(rows: int):
    raise ZeroDivisionError("no rows")
"""


@pytest.fixture
def functions(tmp_path: Path) -> None:
    (tmp_path / "shutters.py").write_text(FUNCTIONS, encoding="utf-8")


def _table(rows: int = ROWS) -> np.ndarray:
    opening = np.linspace(0, 0.004, rows)
    return np.stack([opening, opening + 0.002], axis=1)


def _csv(table: np.ndarray, head: str = "") -> str:
    return head + "".join(f"{opening!r},{closing!r}\n" for opening, closing in table.tolist())


@pytest.mark.parametrize(
    ("yaml", "expected"),
    [
        (SHUTTER, GlobalShutter(5e-3, 4)),
        ("shutter: {}", GlobalShutter(10e-3, 4)),
        ("shutter: {type: global, exposure_ms: 2}", GlobalShutter(2e-3, 4)),
        ("shutter: {type: rolling, line_time_us: 20}", RollingShutter(10e-3, 20e-6, "down", 4)),
        (
            "shutter: {type: rolling, exposure_ms: 3, line_time_us: 20, direction: up}",
            RollingShutter(3e-3, 20e-6, "up", 4),
        ),
        ("shutter: {type: dual_rolling, line_time_us: 9.5}", DualRollingShutter(10e-3, 9.5e-6, "outside_in", 4)),
        (
            "shutter: {type: dual_rolling, line_time_us: 9.5, order: centre_out}",
            DualRollingShutter(10e-3, 9.5e-6, "centre_out", 4),
        ),
    ],
)
def test_every_kind_becomes_its_shutter_in_seconds(write: Callable[..., Path], yaml: str, expected) -> None:
    config = load_config(write(SHUTTER, yaml))
    shutter = Assembly(config).shutter
    assert type(shutter) is type(expected)
    for name, value in vars(expected).items():
        assert getattr(shutter, name) == (pytest.approx(value, rel=1e-14) if isinstance(value, float) else value)
    assert config_from_dict(dump(config), config.base_dir) == config


@pytest.mark.parametrize(
    ("head", "unit"),
    [
        ("", (1, 1)),
        ("open_s,close_s\n", (1, 1)),
        ("# measured\nOpen_ms, close_ms\n", (1e3, 1e3)),
        ("open_us,close_ms\n\n", (1e6, 1e3)),
        ("open_ms;close_ms\n", (1e3, 1e3)),
    ],
)
def test_windows_from_a_table(write: Callable[..., Path], tmp_path: Path, head: str, unit: tuple[float, float]) -> None:
    (tmp_path / "rows.csv").write_text(_csv(_table() * unit, head), encoding="utf-8")
    shutter = Assembly(load_config(write(SHUTTER, "shutter: {type: windows, file: rows.csv}"))).shutter
    assert isinstance(shutter, RowShutter)
    assert shutter.binning == 4
    np.testing.assert_allclose(shutter.table_s, _table(), rtol=1e-14)


def test_windows_from_an_array(write: Callable[..., Path], tmp_path: Path) -> None:
    np.save(tmp_path / "rows.npy", _table())
    config = load_config(write(SHUTTER, "shutter: {type: windows, file: rows.npy}"))
    shutter = Assembly(config).shutter
    assert isinstance(shutter, RowShutter)
    assert np.array_equal(shutter.table_s, _table())
    assert config_from_dict(dump(config), config.base_dir) == config


@pytest.mark.usefixtures("functions")
def test_windows_from_a_function_with_parameters_of_its_own(write: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "later.txt").write_text("0.5")
    yaml = 'shutter: {type: windows, function: "./shutters.py:staircase", steps: 2, table: later.txt}'
    config = load_config(write(SHUTTER, yaml))
    shutter = Assembly(config).shutter
    assert isinstance(shutter, RowShutter)
    expected = 0.5 + np.repeat([0.0, 1e-3], ROWS // 2)
    np.testing.assert_allclose(shutter.table_s, np.stack([expected, expected + 1e-3], axis=1), rtol=1e-14)
    assert dump(config)["camera"]["shutter"]["exposure_ms"] == 1.0  # its defaults are filled in


REFUSED = [
    ("shutter: {type: ^roling, line_time_us: 9}", ["camera.shutter.type:", "'roling'", "'rolling'"]),
    ("^shutter: {type: rolling}", ["camera.shutter.line_time_us:"]),
    ("shutter: {type: dual_rolling, line_time_us: ^0}", ["0.001 to 1e+06 us"]),
    ("shutter: {type: rolling, line_time_us: 9, exposure_ms: ^0}", []),
    ("shutter: {type: rolling, line_time_us: 9, direction: ^dwn}", ["'down'"]),
    ("shutter: {type: dual_rolling, line_time_us: 9, order: ^in}", ["outside_in"]),
    ("shutter: {type: rolling, ^line_tme_us: 9}", ["line_tme_us:", "'line_time_us'"]),
    ("shutter: {exposure_ms: 5, ^line_time_us: 9}", []),
    ("shutter: {type: rolling, line_time_us: 9, ^order: outside_in}", ["dual_rolling"]),
    ("shutter: ^5", ["camera.shutter:"]),
    ("^shutter: {type: windows}", []),
    ('shutter: {type: windows, file: ^a.csv, function: "./shutters.py:staircase"}', []),
    ("shutter: {type: windows, ^fle: rows.csv}", ["rows.csv", "'file'"]),
    ("shutter: {type: windows, file: rows.csv, ^exposure_ms: 5}", []),
    ("shutter: {type: windows, file: ^none.csv}", ["none.csv:"]),
    ("shutter: {type: windows, file: ^shutters.py}", []),
    ("shutter: {type: windows, function: ^staircase}", ["'staircase'"]),
    ('shutter: {type: windows, function: ^"./shutters.py:stair"}', ["'stair'", "'staircase'"]),
    ('shutter: {type: windows, function: "./shutters.py:staircase", ^step: 2}', ["camera.shutter.step:", "'steps'"]),
    ('shutter: {type: windows, function: "./shutters.py:staircase", steps: ^0}', ["camera.shutter.steps:"]),
]


@pytest.mark.usefixtures("functions")
@pytest.mark.parametrize(("new", "words"), REFUSED, ids=[row[0] for row in REFUSED])
def test_mistakes_are_refused_at_their_place(refused: Callable[..., None], new: str, words: list[str]) -> None:
    refused(SHUTTER, new, "", words)


TABLES = [
    (_csv(_table(64)), ["256"]),
    (_csv(np.vstack([_table(255), [(0.1, np.nan)]])), ["rows.csv:256:"]),
    (_csv(np.vstack([_table(255), [(0.1, 0.05)]])), ["row 255"]),
    ("0,1\n0,1,2\n", ["rows.csv:2:"]),
    ("0,1\n# remark\n0:1\n", ["rows.csv:3:"]),
    ("0,1\n0,one\n", ["rows.csv:2:", "'0,one'"]),
    ("start,end\n0,1\n", ["'start,end'", "open_s,close_s"]),
    ("close_s,open_s\n0,1\n", ["'close_s,open_s'"]),
    ("open_m,close_m\n0,1\n", ["'open_m,close_m'"]),
    ("open_s,close_s\n", []),
    ("", []),
    ("\x00\xff", ["UTF-8"]),
]


@pytest.mark.parametrize(("text", "words"), TABLES)
def test_a_table_that_is_no_shutter_is_refused(write, tmp_path: Path, text: str, words: list[str]) -> None:
    (tmp_path / "rows.csv").write_bytes(text.encode("latin-1"))
    path = write(SHUTTER, "shutter: {type: windows, file: rows.csv}")
    with pytest.raises(InputError) as caught:
        load_config(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:7:34: camera.shutter.file: "), message
    assert all(word in message for word in ["rows.csv", *words]), message


@pytest.mark.parametrize("array", [np.zeros((4, 3)), np.zeros(8), np.array([["a", "b"]])])
def test_an_array_of_another_kind_is_refused(write, tmp_path: Path, array: np.ndarray) -> None:
    np.save(tmp_path / "rows.npy", array)
    with pytest.raises(InputError, match=r"rows\.npy: got "):
        load_config(write(SHUTTER, "shutter: {type: windows, file: rows.npy}"))


@pytest.mark.usefixtures("functions")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("short", "(./shutters.py:short): got windows of 3 rows, expected 256"),
        ("words", "(./shutters.py:words): got str"),
        ("backwards", "(./shutters.py:backwards): row 255"),
        ("broken", "shutters.py:29: ZeroDivisionError"),
    ],
)
def test_a_function_that_gives_no_windows_is_named(write, name: str, words: str) -> None:
    config = load_config(write(SHUTTER, f'shutter: {{type: windows, function: "./shutters.py:{name}"}}'))
    with pytest.raises(InputError, match=re.escape(words)):
        _ = Assembly(config).shutter


def test_a_data_set_of_somebody_else_opens_no_file(write, tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text(_csv(_table()))
    data = dump(load_config(write(SHUTTER, "shutter: {type: windows, file: rows.csv}")))
    (tmp_path / "rows.csv").unlink()
    assert config_from_dict(data, tmp_path, check_plugins=False).camera.shutter.type == "windows"


def test_the_json_schema_knows_every_kind() -> None:
    kinds = json_schema()["$defs"]["CameraConfig"]["properties"]["shutter"]["discriminator"]["mapping"]
    assert set(kinds) == {"global", "rolling", "dual_rolling", "windows"}
    line_time = kinds["rolling"]["properties"]["line_time_us"]
    assert (line_time["type"], line_time["minimum"], line_time["maximum"]) == ("number", 1e-3, 1e6)
    assert line_time["description"].endswith("opening to the next, microseconds")
    assert "binning" not in kinds["rolling"]["properties"]  # the sensor's
    assert kinds["global"]["properties"]["exposure_ms"]["default"] == 10.0  # in the unit of the key
