"""Masks judged by reconstruction: each method's numbers against the method by hand, what is kept, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from torch.utils.data import default_collate

from learning import swap
from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.classical.method import DEFAULTS, build_classical
from learning.config import SwapConfig, TuneConfig, load_file
from learning.data import ExampleSet
from learning.evaluate import report
from learning.method import Method, linear_to_srgb
from learning.models.flatnet import LearnedMethod
from learning.provenance import scenes_of
from learning.swap import swap_masks
from learning.tune.study import Study
from simulator.dataset import open_dataset
from simulator.dataset.job import GenerateResult
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

MASKS = {"one": {"design": "./plugins.py:corners"}, "other": {"design": "./plugins.py:corners", "seed": 5}}
Load = Callable[..., SwapConfig]


@pytest.fixture
def load(
    tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path], learning_trial: Any, monkeypatch: pytest.MonkeyPatch
) -> Load:
    """Return a function that writes a small file and loads it; nothing is drawn, and no FLIP measured: both are slow."""
    monkeypatch.setattr(report, "_figures", lambda *_: {})
    monkeypatch.setattr(swap, "comparison_html", lambda candidates: ", ".join(one.name for one in candidates))
    monkeypatch.setattr("flip_evaluator.evaluate", lambda *_, **__: (None, 0.5, None))
    learning_trial.write()

    def load(**changes: Any) -> SwapConfig:
        scenes = {"train": str(tiny_dataset), "train_scenes": 6, "validation_scenes": 2, "test_scenes": 3}
        content: dict[str, Any] = {
            "name": "two masks",
            "output": "out",
            "config": "trial.yaml",
            "settings": ["camera.noise={type: physical}"],
            "masks": MASKS,
            "scenes": scenes | changes.pop("scenes", {}),
            "network": {"init_from": str(checkpoints[0]), "steps": 2, "batch": 2},
            "tuned": [],
            "untuned": ["cls"],
        }
        path = tmp_path / "swap.yaml"
        path.write_text(yaml.safe_dump(content | changes, sort_keys=False), encoding="utf-8")
        return load_file(SwapConfig, path)

    return load


def psnr_by_hand(method: Method, folder: Path) -> float:
    """Return the mean PSNR of sRGB codes over the test scenes of a mask, as stored."""
    test = open_dataset(folder / "test", "test")
    batch = default_collate([ExampleSet(test)[position] for position in range(len(test))])
    found = method.reconstruct(batch.measurement).clamped().image.double()
    truth = linear_to_srgb(batch.radiance, method.capture.white).double()
    return float((-10 * torch.log10((found - truth).square().mean(dim=(1, 2, 3)))).mean())


def test_the_table_has_every_method_through_every_mask(load: Load, tmp_path: Path, checkpoints: list[Path]) -> None:
    found = swap_masks(load())
    assert found.table[0] == ["", "one", "other"]
    rows = {row[0]: row[1:] for row in found.table}
    for at, mask in enumerate(MASKS):
        folder = tmp_path / "out" / mask
        learned, test = open_dataset(folder / "data", "train"), open_dataset(folder / "test", "test")
        camera = capture_model(learned, white=measure_reference_white(learned))
        # The network of the checkpoint with the PSFs of this mask; the same after its steps; CLS with these PSFs.
        networks = {
            "given the PSFs": load_checkpoint(checkpoints[0], capture=camera).network,
            "2 steps with the mask": load_checkpoint(folder / "network" / "best.safetensors").network,
        }
        tested = capture_model(test, white=camera.white).with_assumed(camera)
        methods: dict[str, Method] = {
            f"FlatNet3D, {words}": LearnedMethod("", network, tested) for words, network in networks.items()
        }
        methods["CLS + graph cut, untuned"] = build_classical(tested, "cls", DEFAULTS["cls"])
        for name, method in methods.items():
            assert float(rows[f"PSNR dB ↑: {name}"][at]) == pytest.approx(psnr_by_hand(method, folder), abs=6e-3), name
    # Both masks saw the same scenes, in the same light.
    one, other = (open_dataset(tmp_path / "out" / mask / "test", "test") for mask in MASKS)
    np.testing.assert_array_equal(one[1].rgb, other[1].rgb)
    assert one.info.exposure["full_scale"] == other.info.exposure["full_scale"]
    assert not np.array_equal(one[1].noiseless, other[1].noiseless)
    assert found.light.startswith("The same light for all (full scale 3e-06)")
    below = [each.info.exposure["pilot_shares"]["below_noise"] for each in (one, other)]
    assert [float(cell.removesuffix(" %")) / 100 for cell in rows["Values below the noise"]] == pytest.approx(
        below, rel=0.05
    )
    page = found.report.read_text(encoding="utf-8")
    assert "| one − other |" in page
    assert "had learned with corners for some time before" in page
    assert rows["Transmitted area"][0] in page
    assert (tmp_path / "out" / "psfs.html").read_text() == "one, other"


def test_a_further_mask_leaves_the_others_as_they_are(load: Load, tmp_path: Path) -> None:
    first = swap_masks(load(masks={"one": MASKS["one"]}, untuned=[]))
    kept = {
        path: path.stat().st_mtime_ns
        for name in ("data/train", "test/test", "network")
        for path in (tmp_path / "out" / "one" / name).rglob("*.*r*")  # .exr, .safetensors
    }
    again = swap_masks(load(untuned=[]))
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert [row[:2] for row in again.table] == first.table


def test_methods_are_tuned_for_each_mask_on_its_validation_scenes(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tuned: list[TuneConfig] = []

    def tune_file(config: TuneConfig, **_: Any) -> Path:
        tuned.append(config)
        study = Study(Path(config.output), {"split": "validation"}, {})
        parameters = DEFAULTS["cls"] | {"regularisation_lambda": 10.0 ** len(tuned)}
        study.add_result({"method": "cls", "noise_db": 40.0, "parameters": parameters, "score": 1.0})
        return Path(config.output)

    monkeypatch.setattr(swap, "tune_file", tune_file)
    found = swap_masks(load(network=None, tuned=["cls"], noise_db=[30]))
    rows = {row[0]: row[1:] for row in found.table}
    for at, (mask, config) in enumerate(zip(MASKS, tuned, strict=True)):
        folder = tmp_path / "out" / mask
        assert (config.data.validation, config.data.scenes, config.noise_db) == (folder / "data", 2, ["stored", 30.0])
        learned, test = open_dataset(folder / "data", "train"), open_dataset(folder / "test", "test")
        camera = capture_model(test, white=measure_reference_white(learned))
        method = build_classical(camera, "cls", DEFAULTS["cls"] | {"regularisation_lambda": 10.0 ** (at + 1)})
        assert float(rows["PSNR dB ↑: CLS + graph cut"][at]) == pytest.approx(psnr_by_hand(method, folder), abs=6e-3)
    assert "PSNR dB ↑ at 30 dB: CLS + graph cut" in rows


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"scenes": {"test_scenes": 9}}, r"scenes\.test_scenes"),
        ({"masks": {"a/b": MASKS["one"]}}, r"masks\.a/b"),
        ({"network": None, "untuned": []}, r"nothing reconstructs"),
        ({"masks": {"one": {"design": "./plugins.py:corners", "arms": 3}}}, r"camera\.mask\.arms"),
    ],
)
def test_mistakes(load: Load, tmp_path: Path, changes: dict[str, Any], key: str) -> None:
    with pytest.raises(InputError, match=key):
        swap_masks(load(**changes))
    assert not (tmp_path / "out").exists()


def test_samples_that_fail_stop_it(load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = GenerateResult(tmp_path / "out" / "one" / "data", 5, 0, ("train/s00000005: no clip today",), 1.0)
    monkeypatch.setattr(swap, "generate", lambda *_, **__: made)
    with pytest.raises(InputError, match=r"data: 1 samples .*s00000005: no clip today"):
        swap_masks(load())


def test_a_network_that_knows_the_test_scenes_is_refused_before_any_work(
    load: Load, tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path]
) -> None:
    known = load_checkpoint(checkpoints[0])
    record = {"scenes": {"train": scenes_of(open_dataset(tiny_dataset, "test"))}}
    path = tmp_path / "knows.safetensors"
    save_checkpoint(path, known.network, architecture=known.architecture, capture=known.capture, record=record)
    with pytest.raises(InputError, match=r"^network\.init_from: "):
        swap_masks(load(network={"init_from": str(path), "steps": 2}))
    assert not (tmp_path / "out").exists()
