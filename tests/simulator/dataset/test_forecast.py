"""Room is forecast from the first samples, and a job that will not fit does not begin."""

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from simulator.dataset import generate, verify
from simulator.dataset.forecast import ENOUGH, Facts
from simulator.dataset.manifest import load_manifest
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def room(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))


def sample_bytes(root: Path) -> int:
    return sum(path.stat().st_size for path in (root / "train/0000/s00000000").iterdir())


def test_a_job_that_does_not_fit_stops_after_two_samples(trial, monkeypatch: pytest.MonkeyPatch, flatlight) -> None:
    path, root = trial.write(dataset={"train": 40}), trial.folder / "out"
    room(monkeypatch, 100_000)
    with pytest.raises(InputError, match=r"^dataset\.output: 42 samples of .*--ignore-space"):
        generate(path)
    assert len(load_manifest(root).entries) == ENOUGH
    with pytest.raises(InputError, match=r"^dataset\.output: 40 samples"):  # and the next one before the first
        generate(path)
    assert len(load_manifest(root).entries) == ENOUGH
    code, _, err = flatlight("generate", path)
    assert code == 2
    assert "--ignore-space" in err
    assert flatlight("generate", path, "--ignore-space")[0] == 0
    assert verify(root).ok


@pytest.mark.parametrize("fits", [False, True])
def test_the_limit_is_what_is_left_to_make(trial, monkeypatch: pytest.MonkeyPatch, fits: bool) -> None:
    root = trial.generate(dataset={"train": 2, "validation": 0, "test": 0})
    each = sum(path.stat().st_size for path in (root / "train/0000").rglob("*.*")) / 2
    room(monkeypatch, int(each * 10) + (1 if fits else -1))
    path = trial.write(dataset={"train": 12, "validation": 0, "test": 0})
    if fits:
        assert generate(path).made == 10
    else:
        with pytest.raises(InputError, match=r"^dataset\.output: 10 samples"):
            generate(path)


def test_what_is_known_of_a_job_while_it_runs(trial) -> None:
    seen: list[Facts] = []
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "fail_at": 1}
    result = generate(trial.write(dataset={"train": 8}, scene=scene), watch=seen.append)
    assert len(result.failed) == 1
    assert len(seen) == 10
    assert seen[-1].failed == 1
    assert seen[0].bytes_expected is None
    mean = sample_bytes(result.path)
    assert seen[-1].bytes_made == pytest.approx(9 * mean, rel=0.1)  # samples differ by a few hundred bytes
    assert seen[-1].bytes_expected == pytest.approx(10 * mean, rel=0.1)
