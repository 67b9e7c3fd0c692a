"""Training as a whole: it learns, goes on as if it had never stopped, and says what is wrong."""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

import learning.training_loop as loop
from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.checkpoint import FOLDER, load_checkpoint
from learning.config import LossConfig, OptimiserConfig, TrainConfig, load_file
from learning.data import CACHE, Batches, ExampleSet
from learning.layers.inversion import FourierInversion
from learning.losses import ReconstructionLoss
from learning.models import build_network
from learning.provenance import scenes_of
from learning.resume import BEST, DESCRIPTION, LAST, STATE, DivergedError
from learning.simulate import Augmentation
from learning.train import find_data, open_examples, train
from learning.training_loop import build_optimiser, learning_rate
from learning.validation import METRICS, PREVIEW
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.optics.stack_files import read_psf_stack, write_psf_stack

pytestmark = pytest.mark.usefixtures("ctrl_c")
Settings = Callable[..., TrainConfig]
Patch = pytest.MonkeyPatch


def lines(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Return the log's numbers that do not measure time."""
    found = [json.loads(line) for line in (folder / METRICS).read_text().splitlines()]
    return [line | {"samples_per_second": None} for line in found if line["kind"] == kind]


def stop_at(step: int) -> Callable[[str, int, int], None]:
    """Return what presses Ctrl-C after a step."""

    def show(stage: str, done: int, total: int) -> None:
        if done == step:
            signal.raise_signal(signal.SIGINT)

    return show


def weights(path: Path) -> dict[str, torch.Tensor]:
    return load_checkpoint(path).network.state_dict()


@pytest.mark.slow
def test_learns_and_leaves_what_belongs_to_it(settings: Settings) -> None:
    idle = train(settings("idle", steps=1, optimiser={"learning_rate": 1e-9}))
    config = settings(steps=80, log_every=10, validate_every=20, optimiser={"learning_rate": 1e-2})
    said: list[str] = []
    result = train(config, say=said.append)
    trained, validated = (lines(result.folder, kind) for kind in ("train", "validation"))
    # Where it has learned nothing, the loss stays as it began: 0.51, of validation 0.52 and 11.9 dB.
    assert trained[-1]["total"] < 0.85 * lines(idle.folder, "train")[0]["total"]
    assert validated[-1]["total"] < 0.88 * idle.best["total"]
    assert validated[-1]["psnr_db"] > idle.best["psnr_db"] + 1
    last = trained[-1]
    assert last["total"] == pytest.approx(last["intensity_weighted"] + last["depth_weighted"], rel=1e-5)
    best = load_checkpoint(result.folder / BEST)
    scores = {line["step"]: line["score"] for line in validated}
    assert best.record["step"] == result.best["step"] == max(scores, key=lambda step: scores[step])
    assert best.record["config"]["batch"] == 5
    assert best.record["data sets"]["train"]["samples"] == 32
    files = {BEST, LAST, DESCRIPTION, METRICS, PREVIEW, STATE, "tensorboard"}
    assert {path.name for path in result.folder.iterdir()} == files
    assert sum("validation PSNR" in line for line in said) == 4


@pytest.mark.parametrize(
    ("stops", "augment"),
    [*(pytest.param(stops, None, marks=pytest.mark.slow) for stops in ((1,), (4, 7))), ((5,), Augmentation())],
)
@pytest.mark.slow
def test_goes_on_as_if_it_had_never_stopped(
    settings: Settings, stops: tuple[int, ...], augment: Augmentation | None
) -> None:
    whole, parts = (settings(n, data={"workers": w, "augment": augment}) for n, w in (("whole", 0), ("parts", 1)))
    train(whole)
    for stop in stops:
        with pytest.raises(KeyboardInterrupt):
            train(parts, progress=stop_at(stop))
    result = train(parts)
    assert result.steps == 9 - stops[-1]
    one, two = Path(whole.output), Path(parts.output)
    for kind in ("train", "validation"):
        assert lines(one, kind) == lines(two, kind)
    for name in (BEST, LAST):
        expected, found = weights(one / name), weights(two / name)
        assert all(torch.equal(expected[key], found[key]) for key in expected)
    expected, found = (torch.load(folder / STATE, weights_only=True) for folder in (one, two))
    moments = [each["optimiser"]["state"] for each in (expected, found)]
    assert len(moments[0]) > 10
    for key, values in moments[0].items():
        assert all(torch.equal(values[name], moments[1][key][name]) for name in values)


@pytest.mark.slow
def test_a_killed_training_goes_on_from_its_last_state(settings: Settings) -> None:
    """What was logged and kept after the state that survives is made again, not twice."""

    def die(stage: str, done: int, total: int) -> None:
        if done == 7:
            raise MemoryError

    whole, killed = settings("whole"), settings("killed")
    train(whole)
    with pytest.raises(KeyboardInterrupt):
        train(killed, progress=stop_at(2))
    with pytest.raises(MemoryError):
        train(killed, progress=die)
    assert train(killed).steps == 7
    assert lines(Path(whole.output), "train") == lines(Path(killed.output), "train")
    assert lines(Path(whole.output), "validation") == lines(Path(killed.output), "validation")


def test_finished_and_raised(settings: Settings) -> None:
    train(settings(steps=2))
    again = train(settings(steps=2))
    assert again.steps == 0
    assert again.best["step"] == 2
    said: list[str] = []
    raised = train(settings(steps=4), say=said.append)
    assert raised.steps == 2
    # Half a cosine over 2 steps ends at cos^2(pi / 4) = 1 / 2 of the rate, over 4 it is there again: the warm-up is 0 steps.
    assert "steps: 2 -> 4 after step 2; the learning rate goes from 0.0005 to 0.0005 there" in said
    record = load_checkpoint(raised.folder / LAST).record
    assert record["steps"] == [{"from": 0, "of": 2}, {"from": 2, "of": 4}]
    with pytest.raises(InputError, match=r"^steps: "):
        train(settings(steps=2))


def test_another_configuration_is_refused_line_by_line(settings: Settings) -> None:
    train(settings(steps=1))
    with pytest.raises(InputError, match=r"^output: "):
        train(settings(steps=1, batch=4, loss={"depth_weight": 2.0}))
    assert train(settings(steps=2, log_every=1, data={"workers": 1})).steps == 1


def test_a_non_finite_loss_stops_before_its_step(settings: Settings, monkeypatch: Patch, tiny_dataset: Path) -> None:
    config = settings(checkpoint_every_s=0.0)
    folder, forward = Path(config.output), ReconstructionLoss.forward
    calls = 0

    def broken(self: ReconstructionLoss, *arguments: Any) -> dict[str, torch.Tensor]:
        nonlocal calls
        calls += 1
        terms = forward(self, *arguments)
        return {name: value * float("nan") for name, value in terms.items()} if calls == 3 else terms

    monkeypatch.setattr(ReconstructionLoss, "forward", broken)
    with pytest.raises(DivergedError) as error:
        train(config)
    ids = open_dataset(tiny_dataset, "train").ids
    wanted = ", ".join(ids[draw.position] for draw in Batches(32, 5, seed=3).batch(2))
    assert error.value.path == "step 3"
    assert f"samples {wanted};" in error.value.reason
    assert "total nan" in error.value.reason
    kept = torch.load(folder / STATE, weights_only=True)
    assert kept["progress"]["step"] == 2
    assert all(bool(torch.isfinite(value).all()) for value in kept["network"].values())
    monkeypatch.undo()
    assert train(config).steps == 7


def test_a_non_finite_gradient(settings: Settings, monkeypatch: Patch) -> None:
    """The root of nothing: its value is 0, its slope infinite."""
    forward = ReconstructionLoss.forward

    def broken(self: ReconstructionLoss, estimate: Any, *arguments: Any) -> dict[str, torch.Tensor]:
        terms = forward(self, estimate, *arguments)
        return terms | {"total": terms["total"] + (estimate.image - estimate.image.detach()).square().sum().sqrt()}

    monkeypatch.setattr(ReconstructionLoss, "forward", broken)
    with pytest.raises(DivergedError, match=r"step 1: .*gradient nan.*nothing is saved yet"):
        train(settings())


def test_a_non_finite_validation(settings: Settings, monkeypatch: Patch) -> None:
    monkeypatch.setattr("learning.train.validate", lambda *_, **__: {"total": float("nan"), "psnr_db": 3.0})
    with pytest.raises(DivergedError, match=r"^validation after step 4: .*total nan, psnr_db 3"):
        train(settings())


def test_fine_tuning_begins_with_a_checkpoint(settings: Settings) -> None:
    first = train(settings("first"))
    rate = {"learning_rate": 1e-9, "warm_up": 0.0}
    tuned = train(settings("tuned", init_from=str(first.folder / LAST), steps=1, optimiser=rate))
    before, after = weights(first.folder / LAST), weights(tuned.folder / LAST)
    for name, parameter in load_checkpoint(first.folder / LAST).network.named_parameters():
        assert torch.allclose(before[name], after[name], atol=2e-9), name
        assert parameter.shape == after[name].shape


def test_a_start_that_changed_is_another_training(settings: Settings, tmp_path: Path) -> None:
    first, second = train(settings("first", steps=1)), train(settings("second", steps=1, seed=4))
    start = tmp_path / "start.safetensors"
    shutil.copy(first.folder / LAST, start)
    train(settings("tuned", init_from=str(start), steps=1))
    moved = tmp_path / "moved" / start.name
    moved.parent.mkdir()
    shutil.copy(start, moved)
    assert train(settings("tuned", init_from=str(moved), steps=2)).steps == 1  # the same content elsewhere
    shutil.copy(second.folder / LAST, start)
    with pytest.raises(InputError, match=r"^output: "):
        train(settings("tuned", init_from=str(start), steps=3))


@pytest.mark.parametrize("moment", ["learning.train.build_network", "learning.training_loop.count_workers"])
def test_another_training_in_between(settings: Settings, monkeypatch: Patch, moment: str) -> None:
    """It begins while this one prepares: before the lock this one is refused, after it the other; neither is lost."""
    module, name = moment.rsplit(".", 1)
    original, refused = getattr(sys.modules[module], name), []

    def inject(*arguments: Any, **others: Any) -> Any:
        monkeypatch.setattr(moment, original)
        try:
            train(settings(seed=99, steps=2))
        except InputError as error:
            refused.append(error.reason)
        return original(*arguments, **others)

    monkeypatch.setattr(moment, inject)
    if name == "build_network":
        with pytest.raises(InputError, match=r"^output: "):
            train(settings(steps=1))
    else:
        train(settings(steps=1))
        assert len(refused) == 1
        assert "another process trains in" in refused[0]
    folder = Path(settings().output)
    seed = 99 if name == "build_network" else 3
    assert json.loads((folder / DESCRIPTION).read_text())["config"]["seed"] == seed
    assert load_checkpoint(folder / LAST).record["config"]["seed"] == seed


def test_speed_is_that_of_this_session(settings: Settings, monkeypatch: Patch) -> None:
    """A step takes a second of a clock that only steps move; five samples are in each."""
    now, step = [0.0], loop.Training._step

    def slow(self: loop.Training, *arguments: Any) -> bool:
        now[0] += 1.0
        return step(self, *arguments)

    monkeypatch.setattr(loop.Training, "_step", slow)
    monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=lambda: now[0]))
    config = settings(steps=9, log_every=9, validate_every=9)
    with pytest.raises(KeyboardInterrupt):
        train(config, progress=stop_at(8))
    train(config)
    log = (Path(config.output) / METRICS).read_text().splitlines()
    assert [json.loads(line)["samples_per_second"] for line in log if "samples_per_second" in line] == [5.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data": {"train": "/nowhere/set"}}, "^/nowhere/set: "),
        ({"data": {"stack": "/nowhere/psf"}}, "^/nowhere/psf: "),
        ({"init_from": "/nowhere/net.safetensors"}, r"^init_from: got .*net\.safetensors"),
        ({"init_from": str(FOLDER / "flatnet2d.safetensors")}, r"flatnet2d\.safetensors: "),
    ],
)
def test_what_cannot_be_used_is_named_and_leaves_no_folder(settings: Settings, changes: Any, message: str) -> None:
    config = settings(**changes)
    with pytest.raises(InputError, match=message):
        train(config)
    assert not Path(config.output).exists()


