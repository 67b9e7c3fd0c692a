"""``psf`` as users meet it."""

from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_writes_and_describes_the_stack(flatlight, trial, tmp_path: Path) -> None:
    from simulator.assembly import Assembly
    from simulator.config import load_config
    from simulator.optics.stack_files import read_psf_stack

    path = trial.write()
    code, out, err = flatlight("psf", path, "--output", tmp_path / "stack")
    assert code == 0, err
    assert "3, 3.6 cm to 20 cm" in out
    assert "sampling error" in out
    assert "as captured" not in out
    assert not (tmp_path / "stack_captured").exists()
    stack = Assembly(load_config(path)).psf_stack
    assert np.array_equal(read_psf_stack(tmp_path / "stack").values, stack.values)
    assert flatlight("psf", path, "--output", tmp_path / "stack")[0] == 0  # an older stack is replaced


def test_replaces_nothing_else(one_error, flatlight, trial, tmp_path: Path) -> None:
    one_error(flatlight("psf", trial.write(), "--output", tmp_path), "plugins.py", "choose another name")
    assert trial.plugins.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--plot", "p.txt"), "--plot: got 'p.txt', expected a name that ends in .png"),
        (("--plot", "folder.png"), "folder.png exists already and is a folder"),
        (("--plot", "no/p.png"), "the folder no does not exist; make it first"),
        (("--plot", "p.png", "--as-captured"), "p_captured.png"),
        (("--output", "plugins.py/x"), "plugins.py is a file; choose another folder"),
    ],
)
def test_places_are_looked_at_before_anything_is_computed(
    one_error, flatlight, trial, monkeypatch, arguments, words
) -> None:
    monkeypatch.chdir(trial.folder)
    for name in ("folder.png", "p_captured.png"):
        (trial.folder / name).mkdir()
    result = flatlight("psf", trial.write(), *arguments)
    one_error(result, words)
    assert result[1] == ""
    assert "PSFs:" not in result[2]
