"""Evaluations of clips: frame by frame and by group, beside methods for stills, and with depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.camera import capture_model
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.classical.by_name import build_method
from learning.config import EvaluateConfig
from learning.data import ExampleSet
from learning.evaluate.job import evaluate
from learning.method import linear_to_srgb
from learning.models import build_network
from learning.provenance import scenes_of
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError

Load = Callable[..., EvaluateConfig]


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


@pytest.mark.slow
def test_networks_for_stills_give_all_frames_the_same(
    load: Load, moving_dataset: Path, checkpoints: list[Path]
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
    load: Load, tmp_path: Path, moving_dataset: Path, checkpoints: list[Path], written: Callable[[], dict[str, Any]]
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
    plain = written()["methods"]
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