def test_damage_is_named_though_a_worker_meets_it(settings: Settings, tiny_dataset: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(tiny_dataset, copy)
    ids = open_dataset(copy, "train").ids
    damaged = next(copy.glob(f"train/*/{ids[15]}")) / "measurement.exr"  # no one of those that are looked at beforehand
    damaged.write_bytes(damaged.read_bytes()[:-100])
    with pytest.raises(InputError) as error:
        train(settings(data={"train": str(copy), "workers": 1}))
    assert error.value.path == str(damaged)


@pytest.mark.slow
def test_learns_in_bfloat16(settings: Settings) -> None:
    ends = []
    for precision in ("float32", "bfloat16"):
        rate = {"learning_rate": 5e-3}
        result = train(settings(precision, steps=40, log_every=10, precision=precision, optimiser=rate))
        assert load_checkpoint(result.folder / LAST).record["precision"] == precision
        ends.append(lines(result.folder, "train")[-1]["total"])
    assert ends[0] != ends[1]
    assert ends[1] == pytest.approx(ends[0], rel=0.1)  # 2^-9 in each number, forty steps apart


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["terminal", "cluster"])
def test_a_signal_to_all_processes(settings: Settings, tmp_path: Path, number: signal.Signals) -> None:
    """Ctrl-C, or a cluster's SIGTERM, reaches the workers too, which must live on until the step is done."""
    config = settings(steps=100_000, data={"workers": 2}, log_every=1)
    path = tmp_path / "train.yaml"
    path.write_text(json.dumps(config.dump()))
    code = (
        "import sys; from learning.config import TrainConfig, load_file; from learning.train import train; "
        "train(load_file(TrainConfig, sys.argv[1]), say=print)"
    )
    root = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-u", "-c", code, str(path)]
    env = os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"}
    pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, cwd=root, env=env, start_new_session=True, **pipes)
    log = Path(config.output) / METRICS
    begin = time.monotonic()
    while not (log.exists() and log.stat().st_size) and time.monotonic() - begin < 120:
        time.sleep(0.1)
    os.killpg(process.pid, number)
    out, err = process.communicate(timeout=60)
    step = torch.load(Path(config.output) / STATE, weights_only=True)["progress"]["step"]
    assert f"stopped after step {step} of 100000; the same command goes on from there" in out
    assert step >= 1
    assert err.count("Traceback") == 1  # ours: KeyboardInterrupt, which the command turns into words
    assert err.rstrip().endswith("KeyboardInterrupt")


