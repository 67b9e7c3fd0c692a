"""LPIPS only where its weights are; then the published formula."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import torch
from torch.nn.functional import conv2d, max_pool2d

from learning.perceptual import LpipsDistance, available_lpips
from learning.perceptual.weights import FILES
from simulator.errors import InputError

LAYERS = {
    "0": (64, 3, 11),
    "3": (192, 64, 5),
    "6": (384, 192, 3),
    "8": (256, 384, 3),
    "10": (256, 256, 3),
}  # of AlexNet


def test_without_weights_there_is_a_reason_or_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    lpips, reason = available_lpips()
    assert lpips is None
    for words in ("alexnet-owt-7be5be79.pth", "vgg16-397923af.pth", str(tmp_path / "hub" / "checkpoints")):
        assert words in reason
    with pytest.raises(InputError, match=r"vgg16-397923af\.pth is not in .*leave LPIPS out"):
        LpipsDistance("vgg")
    for ask in (LpipsDistance, available_lpips):
        with pytest.raises(InputError, match="'squeeze', expected one of alex, vgg"):
            ask("squeeze")


@pytest.mark.slow  # importing torchvision, which lpips does, takes 7 s
def test_it_is_the_published_formula_with_the_file_s_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Zhang et al. 2018, equation 1: squared differences of unit features, weighted per channel, averaged over space."""
    import lpips

    def refuse(*arguments: object, **keywords: object) -> None:
        pytest.fail("something asked the network")

    monkeypatch.setattr("urllib.request.urlopen", refuse)
    monkeypatch.setattr("torch.hub.load_state_dict_from_url", refuse)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    generator, state = torch.Generator().manual_seed(1), {}
    for name, (outputs, inputs, size) in LAYERS.items():
        weight = torch.randn(outputs, inputs, size, size, generator=generator)
        state[f"features.{name}.weight"] = weight * (2 / (inputs * size**2)) ** 0.5
        state[f"features.{name}.bias"] = torch.randn(outputs, generator=generator) / 10
    place = tmp_path / "hub" / "checkpoints"
    place.mkdir(parents=True)
    torch.save(state, place / "new")
    digest = hashlib.sha256((place / "new").read_bytes()).hexdigest()
    monkeypatch.setitem(FILES, "alex", f"alexnet-owt-{digest[:8]}.pth")
    (place / "new").rename(place / FILES["alex"])
    linear = torch.load(Path(lpips.__file__).parent / "weights/v0.1/alex.pth", map_location="cpu", weights_only=True)

    def features(picture: torch.Tensor) -> list[torch.Tensor]:
        shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])
        values, found = ((2 * picture - 1) - shift[:, None, None]) / scale[:, None, None], []
        for name, pad, stride in (("0", 2, 4), ("3", 2, 1), ("6", 1, 1), ("8", 1, 1), ("10", 1, 1)):
            if name in "36":
                values = max_pool2d(values, 3, 2)
            kernel, bias = state[f"features.{name}.weight"], state[f"features.{name}.bias"]
            values = conv2d(values, kernel, bias, padding=pad, stride=stride).relu()
            found.append(values / values.square().sum(dim=1, keepdim=True).sqrt())
        return found

    one, other = torch.rand(2, 2, 3, 64, 48, generator=generator)
    expected = torch.zeros(2)
    for layer, (x, y) in enumerate(zip(features(one), features(other), strict=True)):
        weighted = (x - y).square() * linear[f"lin{layer}.model.1.weight"][0]
        expected += weighted.sum(dim=1).mean(dim=(1, 2))
    torch.manual_seed(1)
    before = torch.random.get_rng_state()
    distance, reason = available_lpips()
    assert torch.equal(torch.random.get_rng_state(), before)
    assert distance is not None
    assert FILES["alex"] in reason
    torch.testing.assert_close(distance(one, other), expected, rtol=1e-5, atol=1e-7)
    assert distance(one, one).tolist() == [0, 0]
    assert distance.record()["sha256"] == digest
    with pytest.raises(InputError, match="at least 32 x 32"):
        distance(one[..., :16], other[..., :16])
