"""A sample made again is the stored one, byte by byte; what is not, and code of somebody else's, is named."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from simulator.dataset import generate, open_dataset, verify
from simulator.dataset.fingerprint import cpu_level
from simulator.dataset.manifest import load_manifest
from simulator.dataset.regeneration import TOLERANCE, named_sample, regenerate, some_samples
from simulator.dataset.sample import write_sample
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

KEYS = [("train", "s00000002"), ("test", "s00000000")]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable):
    """A trial and its data set; not to be changed."""
    trial = make_trial(tmp_path_factory.mktemp("made"))
    return trial, trial.generate(dataset={"engine": "local", "workers": 1})


@pytest.fixture
def copy(made, tmp_path: Path) -> Path:
    shutil.copytree(made[1], tmp_path / "copy")
    return tmp_path / "copy"


@pytest.mark.slow
def test_a_sample_made_again_is_the_stored_one(made) -> None:
    trial, root = made
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    found = regenerate(root, KEYS, config=trial.path)
    assert [sample.key for sample in found.samples] == KEYS
    assert all(sample.identical for sample in found.samples)
    assert (found.elsewhere, found.faults) == ((), ())
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before


def test_code_of_the_data_set_runs_only_where_it_is_trusted(copy: Path, monkeypatch, flatlight) -> None:
    folder = copy.parent / "elsewhere"
    folder.mkdir()
    (folder / "plugins.py").write_text("raise SystemExit('code of a data set was run')")
    monkeypatch.chdir(folder)
    with pytest.raises(InputError, match=r"dataset\.json: .*plugins\.py:boxes.*--trust-code"):
        regenerate(copy, KEYS)
    for arguments in (["regenerate", copy, "train/s00000001"], ["verify", copy, "--deep", 1]):
        code, _, err = flatlight(*arguments)
        assert code == 2
        assert "--trust-code" in err
    code, _, err = flatlight("regenerate", copy, "train/s00000001", "--trust-code")
    assert code == 2
    assert "code of a data set was run" in err


def test_with_trust_the_code_is_taken_from_the_current_folder(made, monkeypatch, flatlight) -> None:
    trial, root = made
    monkeypatch.chdir(trial.folder)
    code, out, _ = flatlight("verify", root, "--deep", 2, "--trust-code")
    assert code == 0
    assert out.count(": identical") == 2


def test_a_sample_that_is_not_what_it_should_be(copy: Path, made, flatlight) -> None:
    """Whole in itself, hashes and all, but not what its seed makes: only making it again can tell."""
    sample = open_dataset(copy)[1]
    changed = sample.rgb.copy()
    changed[0, 3, 4] += 0.01
    record = write_sample(copy, "train", 1, type(sample)(**{**vars(sample), "rgb": changed}))
    text = (copy / "manifest.jsonl").read_text()
    old = load_manifest(copy).entries["train", "s00000001"].digest
    (copy / "manifest.jsonl").write_text(text.replace(old, record.digest))
    (copy / "checksums.json").unlink()
    assert flatlight("verify", copy, "--seal")[0] == 0
    code, out, _ = flatlight("regenerate", copy, "train/s00000001", "train/s00000002", "--config", made[0].path)
    assert code == 2
    expected = np.linalg.norm(changed - sample.rgb) / np.linalg.norm(changed)
    line = next(line for line in out.splitlines() if line.startswith("train/s00000001"))
    assert f"{expected:.1e}" in line
    assert "train/s00000002: identical" in out


@pytest.mark.slow
def test_elsewhere_samples_agree_to_a_tolerance(copy: Path, made, monkeypatch) -> None:
    info = json.loads((copy / "dataset.json").read_text())
    info["versions"]["cpu"] = "x86_64 SSE42"
    (copy / "dataset.json").write_text(json.dumps(info))
    sample = open_dataset(copy)[1]
    for change, fits in ((0.1 * TOLERANCE, True), (10 * TOLERANCE, False)):
        other = (sample.noiseless * (1 + change)).astype(np.float32)
        write_sample(copy, "train", 1, type(sample)(**{**vars(sample), "noiseless": other}))
        (found,) = regenerate(copy, [("train", "s00000001")], config=made[0].path).samples
        assert found.difference == pytest.approx(change, rel=0.02)  # of the changed one, which is the reference
        assert (found.fault == "") == fits
        assert not found.identical
    others = [
        {"metadata": sample.metadata | {"full_scale": 2 * sample.metadata["full_scale"]}},
        {"metadata": sample.metadata | {"scene": {"drawn": 7}}},
        {"label": "another"},
        {"extras": {"flow": np.zeros((*sample.depth_m.shape, 2), np.float32)}},
        {"global_measurements": sample.noiseless[None]},
    ]
    for change in others:  # whatever a sample says counts, not its images alone
        write_sample(copy, "train", 1, type(sample)(**{**vars(sample), **change}))
        (found,) = regenerate(copy, [("train", "s00000001")], config=made[0].path).samples
        assert found.fault != "", change
    again = regenerate(copy, [("train", "s00000000")], config=made[0].path)
    assert again.samples[0].identical
    assert again.elsewhere[0].startswith("cpu: x86_64 SSE42 -> ")


def test_each_sample_knows_on_which_kind_of_processor_it_was_made(trial, monkeypatch) -> None:
    """In a cluster of several kinds: only of the others' samples some digits may differ."""
    root = trial.generate()
    said: list[str] = []
    with monkeypatch.context() as patch:
        patch.setattr("simulator.dataset.recipe.cpu_level", lambda: "riscv64 V")
        generate(trial.write(dataset={"train": 5}), say=said.append)
    assert [line for line in said if "riscv64 V" in line] == [line for line in said if "last digits" in line]
    assert sum("riscv64 V" in line for line in said) == 1
    made_on = {key: entry.cpu for key, entry in load_manifest(root).entries.items() if key[0] == "train"}
    assert list(made_on.values()) == [None, None, None, "riscv64 V", "riscv64 V"]
    assert verify(root).ok
    found = regenerate(root, list(made_on), config=trial.path)
    assert all(sample.identical for sample in found.samples)
    assert found.elsewhere == (f"cpu: riscv64 V -> {cpu_level()}",)
    for index in (2, 3):
        sample = open_dataset(root)[index]
        other = (sample.noiseless * (1 + 0.1 * TOLERANCE)).astype(np.float32)
        write_sample(root, "train", index, type(sample)(**{**vars(sample), "noiseless": other}))
    found = regenerate(root, [("train", "s00000002"), ("train", "s00000003")], config=trial.path)
    assert [sample.fault == "" for sample in found.samples] == [False, True]


