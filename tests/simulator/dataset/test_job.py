"""Making a data set: its layout, its bytes, resuming after any death, and what is refused."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.camera.shutter import GlobalShutter
from simulator.config import load_config
from simulator.dataset import generate, open_dataset, verify
from simulator.dataset.checksums import CHECKSUMS
from simulator.dataset.engines.tries import Tries
from simulator.dataset.manifest import load_manifest
from simulator.errors import InputError
from simulator.optics.stack_files import read_psf_stack
from simulator.types import Clip

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

ALL = {("train", "s00000000"), ("train", "s00000001"), ("train", "s00000002"), ("validation", "s00000000")}
ALL |= {("test", "s00000000")}
SLOW = {"family": "./plugins.py:boxes", "size": [16, 20]}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Path:
    """A data set made without any disturbance; not to be changed."""
    return make_trial(tmp_path_factory.mktemp("undisturbed")).generate()


def test_a_finished_set_verifies_and_its_layout_is_the_documented_one(finished: Path) -> None:
    report = verify(finished)
    assert report.ok, str(report)
    assert report.counts == {"train": 3, "validation": 1, "test": 1}
    info = json.loads((finished / "dataset.json").read_text())
    assert (info["exposure"]["full_scale"], info["exposure"]["from"]) == (3e-6, "configuration")
    assert info["backend"] == "none"  # nothing was rendered
    samples = [f"{split}/0000/{name}" for split, name in sorted(ALL)]
    expected = {"dataset.json", "manifest.jsonl", "checksums.json", "croissant.json", "README.md", "psf/psf.json"}
    expected |= {f"psf/depth_{k:04d}.exr" for k in range(3)}
    expected |= {f"{sample}/{name}" for sample in samples for name in ("measurement.exr", "ground_truth.exr")}
    expected |= {f"{sample}/sample.json" for sample in samples}
    assert {str(path.relative_to(finished)) for path in finished.rglob("*") if path.is_file()} == expected
    lines = [json.loads(line) for line in (finished / "manifest.jsonl").read_text().splitlines()]
    assert {(line["split"], line["id"]) for line in lines} == ALL
    assert all(set(line) == {"id", "split", "digest", "seed", "label", "seconds", "stages"} for line in lines)
    # The scene, its exposure and the files are all that a sample's time goes into, but for the calls between them.
    assert all(sum(line["stages"]) == pytest.approx(line["seconds"], abs=5e-3) for line in lines)
    description = json.loads((finished / "train/0000/s00000001/sample.json").read_text())
    for name, digest in description["files"].items():
        assert hashlib.sha256((finished / "train/0000/s00000001" / name).read_bytes()).hexdigest() == digest


def test_a_run_with_a_warm_cache_waits_for_no_heavy_package(trial, finished: Path, python) -> None:
    """``finished`` has warmed it: what colour-science knows of camera and light is kept."""
    code = (
        "import sys; from simulator.dataset import generate; assert generate(sys.argv[1]).made\n"
        "print([name for name in ('colour', 'scipy.interpolate', 'matplotlib', 'torch') if name in sys.modules])"
    )
    done = python("-c", code, str(trial.write(dataset={"train": 1, "validation": 0, "test": 0})))
    assert done.stdout.splitlines()[-1:] == ["[]"], done.stderr


def test_raising_counts_keeps_what_was_there(trial, contents) -> None:
    first = trial.generate()
    before = contents(first)
    stamps = {path: path.stat().st_mtime_ns for path in first.rglob("*.exr")}
    again = generate(trial.path)
    assert (again.made, again.kept) == (0, 5)
    assert contents(first) == before
    result = generate(trial.write(dataset={"train": 5}))
    assert (result.made, result.kept, result.failed) == (2, 5, ())
    after = contents(first)
    changed = {key for key in before if before[key] != after[key]}
    assert changed == {"info"}
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())  # not even written again
    assert json.loads((first / "dataset.json").read_text())["counts"] == {"train": 5, "validation": 1, "test": 1}
    assert verify(first).ok
    trial.plugins.with_name("again").mkdir()
    assert contents(trial.generate(dataset={"train": 5, "output": "again/out"})) == after  # as if made at once


def test_what_the_manifest_does_not_hold_is_made_again(trial, finished: Path, contents) -> None:
    root = trial.generate()
    lines = (root / "manifest.jsonl").read_bytes().splitlines(keepends=True)
    (root / "manifest.jsonl").write_bytes(b"".join([*lines[:2], lines[3][:20]]))  # three lines lost, the last one torn
    (root / "train/0000/.tmp-s00000001-12345678").mkdir()  # what a writer left that died
    (root / ".tmp-dataset.json-1234").write_text("{")
    result = generate(trial.path)
    assert (result.made, result.kept) == (3, 2)
    assert contents(root) == contents(finished)


def test_a_worker_that_is_killed_costs_nothing(trial, tmp_path: Path, contents) -> None:
    marker = tmp_path / "killed"
    scene = SLOW | {"kill_at": 1, "marker": str(marker)}
    root = trial.generate(dataset={"engine": "local", "workers": 2}, scene=scene)
    assert marker.exists()
    assert verify(root).ok
    asked = (tmp_path / "killed.log").read_text().split()
    assert asked.count("1") >= 2  # the sample that died was tried again
    # The marker exists now, so that nothing dies: these are the undisturbed bytes.
    assert contents(trial.generate(dataset={"output": "undisturbed"}, scene=scene)) == contents(root)


@pytest.mark.slow
def test_a_killed_run_is_finished_by_the_next(trial, tmp_path: Path, contents) -> None:
    scene = SLOW | {"seconds": 0.2}
    path = trial.write(dataset={"engine": "local", "workers": 1, "train": 4}, scene=scene)
    root = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-c", "from simulator.cli import main; main()", "generate", str(path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    manifest = root / "manifest.jsonl"
    end = time.monotonic() + 60
    while not manifest.exists() or manifest.read_bytes().count(b"\n") < 1:
        assert process.poll() is None, "the run ended before it could be killed"
        assert time.monotonic() < end, "a sample takes too long"
        time.sleep(0.02)
    process.kill()
    process.wait()
    kept = len(load_manifest(root).entries)
    assert 1 <= kept < 6
    assert not (root / CHECKSUMS).exists()
    assert not verify(root).ok
    result = generate(path, ["dataset.engine=inline"])
    assert (result.made, result.kept) == (6 - kept, kept)
    assert verify(root).ok
    undisturbed = trial.generate(dataset={"output": "undisturbed", "train": 4}, scene=scene)
    assert contents(undisturbed) == contents(root)


def test_the_seal_covers_all_but_the_samples_and_comes_last(trial) -> None:
    def finish(root: Path) -> None:
        assert not (root / CHECKSUMS).exists()
        (root / "contact_sheet.png").write_bytes(b"drawn")

    root = generate(trial.write(), finish=finish).path
    files = ["dataset.json", "manifest.jsonl", "contact_sheet.png", "croissant.json", "README.md", "psf/psf.json"]
    files += [f"psf/depth_{k:04d}.exr" for k in range(3)]
    sealed = json.loads((root / CHECKSUMS).read_text())["files"]
    assert sealed == {name: hashlib.sha256((root / name).read_bytes()).hexdigest() for name in files}


def test_a_run_that_breaks_off_leaves_its_data_set_unsealed(trial) -> None:
    def finish(root: Path) -> None:
        raise KeyboardInterrupt

    root = trial.generate()
    with pytest.raises(KeyboardInterrupt):
        generate(trial.write(dataset={"train": 4}), finish=finish)
    (problem,) = verify(root).problems
    assert problem.startswith(f"{CHECKSUMS}: missing")
    assert len(open_dataset(root)) == 4  # for readers it is a data set
    assert generate(trial.path).made == 0
    assert verify(root).ok


def test_killed_at_any_moment_a_growing_data_set_is_not_whole_and_is_finished(
    trial, monkeypatch, contents, tree
) -> None:
    """The disk after every step that reaches it, as a killed run leaves it: no handler cleans up."""
    root, kept, seen = trial.generate(), trial.folder / "moments", {}

    def watched(step: Callable) -> Callable:
        def then_copied(*arguments, **options):
            result = step(*arguments, **options)
            if (state := json.dumps(tree(root))) not in seen:
                seen[state] = shutil.copytree(root, kept / str(len(seen)))
            return result

        return then_copied

    with monkeypatch.context() as patch:
        for name in ("fsync", "replace", "rename", "unlink"):
            patch.setattr(os, name, watched(getattr(os, name)))
        generate(trial.write(dataset={"train": 4}))
    states = [Path(path) for path in seen.values()]
    assert len(states) > 10
    whole = [verify(path).ok for path in states]
    assert whole == [False] * (len(states) - 1) + [True]
    for path in states:
        assert generate(trial.path, [f"dataset.output={path}"]).failed == ()
        assert verify(path).ok, path
        assert contents(path) == contents(root)


@pytest.mark.parametrize("name", ["dataset.json", "psf/psf.json", "checksums.json"])
def test_a_data_set_does_not_grow_on_what_was_changed_since(trial, name: str) -> None:
    path = trial.generate() / name
    content = json.loads(path.read_text())
    content |= (
        {"versions": {}} if name == "dataset.json" else {"depths_m": [1, 2, 3]} if "psf" in name else {"files": {}}
    )
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"^{path}: "):
        trial.generate(dataset={"train": 4})
    assert json.loads((trial.folder / "out/dataset.json").read_text())["counts"]["train"] == 3
    assert (trial.folder / "out" / CHECKSUMS).exists()


def test_lines_that_repeat_are_dropped_by_the_next_run(trial) -> None:
    manifest = trial.generate() / "manifest.jsonl"
    lines = manifest.read_bytes().splitlines(keepends=True)
    manifest.write_bytes(b"".join(lines * 3))
    assert generate(trial.write(dataset={"train": 4})).made == 1
    assert sorted(manifest.read_bytes().splitlines(keepends=True))[:3] == sorted(lines)[:3]
    assert len(load_manifest(manifest.parent).entries) == manifest.read_bytes().count(b"\n") == 6
    assert verify(manifest.parent).ok


def test_a_failing_sample_is_reported_and_tried_again(trial, tmp_path: Path) -> None:
    marker = tmp_path / "mended"
    path = trial.write(scene=SLOW | {"fail_at": 1, "marker": str(marker)})
    result = generate(path)
    assert (result.made, result.kept) == (4, 0)
    assert len(result.failed) == 1
    assert result.failed[0].startswith("train/s00000001: ")
    assert "ZeroDivisionError" in result.failed[0]
    assert "no clip 1 today" in result.failed[0]
    assert not (result.path / "train/0000/s00000001").exists()
    assert set(load_manifest(result.path).entries) == ALL - {("train", "s00000001")}
    (tmp_path / "mended.log").unlink()
    marker.touch()
    again = generate(path)
    assert (again.made, again.kept, again.failed) == (1, 4, ())
    assert (tmp_path / "mended.log").read_text().split() == ["1"]  # nothing else was asked for
    assert verify(again.path).ok


def test_a_pilot_that_ends_its_process_is_a_mistake_of_the_plugin(trial) -> None:
    code = trial.plugins.read_text()
    trial.plugins.write_text(code.replace("        time.sleep(self.seconds)\n", "        raise KeyboardInterrupt\n"))
    with pytest.raises(InputError, match=r"^exposure pilot 0: .*KeyboardInterrupt"):
        generate(trial.write(camera={"exposure": {"full_scale": "auto"}}))
    assert not (trial.folder / "out").exists()


def test_what_runs_out_of_memory_is_not_left_out_for_good(trial) -> None:
    """It may do better on another day; what is wrong with a clip's file stays wrong."""
    code = trial.plugins.read_text()
    trial.plugins.write_text(code.replace("raise ZeroDivisionError(", "raise MemoryError("))
    marker = trial.folder / "more memory"
    path = trial.write(scene=SLOW | {"fail_at": 1, "marker": str(marker)})
    result = generate(path, skip_bad=True)
    assert (result.made, len(result.failed), result.skipped) == (4, 1, ())
    assert "MemoryError" in result.failed[0]
    assert "(tried 3 times)" in result.failed[0]
    marker.touch()
    assert generate(path, skip_bad=True).made == 1


