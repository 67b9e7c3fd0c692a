"""The command says what became of a training."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from learning.commands import evaluate, reconstruct, train, tune
from learning.tune.study import load_tuned
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.stack_files import read_depths_m


def test_command(tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = {"train": str(tiny_dataset), "cache": str(tmp_path / "cache"), "workers": 0}
    plain = {"name": "tiny", "output": "out", "data": data, "network": {"size": "tiny"}, "steps": 3, "batch": 4}
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(plain))
    train(path, ["steps=2"])
    out = capsys.readouterr()
    assert "2 steps" in out.out
    assert (tmp_path / "out" / "best.safetensors").exists()  # relative to the file
    assert re.search(r"best after step 2: PSNR \d+\.\d\d dB, depth RMSE \d+\.\d\d cm on validation", out.out)
    assert "step 2: validation PSNR" in out.err
    train(path, ["steps=2"])
    assert "finished before" in capsys.readouterr().out


SEARCH = {
    "cls": {
        "regularisation_lambda": {"values": [0.03, 0.3], "high": 10},
        "cost": {"values": ["spread"]},
        "measure": {"values": ["gradient"]},
        "light": {"values": ["label"]},
        "contrast": {"values": [8.0], "low": 8, "high": 8},
        "steps_between_planes": {"values": [4], "low": 4, "high": 4},
        "window_px": {"values": [1.0], "low": 1, "high": 1},
        "pairwise": {"values": [0.1, 1.0], "high": 100},
    }
}


@pytest.mark.slow
def test_the_command_tunes_and_goes_on(tiny_dataset: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tune.yaml"
    data = {"validation": str(tiny_dataset), "scenes": 4, "allow_few_scenes": True}
    path.write_text(json.dumps({"data": data, "methods": ["cls"], "noise_db": [30, 40], "search": SEARCH}))
    tune(path, ["noise_db=[40]"])
    out, err = capfd.readouterr()
    lines = out.splitlines()
    assert lines[-1] == f"wrote {tmp_path / 'tuned.json'}"
    assert lines[0].split()[:3] == ["method", "noise", "dB"]
    assert lines[1].split()[:2] == ["cls", "40"]
    assert lines[2].startswith("constant guess")
    assert "cls at 40 dB: PSNR" in err
    first = load_tuned(tmp_path / "tuned.json")
    assert first.content["results"][0]["score"] <= min(t["score"] for t in first.content["trials"]) * (1 + 2e-3)
    tune(path, None)
    again = load_tuned(tmp_path / "tuned.json")
    assert again.levels_db("cls") == [30.0, 40.0]
    assert again.content["trials"][: len(first.content["trials"])] == first.content["trials"]


def test_an_unknown_parameter_is_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    path = tmp_path / "tune.yaml"
    data = {"validation": str(tiny_dataset), "scenes": 4, "allow_few_scenes": True}
    path.write_text(json.dumps({"data": data, "methods": ["cls"]}), encoding="utf-8")
    with pytest.raises(InputError, match=r"^search\.cls: "):
        tune(path, ["search.cls.tau.values=[1.0]"])
    with pytest.raises(InputError, match=r"^search\.cls\.regularisation_lambda: "):
        tune(path, ["search.cls.regularisation_lambda.values=[1.0, 0.1]"])


def _write(tmp_path: Path, tiny_dataset: Path, **changes: Any) -> Path:
    content: dict[str, Any] = {
        "name": "trial",
        "output": "out",
        "data": {"test": str(tiny_dataset), "training": str(tiny_dataset), "scenes": 2},
        "methods": [{"name": "CLS", "classical": "cls", "parameters": {}}],
        "perceptual": "none",
        "time": {"repeats": 1},
        "figures": {"montage": 1},
    }
    path = tmp_path / "evaluate.yaml"
    path.write_text(yaml.safe_dump(content | changes), encoding="utf-8")
    return path


def test_a_table_is_printed(tmp_path: Path, tiny_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate(_write(tmp_path, tiny_dataset), ["output=elsewhere"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["method", "PSNR", "dB"]
    assert [line.split()[0] for line in lines[1:5]] == ["CLS", "constant", "mean", "black"]
    assert lines[5] == f"look at {tmp_path / 'elsewhere' / 'report.md'}"
    assert (tmp_path / "elsewhere" / "report.md").is_file()


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("methods", {"methods": []}),
        ("methods[0].checkpoints", {"methods": [{"name": "A", "checkpoints": []}]}),
        ("methods[0].checkpoints[1]", {"methods": [{"name": "A", "checkpoints": ["a", "a"]}]}),
        ("methods[0]", {"methods": [{"name": "A"}]}),
        ("methods[0]", {"methods": [{"name": "A", "checkpoints": ["a"], "classical": "cls"}]}),
        ("methods[0]", {"methods": [{"name": "A", "checkpoints": ["a"], "tuned": "b"}]}),
        ("methods[0]", {"methods": [{"name": "A", "classical": "cls"}]}),
        ("methods[1].name", {"methods": [{"name": "A", "checkpoints": ["a"]}, {"name": "A", "checkpoints": ["b"]}]}),
        ("data", {"data": {"test": "x"}}),
        ("data", {"data": {"test": "x", "stack": "captured"}}),
        ("depth_bins_cm", {"depth_bins_cm": [5, 4]}),
        ("noise_db", {"noise_db": []}),
        ("noise_db[1]", {"noise_db": [20, 20]}),
        ("noise_db[0]", {"noise_db": [2000]}),
        ("speed", {"speed": 1}),
    ],
)
def test_a_mistake_in_the_file_is_named(tmp_path: Path, tiny_dataset: Path, key: str, changes: Any) -> None:
    with pytest.raises(InputError, match=rf"evaluate\.yaml:\d+:\d+: {re.escape(key)}: "):
        evaluate(_write(tmp_path, tiny_dataset, **changes))


def test_a_sample_becomes_a_folder(tiny_dataset: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    sample = open_dataset(tiny_dataset, "test").folder(0)
    reconstruct(sample, method="cls", set_=["regularisation_lambda=0.1", "pairwise=1"], output=folder, volume=True)
    out = capfd.readouterr().out
    assert "CLS + graph cut (regularisation_lambda 0.1" in out
    assert f"{folder}: depth.exr, depth.png, image.exr, image.png, reconstruction.json, volume.exr" in out
    record = json.loads((folder / "reconstruction.json").read_text())
    assert record["parameters"]["regularisation_lambda"] == 0.1
    assert record["method"] == "cls"
    assert record["camera"]["depths_m"] == read_depths_m(tiny_dataset / "psf").tolist()
    assert set(record["seconds"]) == {"inversion", "graph cut", "assembly"}
    assert len(read_exr(folder / "volume.exr")[0]) == 9


# What takes long to import and has no part in a reconstruction; ortools has in that of a depth by a graph cut.
UNUSED = ["torch._dynamo", "torch._inductor", "torch.utils.tensorboard", "tensorboard", "torchvision", "lpips", "sympy"]
UNUSED += ["skimage", "flip_evaluator", "scipy", "numpy.f2py", "matplotlib", "colour"]
UNUSED += ["mitsuba", "drjit", "ortools", "learning.train", "learning.tune.job", "learning.evaluate", "learning.config"]
UNUSED += ["learning.metrics"]


@pytest.mark.slow
def test_a_reconstruction_imports_only_what_it_uses(
    tiny_dataset: Path, checkpoints: list[Path], tmp_path: Path
) -> None:
    """By a network, and by ADMM from the image of a PSF: SymPy alone, which a network once imported, takes a second."""
    sample = open_dataset(tiny_dataset, "test").folder(0)
    psf = np.zeros((16, 16))
    psf[[8, 5, 9], [8, 3, 12]] = 1, 2, 3
    np.save(tmp_path / "psf.npy", psf)
    np.save(tmp_path / "m.npy", np.random.default_rng(0).uniform(size=(16, 16)))
    image = {"method": "admm", "stack": str(tmp_path / "psf.npy"), "frame": "stored", "accept_frame": True}
    code = f"""if True:
        import sys
        from pathlib import Path
        from learning.commands import reconstruct
        reconstruct(Path({str(sample)!r}), checkpoint={str(checkpoints[0])!r}, output=Path({str(tmp_path / "a")!r}))
        image = {image!r}
        reconstruct(Path({str(tmp_path / "m.npy")!r}), set_=["iterations=2"], output=Path({str(tmp_path / "b")!r}), **image)
        print([name for name in {UNUSED} if name in sys.modules])
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"


