"""Whose folder it is."""

from __future__ import annotations

import pickle
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import nn

from learning.resume import (
    DESCRIPTION,
    STATE,
    TrainingProgress,
    check_folder,
    load_state,
    save_state,
    sole_use,
    stop_signals,
)
from learning.resume import described as described_with
from simulator.errors import InputError
from simulator.io.locks import take_lock

CONFIG: dict[str, Any] = {"output": "a", "steps": 5, "seed": 1, "data": {"train": "x", "workers": 2, "cache": True}}


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_the_first_signal_is_a_wish_the_second_acts(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with stop_signals() as stop:
        assert not stop.wanted
        signal.raise_signal(number)
        assert stop.wanted
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before


def test_nohup_stays_nohup() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_signals() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert not stop.wanted
    finally:
        signal.signal(signal.SIGHUP, before)


def described(config: dict[str, Any], data: dict[str, Any], **decided: Any) -> dict[str, Any]:
    return described_with(config, data, **({"precision": "float32", "init_from": None} | decided))


def test_what_does_not_matter(tmp_path: Path) -> None:
    with sole_use(tmp_path / "a", described(CONFIG, {"white": 1.0})):
        pass
    (tmp_path / "a" / STATE).touch()
    free = {"output": "b", "steps": 9, "data": {"train": "x", "workers": 0, "cache": False}}
    check_folder(tmp_path / "a", described(CONFIG | free, {"white": 1.0}))
    resolved = {"device": "cuda", "precision": "float32", "init_from": "elsewhere.safetensors"}
    check_folder(tmp_path / "a", described(CONFIG | resolved, {"white": 1.0}))
    with pytest.raises(InputError, match=r"^output: "):
        check_folder(tmp_path / "a", described(CONFIG | {"seed": 2}, {"white": 2.0}))


def test_what_was_resolved_matters(tmp_path: Path) -> None:
    config = CONFIG | {"precision": "auto", "init_from": "net.safetensors"}
    start = {"file": "net.safetensors", "sha256": "a" * 64}
    with sole_use(tmp_path, described(config, {}, init_from=start)):
        (tmp_path / STATE).touch()
    with pytest.raises(InputError, match=r"^output: "):
        check_folder(tmp_path, described(config | {"device": "cuda"}, {}, init_from=start, precision="bfloat16"))
    with pytest.raises(InputError, match=r"^output: "):
        check_folder(tmp_path, described(config, {}, init_from=start | {"sha256": "b" * 64}))


def test_a_training_that_never_saved_anything_is_replaced(tmp_path: Path) -> None:
    with sole_use(tmp_path, described(CONFIG, {})):
        pass
    other = described(CONFIG | {"seed": 2}, {})
    check_folder(tmp_path, other)
    with sole_use(tmp_path, other):
        pass
    (tmp_path / STATE).touch()
    check_folder(tmp_path, other)
    with pytest.raises(InputError, match=r"^output: "):
        check_folder(tmp_path, described(CONFIG, {}))


def test_a_file_and_a_damaged_description(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"^output: "):
        check_folder(tmp_path / "file", {})
    (tmp_path / DESCRIPTION).write_text("{")
    with pytest.raises(InputError, match=r"training\.json: "):
        check_folder(tmp_path, {})


def test_one_training_at_a_time(tmp_path: Path) -> None:
    (tmp_path / ".tmp-state.pt-1").touch()
    with sole_use(tmp_path, {}):
        assert [path.name for path in tmp_path.iterdir()] == [DESCRIPTION]
        with pytest.raises(InputError, match=r"^output: "), sole_use(tmp_path, {}):
            pass
    with sole_use(tmp_path, {}):
        pass


def test_what_came_there_before_the_lock_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another training begins and ends between the first look and the lock."""

    def late(descriptor: int) -> bool | None:
        (tmp_path / DESCRIPTION).write_text('{"config": {"seed": 7}}')
        (tmp_path / STATE).touch()
        return take_lock(descriptor)

    monkeypatch.setattr("learning.resume.take_lock", late)
    with pytest.raises(InputError, match=r"^output: "), sole_use(tmp_path, {"config": {"seed": 8}}):
        pass


def trained(width: int = 3) -> tuple[nn.Module, torch.optim.Optimizer]:
    network = nn.Sequential(nn.Conv2d(2, width, 3), nn.BatchNorm2d(width))
    optimiser = torch.optim.AdamW(network.parameters(), lr=0.1)
    network(torch.randn(2, 2, 5, 5)).square().sum().backward()
    optimiser.step()
    return network, optimiser


def test_round_trip(tmp_path: Path) -> None:
    torch.manual_seed(1)
    (network, optimiser), (other, empty) = trained(), trained()
    best, last = {"step": 5, "total": 0.5}, {"step": 6, "total": 0.75}
    progress = TrainingProgress(7, 1.25, best, last, {"total": 3.5}, 2, [[0, 9], [4, 12]])
    save_state(tmp_path / "state.pt", network, optimiser, progress)
    assert load_state(tmp_path / "state.pt", other, empty) == progress
    for name, value in network.state_dict().items():
        assert torch.equal(value, other.state_dict()[name])
    for key, values in optimiser.state_dict()["state"].items():
        assert all(torch.equal(value, empty.state_dict()["state"][key][name]) for name, value in values.items())


class Trap:
    """Runs code when it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return (Path.touch, (Path("trapped"),))


@pytest.mark.parametrize("what", ["cut", "text", "pickle", "other"])
def test_no_state(tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "state.pt"
    network, optimiser = trained()
    save_state(path, network, optimiser, TrainingProgress())
    if what == "cut":
        path.write_bytes(path.read_bytes()[:1000])
    elif what == "text":
        path.write_text("no state")
    elif what == "pickle":
        path.write_bytes(pickle.dumps(Trap(), protocol=2))
    else:
        network, optimiser = trained(4)
    with pytest.raises(InputError, match=r"state\.pt: "):
        load_state(path, network, optimiser)
    assert not (tmp_path / "trapped").exists()
