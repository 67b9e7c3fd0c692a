"""A whole evaluation on the tiny data set: its numbers against an independent computation, and its files."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.classical.method import DEFAULTS, build_classical
from learning.config import EvaluateConfig
from learning.data import ExampleSet
from learning.evaluate.job import evaluate
from learning.method import linear_to_srgb
from learning.tune.study import Study
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError

TEST_SCENES = 3  # of `load`
Load = Callable[..., EvaluateConfig]


def _psnr_db(measurement: np.ndarray, noiseless: np.ndarray) -> float:
    return 20 * np.log10(noiseless.max() / np.sqrt(np.mean((measurement - noiseless).astype(np.float64) ** 2)))


@pytest.mark.usefixtures("no_figures")
def test_the_table_is_of_the_estimates(
    load: Load, tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path], written: Callable[[], dict[str, Any]]
) -> None:
    evaluate(load())
    rows = list(csv.DictReader((tmp_path / "out" / "table.csv").read_text(encoding="utf-8").splitlines()))
    rows = [row for row in rows if not row["seed"]]
    assert [row["method"] for row in rows][:2] == ["FlatNet3D", "CLS"]
    test = open_dataset(tiny_dataset, "test")
    psnr, depth = np.zeros((2, TEST_SCENES)), np.zeros((2, TEST_SCENES))
    for seed, path in enumerate(checkpoints[:2]):
        checkpoint = load_checkpoint(path)
        for scene in range(TEST_SCENES):
            stored, frame = test.stored(scene), test.stored(scene).frame(0)
            with torch.no_grad():
                found = checkpoint.network(torch.from_numpy(stored.measurement()[0][None]))
            truth = linear_to_srgb(torch.from_numpy(frame.rgb), checkpoint.capture.white).numpy().astype(np.float64)
            image = np.moveaxis(found.image[0].numpy().astype(np.float64).clip(0, 1), 0, -1)
            psnr[seed, scene] = -10 * np.log10(np.mean((image - truth) ** 2))
            near, far = checkpoint.capture.near_m, checkpoint.capture.far_m
            disparity = found.disparity[0, 0].numpy().astype(np.float64).clip(0, 1)
            error = 1 / (1 / far + disparity * (1 / near - 1 / far)) - frame.depth_m
            depth[seed, scene] = 100 * np.sqrt(np.mean(error[frame.valid] ** 2))
    for name, table in (("psnr", psnr), ("depth_rmse_cm", depth)):
        # float32 networks, in batches of two and one at a time.
        assert float(rows[0][f"{name}_mean"]) == pytest.approx(table.mean(), rel=1e-4)
        assert float(rows[0][f"{name}_over_scenes"]) == pytest.approx(table.mean(0).std(ddof=1), rel=1e-3)
        assert float(rows[0][f"{name}_over_seeds"]) == pytest.approx(table.mean(1).std(ddof=1), rel=1e-3)
    assert (rows[0]["seeds"], rows[1]["seeds"]) == ("2", "1")
    assert rows[1]["psnr_over_seeds"] == ""
    results, levels = written(), [_psnr_db(*test.stored(n).measurement()) for n in range(3)]
    assert results["data"]["scenes"] == TEST_SCENES
    assert results["data"]["stored_psnr_db"] == pytest.approx(np.mean(levels))
    assert results["outcomes"][1]["identities"][0]["parameters"] == DEFAULTS["cls"] | {"regularisation_lambda": 0.1}
    assert [one["seed"] for one in (c["record"] for c in results["methods"][0]["checkpoints"])] == [0, 1]


@pytest.mark.usefixtures("no_figures")
def test_levels_of_noise_differ_and_are_as_asked(load: Load, written: Callable[[], dict[str, Any]]) -> None:
    through = {"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 1e-4}}  # lets noise through
    config = load(methods=[through], noise_db=[20, 60])
    evaluate(config)
    stored, noisy, clean = (one["scores"]["psnr"]["mean"] for one in written()["outcomes"])
    assert noisy < stored < clean
    assert clean - noisy > 1
    test = open_dataset(str(config.data.test), "test")
    for level in (20.0, 60.0):
        example = ExampleSet(test, noise_db=(level, level))[0]
        found = _psnr_db(example.measurement.numpy(), test.stored(0).measurement()[1])
        assert level - 0.1 < found < level + 3.1  # clipping at 0 takes away at most half of the error's energy


@pytest.mark.usefixtures("no_figures")
def test_methods_are_compared_at_every_level(load: Load, tmp_path: Path, written: Callable[[], dict[str, Any]]) -> None:
    evaluation, files = evaluate(load(noise_db=[20], reference="CLS", ablation_scenes=2))
    found = evaluation.findings[""]
    assert [title.partition(" (")[0] for title in found.differences] == ["stored", "20 dB"]
    pairs = [("CLS", "FlatNet3D"), ("CLS", "FlatNet3D, seed 1"), ("CLS", "FlatNet3D, seed 2")]
    for outcomes, differences in zip((found.main, found.ablation), found.differences.values(), strict=True):
        net, cls = (one.scores["psnr"].mean for one in outcomes)
        of_psnr = [one for one in differences if one.score == "psnr"]
        assert [(one.reference, one.other) for one in of_psnr] == pairs
        assert of_psnr[0].mean == pytest.approx(cls - net)
        assert np.mean([one.mean for one in of_psnr[1:]]) == pytest.approx(cls - net)
        assert {one.scenes for one in differences} == {outcomes[0].scenes}
    text = files[0].read_text(encoding="utf-8")
    assert "At further levels: of the first 2 of 3 scenes." in text.partition("## Paired differences")[2]
    lines = (tmp_path / "out" / "paired.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + 2 * 3 * 4  # levels, pairs, scores
    assert len(written()["paired"]) == 2 * 3 * 4
    for wrong, key in (({"reference": "ADMM"}, "reference: "), ({"noise_db": [0]}, r"noise_db\[0\]: ")):
        with pytest.raises(InputError, match=key):
            load(**wrong)


@pytest.mark.usefixtures("no_figures")
def test_the_captured_stack_is_used(load: Load, written: Callable[[], dict[str, Any]]) -> None:
    evaluate(load(data={"compare_stacks": ["nominal", "captured"]}))
    results = written()
    for method in ("FlatNet3D", "CLS"):
        by_stack = {one["stack"]: one for one in results["outcomes"] if one["method"] == method}
        own, nominal, captured = (by_stack[name]["scores"] for name in ("own", "nominal", "captured"))
        assert own == nominal
        assert captured["psnr"]["mean"] != nominal["psnr"]["mean"]
    # As the measurements say when they are inverted with that stack by hand.
    test, train = (open_dataset(results["config"]["data"]["test"], split) for split in ("test", "train"))
    capture = capture_model(test, "captured", white=measure_reference_white(train))
    method = build_classical(capture, "cls", {"regularisation_lambda": 0.1})
    psnr = []
    for scene in range(TEST_SCENES):
        found = method.reconstruct(torch.from_numpy(test.stored(scene).measurement()[0][None])).clamped()
        truth = linear_to_srgb(torch.from_numpy(test.stored(scene).frame(0).rgb), method.capture.white)
        psnr.append(-10 * np.log10(np.mean((found.image[0].permute(1, 2, 0) - truth).numpy().astype(np.float64) ** 2)))
    assert by_stack["captured"]["scores"]["psnr"]["mean"] == pytest.approx(np.mean(psnr), rel=1e-4)


@pytest.mark.usefixtures("no_figures")
def test_noise_and_stacks_may_have_fewer_scenes(load: Load) -> None:
    methods = [{"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 0.1}}]
    stacks = {"stack": "nominal", "compare_stacks": ["nominal", "captured"]}
    evaluation, files = evaluate(load(methods=methods, noise_db=[30], data=stacks, ablation_scenes=2))
    found = evaluation.findings[""]
    assert [one.scenes for one in found.main] == [TEST_SCENES]
    assert [(one.noise_db, one.scenes) for one in found.ablation] == [(30, 2)]
    assert [(one.stack, one.scenes) for one in found.compared] == [("nominal", 2), ("captured", 2)]
    assert {one.scenes for one in found.naive_part} == {2}
    assert files[0].read_text(encoding="utf-8").count("Of the first 2 of 3 scenes.") == 2
    # The same two scenes give the same numbers in an evaluation of two.
    alone = evaluate(load(methods=methods, noise_db=[30], data=stacks | {"scenes": 2}, output="two"))[0].findings[""]
    assert alone.ablation[0].scores == found.ablation[0].scores
    assert alone.compared[0].scores == found.compared[0].scores
    assert alone.compared[1].scores == found.compared[1].scores


def test_the_report_shows_how_networks_learned(
    load: Load, tmp_path: Path, checkpoints: list[Path], written: Callable[[], dict[str, Any]]
) -> None:
    """Of the checkpoint that lies where it was trained; the other's training is not at hand."""
    trained = tmp_path / "run" / "best.safetensors"
    trained.parent.mkdir()
    shutil.copyfile(checkpoints[0], trained)
    lines = [{"step": step, "kind": "validation", "psnr_db": step / 10.0} for step in (100, 200)]
    (trained.parent / "metrics.jsonl").write_text("\n".join(map(json.dumps, lines)), encoding="utf-8")
    methods = [{"name": "FlatNet3D", "checkpoints": [str(trained), str(checkpoints[1])]}]
    _, files = evaluate(load(methods=methods, data={"scenes": 2}))
    assert "curves.png" in {path.name for path in files}
    assert "(curves.png)" in files[0].read_text(encoding="utf-8")
    assert written()["curves"] == [{"method": "FlatNet3D", "steps": [100, 200], "scores": {"psnr": [10.0, 20.0]}}]


