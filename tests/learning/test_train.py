"""Training as a whole: it learns, goes on as if it had never stopped, and says what is wrong."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from learning.checkpoint import load_checkpoint
from learning.config.train import TrainConfig
from learning.data import Batches
from learning.losses import ReconstructionLoss
from learning.train import train
from learning.training.folder import BEST, DESCRIPTION, LAST, METRICS, PREVIEW, STATE
from learning.training.stopping import DivergedError
from simulator.dataset import open_dataset
from simulator.errors import InputError

pytestmark = pytest.mark.usefixtures("ctrl_c")


def lines(folder: Path, kind: str) -> list[dict[str, Any]]:
    """Return the log's numbers that do not measure time."""
    found = [json.loads(line) for line in (folder / METRICS).read_text().splitlines()]
    return [
        {key: value for key, value in line.items() if key != "samples_per_second"}
        for line in found
        if line["kind"] == kind
    ]


def stop_at(step: int) -> Callable[[str, int, int], None]:
    """Return what presses Ctrl-C after a step."""

    def show(stage: str, done: int, total: int) -> None:
        if done == step:
            signal.raise_signal(signal.SIGINT)

    return show


def weights(path: Path) -> dict[str, torch.Tensor]:
    return load_checkpoint(path).network.state_dict()


def test_learns_and_leaves_what_belongs_to_it(settings: Callable[..., TrainConfig]) -> None:
    config = settings(steps=40, log_every=10, validate_every=20, optimiser={"learning_rate": 5e-3})
    said: list[str] = []
    result = train(config, say=said.append)
    first, last = lines(result.folder, "train")[0], lines(result.folder, "train")[-1]
    # The first ten steps wander about the grey that a network begins with; where it has learned nothing it stays there.
    assert last["total"] < 0.65 < 0.9 < first["total"]
    assert last["total"] == pytest.approx(last["intensity_weighted"] + last["depth_weighted"], rel=1e-5)
    assert lines(result.folder, "validation")[-1]["psnr_db"] > 8
    best = load_checkpoint(result.folder / BEST)
    totals = {line["step"]: line["total"] for line in lines(result.folder, "validation")}
    assert best.record["step"] == result.best["step"] == min(totals, key=lambda step: totals[step])
    assert best.record["config"]["batch"] == 5
    assert best.record["data sets"]["train"]["samples"] == 32
    assert {path.name for path in result.folder.iterdir()} == {
        BEST,
        LAST,
        DESCRIPTION,
        METRICS,
        PREVIEW,
        STATE,
        "tensorboard",
    }
    assert sum("validation loss" in line for line in said) == 2


@pytest.mark.parametrize("stops", [(1,), (4, 7)])
def test_goes_on_as_if_it_had_never_stopped(settings: Callable[..., TrainConfig], stops: tuple[int, ...]) -> None:
    whole, parts = settings("whole"), settings("parts", data={"workers": 1})
    train(whole)
    for stop in stops:
        with pytest.raises(KeyboardInterrupt):
            train(parts, show=stop_at(stop))
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


def test_a_killed_training_goes_on_from_its_last_state(settings: Callable[..., TrainConfig]) -> None:
    """What was logged and kept after the state that survives is made again, not twice."""

    def die(stage: str, done: int, total: int) -> None:
        if done == 7:
            raise MemoryError

    whole, killed = settings("whole"), settings("killed")
    train(whole)
    with pytest.raises(KeyboardInterrupt):
        train(killed, show=stop_at(2))
    with pytest.raises(MemoryError):
        train(killed, show=die)
    assert train(killed).steps == 7
    assert lines(Path(whole.output), "train") == lines(Path(killed.output), "train")
    assert lines(Path(whole.output), "validation") == lines(Path(killed.output), "validation")


def test_finished_and_raised(settings: Callable[..., TrainConfig]) -> None:
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
    with pytest.raises(InputError, match=r"steps: got 2, but .* has done 4"):
        train(settings(steps=2))


def test_another_configuration_is_refused_line_by_line(settings: Callable[..., TrainConfig]) -> None:
    train(settings(steps=1))
    with pytest.raises(InputError, match=r"another configuration(.|\n)*batch: 5 -> 4\nloss.depth_weight: 1.0 -> 2.0$"):
        train(settings(steps=1, batch=4, loss={"depth_weight": 2.0}))
    assert train(settings(steps=2, log_every=1, data={"workers": 1})).steps == 1