def test_captured_stack_is_another_training(settings: Settings, tiny_dataset: Path) -> None:
    config = settings(steps=1, data={"stack": "captured"})
    train(config)
    capture = load_checkpoint(Path(config.output) / LAST).capture
    assert capture.stack.fingerprint == read_psf_stack(tiny_dataset / "psf_captured").fingerprint
    assert capture.stack.fingerprint != read_psf_stack(tiny_dataset / "psf").fingerprint


def test_noise_of_the_file(settings: Settings, monkeypatch: Patch, tiny_dataset: Path) -> None:
    """And its seed decide the first batch; which noise that is: see test_data."""
    seen: list[torch.Tensor] = []
    step = loop.Training._step

    def spy(self: loop.Training, wrapped: Any, batch: Any, stop: Any) -> bool:
        seen.append(batch.measurement)
        return step(self, wrapped, batch, stop)

    monkeypatch.setattr(loop.Training, "_step", spy)
    train(settings(steps=1, batch=32, data={"noise_db": (20.0, 20.0)}))
    dataset = open_dataset(tiny_dataset, "train")
    examples = ExampleSet(dataset, noise_db=(20.0, 20.0), seed=3)
    for draw, measurement in zip(Batches(32, 32, seed=3).batch(0), seen[0], strict=True):
        assert torch.equal(examples[draw].measurement, measurement)


