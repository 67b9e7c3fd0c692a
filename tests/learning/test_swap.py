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
from learning.evaluate import folder, report
from learning.method import Method, linear_to_srgb
from learning.models.flatnet import LearnedMethod
from learning.provenance import scenes_of
from learning.swap import Swapped, swap_masks
from learning.tune.study import Study
from simulator.dataset import open_dataset
from simulator.dataset.job import GenerateResult
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

MASKS = {"one": {"design": "./plugins.py:corners"}, "other": {"design": "./plugins.py:corners", "seed": 5}}
LEVELS = (20.0, 50.0)
Load = Callable[..., SwapConfig]


def write(folder: Path, dataset: Path, checkpoint: Path, **changes: Any) -> SwapConfig:
    """Write a small file into a folder that has a configuration, and load it."""
    seen = {"train": str(dataset), "train_scenes": 6, "validation_scenes": 2, "test_scenes": 3}
    content: dict[str, Any] = {
        "name": "two masks",
        "output": "out",
        "config": "trial.yaml",
        "settings": ["camera.noise={type: physical}"],
        "masks": MASKS,
        "scenes": seen | changes.pop("scenes", {}),
        "network": {"init_from": str(checkpoint), "steps": 2, "batch": 2},
        "tuned": [],
        "untuned": ["cls"],
    }
    path = folder / "swap.yaml"
    path.write_text(yaml.safe_dump(content | changes, sort_keys=False), encoding="utf-8")
    return load_file(SwapConfig, path)


def quick(patch: pytest.MonkeyPatch) -> None:
    """Draw nothing, and measure no FLIP: both are slow."""
    patch.setattr(report, "_figures", lambda *_: {})
    patch.setattr(swap, "comparison_html", lambda candidates: ", ".join(one.name for one in candidates))
    patch.setattr("flip_evaluator.evaluate", lambda *_, **__: (None, 0.5, None))


@pytest.fixture
def load(
    tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path], learning_trial: Any, monkeypatch: pytest.MonkeyPatch
) -> Load:
    """Return a function that writes a small file and loads it."""
    quick(monkeypatch)
    learning_trial.write()
    return lambda **changes: write(tmp_path, tiny_dataset, checkpoints[0], **changes)


@pytest.fixture(scope="module")
def swapped(
    tmp_path_factory: pytest.TempPathFactory,
    make_learning_trial: Callable[[Path], Any],
    tiny_dataset: Path,
    checkpoints: list[Path],
) -> tuple[Path, Swapped]:
    """The folder of one run with everything that a file may say, and what came out."""
    folder = tmp_path_factory.mktemp("swap")
    make_learning_trial(folder).write()
    # Not the first checkpoint: a training from scratch with the seed 0 would begin with its very weights.
    network = {"init_from": str(checkpoints[1]), "steps": 2, "batch": 2, "augment": {"flip": False}}
    network["loss"] = {"depth_cm_weight": 0.05}
    changes = {"network": network, "test_settings": ["seed=12"], "noise_db": list(LEVELS)}
    with pytest.MonkeyPatch.context() as patch:
        quick(patch)
        return folder / "out", swap_masks(write(folder, tiny_dataset, checkpoints[1], **changes))


def psnr_by_hand(method: Method, folder: Path, noise_db: float | None = None) -> float:
    """Return the mean PSNR of sRGB codes over the test scenes of a mask, as stored or at a level of noise."""
    test = open_dataset(folder / "test", "test")
    examples = ExampleSet(test, noise_db=None if noise_db is None else (noise_db, noise_db))
    batch = default_collate([examples[position] for position in range(len(test))])
    found = method.reconstruct(batch.measurement).clamped().image.double()
    truth = linear_to_srgb(batch.radiance, method.capture.white).double()
    return float((-10 * torch.log10((found - truth).square().mean(dim=(1, 2, 3)))).mean())


@pytest.mark.slow
def test_the_table_has_every_method_through_every_mask_at_every_level(
    swapped: tuple[Path, Swapped], checkpoints: list[Path]
) -> None:
    out, found = swapped
    assert found.table[0] == ["", "one", "other"]
    rows = {row[0]: row[1:] for row in found.table}
    for at, mask in enumerate(MASKS):
        folder = out / mask
        learned, test = open_dataset(folder / "data", "train"), open_dataset(folder / "test", "test")
        camera = capture_model(learned, white=measure_reference_white(learned))
        # The network of the checkpoint with the PSFs of this mask; the same after its steps; CLS with these PSFs.
        networks = {
            "given the PSFs": load_checkpoint(checkpoints[1], capture=camera).network,
            "2 steps with the mask": load_checkpoint(folder / "network" / "best.safetensors").network,
        }
        tested = capture_model(test, white=camera.white).with_assumed(camera)
        methods: dict[str, Method] = {
            f"FlatNet3D, {words}": LearnedMethod("", network, tested) for words, network in networks.items()
        }
        methods["CLS + graph cut, untuned"] = build_classical(tested, "cls", DEFAULTS["cls"])
        for name, method in methods.items():
            for level, case in ((None, ""), *((level, f" at {level:g} dB") for level in LEVELS)):
                expected = pytest.approx(psnr_by_hand(method, folder, level), abs=6e-3)
                assert float(rows[f"PSNR dB ↑{case}: {name}"][at]) == expected, (name, case)
    # Both masks saw the same scenes, in the same light.
    one, other = (open_dataset(out / mask / "test", "test") for mask in MASKS)
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
    assert (out / "psfs.html").read_text() == "one, other"


