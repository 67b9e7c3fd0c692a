"""The denoiser: what it must do for any weights, what its loss weighs, and that the shipped one takes noise away."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import torch

from learning.checkpoint import find_denoiser, load_checkpoint, load_denoiser, save_denoiser, shipped_checkpoints
from learning.models.denoiser import NOISE_RANGE, TRAINED_PEAK, Denoiser, DenoisingLoss
from simulator.errors import InputError

SIZE = {"filters": 4, "blocks": 1, "levels": 2}


@pytest.fixture
def network() -> Denoiser:
    torch.manual_seed(0)
    return Denoiser(**SIZE).eval()


def test_little_noise_leaves_the_picture(network: Denoiser) -> None:
    """Whatever the weights: the change shrinks in proportion to the noise."""
    picture = torch.rand(1, 3, 9, 11)
    with torch.no_grad():
        changes = [float((network(picture, torch.tensor([s])) - picture).abs().max()) for s in (1e-2, 1e-4, 1e-6)]
    assert changes[1] < 0.05 * changes[0]
    assert changes[2] < 0.05 * changes[1]
    assert changes[2] < 1e-5


def test_pictures_of_a_batch_have_noise_of_their_own(network: Denoiser) -> None:
    pictures, noise = torch.rand(3, 3, 8, 8), torch.tensor([0.01, 0.1, 0.3])
    with torch.no_grad():
        together = network(pictures, noise)
        for at in range(3):
            torch.testing.assert_close(network(pictures[at : at + 1], noise[at : at + 1]), together[at : at + 1])
        assert not torch.allclose(network(pictures, noise.flip(0)), together, atol=1e-3)


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_planes_are_pictures_one_by_one(network: Denoiser, channels: int) -> None:
    """Three channels are colours; others are grey pictures, each by itself."""
    volume = torch.rand(2, 5, channels, 8, 8)
    with torch.no_grad():
        found = network.planes(volume, torch.tensor([0.05, 0.1]))
        picture = volume[1, 4] if channels == 3 else volume[1, 4, :1].expand(3, -1, -1)
        one = network(picture[None], torch.tensor([0.1]))[0]
    assert found.shape == volume.shape
    expected = one if channels == 3 else one.mean(dim=0, keepdim=True)
    torch.testing.assert_close(found[1, 4, : len(expected)], expected)


def test_brightness_beyond_white_is_only_a_factor(network: Denoiser) -> None:
    """A point a thousand times as bright as white, in as much more noise, is the same picture."""
    volume = torch.rand(1, 2, 3, 8, 8)
    volume[..., 3, 4] = TRAINED_PEAK
    with torch.no_grad():
        bright, plain = (network.planes(times * volume, torch.tensor([0.1 * times])) for times in (1000, 1))
    torch.testing.assert_close(bright / 1000, plain)


def test_noise_beyond_what_it_was_trained_for_is_the_nearest_that_was(network: Denoiser) -> None:
    volume = torch.rand(4, 2, 3, 8, 8)
    volume[1], volume[3] = volume[0], volume[2]
    least, most = NOISE_RANGE
    with torch.no_grad():
        found = network.planes(volume, torch.tensor([0.0, least, most, 9.0]))
    torch.testing.assert_close(found[::2], found[1::2])


def test_loss_weighs_all_noise_levels_alike(network: Denoiser) -> None:
    """What the network itself gives counts the same at every level, whatever it is multiplied by there."""
    clean, losses = torch.rand(1, 3, 8, 8), []
    for level in (0.003, 0.1, 0.5):
        noise = torch.tensor([level])
        with torch.no_grad():
            first = network(clean, noise)
            network.body.head.bias += 1  # its output, one more
            losses.append(float(DenoisingLoss()(network(clean, noise), first, noise)["total"]))
            network.body.head.bias -= 1
    np.testing.assert_allclose(losses, 1, rtol=1e-3)


def shapes_on_black(seed: int = 0) -> torch.Tensor:
    """Return discs of one colour each on black, ``(3, 48, 48)``: what a plane of a depth volume looks like."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:48, :48]
    picture = np.zeros((3, 48, 48), np.float32)
    for _ in range(4):
        row, column, radius = rng.uniform(8, 40), rng.uniform(8, 40), rng.uniform(4, 9)
        picture[:, (rows - row) ** 2 + (columns - column) ** 2 < radius**2] = rng.uniform(0.1, 1, (3, 1))
    return torch.from_numpy(picture)


@pytest.mark.parametrize(("noise", "gain_db"), [(0.02, 7), (0.1, 9), (0.3, 10.5)])
def test_the_shipped_one_takes_noise_away(noise: float, gain_db: float) -> None:
    network, record = load_denoiser(find_denoiser("denoiser"))
    assert record["loss"] == DenoisingLoss().record()
    picture = shapes_on_black()
    noisy = picture + noise * torch.randn(picture.shape, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        found = network(noisy[None], torch.tensor([noise]))[0]
    errors = [float((each - picture).square().mean()) for each in (noisy, found)]
    assert 10 * np.log10(errors[0] / errors[1]) > gain_db
    assert NOISE_RANGE[0] <= noise <= NOISE_RANGE[1]


def test_shipped_file_is_small_says_its_scenes_and_is_no_method() -> None:
    assert find_denoiser("denoiser").stat().st_size < 2_000_000
    assert load_denoiser(find_denoiser("denoiser"))[1][
        "scenes"
    ]  # so that a comparison can tell that it tests on others
    assert "denoiser" not in shipped_checkpoints()


def test_checkpoint_keeps_weights_and_record(network: Denoiser, tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    save_denoiser(path, network, architecture={"network": "denoiser", **SIZE}, record={"seed": 3})
    found, record = load_denoiser(find_denoiser(str(path)))
    assert record == {"seed": 3}
    for name, value in network.state_dict().items():
        assert torch.equal(found.state_dict()[name], value)


def test_refuses_what_is_no_denoiser(network: Denoiser, checkpoints: list[Path], tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    save_denoiser(path, network, architecture={"network": "denoiser", **SIZE}, record={})
    with pytest.raises(InputError, match=f"^{path}: got a denoiser"):
        load_checkpoint(path)
    with pytest.raises(InputError, match=f"^{checkpoints[0]}: "):
        load_denoiser(checkpoints[0])
    with pytest.raises(InputError, match=r"^denoiser: "):
        find_denoiser("another")
    content = path.read_bytes()
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    for change in ('"filters":4', '"levels":2'):
        text = json.dumps(header).replace(change.replace('"', '\\"'), (change[:-1] + "3").replace('"', '\\"')).encode()
        path.write_bytes(struct.pack("<Q", len(text)) + text + content[8 + length :])
        with pytest.raises(InputError, match=f"^{path}: "):
            load_denoiser(path)