def test_scenes_are_resimulated_to_learn_from_and_not_to_validate_on(settings: Settings, tiny_dataset: Path) -> None:
    """Of a network that stays as it is: ``data.augment`` changes what is learned from, and nothing that is validated."""
    idle: dict[str, Any] = {"steps": 2, "log_every": 1, "optimiser": {"learning_rate": 1e-9}}
    both = settings("plain", **idle), settings("anew", data={"augment": Augmentation()}, **idle)
    plain, anew = (train(config) for config in both)
    assert anew.best == pytest.approx(plain.best, rel=1e-4)
    for one, other in zip(lines(plain.folder, "train"), lines(anew.folder, "train"), strict=True):
        assert one["total"] != other["total"]
    for split, same in (("train", False), ("validation", True)):
        dataset = open_dataset(tiny_dataset, split)
        sets = [open_examples(dataset, config, lambda _: None) for config in both]
        for position in range(len(dataset)):
            one, other = (examples[position] for examples in sets)
            assert [torch.equal(a, b) for a, b in zip(one[:2], other[:2], strict=True)] == [same, same]


@pytest.mark.parametrize(("key", "value"), [("colour", "3"), ("exposure", "-1"), ("flip", "1"), ("tilt", "0")])
def test_a_change_of_scenes_that_makes_no_sense_is_named(tmp_path: Path, key: str, value: str) -> None:
    path = tmp_path / "train.yaml"
    path.write_text("name: x\noutput: x\nsteps: 1\ndata: {train: set, augment: {colour: 0.1}}\n")
    assert load_file(TrainConfig, path).data.augment == Augmentation(colour=0.1)
    with pytest.raises(InputError, match=rf"data\.augment\.{key}: "):
        load_file(TrainConfig, path, [f"data.augment.{key}={value}"])