def test_a_loss_that_is_no_number_stops_before_its_step(
    settings: Callable[..., TrainConfig], monkeypatch: pytest.MonkeyPatch, tiny_dataset: Path
) -> None:
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
    assert f"samples {wanted};" in str(error.value)
    assert str(error.value).startswith("step 3: ")
    assert "total nan" in str(error.value)
    kept = torch.load(folder / STATE, weights_only=True)
    assert kept["progress"]["step"] == 2
    assert all(bool(torch.isfinite(value).all()) for value in kept["network"].values())
    monkeypatch.undo()
    assert train(config).steps == 7


def test_gradient_that_is_no_number(settings: Callable[..., TrainConfig], monkeypatch: pytest.MonkeyPatch) -> None:
    """The root of nothing: its value is 0, its slope infinite."""
    forward = ReconstructionLoss.forward

    def broken(self: ReconstructionLoss, estimate: Any, *arguments: Any) -> dict[str, torch.Tensor]:
        terms = forward(self, estimate, *arguments)
        return terms | {"total": terms["total"] + (estimate.picture - estimate.picture.detach()).square().sum().sqrt()}

    monkeypatch.setattr(ReconstructionLoss, "forward", broken)
    with pytest.raises(DivergedError, match=r"step 1: .*gradient nan.*nothing is saved yet"):
        train(settings())


def test_a_validation_that_is_no_number(settings: Callable[..., TrainConfig], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("learning.training.loop.validate", lambda *_, **__: {"total": float("nan"), "psnr_db": 3.0})
    with pytest.raises(DivergedError, match=r"validation after step 4 is not finite \(total nan, psnr_db 3\)"):
        train(settings())


def test_fine_tuning_begins_with_a_checkpoint(settings: Callable[..., TrainConfig]) -> None:
    first = train(settings("first"))
    rate = {"learning_rate": 1e-9, "warm_up": 0.0}
    tuned = train(settings("tuned", start=str(first.folder / LAST), steps=1, optimiser=rate))
    before, after = weights(first.folder / LAST), weights(tuned.folder / LAST)
    for name, parameter in load_checkpoint(first.folder / LAST).network.named_parameters():
        assert torch.allclose(before[name], after[name], atol=2e-9), name
        assert parameter.shape == after[name].shape


def test_a_start_that_changed_is_another_training(settings: Callable[..., TrainConfig], tmp_path: Path) -> None:
    first, second = train(settings("first", steps=1)), train(settings("second", steps=1, seed=4))
    start = tmp_path / "start.safetensors"
    shutil.copy(first.folder / LAST, start)
    train(settings("tuned", start=str(start), steps=1))
    moved = tmp_path / "moved" / start.name
    moved.parent.mkdir()
    shutil.copy(start, moved)
    assert train(settings("tuned", start=str(moved), steps=2)).steps == 1  # the same content elsewhere
    shutil.copy(second.folder / LAST, start)
    with pytest.raises(InputError, match=r"another configuration(.|\n)*start\.sha256: "):
        train(settings("tuned", start=str(start), steps=3))


@pytest.mark.parametrize("moment", ["build_network", "count_workers"])
def test_another_training_in_between(
    settings: Callable[..., TrainConfig], monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    """It begins while this one prepares: before the lock this one is refused, after it the other; neither is lost."""
    import learning.train
    import learning.training.plan

    module = learning.training.plan if moment == "build_network" else learning.train
    original, refused = getattr(module, moment), []

    def inject(*arguments: Any, **others: Any) -> Any:
        monkeypatch.setattr(module, moment, original)
        try:
            train(settings(seed=99, steps=2))
        except InputError as error:
            refused.append(str(error))
        return original(*arguments, **others)

    monkeypatch.setattr(module, moment, inject)
    if moment == "build_network":
        with pytest.raises(InputError, match=r"another configuration(.|\n)*seed: 99 -> 3"):
            train(settings(steps=1))
    else:
        train(settings(steps=1))
        assert len(refused) == 1
        assert "another process trains in" in refused[0]
    folder = Path(settings().output)
    seed = 99 if moment == "build_network" else 3
    assert json.loads((folder / DESCRIPTION).read_text())["config"]["seed"] == seed
    assert load_checkpoint(folder / LAST).record["config"]["seed"] == seed


def test_speed_is_that_of_this_sitting(settings: Callable[..., TrainConfig], monkeypatch: pytest.MonkeyPatch) -> None:
    """A step takes a second of a clock that only steps move; five samples are in each."""
    import learning.training.loop as loop

    now, step = [0.0], loop.Training._step

    def slow(self: loop.Training, *arguments: Any) -> bool:
        now[0] += 1.0
        return step(self, *arguments)

    monkeypatch.setattr(loop.Training, "_step", slow)
    monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=lambda: now[0]))
    config = settings(steps=9, log_every=9, validate_every=9)
    with pytest.raises(KeyboardInterrupt):
        train(config, show=stop_at(8))
    train(config)
    log = (Path(config.output) / METRICS).read_text().splitlines()
    assert [json.loads(line)["samples_per_second"] for line in log if "samples_per_second" in line] == [5.0]


