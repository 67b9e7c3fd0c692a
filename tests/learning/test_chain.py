"""From nothing to an image by the commands alone: generate, train, evaluate, reconstruct; the numbers agree."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from numpy.typing import NDArray
from PIL import Image

from learning.method import linear_to_srgb
from simulator.dataset import open_dataset
from simulator.io.exr import read_exr

SCENES = 2
STEPS = 50


def write(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def scores(folder: Path, stored: Any, white: float) -> tuple[float, float]:
    """Return PSNR and depth RMSE in cm of a reconstruction's files, by NumPy."""
    frame = stored.frame(0)
    planes, told = read_exr(folder / "image.exr")
    linear = np.stack([planes[name] for name in "RGB"], axis=-1)
    both = (torch.from_numpy(np.ascontiguousarray(values)) for values in (linear, frame.rgb))
    found, truth = (linear_to_srgb(values, white).numpy() for values in both)
    depth_m: NDArray[np.float32] = read_exr(folder / "depth.exr")[0]["Z"]
    shown = np.asarray(Image.open(folder / "image.png"))
    assert shown.shape == truth.shape
    as_shown = linear_to_srgb(torch.from_numpy(np.ascontiguousarray(linear)), told["white"]).numpy()
    assert np.abs(shown - as_shown * 255.0).max() <= 0.51  # rounding to 8 bit
    squares = (depth_m.astype(np.float64) - frame.depth_m)[frame.valid] ** 2
    return -10 * np.log10(np.mean((found.astype(np.float64) - truth) ** 2)), 100 * np.sqrt(squares.mean())