def test_no_picture_travels_from_a_worker(trial, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a hundred workers on other nodes all would pass through the one that runs the job."""
    sizes: list[int] = []
    finish = Tries.finish

    def weigh(self, job, reply) -> None:
        sizes.append(len(reply.value))
        finish(self, job, reply)

    monkeypatch.setattr(Tries, "finish", weigh)
    changes = {"camera": {"exposure": {"full_scale": "auto"}}, "dataset": {"engine": "local", "workers": 1}}
    root = trial.generate(**changes)
    assert len(sizes) >= 1 + 16 + 5
    # The first is the mask, which a process beside the one that runs the job designs.
    assert max(sizes[1:]) < 1000 < (root / "train/0000/s00000000/measurement.exr").stat().st_size
    assert verify(root).ok  # and nothing is left of the pilots' pictures


@pytest.mark.slow
def test_a_stack_that_is_made_again_must_be_that_of_the_samples(trial, monkeypatch: pytest.MonkeyPatch) -> None:
    code = trial.plugins.read_text()
    trial.plugins.write_text(code.replace("default_rng(seed)", "default_rng(int(os.environ['MASK']))"))
    monkeypatch.setenv("MASK", "1")
    root = trial.generate()
    stack = read_psf_stack(root / "psf").values
    shutil.rmtree(root / "psf")
    monkeypatch.setenv("MASK", "2")
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(trial.folder / "of another machine"))
    with pytest.raises(InputError, match=rf"^{root}/psf: .*not the stack of the samples"):
        trial.generate(dataset={"train": 4})
    assert not (root / "psf").exists()
    monkeypatch.setenv("MASK", "1")
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(trial.folder / "of a third"))
    trial.generate(dataset={"train": 4})
    np.testing.assert_array_equal(read_psf_stack(root / "psf").values, stack)
    assert verify(root).ok


def test_a_plugin_that_changes_the_folder_moves_no_sample(
    trial, finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (trial.folder / "elsewhere").mkdir()
    code = trial.plugins.read_text()
    trial.plugins.write_text(code.replace("time.sleep(self.seconds)", "os.chdir(Path(__file__).parent / 'elsewhere')"))
    path = trial.write()
    monkeypatch.chdir(trial.folder)
    result = generate(path, ["dataset.output=here"])
    assert result.path == trial.folder / "here"
    assert (result.made, verify(result.path).ok) == (5, True)
    assert not list((trial.folder / "elsewhere").iterdir())


@pytest.mark.slow
def test_progress_counts_to_the_end(trial) -> None:
    seen: list[tuple[str, int, int]] = []
    said: list[str] = []
    path = trial.write(camera={"exposure": {"full_scale": "auto"}}, psf={"depths_cm": [5, 7], "accept_error": 1.1})
    result = generate(path, progress=lambda *update: seen.append(update), say=said.append)
    stages = list(dict.fromkeys(stage for stage, _, _ in seen))
    assert stages == ["PSFs", "exposure pilots", "samples"]
    for stage, total in (("PSFs", 18), ("exposure pilots", 16), ("samples", 5)):
        assert [done for name, done, _ in seen if name == stage][-1] == total
        assert {of for name, _, of in seen if name == stage} == {total}
    assert result.seconds > 0
    assert any(line.startswith("error budget") for line in said)


RANDOM_WINDOWS = """
import numpy as np

def drawn(rows: int):
    lasts_s = np.random.default_rng().uniform(1e-3, 9e-3, rows)
    return np.stack([np.zeros(rows), lasts_s], axis=1)
"""


@pytest.mark.slow
def test_a_function_that_draws_windows_gives_all_samples_the_recorded_ones(trial) -> None:
    """The exposure of each row is in its brightness: samples of two workers show one table, that of dataset.json."""
    (trial.folder / "windows.py").write_text(RANDOM_WINDOWS)
    shutter = {"type": "windows", "function": "./windows.py:drawn"}
    path = trial.write(
        camera={"shutter": shutter, "noise": {"type": "none"}}, dataset={"engine": "local", "workers": 2}
    )
    root = generate(path).path
    recorded = json.loads((root / "dataset.json").read_text())["time"]["shutter"]["table_s"]
    opened_s = np.diff(recorded).reshape(48, 8).mean(axis=1)[::-1]  # the stored image is rotated by 180 degrees
    config = load_config(path)
    model = Assembly(config).having(psf_stack=read_psf_stack(root / "psf"), shutter=GlobalShutter(1.0, 8)).forward_model
    for sample in open_dataset(root):
        clip = Clip(sample.rgb, sample.depth_m, sample.valid, np.array([0.0, 1.0]))
        second_long = model.forward_clip(clip)
        np.testing.assert_allclose(
            sample.measurement, second_long * opened_s[:, None] / 3e-6, rtol=0, atol=2e-3 * sample.measurement.max()
        )  # the truth is stored in half precision
    assert verify(root).ok
    with pytest.raises(InputError, match=r"^camera\.shutter\.function: "):
        generate(path)
    assert verify(root).ok


def test_a_recorded_shutter_that_somebody_edited(trial) -> None:
    root = trial.generate()
    info = json.loads((root / "dataset.json").read_text())
    info["time"]["shutter"]["exposure_s"] = 0.5
    (root / "dataset.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match=r"dataset\.json: "):
        trial.generate(dataset={"train": 4})


def test_packages_that_the_scenes_come_through_are_recorded_and_count(trial, monkeypatch: pytest.MonkeyPatch) -> None:
    code = trial.plugins.read_text()
    trial.plugins.write_text(code.replace("    boxes: int\n", "    boxes: int\n    packages = ('pytest',)\n", 1))
    root = trial.generate(dataset={"train": 1, "validation": 0, "test": 0})
    info = json.loads((root / "dataset.json").read_text())
    assert info["versions"]["pytest"] == info["fingerprint_parts"]["versions"]["pytest"] == pytest.__version__
    version = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "0.1" if name == "pytest" else version(name))
    with pytest.raises(InputError, match=r"^dataset\.output: "):
        generate(trial.path)
