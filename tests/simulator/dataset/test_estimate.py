"""What a data set will cost, told from a few samples, against what it then costs."""

import os
import signal
from pathlib import Path

import pytest

from simulator.dataset import generate
from simulator.dataset.estimate import estimate
from simulator.dataset.manifest import load_manifest
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 20, "validation": 4, "test": 4, "engine": "local", "workers": 2}


@pytest.mark.slow
def test_it_tells_what_the_data_set_then_takes(trial) -> None:
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "seconds": 0.05}
    path = trial.write(dataset=DATASET, scene=scene)
    found = estimate(path, price=0.04)
    assert not (trial.folder / "out").exists()
    assert found.counts == {"train": 20, "validation": 4, "test": 4}
    root = generate(path).path
    files = [path for path in root.rglob("*") if path.is_file()]
    assert found.files == len(files) + 2  # drawn by the command: report.html, contact_sheet.png
    assert found.bytes == pytest.approx(sum(path.stat().st_size for path in files if path.suffix != ".md"), rel=0.1)
    seconds = sum(entry.seconds for entry in load_manifest(root).entries.values())
    assert found.samples * found.sample_s == pytest.approx(seconds, rel=0.5)  # of a machine that does other things, too
    assert found.sample_s > 0.05
    assert found.sample_cpu_s < found.sample_s - 0.04  # these scenes sleep for 0.05 s: that costs nobody CPU time
    assert found.cpu_hours == pytest.approx(found.samples * found.sample_cpu_s / 3600)
    assert 50e6 < found.memory_bytes < 5e9


@pytest.mark.slow
def test_the_captured_psfs_and_an_engine_without_workers(trial) -> None:
    psf = {"near_cm": 3.6, "far_cm": 20, "depths": 3}
    path = trial.write(dataset=DATASET | {"engine": "inline"}, psf=psf)
    plain, captured = estimate(path), estimate(trial.write(dataset=DATASET, psf=psf | {"as_captured": {}}))
    assert plain.workers == 1
    assert captured.workers == 2
    assert captured.files == plain.files + 4  # three planes and their description
    assert captured.stack_bytes > 1.5 * plain.stack_bytes


@pytest.mark.slow
def test_the_command_prints_it_and_writes_nothing(trial, flatlight) -> None:
    path = trial.write(dataset=DATASET | {"train": 1_000_000}, camera={"exposure": {"full_scale": "auto"}})
    code, out, _ = flatlight("generate", path, "--estimate", "--price", "0.04")
    assert code == 0
    assert "1,000,008 (train 1,000,000, validation 4, test 4)" in out
    assert "CPU-hours" in out
    assert "at 0.04 per CPU-hour" in out
    assert not (trial.folder / "out").exists()


def test_a_signal_leaves_nothing_behind(trial, command, tmp_path: Path) -> None:
    """Also while PSFs are computed."""
    (tmp_path / "temporary").mkdir()
    asked = "import os, signal\nfrom simulator.dataset import estimate\n"
    asked += "estimate.data_set_stack = lambda *_: os.kill(os.getpid(), signal.SIGTERM)"
    environment = os.environ | {"TMPDIR": str(tmp_path / "temporary")}
    done = command("generate", trial.write(), "--estimate", before=asked, env=environment)
    assert done.returncode == 128 + signal.SIGTERM
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--price", "1"], "--price"),
        (["--estimate", "--shard", "9/3"], "--shard"),
        (["--estimate", "--skip-bad"], "--skip-bad"),
    ],
)
def test_options_that_have_no_meaning_together(trial, flatlight, options: list[str], named: str) -> None:
    code, _, err = flatlight("generate", trial.write(), *options)
    assert code == 2
    assert err.startswith(f"error: {named}: ")


def test_few_samples_and_those_that_cannot_be_made(trial, tmp_path: Path) -> None:
    one = estimate(trial.write(dataset={"train": 0, "validation": 0, "test": 1}))
    assert one.samples == 1
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "fail_at": 0}
    with pytest.raises(InputError, match="no clip 0 today"):
        estimate(trial.write(scene=scene))