@pytest.mark.slow
def test_only_the_test_has_its_own_settings(swapped: tuple[Path, Swapped]) -> None:
    for mask in MASKS:
        learned, test = (
            open_dataset(swapped[0] / mask / name, split) for name, split in (("data", "train"), ("test", "test"))
        )
        assert [each.config["seed"] for each in (learned, test)] == [11, 12]


@pytest.mark.slow
def test_networks_go_on_from_the_checkpoint_as_the_file_says(
    swapped: tuple[Path, Swapped], checkpoints: list[Path]
) -> None:
    begun = load_checkpoint(checkpoints[1]).network.state_dict()
    for mask in MASKS:
        best = load_checkpoint(swapped[0] / mask / "network" / "best.safetensors")
        moved = {key: float((value - begun[key]).abs().max()) for key, value in best.network.state_dict().items()}
        # Adam moves a weight by the learning rate at most, 1e-3, in each of two steps; weights anew differ by tenths.
        assert 0 < max(size for key, size in moved.items() if "enhancement" in key) < 2.1e-3
        config = best.record["config"]
        assert config["data"]["augment"]["flip"] is False
        assert config["loss"]["depth_cm_weight"] == 0.05


@pytest.mark.slow
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


@pytest.mark.slow
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


def of(design: str, **parameters: Any) -> dict[str, Any]:
    return {"masks": {"one": MASKS["one"], "wrong": {"design": design, **parameters}}}


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"scenes": {"test_scenes": 9}}, r"^scenes\.test_scenes: "),
        ({"masks": {"a/b": MASKS["one"]}}, r"masks\.a/b: "),
        *(({"masks": {name: MASKS["one"]}}, f"^masks.{name}: ") for name in ("evaluation", "psfs.html", "cache")),
        (of("./plugins.py:corners", arms=3), r"^masks\.wrong\.arms: "),
        (of("./plugins.py:none"), r"^masks\.wrong\.design: "),
        (of("pinhole", diameter_um=-80.0), r"^masks\.wrong\.diameter_um: "),
        ({"network": None, "untuned": []}, r"nothing reconstructs"),
        ({"network": {"init_from": "nowhere.safetensors"}}, r"^network\.init_from: "),
        ({"tuned": ["cls", "cls"]}, r"tuned\[1\]: "),
        ({"untuned": ["cls", "cls"]}, r"untuned\[1\]: "),
        ({"noise_db": [20, 20]}, r"noise_db\[1\]: "),
        ({"noise_db": [0]}, r"noise_db\[0\]: "),
        ({"settings": ["psf.depths=3", "dataset.train=3"]}, r"settings\[1\]: "),
        ({"test_settings": ["scene.size=[8, 8]"]}, r"test_settings\[0\]: "),
        ({"settings": ["camera.mask={design: pinhole}"]}, r"settings\[0\]: "),
        ({"test_settings": ["psf.near_cm=0.5"]}, r"^test_settings: .*depths"),
        ({"test_settings": ["psf.far_cm=30"]}, r"^test_settings: .*depths"),
        ({"test_settings": ["camera.sensor.binning=4"]}, r"^test_settings: .*pixels"),
        ({"settings": ["camera.mask_to_sensor_mm=3"]}, r"path: the images of"),
        ({"perceptual": "lpips"}, "^perceptual: got lpips"),
        ({"device": "cuda"}, "^device: "),
    ],
)
def test_mistakes_come_out_before_any_work(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any], key: str
) -> None:
    monkeypatch.setattr(swap, "generate", lambda *_, **__: pytest.fail("work"))
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "no weights"))
    with pytest.raises(InputError, match=key):
        swap_masks(load(**changes))
    assert not (tmp_path / "out").exists()


def test_clips_are_refused_before_any_work(load: Load, clip_dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swap, "generate", lambda *_, **__: pytest.fail("work"))
    with pytest.raises(InputError, match=r"^scenes: got clips, .* expected stills"):
        swap_masks(load(scenes={"train": str(clip_dataset)}))


def test_the_evaluation_of_another_name_is_kept(load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(swap, "generate", lambda *_, **__: pytest.fail("work"))
    folder.claim_folder(tmp_path / "out" / "evaluation", "another")
    with pytest.raises(InputError, match=r"^output: "):
        swap_masks(load())


@pytest.mark.slow
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