@pytest.mark.slow
def test_generate_train_evaluate_reconstruct(
    learning_trial: Any, flatlight: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    # Only written here: the command shall generate.
    monkeypatch.setattr(learning_trial.trial, "generate", learning_trial.trial.write)
    generation = learning_trial.generate(dataset={"train": 32, "validation": 4, "test": SCENES})
    code, _, err = flatlight("generate", generation)
    assert code == 0, err
    data = tmp_path / "out"

    training = {"name": "FlatNet3D tiny", "output": "trained", "data": {"train": str(data), "workers": 0}}
    training |= {"network": {"size": "tiny"}, "steps": STEPS, "batch": 4, "validate_every": STEPS // 2, "log_every": 5}
    code, out, err = flatlight("train", write(tmp_path / "train.yaml", training), "--set", "seed=3")
    assert code == 0, err
    assert f"{STEPS} steps" in out
    checkpoint = tmp_path / "trained" / "best.safetensors"
    lines = [json.loads(line) for line in (tmp_path / "trained" / "metrics.jsonl").read_text().splitlines()]
    assert max(line["step"] for line in lines) == STEPS

    evaluation = {
        "name": "chain",
        "output": "evaluated",
        "data": {"test": str(data), "training": str(data)},
        "methods": [
            {"name": "FlatNet3D", "checkpoints": [str(checkpoint)]},
            {"name": "CLS", "classical": "cls", "parameters": {}},
            {"name": "ADMM", "classical": "admm", "parameters": {"iterations": 5}},
        ],
        "perceptual": "none",
        "time": {"repeats": 1},
        "figures": {"montage": 1},
    }
    code, out, err = flatlight("evaluate", write(tmp_path / "evaluate.yaml", evaluation))
    assert code == 0, err
    results = json.loads((tmp_path / "evaluated" / "results.json").read_text(encoding="utf-8"))
    by_method = {one["method"]: one["scores"] for one in results["outcomes"]}
    assert list(by_method) == ["FlatNet3D", "CLS", "ADMM"]
    for name, found in by_method.items():
        assert name in out
        for score in ("psnr", "ssim", "depth_rmse_cm"):
            assert np.isfinite(found[score]["mean"]), (name, score)
    assert Image.open(tmp_path / "evaluated" / "montage.png").convert("RGB").getextrema()[0] != (255, 255)

    test = open_dataset(data, "test")
    options = {
        "FlatNet3D": ("flatnet3d", ["--checkpoint", checkpoint]),
        "CLS": ("cls", ["--method", "cls", "--confidence", "none"]),
        "ADMM": ("admm", ["--method", "admm", "--set", "iterations=5", "--confidence", "none"]),
    }
    for name, (short, told) in options.items():
        table = []
        for scene in range(SCENES):
            sample = test.folder(scene)
            code, out, err = flatlight("reconstruct", sample, *told)
            assert code == 0, err
            table.append(scores(tmp_path / f"test_{sample.name}_{short}", test.stored(scene), results["white"]))
        psnr_db, depth_cm = np.mean(table, axis=0)
        # The same method by two commands, in float32: batches of two and of one; image.exr holds float32 radiance.
        assert psnr_db == pytest.approx(by_method[name]["psnr"]["mean"], rel=1e-4), name
        assert depth_cm == pytest.approx(by_method[name]["depth_rmse_cm"]["mean"], rel=1e-3), name


@pytest.mark.slow
def test_clips_from_generating_to_a_film(
    learning_trial: Any, clip_settings: Any, flatlight: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    """The same for clips: VideoNet, joint least squares and FISTA-TV, scored alike by two commands."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(learning_trial.trial, "generate", learning_trial.trial.write)
    counts = {"train": 16, "validation": 4, "test": SCENES}
    generation = learning_trial.generate(**clip_settings | {"dataset": clip_settings["dataset"] | counts})
    code, _, err = flatlight("generate", generation)
    assert code == 0, err
    data = tmp_path / "out"
    training = {"name": "VideoNet tiny", "output": "trained", "steps": STEPS, "batch": 4, "validate_every": STEPS // 2}
    training |= {"data": {"train": str(data), "workers": 0, "augment": {}, "draws": 1, "cache": str(tmp_path / "kept")}}
    training |= {"network": {"name": "videonet", "size": "tiny"}, "log_every": 5}
    code, out, err = flatlight("train", write(tmp_path / "train.yaml", training))
    assert code == 0, err
    assert "of moving pixels" in out
    checkpoint = tmp_path / "trained" / "best.safetensors"
    evaluation = {
        "name": "chain",
        "output": "evaluated",
        "data": {"test": str(data), "training": str(data)},
        "methods": [
            {"name": "VideoNet", "checkpoints": [str(checkpoint)]},
            {"name": "joint", "classical": "joint", "parameters": {"iterations": 5}},
            {"name": "FISTA", "classical": "fista", "parameters": {"iterations": 5}},
        ],
        "perceptual": "none",
        "time": {"repeats": 1},
        "figures": {"montage": 1},
    }
    code, out, err = flatlight("evaluate", write(tmp_path / "evaluate.yaml", evaluation))
    assert code == 0, err
    results = json.loads((tmp_path / "evaluated" / "results.json").read_text(encoding="utf-8"))
    by_method = {one["method"]: one["scores"] for one in results["outcomes"]}
    test = open_dataset(data, "test")
    options = {
        "VideoNet": ("videonet", ["--checkpoint", checkpoint]),
        "joint": ("joint", ["--method", "joint", "--set", "iterations=5"]),
        "FISTA": ("fista", ["--method", "fista", "--set", "iterations=5"]),
    }
    for name, (short, told) in options.items():
        psnr = []
        for scene in range(SCENES):
            sample = test.folder(scene)
            code, out, err = flatlight("reconstruct", sample, *told)
            assert code == 0, err
            frames = sorted((tmp_path / f"test_{sample.name}_{short}" / "frames").iterdir())
            linear = np.stack([np.stack([read_exr(path)[0][c] for c in "RGB"], axis=-1) for path in frames])
            truth = test[scene].rgb.reshape(4, 2, *linear.shape[1:]).mean(axis=1)
            both = (torch.from_numpy(np.ascontiguousarray(values, np.float32)) for values in (linear, truth))
            found, true = (linear_to_srgb(values, results["white"]).numpy().astype(np.float64) for values in both)
            psnr.append(-10 * np.log10(np.mean((found - true) ** 2)))
        # As of stills: float32, batches of two and of one
        assert np.mean(psnr) == pytest.approx(by_method[name]["psnr"]["mean"], rel=1e-4), name


@pytest.mark.slow
def test_moving_scenes_from_generating_to_frames_and_depth(
    learning_trial: Any, clip_settings: Any, flatlight: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    """Stills, a FlatNet3D of them, clips, a VideoNet3D that begins with it; tested on clips that move and that do not."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(learning_trial.trial, "generate", learning_trial.trial.write)
    stills = learning_trial.generate(dataset={"train": 16, "validation": 2, "test": 0, "output": "stills"})
    code, _, err = flatlight("generate", stills)
    assert code == 0, err
    training = {
        "name": "FlatNet3D",
        "output": "flat",
        "steps": STEPS,
        "batch": 4,
        "validate_every": STEPS,
        "log_every": 9,
    }
    training |= {"data": {"train": "stills", "workers": 0}, "network": {"size": "tiny"}}
    code, _, err = flatlight("train", write(tmp_path / "flat.yaml", training))
    assert code == 0, err
    of_clips = {"camera": clip_settings["camera"], "scene": {"frames": 8, "speed": 1}}
    counts = clip_settings["dataset"] | {"train": 16, "validation": 4, "test": SCENES, "output": "clips"}
    code, _, err = flatlight("generate", learning_trial.generate(**of_clips, dataset=counts))
    assert code == 0, err
    again = {"source": "samples", "path": str(tmp_path / "clips"), "family": None, "still": True, "speed": None}
    counts |= {"train": 0, "validation": 0, "output": "stopped"}
    code, _, err = flatlight("generate", learning_trial.generate(**of_clips | {"scene": again}, dataset=counts))
    assert code == 0, err
    training |= {"name": "VideoNet3D", "output": "moving", "init_from": "flat/best.safetensors"}
    training |= {"data": {"train": "clips", "workers": 0, "augment": {"still": 0.2}, "draws": 1, "cache": "kept"}}
    training |= {"network": {"name": "videonet3d", "size": "tiny"}}
    code, out, err = flatlight("train", write(tmp_path / "moving.yaml", training))
    assert code == 0, err
    assert "depth RMSE" in out
    for data in ("clips", "stopped"):
        evaluation = {
            "name": data,
            "output": f"evaluated_{data}",
            "data": {"test": data},
            "methods": [
                {"name": "VideoNet3D", "checkpoints": ["moving/best.safetensors"]},
                {"name": "FlatNet3D", "checkpoints": ["flat/best.safetensors"]},
            ],
            "perceptual": "none",
            "time": {"repeats": 1},
            "figures": {"montage": 1},
        }
        code, out, err = flatlight("evaluate", write(tmp_path / f"{data}.yaml", evaluation))
        assert code == 0, err
        results = json.loads((tmp_path / f"evaluated_{data}" / "results.json").read_text(encoding="utf-8"))
        found = next(one["scores"] for one in results["outcomes"] if one["method"] == "VideoNet3D")
        assert ("moving_psnr" in found, "depth_rmse_cm" in found) == (data == "clips", True)
    sample = open_dataset(tmp_path / "clips", "test").folder(0)
    code, out, err = flatlight("reconstruct", sample, "--checkpoint", "moving/best.safetensors", "--output", "film")
    assert code == 0, err
    assert len(list((tmp_path / "film" / "frames").glob("depth.*.exr"))) == 4


@pytest.mark.slow
def test_labelled_clips_from_generating_to_a_name(
    learning_trial: Any, clip_settings: Any, flatlight: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    """The same for what is done: ActivityNet and a lens, whose answers two commands agree on; and clips backwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(learning_trial.trial, "generate", learning_trial.trial.write)
    counts = {"train": 16, "validation": 4, "test": 6}
    scene = clip_settings["scene"] | {"labelled": True, "speed": 2}
    changes = clip_settings | {"dataset": clip_settings["dataset"] | counts, "scene": scene}
    generation = learning_trial.generate(**changes)
    code, _, err = flatlight("generate", generation)
    assert code == 0, err
    data = tmp_path / "out"
    again = {"source": "samples", "path": str(data), "size": [16, 16], "backwards": True}
    code, _, err = flatlight("generate", generation, "--set", f"scene={again}", "--set", "dataset.output=back")
    assert code == 0, err
    rows = []
    for name, network in {"net": {"name": "activitynet", "size": "tiny"}, "lens": {"name": "lens_classifier"}}.items():
        training = {"name": name, "output": name, "network": network, "steps": STEPS // 2, "batch": 4}
        training |= {"data": {"train": str(data), "workers": 0, "draws": 1, "cache": str(tmp_path / "kept")}}
        code, out, err = flatlight("train", write(tmp_path / f"{name}.yaml", training))
        assert code == 0, err
        assert "top-2 100.0%" in out
        rows.append({"name": name, "checkpoints": [f"{name}/best.safetensors"]})
    evaluation = {"name": "chain", "output": "evaluated", "classifiers": rows, "ceiling": "lens", "shown": 2}
    evaluation |= {"data": {"test": str(data), "backwards": "back"}, "noise_db": [20], "timed": 1}
    code, out, err = flatlight("evaluate", write(tmp_path / "evaluate.yaml", evaluation))
    assert code == 0, err
    results = json.loads((tmp_path / "evaluated" / "results.json").read_text(encoding="utf-8"))
    assert results["classes"] == ["leftwards", "rightwards"]
    assert np.shape(results["backwards"]["confusion_after_reversal"]) == (2, 2)
    confusion = np.zeros((2, 2))
    test = open_dataset(data, "test")
    for at in range(len(test)):
        code, out, err = flatlight("reconstruct", test.folder(at), "--checkpoint", "net/best.safetensors")
        assert code == 0, err
        record = json.loads((tmp_path / f"test_{test.ids[at]}_activitynet" / "reconstruction.json").read_text())
        said = max(record["classes"], key=record["classes"].get)
        assert f"shows  {said} " in out
        assert f"its label is {test[at].label}" in out
        confusion[results["classes"].index(str(test[at].label)), results["classes"].index(said)] += 1 / 3
    np.testing.assert_allclose(results["predictions"][0]["confusion"], confusion, atol=1e-9)


@pytest.mark.slow
@pytest.mark.shared
def test_real_films_through_the_presets(flatlight: Any, tmp_path: Path, monkeypatch: Any, shared_data: Path) -> None:
    """Films of Something-Something V2 in coarse classes, by `init`, `generate`, `train` and `reconstruct`."""
    monkeypatch.chdir(tmp_path)
    samples, films = shared_data / "ssv2", tmp_path / "something"
    films.mkdir()
    shutil.copy(samples / "something-something-v2-labels.json", films)
    listed = json.loads((samples / "something-something-v2-validation.first400.json").read_bytes())
    (films / "something-something-v2-validation.json").write_text(json.dumps(listed))
    # The first is of its class; the samples beside it stand in for films of others.
    classes = {
        "166766": "Picking [something] up",
        "closing_0": "Holding [something]",
        "moving_away_1": "Poking [something]",
    }
    for name, template in classes.items():
        identity = next(item["id"] for item in listed if item["template"].startswith(template))
        shutil.copy(samples / "clips" / f"{name}.webm", films / f"{identity}.webm")
    for preset in ("something_something_v2", "activitynet_64"):
        assert flatlight("init", "--preset", preset)[0] == 0
    counts = {"train": 6, "validation": 3, "test": 3, "share_videos": "true"}
    told = [word for key, value in counts.items() for word in ("--set", f"dataset.{key}={value}")]
    code, out, err = flatlight("generate", "something_something_v2.yaml", "--set", f"scene.path={films}", *told)
    assert code == 0, err
    settings = {
        "data.train": "out/something_v2",
        "data.workers": 0,
        "data.draws": 1,
        "data.cache": str(tmp_path / "kept"),
    }
    settings |= {"network": "{name: activitynet, joint_iterations: 2}", "steps": 2, "batch": 3, "output": "trained"}
    told = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    code, out, err = flatlight("train", "activitynet_64.yaml", *told)
    assert code == 0, err
    rows = [{"name": "net", "checkpoints": ["trained/best.safetensors"]}]
    evaluation = {"name": "films", "output": "evaluated", "data": {"test": "out/something_v2"}, "classifiers": rows}
    code, out, err = flatlight("evaluate", write(tmp_path / "evaluate.yaml", evaluation))
    assert code == 2
    assert "learned from test scenes" in err  # there are only three films, which all splits share
    sample = open_dataset(tmp_path / "out" / "something_v2", "test").folder(0)
    code, out, err = flatlight("reconstruct", sample, "--checkpoint", "trained/best.safetensors")
    assert code == 0, err
    assert "shows  " in out
    assert sum(name in out for name in ("Holding something", "Picking something up", "Poking something")) >= 2