def test_white_and_network_of_the_file(settings: Settings, tiny_dataset: Path) -> None:
    result = train(settings(steps=1, network={"filters": 6, "levels": 1}))
    checkpoint = load_checkpoint(result.folder / LAST)
    assert checkpoint.capture.white == measure_reference_white(open_dataset(tiny_dataset, "train")) != 1
    assert checkpoint.architecture["filters"] == 6
    first = next(value for value in checkpoint.network.enhancement.parameters() if value.ndim == 4)
    assert first.shape[0] == 6


def test_gradient_clip_of_the_file(settings: Settings, monkeypatch: Patch) -> None:
    """Adam hides the length of a gradient, so it is looked at where the optimiser takes it."""
    norms: list[float] = []
    step = torch.optim.AdamW.step

    def spy(self: torch.optim.AdamW, *arguments: Any) -> Any:
        gradients = [value.grad for group in self.param_groups for value in group["params"]]
        norms.append(float(torch.stack([value.norm() for value in gradients if value is not None]).norm()))
        return step(self, *arguments)

    monkeypatch.setattr(torch.optim.AdamW, "step", spy)
    train(settings("clipped", steps=1, optimiser={"gradient_clip": 1e-6}))
    train(settings("free", steps=1))
    assert norms[0] == pytest.approx(1e-6, rel=1e-3)
    assert norms[1] > 1e-3


def test_best_is_the_greatest_score(settings: Settings, monkeypatch: Patch) -> None:
    """Whatever the loss says."""
    scores, totals = iter([-3.0, 5.0, 4.0]), iter([2.0, 3.0, 1.0])
    others = {"psnr_db": 1.0, "depth_rmse_cm": 1.0}
    monkeypatch.setattr(
        "learning.train.validate", lambda *_, **__: {"total": next(totals), "score": next(scores), **others}
    )
    result = train(settings(steps=3, validate_every=1))
    assert (result.best["step"], result.best["score"]) == (2, 5.0)
    assert load_checkpoint(result.folder / BEST).record["step"] == 2
    record = load_checkpoint(result.folder / LAST).record
    assert (record["validation"]["best"]["step"], record["validation"]["last"]["total"]) == (2, 1.0)


def test_seeds_make_the_same_loss_small(settings: Settings, monkeypatch: Patch) -> None:
    made: list[int] = []
    build = ReconstructionLoss.__init__

    def spy(self: ReconstructionLoss, settings: LossConfig, capture: CaptureModel) -> None:
        made.append(settings.perceptual_seed)
        build(self, settings, capture)

    monkeypatch.setattr(ReconstructionLoss, "__init__", spy)
    for seed in (1, 2):
        train(settings(f"seed{seed}", steps=1, seed=seed))
    train(settings("another", steps=1, loss={"perceptual_seed": 5}))
    assert made == [0, 0, 5]


