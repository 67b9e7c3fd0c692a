"""A whole evaluation on the tiny data set: its numbers against an independent computation, and what it keeps."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from PIL import Image

from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.classical.by_name import build_method
from learning.classical.clips import ClipMethod
from learning.classical.fitting import FilmNetwork
from learning.classical.method import DEFAULTS, ClassicalMethod, build_classical
from learning.config import EvaluateConfig, load_file
from learning.data import ExampleSet
from learning.evaluate import report, runs
from learning.evaluate.job import CACHE, evaluate
from learning.method import linear_to_srgb
from learning.models import build_network
from learning.provenance import scenes_of
from learning.tune.study import Study
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError

TEST_SCENES = 3
Load = Callable[..., EvaluateConfig]


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing and measure no FLIP: both take longer than all the rest, and have tests of their own."""
    monkeypatch.setattr(report, "_figures", lambda *_: {})
    monkeypatch.setattr("flip_evaluator.evaluate", lambda *_, **__: (None, 0.5, None))


@pytest.fixture
def load(tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path]) -> Load:
    """Return a function that writes an evaluation's file and loads it."""

    def load(**changes: Any) -> EvaluateConfig:
        content: dict[str, Any] = {
            "name": "trial",
            "output": "out",
            "data": {"test": str(tiny_dataset), "training": str(tiny_dataset), "scenes": TEST_SCENES},
            "methods": [
                {"name": "FlatNet3D", "checkpoints": [str(path) for path in checkpoints[:2]]},
                {"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 0.1}},
            ],
            "perceptual": "none",
            "time": {"repeats": 0},
            "figures": {"montage": 0},
            "batch": 2,
        }
        data = content["data"] | changes.pop("data", {})
        path = tmp_path / "evaluate.yaml"
        path.write_text(yaml.safe_dump(content | {"data": data} | changes, sort_keys=False), encoding="utf-8")
        return load_file(EvaluateConfig, path)

    return load


def _results(tmp_path: Path) -> dict[str, Any]:
    return json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))


def _psnr_db(measurement: np.ndarray, noiseless: np.ndarray) -> float:
    return 20 * np.log10(noiseless.max() / np.sqrt(np.mean((measurement - noiseless).astype(np.float64) ** 2)))


def test_clips_are_judged_frame_by_frame_and_by_group(load: Load, tmp_path: Path, clip_dataset: Path) -> None:
    """Two test clips of the tiny data set, by parity one each; depth has no part in it."""
    config = load(
        data={"test": str(clip_dataset), "training": str(clip_dataset), "scenes": 2},
        methods=[
            {"name": "joint", "classical": "joint", "parameters": {"iterations": 5}},
            {"name": "static", "classical": "static", "parameters": {}},
        ],
        group_by="parity",
        noise_db=[30],
        figures={"montage": 1},
    )
    evaluation, files = evaluate(config)
    found = evaluation.findings[""]
    names = {path.name for path in files}
    assert {"films.png", "films.webp", "report.md"} <= names
    assert not names & {"montage.png", "depth.png"}
    test = open_dataset(clip_dataset, "test")
    capture = capture_model(test, white=found.camera.white)
    truth = linear_to_srgb(torch.stack([ExampleSet(test)[n].radiance for n in range(2)]), capture.white).numpy()
    measured = torch.stack([ExampleSet(test)[n].measurement for n in range(2)])
    image = build_method(capture, "joint", {"iterations": 5}).reconstruct(measured).image.numpy().clip(0, 1)
    psnr = -10 * np.log10(np.mean((image.astype(np.float64) - truth) ** 2, axis=(1, 2, 3, 4)))
    row = next(one for one in found.main if one.method == "joint")
    assert row.values["psnr"][0] == pytest.approx(psnr, rel=1e-4)  # float32, in batches
    assert "depth_rmse_cm" not in row.scores
    assert "moving_psnr" in row.scores
    for parity in range(2):
        group = {one.method: one for one in found.groups[f"parity: {parity}"]}
        assert group["joint"].scores["psnr"].mean == pytest.approx(psnr[parity], rel=1e-4)
        assert {"black", "mean film"} < set(group)
        exposed = linear_to_srgb(ExampleSet(test)[parity].radiance.mean(dim=0), capture.white).numpy()
        for oracle, still in (("perfect long exposure", exposed), ("best still film", truth[parity].mean(axis=0))):
            wanted = -10 * np.log10(np.mean((still - truth[parity]) ** 2))
            assert group[oracle].scores["psnr"].mean == pytest.approx(wanted, rel=1e-4)
        assert group["best still film"].scores["psnr"].mean > group["perfect long exposure"].scores["psnr"].mean
    pairs = {(one.reference, one.other): one.mean for one in found.differences["parity: 0"] if one.score == "psnr"}
    oracle = next(one for one in found.groups["parity: 0"] if one.kind == "oracle")
    gain = psnr[0] - oracle.scores["psnr"].mean
    assert pairs["joint", "perfect long exposure"] == pytest.approx(gain, rel=1e-4)
    compared = [{one.other for one in differences} for differences in found.differences.values()]
    assert compared == 4 * [
        {"static", "perfect long exposure", "best still film"}
    ]  # as stored, of both parities, at 30 dB
    text = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    for words in ("4 slivers", "one plane at 5 cm", "## Parity: 0", "moving PSNR dB", "films.webp"):
        assert words in text
    assert "epth RMSE" not in text


