"""From the configuration to the shutter, to what depends on it, and to the fingerprint's input files."""

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.shutter import RowShutter
from simulator.config import load_config

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

ROWS = 48 * 8  # physical rows of the trial's sensor
CODE = """
from pathlib import Path
import numpy as np

def later(rows: int, *, table: Path, times: float = 1.0):
    return np.loadtxt(table, delimiter=",")[:rows] * times
"""


@pytest.fixture
def table(trial):
    """Windows that grow from the top row down, in a file beside the configuration."""
    lasts = np.linspace(1e-3, 4e-3, ROWS)
    windows = np.stack([np.zeros(ROWS), lasts], axis=1)
    np.savetxt(trial.folder / "rows.csv", windows, delimiter=",")
    return windows


@pytest.mark.parametrize("time", ["integral", "mean"])
def test_what_a_pixel_adds_up_reaches_the_forward_model(trial, time):
    assert Assembly(load_config(trial.write(), [f"forward.time={time}"])).forward_model.time == time


def test_dark_current_runs_for_as_long_as_each_stored_row_is_open(trial, table):
    equal = {"type": "rolling", "exposure_ms": 3, "line_time_us": 20}
    assert Assembly(load_config(trial.write(camera={"shutter": equal}))).sensor.exposure_s == 3e-3
    own = {"type": "windows", "file": "rows.csv"}
    times = Assembly(load_config(trial.write(camera={"shutter": own}))).sensor.exposure_s
    # The image's first row is the sensor's last, which is open longest.
    assert times == pytest.approx(table[:, 1].reshape(48, 8).mean(axis=1)[::-1])
    assert times[0] > times[-1]


def _names(config):
    return [path.name for path in Assembly(config, "none").input_files]


def test_the_shutter_s_files_are_inputs_of_the_data_set(trial, table):
    assert _names(load_config(trial.write())).count("rows.csv") == 0
    config = load_config(trial.write(camera={"shutter": {"type": "windows", "file": "rows.csv"}}))
    assert _names(config).count("rows.csv") == 1
    (trial.folder / "shutters.py").write_text(CODE)
    chosen = {"type": "windows", "function": "./shutters.py:later", "table": "rows.csv", "times": 2.0}
    config = load_config(trial.write(camera={"shutter": chosen}))
    assert _names(config).count("shutters.py") == 1
    assert _names(config).count("rows.csv") == 1
    shutter = Assembly(config).shutter
    assert isinstance(shutter, RowShutter)
    np.testing.assert_allclose(shutter.table_s, 2 * table, rtol=1e-12)