def test_a_record_names_no_folder_of_this_machine(settings: Settings, tiny_dataset: Path, tmp_path: Path) -> None:
    first = train(settings("first", steps=1))
    config = settings("made here", steps=2, init_from=str(first.folder / LAST), data={"cache": str(tmp_path / "cache")})
    path = tmp_path / "tiny.yaml"
    path.write_text(json.dumps(config.dump()))
    overrides = ["steps=1", f"output={tmp_path / 'over there'}", f"data.validation={tiny_dataset}"]
    result = train(load_file(TrainConfig, path, overrides))
    record = load_checkpoint(result.folder / LAST).record
    text = json.dumps(record)
    assert "/" not in text.replace("1/m", "")
    assert "\\\\" not in text
    assert str(tmp_path.parent).encode() not in (result.folder / LAST).read_bytes()
    assert record["command"] == (
        f"flatlight train tiny.yaml --set steps=1 --set 'output=over there' --set data.validation={tiny_dataset.name}"
    )
    assert load_checkpoint(first.folder / LAST).record["command"] == "learning.train, called from Python"
    assert record["config"]["init_from"] == LAST
    assert record["config"]["data"]["stack"] == "nominal"
    dataset = open_dataset(tiny_dataset, "train")
    assert record["data sets"]["train"]["fingerprint"] == dataset.fingerprint
    assert record["data sets"]["train"]["name"] == dataset.info.name
    splits = {split: scenes_of(open_dataset(dataset.root, split)) for split in ("train", "validation")}
    assert record["scenes"] == record["init_from"]["scenes"] == splits
    assert record["init_from"]["architecture"] == load_checkpoint(first.folder / LAST).architecture


COUNTS = {"train": 0, "validation": 2, "test": 0}


def config(train: Path, **data: Any) -> TrainConfig:
    return TrainConfig.model_validate({"name": "x", "output": "x", "steps": 1, "data": {"train": str(train), **data}})


@pytest.mark.parametrize(
    ("override", "what"),
    [
        ("camera.exposure.full_scale=6e-6", "gain"),
        ("camera.noise={type: physical}", "offset"),
        ("forward.vignetting=false", "irradiance"),
        pytest.param("camera.mask.seed=5", "mask", marks=pytest.mark.slow),
        pytest.param("psf.far_cm=25", "range of depths", marks=pytest.mark.slow),
        ("camera.scene_to_camera=[[0.9, 0.1, 0.0], [0.1, 0.8, 0.2], [0.0, 0.1, 0.7]]", "scene_to_camera"),
    ],
)
def test_another_camera_is_refused(tiny_dataset: Path, learning_trial: Any, override: str, what: str) -> None:
    other = learning_trial.generate(override, dataset=COUNTS, psf={"as_captured": None})
    with pytest.raises(InputError, match=rf"^data\.validation: {what}.*{override.split('=')[0].removesuffix('.seed')}"):
        find_data(config(tiny_dataset, validation=str(other)))


@pytest.mark.slow
def test_finer_psfs_of_the_same_camera_are_welcome(tiny_dataset: Path, learning_trial: Any) -> None:
    other = learning_trial.generate("psf.depths=4", dataset=COUNTS, psf={"as_captured": None})
    _, validation, capture = find_data(config(tiny_dataset, validation=str(other)))
    assert validation.root == other
    assert len(capture.stack.depths_m) == 3
    assert capture.white == measure_reference_white(open_dataset(tiny_dataset, "train")) != 1


def test_psfs_up_to_infinity_are_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    stack = capture_model(open_dataset(tiny_dataset, "train")).stack
    write_psf_stack(tmp_path / "endless", replace(stack, depths_m=np.array([*stack.depths_m[:-1], np.inf])))
    with pytest.raises(InputError, match=r"^psf\.far_cm: "):
        find_data(config(tiny_dataset, stack=str(tmp_path / "endless")))


def test_a_relative_cache_lies_beside_the_file(tiny_dataset: Path, tmp_path: Path, monkeypatch: Patch) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "work").mkdir()
    path = tmp_path / "work" / "train.yaml"
    path.write_text(f"name: x\noutput: x\nsteps: 1\ndata: {{train: '{tiny_dataset}', cache: kept}}\n")
    monkeypatch.chdir(tmp_path / "elsewhere")
    said: list[str] = []
    open_examples(open_dataset(tiny_dataset, "validation"), load_file(TrainConfig, path), said.append)
    assert any((tmp_path / "work" / "kept").glob(f"*/{CACHE}"))
    assert list((tmp_path / "elsewhere").iterdir()) == []
    assert said == [f"validation: 8 samples, kept decoded in {tmp_path / 'work' / 'kept'}"]