def test_another_configuration_or_sample_is_refused(made, tmp_path: Path) -> None:
    trial, root = made
    content = yaml.safe_load(trial.path.read_text())
    content["camera"]["noise"]["psnr_db"] = 30
    other = trial.folder / "other.yaml"
    other.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError, match=r"(?s)dataset\.json: .*psnr_db"):
        regenerate(root, KEYS, config=other)
    with pytest.raises(InputError, match=r"^train/s00000009: "):
        regenerate(root, [("train", "s00000009")], config=trial.path)
    for name in ("s00000000", "s9", "nowhere/s00000001", "train/s00000009"):
        with pytest.raises(InputError, match=f"^{name}: "):
            named_sample(root, name)
    assert named_sample(root, "s00000002") == ("train", "s00000002")
    assert named_sample(root, "test/s00000000") == ("test", "s00000000")


def test_random_samples_differ_from_call_to_call(made) -> None:
    _, root = made
    assert len(some_samples(root, 99)) == 5
    assert len({tuple(some_samples(root, 1)) for _ in range(100)}) > 2  # all alike: 5^-99


def test_what_cannot_be_made_again_says_why(trial) -> None:
    marker = trial.folder / "mended"
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "fail_at": 1, "marker": str(marker)}
    marker.touch()
    root = trial.generate(scene=scene)
    marker.unlink()
    (found,) = regenerate(root, [("train", "s00000001")], config=trial.path).samples
    assert "no clip 1 today" in found.fault
    assert generate(trial.path).made == 0


@pytest.mark.slow
def test_rendered_scenes_come_back_in_another_process(tmp_path: Path) -> None:
    command = [sys.executable, "-c", "from simulator.cli import main; main()"]
    small = [
        "camera.mask={design: phlatcam, width_mm: 1.5, iterations: 2}",
        "psf.depths=3",
        "scene.samples_per_pixel=4",
    ]
    small += ["psf.wavelengths_per_channel=1", "psf.shared_wavelengths=null", "psf.accept_error=1", "scene.margin=0"]
    small += ["dataset.train=3", "dataset.validation=0", "dataset.test=0", f"dataset.output={tmp_path / 'set'}"]
    overrides = [word for setting in small for word in ("--set", setting)]
    root = Path(__file__).parents[3]
    subprocess.run([*command, "generate", str(root / "sim_config.yaml"), *overrides], check=True, capture_output=True)
    done = subprocess.run([*command, "verify", str(tmp_path / "set"), "--deep", "2"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(": identical") == 2
