"""A state comes back bit for bit; a file that is none is refused, and nothing in it is run."""

import pickle
from pathlib import Path

import pytest
import torch
from torch import nn

from learning.training.state import Progress, load_state, save_state
from simulator.errors import InputError


def trained(width: int = 3) -> tuple[nn.Module, torch.optim.Optimizer]:
    network = nn.Sequential(nn.Conv2d(2, width, 3), nn.BatchNorm2d(width))
    optimiser = torch.optim.AdamW(network.parameters(), lr=0.1)
    network(torch.randn(2, 2, 5, 5)).square().sum().backward()
    optimiser.step()
    return network, optimiser


def test_round_trip(tmp_path: Path) -> None:
    torch.manual_seed(1)
    (network, optimiser), (other, empty) = trained(), trained()
    progress = Progress(
        7, 1.25, {"step": 5, "total": 0.5}, {"step": 6, "total": 0.75}, {"total": 3.5}, 2, [[0, 9], [4, 12]]
    )
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
    save_state(path, network, optimiser, Progress())
    if what == "cut":
        path.write_bytes(path.read_bytes()[:1000])
    elif what == "text":
        path.write_text("no state")
    elif what == "pickle":
        path.write_bytes(pickle.dumps(Trap(), protocol=2))
    else:
        network, optimiser = trained(4)
    with pytest.raises(InputError, match=r"state\.pt cannot be read \(.*delete it to begin"):
        load_state(path, network, optimiser)
    assert not (tmp_path / "trapped").exists()