def test_cosine_with_warm_up_and_constant() -> None:
    config = OptimiserConfig(learning_rate=2.0, warm_up=0.1)
    rates = [learning_rate(step, 100, config) for step in range(100)]
    assert rates[:10] == pytest.approx([0.2 * (step + 1) for step in range(10)], rel=1e-12)
    assert rates[10] == 2.0
    assert rates[55] == pytest.approx(1.0, rel=1e-12)  # half of the way down
    assert rates[99] == pytest.approx(1 + math.cos(math.pi * 89 / 90), rel=1e-12)
    config = OptimiserConfig(learning_rate=2.0, warm_up=0.0, schedule="constant")
    assert {learning_rate(step, 7, config) for step in range(7)} == {2.0}


@pytest.mark.parametrize("body", ["naf", "unet"])
def test_only_convolutions_decay(tiny_capture: CaptureModel, body: str) -> None:
    network = build_network(tiny_capture, "flatnet3d", "tiny", body=body)
    optimiser = build_optimiser(network, OptimiserConfig(learning_rate=0.1, weight_decay=0.5))
    before = {name: value.detach().clone() for name, value in network.named_parameters()}
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    optimiser.step()
    convolutions = {f"{name}.weight" for name, module in network.named_modules() if isinstance(module, torch.nn.Conv2d)}
    assert len(convolutions) > 5
    for name, value in network.named_parameters():
        share = 0.95 if name in convolutions else 1.0  # 1 - 0.1 x 0.5
        assert torch.allclose(value, before[name] * share, rtol=1e-6), name
    assert network.joint is not None
    for inversion in (network.inversion, network.joint):  # what does not learn is left out
        inversion.requires_grad_(False)
    assert held(build_optimiser(network, OptimiserConfig())) == {id(each) for each in network.enhancement.parameters()}


def held(optimiser: torch.optim.Optimizer) -> set[int]:
    return {id(parameter) for group in optimiser.param_groups for parameter in group["params"]}


def inversion_at(rate: float) -> Callable[[torch.nn.Module], float]:
    return lambda module: rate if isinstance(module, FourierInversion) else 1.0


def test_the_inversions_learn_faster(settings: Settings, tiny_capture: CaptureModel) -> None:
    """Adam's first step changes every number that has a gradient by the learning rate, here of a warm-up's first step."""
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    assert network.joint is not None
    optimiser = build_optimiser(network, OptimiserConfig(), inversion_at(7))
    own = {id(each) for inversion in (network.inversion, network.joint) for each in inversion.parameters()}
    fast = [group for group in optimiser.param_groups if group["rate"] == 7]
    assert {id(each) for group in fast for each in group["params"]} == own
    assert {group["rate"] for group in optimiser.param_groups} == {1, 7}
    assert held(optimiser) == {id(each) for each in network.parameters()}

    rates = {"learning_rate": 1e-3, "schedule": "constant", "warm_up": 0.0}
    begun = weights(train(settings("begun", steps=1, optimiser=rates | {"learning_rate": 1e-9})).folder / LAST)
    ended = weights(train(settings("ended", steps=1, optimiser=rates)).folder / LAST)
    for name, value in ended.items():
        step = (value - begun[name]).abs().max().item()
        kinds = ("inversion.", "joint.")
        expected = 1e-2 if name.startswith(kinds) else 1e-3
        assert step == 0 or step == pytest.approx(expected, rel=0.01), name  # what has no gradient yet stays


def test_inversions_that_do_not_learn(tiny_capture: CaptureModel) -> None:
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    optimiser = build_optimiser(network, OptimiserConfig(), inversion_at(0))
    assert held(optimiser) == {id(each) for each in network.enhancement.parameters()}
    torch.cat(network(torch.rand(1, 3, 48, 48)), dim=1).sum().backward()
    assert {id(each) for each in network.parameters() if each.grad is not None} == held(optimiser)


@pytest.mark.parametrize(("share", "moved"), [(0.5, 3), (0.0, 0), (1.0, 6)])
def test_batch_statistics_stay_after_their_share_of_the_steps(settings: Settings, share: float, moved: int) -> None:
    """Counted by batch normalisation itself, and used: what is learned from then on is what is validated."""
    given = {"network": {"body": "unet"}, "optimiser": {"freeze_statistics": share}}
    result = train(settings(steps=6, **given))
    found = weights(result.folder / LAST)
    counts = {int(value) for name, value in found.items() if name.endswith("num_batches_tracked")}
    assert counts == {moved}