@pytest.mark.usefixtures("no_figures")
def test_what_is_fitted_to_each_capture_is_kept_and_not_timed(
    load: Load, clip_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = [
        {"name": "fit", "classical": "nstm", "parameters": {"iterations": 2, "width": 8}},
        {"name": "static", "classical": "static", "parameters": {}},
    ]
    data = {"test": str(clip_dataset), "training": str(clip_dataset), "scenes": 2}
    evaluate(load(data=data, methods=methods, time={"repeats": 1}))
    cache = tmp_path / "out" / "cache"
    fits = sorted(cache.glob("fits/*/*.pt"))
    assert len(fits) == 2
    assert [one["method"] for one in _results(tmp_path)["times"]] == ["static"]
    # Of an evaluation that died before its end, the fits are taken up again.
    for path in cache.glob("*.json"):
        path.unlink()
    first = _results(tmp_path)["outcomes"]
    with monkeypatch.context() as patched:
        patched.setattr(FilmNetwork, "penalty", lambda *_: pytest.fail("an iteration of a fit that was done"))
        evaluate(load(data=data, methods=methods))
    assert _results(tmp_path)["outcomes"] == first
    assert sorted(cache.glob("fits/*/*.pt")) == fits
    # Other code may find other films.
    monkeypatch.setattr("learning.evaluate.runs.code_digest", lambda *_: "another")
    evaluate(load(data=data, methods=methods))
    assert len(list(cache.glob("fits/*/*.pt"))) == 4


@pytest.mark.slow
def test_networks_for_stills_give_all_frames_the_same(
    load: Load, tmp_path: Path, moving_dataset: Path, checkpoints: list[Path]
) -> None:
    """A FlatNet3D beside a method with depth of its own: by what the network makes of the captures as of stills."""
    flat = {"name": "FlatNet3D", "checkpoints": [str(checkpoints[0])]}
    joint = {"name": "joint", "classical": "joint3d", "parameters": {"iterations": 2, "planes": 2}}
    data = {"test": str(moving_dataset), "training": str(moving_dataset), "scenes": 2}
    evaluation, files = evaluate(load(data=data, methods=[flat, joint], figures={"montage": 1}))
    found = evaluation.findings[""]
    assert "films.webp" in {path.name for path in files}
    test = open_dataset(moving_dataset, "test")
    known = load_checkpoint(checkpoints[0]).capture
    capture = replace(capture_model(test, white=known.white), timing=None).with_assumed(known)
    network = load_checkpoint(checkpoints[0], capture=capture).network
    errors_cm, psnr = [], []
    for example in ExampleSet(test):
        with torch.no_grad():
            image, disparity = network(example.measurement[None])
        found_m = capture.depth_m(disparity.double().clamp(0, 1)).expand(4, -1, -1, -1)
        error_cm = 100 * (found_m - example.depth_m)[example.valid]
        errors_cm.append(error_cm.square().mean().sqrt().item())
        truth = linear_to_srgb(example.radiance, capture.white)
        psnr.append(-10 * np.log10((image.clamp(0, 1) - truth).double().square().mean().item()))
    row = next(one for one in found.main if one.method == "FlatNet3D")
    # float32, in batches; depths of 20 cm from disparities
    assert row.values["depth_rmse_cm"][0] == pytest.approx(errors_cm, rel=1e-3)
    assert row.values["psnr"][0] == pytest.approx(psnr, rel=1e-4)
    assert "depth_rmse_cm" in next(one for one in found.main if one.method == "joint").scores
    titles = [film.name for film in found.films[0]]
    assert titles == ["truth", "depth", "FlatNet3D", "depth", "joint", "depth"]


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_the_frames_of_one_network_and_the_depth_of_another(
    load: Load, tmp_path: Path, moving_dataset: Path, checkpoints: list[Path]
) -> None:
    """Beside the networks that both are of; the first one, which knows one depth, decides nothing for the others."""
    train = open_dataset(moving_dataset, "train")
    moving = capture_model(train, white=1.5)
    one = moving.with_stack(
        replace(moving.stack, values=moving.stack.values[1:2], depths_m=moving.stack.depths_m[1:2], fingerprint="one")
    )
    architecture = {"network": "videonet", "size": "tiny", "joint_iterations": 2}
    video = build_network(one, "videonet", "tiny", joint_iterations=2)
    path, knows = tmp_path / "video.safetensors", tmp_path / "knows.safetensors"
    save_checkpoint(path, video, architecture=architecture, capture=one, record={})
    record = {"data sets": {"train": {"fingerprint": train.fingerprint}}, "scenes": {"train": scenes_of(train)}}
    save_checkpoint(knows, video, architecture=architecture, capture=one, record=record)
    flat = {"name": "FlatNet3D", "checkpoints": [str(checkpoints[0])]}
    both = {"name": "both", "checkpoints": [str(checkpoints[0])], "frames": str(path)}
    alone = {"name": "VideoNet", "checkpoints": [str(path)]}
    data: dict[str, Any] = {"test": str(moving_dataset), "training": str(moving_dataset), "scenes": 2}
    evaluation, _ = evaluate(load(data=data, methods=[alone, both, flat], figures={"montage": 1}))
    found = evaluation.findings[""]
    rows = {row.method: row for row in found.main}
    # float32, in batches
    assert rows["both"].values["psnr"] == pytest.approx(rows["VideoNet"].values["psnr"], rel=1e-5)
    assert rows["both"].values["depth_rmse_cm"] == pytest.approx(rows["FlatNet3D"].values["depth_rmse_cm"], rel=1e-5)
    assert abs(rows["both"].values["psnr"] - rows["FlatNet3D"].values["psnr"]).min() > 0.01
    assert found.edges_cm[0] == pytest.approx(1)
    assert found.edges_cm[-1] == pytest.approx(20)
    assert any(row.method.startswith("constant depth") for row in found.naive)
    assert [film.name for film in found.films[0]][:4] == ["truth", "depth", "VideoNet", "both"]
    plain = _results(tmp_path)["methods"]
    assert plain[1]["checkpoints"][0]["frames"]["file"] == "video.safetensors"

    with pytest.raises(InputError, match=r"^both: .*knows\.safetensors learned from"):
        evaluate(load(data=data | {"split": "train"}, methods=[flat | {"name": "both", "frames": str(knows)}]))
    with pytest.raises(InputError, match=r"^both: frames: .*flatnet3d_1\.safetensors is for stills"):
        evaluate(load(data=data, methods=[both | {"frames": str(checkpoints[1])}]))
    with pytest.raises(InputError, match=r"^both: got frames, but .* holds stills"):
        evaluate(load(methods=[both]))


def test_a_word_that_no_scene_has_and_methods_of_the_other_kind_are_refused(
    load: Load, clip_dataset: Path, clip_checkpoint: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = {"test": str(clip_dataset), "training": str(clip_dataset), "scenes": 2}
    joint = [{"name": "joint", "classical": "joint", "parameters": {"iterations": 1}}]
    monkeypatch.setattr("learning.evaluate.runs.score", lambda *_, **__: pytest.fail("work before the refusal"))
    with pytest.raises(InputError, match=r"^group_by: .*parity"):
        evaluate(load(data=data, methods=joint, group_by="colour"))
    with pytest.raises(InputError, match=r"^CLS: .*clips"):
        evaluate(load(data=data, methods=[{"name": "CLS", "classical": "cls", "parameters": {}}]))
    with pytest.raises(InputError, match=r"^joint: .*stills"):
        evaluate(load(methods=joint))
    moving = {"name": "VideoNet", "checkpoints": [str(clip_checkpoint)], "frames": str(clip_checkpoint)}
    with pytest.raises(InputError, match=r"^VideoNet: got frames of video\.safetensors for a network that has frames"):
        evaluate(load(data=data, methods=[moving]))
    with pytest.raises(InputError, match=r"methods\[0\].frames: a classical method has frames of its own"):
        load(methods=[joint[0] | {"frames": str(clip_checkpoint)}])


@pytest.mark.usefixtures("no_figures")
def test_the_table_is_of_the_estimates(load: Load, tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path]) -> None:
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
    results, levels = _results(tmp_path), [_psnr_db(*test.stored(n).measurement()) for n in range(3)]
    assert results["data"]["scenes"] == TEST_SCENES
    assert results["data"]["stored_psnr_db"] == pytest.approx(np.mean(levels))
    assert results["outcomes"][1]["identities"][0]["parameters"] == DEFAULTS["cls"] | {"regularisation_lambda": 0.1}
    assert [one["seed"] for one in (c["record"] for c in results["methods"][0]["checkpoints"])] == [0, 1]


@pytest.mark.usefixtures("no_figures")
def test_levels_of_noise_differ_and_are_as_asked(load: Load, tmp_path: Path) -> None:
    through = {"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 1e-4}}  # lets noise through
    config = load(methods=[through], noise_db=[20, 60])
    evaluate(config)
    stored, noisy, clean = (one["scores"]["psnr"]["mean"] for one in _results(tmp_path)["outcomes"])
    assert noisy < stored < clean
    assert clean - noisy > 1
    test = open_dataset(str(config.data.test), "test")
    for level in (20.0, 60.0):
        example = ExampleSet(test, noise_db=(level, level))[0]
        found = _psnr_db(example.measurement.numpy(), test.stored(0).measurement()[1])
        assert level - 0.1 < found < level + 3.1  # clipping at 0 takes away at most half of the error's energy


@pytest.mark.usefixtures("no_figures")
def test_methods_are_compared_at_every_level(load: Load, tmp_path: Path) -> None:
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
    assert len(_results(tmp_path)["paired"]) == 2 * 3 * 4
    for wrong, key in (({"reference": "ADMM"}, "reference: "), ({"noise_db": [0]}, r"noise_db\[0\]: ")):
        with pytest.raises(InputError, match=key):
            load(**wrong)


@pytest.mark.usefixtures("no_figures")
def test_the_captured_stack_is_used(load: Load, tmp_path: Path) -> None:
    evaluate(load(data={"compare_stacks": ["nominal", "captured"]}))
    results = _results(tmp_path)
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
def test_noise_and_stacks_may_have_fewer_scenes(load: Load, tmp_path: Path) -> None:
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


@pytest.mark.usefixtures("no_figures")
def test_only_what_changed_is_done_anew(load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scored: list[str] = []
    real = runs.score

    def counting(method: Any, *arguments: Any, **options: Any) -> dict[str, Any]:
        scored.append(method.name)
        return real(method, *arguments, **options)

    monkeypatch.setattr(runs, "score", counting)
    evaluate(load())
    first = _results(tmp_path)
    assert scored == ["FlatNet3D", "FlatNet3D", "CLS"]
    evaluate(load())
    assert len(scored) == 3
    assert _results(tmp_path) == first
    (tmp_path / "out" / "noise.png").write_bytes(b"of a run with other settings")
    evaluate(load())
    assert not (tmp_path / "out" / "noise.png").exists()
    with pytest.raises(InputError, match=r"^output: "):
        evaluate(load(name="another"))
    evaluate(load(noise_db=[30]))  # an extended evaluation does only what is new
    assert scored[3:] == ["FlatNet3D", "FlatNet3D", "CLS"]
    methods = [{"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 0.2}}]
    for changes in ({}, {"dark_share": 0.1}, {"data": {"scenes": 2}}):
        before = len(scored)
        evaluate(load(methods=methods, **changes))
        assert scored[before:] == ["CLS"], changes


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("clips", [True, False])
def test_an_interrupted_run_goes_on_where_it_was(
    load: Load, tmp_path: Path, clip_dataset: Path, monkeypatch: pytest.MonkeyPatch, clips: bool
) -> None:
    name, kind = ("static", ClipMethod) if clips else ("cls", ClassicalMethod)
    told = {"methods": [{"name": "it", "classical": name, "parameters": {}}], "batch": 1}
    if clips:
        told["data"] = {"test": str(clip_dataset), "training": str(clip_dataset), "scenes": 2}
    whole = evaluate(load(**told, output="whole"))[0].findings[""].main[0].scores
    monkeypatch.setattr(runs, "_KEEP_EVERY_S", 0.0)
    seen, real = [], kind.reconstruct

    def stopping(self: Any, measurement: Any) -> Any:
        seen.append(measurement)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return real(self, measurement)

    monkeypatch.setattr(kind, "reconstruct", stopping)
    with pytest.raises(KeyboardInterrupt):
        evaluate(load(**told))
    rest = evaluate(load(**told))[0].findings[""].main[0].scores
    assert len(seen) == 1 + (2 if clips else TEST_SCENES)  # what failed is done again, what was done is not
    assert rest == whole
    assert len(list((tmp_path / "out" / CACHE).glob("*.json"))) == 1


def test_the_report_shows_how_networks_learned(load: Load, tmp_path: Path, checkpoints: list[Path]) -> None:
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
    assert _results(tmp_path)["curves"] == [
        {"method": "FlatNet3D", "steps": [100, 200], "scores": {"psnr": [10.0, 20.0]}}
    ]


def test_all_files_are_written_and_the_report_shows_them(load: Load, tmp_path: Path) -> None:
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
    assert "1 of " in _results(tmp_path)["device"]
    times = {one["method"]: one["stages_s"] for one in _results(tmp_path)["times"]}
    assert set(times["FlatNet3D"]) == {"inversion", "network"}
    assert set(times["CLS"]) == {"inversion", "graph cut", "assembly"}


@pytest.mark.usefixtures("no_figures")
def test_parameters_are_those_of_the_nearest_tuned_level(load: Load, tmp_path: Path) -> None:
    study = Study(tmp_path / "tuned.json", {"data": "another"}, {})
    for level, regularisation_lambda in ((20.0, 0.5), (40.0, 0.05)):
        parameters = {**DEFAULTS["cls"], "regularisation_lambda": regularisation_lambda}
        study.add_result({"method": "cls", "noise_db": level, "parameters": parameters, "score": 1.0})
    evaluate(load(methods=[{"name": "CLS", "classical": "cls", "tuned": "tuned.json"}], noise_db=[25, 50]))
    outcomes = _results(tmp_path)["outcomes"]
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


@pytest.fixture
def other_camera(learning_trial: Any) -> Path:
    """A small data set of another camera, at another distance from its mask."""
    return learning_trial.generate(
        "camera.mask_to_sensor_mm=2.3", "seed=8", dataset={"train": 2, "test": 2, "validation": 0}
    )


@pytest.mark.slow
def test_several_data_sets_have_a_table_each_and_a_joint_one(
    load: Load, tmp_path: Path, tiny_dataset: Path, other_camera: Path
) -> None:
    for name, folder in (("wide", tiny_dataset), ("narrow", other_camera)):
        (tmp_path / name).symlink_to(folder)
        study = Study(tmp_path / f"tuned_{name}.json", {"data": name}, {})
        parameters = DEFAULTS["cls"] | {"regularisation_lambda": 0.1 if name == "wide" else 0.2}
        study.add_result({"method": "cls", "noise_db": 40.0, "parameters": parameters, "score": 1.0})
    methods = [
        {"name": "tuned", "classical": "cls", "tuned": "tuned_<set>.json"},
        {"name": "given", "classical": "cls", "parameters": {}},
    ]
    sets = {"test": {"wide": str(tiny_dataset), "narrow": "<set>"}, "training": "<set>"}
    stages: set[str] = set()
    evaluation, files = evaluate(
        load(methods=methods, data=sets, output="sets"), progress=lambda stage, *_: stages.add(stage)
    )
    assert list(evaluation.findings) == ["wide", "narrow"]
    assert stages == {"wide: tuned", "wide: given", "narrow: tuned", "narrow: given"}
    for name, folder, value in (("wide", tiny_dataset, 0.1), ("narrow", other_camera, 0.2)):
        given = [*methods[1:], {"name": "by hand", "classical": "cls", "parameters": {"regularisation_lambda": value}}]
        data = {"test": str(folder), "training": str(folder)}
        alone = evaluate(load(methods=given, data=data, output=f"alone_{name}"))[0].findings[""]
        assert [one.scores for one in evaluation.findings[name].main] == [one.scores for one in reversed(alone.main)]
        assert tmp_path / "sets" / name / "depth.png" in files
    report = files[0].read_text(encoding="utf-8")
    assert report.index("## All data sets") < report.index("## wide") < report.index("## narrow")
    assert "| PSNR dB ↑ | wide | narrow |" in report
    assert "](narrow/depth.png)" in report
    rows = list(csv.DictReader((tmp_path / "sets" / "table.csv").read_text(encoding="utf-8").splitlines()))
    assert {(row["set"], row["method"]) for row in rows if row["kind"] == "classical"} == {
        (name, method) for name in ("wide", "narrow") for method in ("tuned", "given")
    }
    assert set(json.loads((tmp_path / "sets" / "results.json").read_bytes())["sets"]) == {"wide", "narrow"}
    # Without one of them its figures go.
    evaluate(load(methods=methods, data=sets | {"test": {"wide": str(tiny_dataset)}}, output="sets"))
    assert not (tmp_path / "sets" / "narrow").exists()
    assert (tmp_path / "sets" / "wide" / "depth.png").exists()


def test_every_path_may_have_the_name_of_the_data_set(load: Load) -> None:
    data = {"test": {"a": "<set>_test", "b": "other"}, "training": "<set>", "stack": "psf_<set>"}
    methods = [
        {"name": "Net", "checkpoints": ["<set>/0", "<set>/1"]},
        {"name": "CLS", "classical": "cls", "tuned": "<set>.json"},
        {"name": "PnP", "classical": "pnp", "parameters": {"denoiser": "<set>/d", "prior": 0.2}},
    ]
    config = load(data=data | {"compare_stacks": ["nominal", "<set>/psf"]}, methods=methods)
    one, other = (alone.dump() for alone in config.sets.values())
    assert one["data"]["test"] == "a_test"
    assert other["data"]["test"] == "other"
    for name, dumped in (("a", one), ("b", other)):
        assert dumped["data"] | {"test": ""} == config.dump()["data"] | {
            "test": "",
            "training": name,
            "stack": f"psf_{name}",
            "compare_stacks": ["nominal", f"{name}/psf"],
        }
        assert [method["checkpoints"] for method in dumped["methods"]] == [[f"{name}/0", f"{name}/1"], None, None]
        assert [method["tuned"] for method in dumped["methods"]] == [None, f"{name}.json", None]
        assert dumped["methods"][2]["parameters"] == {"denoiser": f"{name}/d", "prior": 0.2}
    assert config.sets["a"].resolve_path("x") == config.resolve_path("x")


@pytest.mark.parametrize(("test", "key"), [({}, "data.test: "), ({"../up": "x"}, "data.test")])
def test_names_of_data_sets_are_those_of_folders(load: Load, test: Any, key: str) -> None:
    with pytest.raises(InputError, match=re.escape(key)):
        load(data={"test": test})