def test_all_files_are_written_and_the_report_shows_them(
    load: Load, tmp_path: Path, written: Callable[[], dict[str, Any]]
) -> None:
    stages: dict[str, tuple[int, int]] = {}
    said: list[str] = []
    data = {"compare_stacks": ["captured"], "scenes": 2}
    config = load(data=data, noise_db=[30], time={"repeats": 1}, figures={"montage": 1}, threads=1)
    threads = torch.get_num_threads()
    _, files = evaluate(config, progress=lambda stage, *counts: stages.__setitem__(stage, counts), say=said.append)
    assert torch.get_num_threads() == threads
    names = [path.name for path in files]
    assert names[:4] == ["report.md", "table.csv", "results.json", "paired.csv"]
    assert set(json.loads((tmp_path / "out" / "evaluation.json").read_bytes())["files"]) == set(names)
    report = files[0].read_text(encoding="utf-8")
    for name in ("montage.png", "noise.png", "depth.png", "stacks.png", "times.png"):
        assert name in names
        assert f"({name})" in report
        Image.open(tmp_path / "out" / name).verify()
    assert stages == {"FlatNet3D": (12, 12), "CLS": (6, 6), "times": (2, 2)}
    assert said[0] == "no LPIPS: it was not asked for"
    assert [line.partition(":")[0] for line in said[1:]] == ["FlatNet3D"]  # whose checkpoints say nothing of scenes
    assert f"- {said[1]}" in report
    assert "1 of " in written()["device"]
    times = {one["method"]: one["stages_s"] for one in written()["times"]}
    assert set(times["FlatNet3D"]) == {"inversion", "network"}
    assert set(times["CLS"]) == {"inversion", "graph cut", "assembly"}