def test_results_have_names_of_their_own(tiny_dataset: Path, tmp_path: Path, monkeypatch: Any, capfd: Any) -> None:
    monkeypatch.chdir(tmp_path)
    test, train = (open_dataset(tiny_dataset, split).folder(0) for split in ("test", "train"))
    for sample, method in ((test, "cls"), (train, "cls"), (test, "admm")):
        reconstruct(sample, method=method, set_=["iterations=2"] if method == "admm" else None)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"test_{test.name}_cls",
        f"train_{train.name}_cls",
        f"test_{test.name}_admm",
    }
    assert "replaced" not in capfd.readouterr().out
    reconstruct(test / "measurement.exr", method="cls")
    assert "reconstruction.json; replaced an earlier reconstruction" in capfd.readouterr().out
    assert len(list(tmp_path.iterdir())) == 3


def test_options_of_another_form_are_named(tiny_dataset: Path, tmp_path: Path) -> None:
    sample = open_dataset(tiny_dataset, "test").folder(0)
    wrong: list[tuple[str, dict[str, Any]]] = [("--white", {"white": -1}), ("--scene", {"scene": "16"})]
    wrong += [("--set", {"set_": ["regularisation_lambda"]}), ("--set", {"set_": ["=1"]})]
    for option, given in wrong:
        with pytest.raises(InputError, match=f"^{option}: "):
            reconstruct(sample, method="cls", output=tmp_path / "out", **given)
    assert not (tmp_path / "out").exists()
