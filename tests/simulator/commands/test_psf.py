"""``psf`` as users meet it."""

from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_writes_and_describes_the_stack(flatlight, trial, tmp_path: Path) -> None:
    from simulator.assemble import build_psf_stack
    from simulator.config import load_config
    from simulator.dataset.psf_files import read_psf_stack

    path = trial.write()
    code, out, err = flatlight("psf", path, "--output", tmp_path / "stack")
    assert code == 0, err
    assert "3, 3.6 cm to 20 cm" in out
    assert "sampling error" in out
    stack = build_psf_stack(load_config(path))
    assert np.array_equal(read_psf_stack(tmp_path / "stack").values, stack.values)
    assert flatlight("psf", path, "--output", tmp_path / "stack")[0] == 0  # an older stack is replaced


def test_replaces_nothing_else(one_error, flatlight, trial, tmp_path: Path) -> None:
    one_error(flatlight("psf", trial.write(), "--output", tmp_path), "plugins.py", "choose another name")
    assert trial.plugins.exists()