@pytest.mark.usefixtures("no_figures")
def test_parameters_are_those_of_the_nearest_tuned_level(
    load: Load, tmp_path: Path, written: Callable[[], dict[str, Any]]
) -> None:
    study = Study(tmp_path / "tuned.json", {"data": "another"}, {})
    for level, regularisation_lambda in ((20.0, 0.5), (40.0, 0.05)):
        parameters = {**DEFAULTS["cls"], "regularisation_lambda": regularisation_lambda}
        study.add_result({"method": "cls", "noise_db": level, "parameters": parameters, "score": 1.0})
    evaluate(load(methods=[{"name": "CLS", "classical": "cls", "tuned": "tuned.json"}], noise_db=[25, 50]))
    outcomes = written()["outcomes"]
    assert [one["identities"][0]["parameters"]["regularisation_lambda"] for one in outcomes] == [0.05, 0.5, 0.05]
    assert [one["note"].split("(")[1] for one in outcomes] == ["tuned at 40 dB)", "tuned at 20 dB)", "tuned at 40 dB)"]
    assert [one["tuned_db"] for one in outcomes] == [40, 20, 40]


def test_known_scenes_do_not_decide(load: Load, tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path]) -> None:
    """What counts as known: see test_methods."""
    known, fingerprint = load_checkpoint(checkpoints[0]), open_dataset(tiny_dataset, "validation").fingerprint
    path, record = tmp_path / "knows.safetensors", {"data sets": {"validation": {"fingerprint": fingerprint}}}
    save_checkpoint(path, known.network, architecture=known.architecture, capture=known.capture, record=record)
    Study(tmp_path / "tuned.json", {"data": fingerprint, "split": "validation"}, {}).add_result(
        {"method": "cls", "noise_db": 40.0, "parameters": dict(DEFAULTS["cls"]), "score": 1.0}
    )
    for knows in ({"checkpoints": [str(path)]}, {"classical": "cls", "tuned": "tuned.json"}):
        with pytest.raises(InputError, match=r"^It: "):
            evaluate(load(methods=[{"name": "It", **knows}], data={"split": "validation"}))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"methods": [{"name": "N", "checkpoints": ["none.safetensors"]}]}, r"^N: .*none\.safetensors"),
        ({"methods": [{"name": "C", "classical": "cls", "tuned": "none.json"}]}, r"none\.json: "),
        ({"methods": [{"name": "C", "classical": "cls", "parameters": {"speed": 1}}]}, "^C: .*speed"),
        ({"methods": [{"name": "P", "classical": "pnp", "parameters": {"prior": -1.0}}]}, "^P: prior: "),
        ({"methods": [{"name": "C", "classical": "cls", "tuned": "bad.json"}]}, r"^C: .*bad\.json: pairwise: "),
        ({"data": {"test": {"report.md": "x"}}}, r"^data\.test\.report\.md: "),
        ({"data": {"test": {"cache": "x"}}}, r"^data\.test\.cache: "),
        ({"data": {"test": "nowhere"}}, "nowhere: "),
        ({"data": {"stack": "no_folder"}}, "^FlatNet3D: "),
        ({"perceptual": "lpips"}, r"^perceptual: got lpips, .*alexnet-owt-7be5be79\.pth or vgg16"),
    ],
)
def test_what_is_missing_is_named(load: Load, tmp_path: Path, monkeypatch: Any, changes: Any, message: str) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "no weights"))
    bad = {"method": "cls", "noise_db": 40.0, "parameters": DEFAULTS["cls"] | {"pairwise": -1.0}, "score": 1.0}
    Study(tmp_path / "bad.json", {"data": "another"}, {}).add_result(bad)
    with pytest.raises(InputError, match=message):
        evaluate(load(**changes))
    assert not (tmp_path / "out").exists()


def test_seeds_are_of_one_training(load: Load, checkpoints: list[Path]) -> None:
    """Which differ, see test_methods."""
    with pytest.raises(InputError, match=r"^N: got different trainings: .*flatnet2d_0\.safetensors has network"):
        evaluate(load(methods=[{"name": "N", "checkpoints": [str(checkpoints[0]), str(checkpoints[2])]}]))


def test_scenes_without_depth_are_refused(learning_trial: Any, load: Load) -> None:
    flat = learning_trial.generate("scene.flat=true", dataset={"train": 2, "validation": 0, "test": 2})
    with pytest.raises(InputError, match="out: "):
        evaluate(load(data={"test": str(flat)}))