def test_start_from_another_architecture(settings: Callable[..., TrainConfig]) -> None:
    first = train(settings("first", steps=1))
    config = settings("other", start=str(first.folder / LAST), network={"name": "flatnet2d"})
    with pytest.raises(InputError, match="checkpoint of flatnet3d, expected flatnet2d"):
        train(config)
    assert not Path(config.output).exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data": {"train": "/nowhere/set"}}, "/nowhere/set"),
        ({"data": {"stack": "/nowhere/psf"}}, "/nowhere/psf"),
        ({"start": "/nowhere/net.safetensors"}, "/nowhere/net.safetensors"),
    ],
)
def test_absent_files_are_named(settings: Callable[..., TrainConfig], changes: Any, message: str) -> None:
    config = settings(**changes)
    with pytest.raises(InputError, match=message):
        train(config)
    assert not Path(config.output).exists()


def test_output_that_holds_something_else(settings: Callable[..., TrainConfig]) -> None:
    config = settings()
    Path(config.output).mkdir()
    (Path(config.output) / "thesis.txt").touch()
    with pytest.raises(InputError, match=r"not empty and holds no training \(thesis.txt"):
        train(config)


@pytest.mark.leaves_workers
def test_damage_is_named_though_a_worker_meets_it(
    settings: Callable[..., TrainConfig], tiny_dataset: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(tiny_dataset, copy)
    ids = open_dataset(copy, "train").ids
    damaged = next(copy.glob(f"train/*/{ids[15]}")) / "measurement.exr"  # no one of those that are looked at beforehand
    damaged.write_bytes(damaged.read_bytes()[:-100])
    with pytest.raises(InputError) as error:
        train(settings(data={"train": str(copy), "workers": 1}))
    assert str(damaged) in str(error.value)
    assert "Traceback" not in str(error.value)


@pytest.mark.slow
def test_learns_in_bfloat16(settings: Callable[..., TrainConfig]) -> None:
    ends = []
    for precision in ("float32", "bfloat16"):
        result = train(
            settings(precision, steps=40, log_every=10, precision=precision, optimiser={"learning_rate": 5e-3})
        )
        assert load_checkpoint(result.folder / LAST).record["precision"] == precision
        ends.append(lines(result.folder, "train")[-1]["total"])
    assert ends[0] != ends[1]
    assert ends[1] == pytest.approx(ends[0], rel=0.1)  # 2^-9 in each number, forty steps apart


@pytest.mark.slow
def test_a_terminal_s_ctrl_c(settings: Callable[..., TrainConfig], tmp_path: Path) -> None:
    """It reaches the workers too, which must live on until the step is done."""
    config = settings(steps=100_000, data={"workers": 2}, log_every=1)
    path = tmp_path / "train.yaml"
    path.write_text(json.dumps(config.dump()))
    code = "import sys; from learning.train import train; train(sys.argv[1], say=print)"
    root = Path(__file__).resolve().parents[2]
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", code, str(path)],
        cwd=root,
        env=os.environ | {"PYTHONPATH": str(root), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    log = Path(config.output) / METRICS
    begin = time.monotonic()
    while not (log.exists() and log.stat().st_size) and time.monotonic() - begin < 120:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    step = torch.load(Path(config.output) / STATE, weights_only=True)["progress"]["step"]
    assert f"stopped after step {step} of 100000; the same command goes on from there" in out
    assert step >= 1
    assert err.count("Traceback") == 1  # ours: KeyboardInterrupt, which the command turns into words
    assert err.rstrip().endswith("KeyboardInterrupt")


def test_captured_stack_is_another_training(settings: Callable[..., TrainConfig], tiny_dataset: Path) -> None:
    config = settings(steps=1, data={"stack": "captured"})
    train(config)
    capture = load_checkpoint(Path(config.output) / LAST).capture
    from simulator.optics.stack_files import read_psf_stack

    assert capture.stack.fingerprint == read_psf_stack(tiny_dataset / "psf_captured").fingerprint
    assert capture.stack.fingerprint != read_psf_stack(tiny_dataset / "psf").fingerprint
