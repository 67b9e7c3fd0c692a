"""The perceptual loss: the right layer, the right weights or an error, and random features worth comparing."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d, conv2d, max_pool2d

from learning.perceptual import (
    FILES,
    LpipsDistance,
    PerceptualLoss,
    available_lpips,
    build_features,
    layer_indices,
    natural_images,
    weight_folder,
)
from simulator.errors import InputError


@pytest.fixture(scope="module")
def random_loss() -> PerceptualLoss:
    return PerceptualLoss("random_vgg", seed=3)


@pytest.fixture(scope="module")
def images() -> Tensor:
    return natural_images(torch.Generator().manual_seed(8), 4, 32)


@pytest.fixture(autouse=True)
def offline(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object, **keywords: object) -> None:
        pytest.fail("something asked the network")

    monkeypatch.setattr("urllib.request.urlopen", refuse)
    monkeypatch.setattr("torch.hub.load_state_dict_from_url", refuse)


def put_weights(folder: Path, monkeypatch: Any, content: Any, key: str = "vgg19", name: str = "vgg19") -> Path:
    """Save a weight file where torch's hub would have put it, its digest in its name."""
    monkeypatch.setenv("TORCH_HOME", str(folder))
    place = folder / "hub" / "checkpoints"
    place.mkdir(parents=True)
    torch.save(content, place / "new")
    digest = hashlib.sha256((place / "new").read_bytes()).hexdigest()
    monkeypatch.setitem(FILES, key, f"{name}-{digest[:8]}.pth")
    return (place / "new").rename(place / FILES[key])


def random_state() -> dict[str, Tensor]:
    """Weights as torchvision's file has them; as many as are read."""
    shapes = [(64, 3), (64, 64), (128, 64), (128, 128), (256, 128), *[(256, 256)] * 3, (512, 256), (512, 512)]
    numbers = (0, 2, 5, 7, 10, 12, 14, 16, 19, 21)  # of the convolutions in torchvision's features
    generator, state = torch.Generator().manual_seed(1), {"classifier.6.bias": torch.zeros(10)}
    for number, (outputs, inputs) in zip(numbers, shapes, strict=True):
        weight = torch.randn(outputs, inputs, 3, 3, generator=generator) * (2 / (9 * inputs)) ** 0.5
        state[f"features.{number}.weight"] = weight
        state[f"features.{number}.bias"] = torch.randn(outputs, generator=generator) / 10
    return state


def test_layers_are_named_as_in_the_literature() -> None:
    """Simonyan and Zisserman, table 1: blocks of 2, 2, 3, 3, 3 and of 2, 2, 4, 4, 4 convolutions, each followed by a pool."""
    sixteen, nineteen = layer_indices("vgg16"), layer_indices("vgg19")
    assert [sixteen[name] for name in ("relu1_1", "relu2_2", "relu4_3", "relu5_3")] == [1, 8, 22, 29]
    assert [nineteen[name] for name in ("relu2_2", "relu4_1", "relu4_2", "relu5_4")] == [8, 20, 22, 35]
    assert len(sixteen) == 13
    assert len(nineteen) == 16  # so the thesis's "22nd convolution" does not exist


@pytest.mark.slow  # importing torchvision takes 7 s
@pytest.mark.parametrize("network", ["vgg16", "vgg19"])
def test_features_are_those_of_torchvision(network: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Index 22 of torchvision's own VGG-19 is the ReLU after conv4_2, counted from its modules; layers are alike."""
    import torchvision

    for name in ("kaiming_normal_", "normal_", "kaiming_uniform_"):  # 140 million weights that nobody looks at
        monkeypatch.setattr(nn.init, name, lambda tensor, *arguments, **keywords: tensor)
    theirs = list(getattr(torchvision.models, network)(weights=None).features)
    if network == "vgg19":
        assert sum(isinstance(layer, nn.Conv2d) for layer in theirs) == 16
        pools = [index for index, layer in enumerate(theirs) if isinstance(layer, nn.MaxPool2d)]
        block = [n for n, layer in enumerate(theirs) if isinstance(layer, nn.Conv2d) and pools[2] < n < pools[3]]
        assert isinstance(theirs[22], nn.ReLU)
        assert block[1] == 21
    ours = build_features(network, len(theirs))
    without = [str(layer).replace("inplace=True", "") for layer in theirs]
    assert [str(layer) for layer in ours] == without
    assert ours.state_dict().keys() == nn.Sequential(*theirs).state_dict().keys()


def test_vgg_is_the_formula_with_the_file_s_weights(tmp_path: Path, monkeypatch: Any, images: Tensor) -> None:
    """Against the same weights applied layer by layer, in float64."""
    state = random_state()
    path = put_weights(tmp_path, monkeypatch, state)
    loss = PerceptualLoss("vgg")

    def features(image: Tensor) -> Tensor:
        mean, spread = torch.tensor([[0.485, 0.456, 0.406], [0.229, 0.224, 0.225]])[..., None, None].double()
        values = (image.double() - mean) / spread
        for number in (0, 2, 5, 7, 10, 12, 14, 16, 19, 21):
            if number in (5, 10, 19):
                values = nn.functional.max_pool2d(values, 2)
            weight, bias = (state[f"features.{number}.{name}"].double() for name in ("weight", "bias"))
            values = nn.functional.conv2d(values, weight, bias, padding=1).relu()
        return values

    one, other = images[:2], images[2:]
    expected = (features(one) - features(other)).square().mean()
    assert float(loss(one, other)) == pytest.approx(float(expected), rel=1e-4)  # float32 through ten layers
    assert loss.record() == {
        "perceptual": "vgg",
        "network": "vgg19",
        "layers": ["relu4_2"],
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def test_missing_weights_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(InputError, match=r"^weights of vgg19: ") as caught:
        PerceptualLoss("vgg")
    assert "vgg19-dcbb9e9d.pth" in str(caught.value)
    assert str(tmp_path / "hub" / "checkpoints") in str(caught.value)
    assert weight_folder() == tmp_path / "hub" / "checkpoints"
    assert not list(tmp_path.rglob("*"))


def test_a_file_that_is_not_what_its_name_says_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = put_weights(tmp_path, monkeypatch, {"features.0.weight": torch.zeros(64, 3, 3, 3)})
    with pytest.raises(InputError, match=r"^vgg19-4df172aa\.pth: "):
        PerceptualLoss("vgg")
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(InputError, match=r"vgg19-4df172aa\.pth: "):
        PerceptualLoss("vgg")


class Unwelcome:
    """What a malicious file would have pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (Path.touch, (Path("unpickled"),))


def test_nothing_is_unpickled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    put_weights(tmp_path, monkeypatch, {"features.0.weight": Unwelcome()})
    with pytest.raises(InputError, match=r"vgg19-0fbe5e48\.pth: "):
        PerceptualLoss("vgg")
    assert not (tmp_path / "unpickled").exists()


def test_random_features_depend_on_the_seed_alone(random_loss: PerceptualLoss, images: Tensor) -> None:
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    again = PerceptualLoss("random_vgg", seed=3)
    assert torch.equal(torch.random.get_rng_state(), before)
    torch.testing.assert_close(again.state_dict(), random_loss.state_dict(), rtol=0, atol=0)
    other = PerceptualLoss("random_vgg", seed=4)
    distance = random_loss(images[:2], images[2:])
    assert not torch.equal(other.state_dict()["features.0.weight"], random_loss.state_dict()["features.0.weight"])
    # Normalised features: another seed is another network, not another scale (unnormalised: factors of 10).
    assert float(other(images[:2], images[2:]) / distance) == pytest.approx(1, abs=0.3)
    assert random_loss.record()["seed"] == 3


def test_random_features_of_unlike_images_are_about_one_apart(random_loss: PerceptualLoss) -> None:
    """Each channel has variance 1 over such images: independent ones would be 2 apart, but share their channels' means."""
    fresh = natural_images(torch.Generator().manual_seed(77), 12, 64)
    assert torch.stack(random_loss.extract(fresh)).var(dim=(0, 1, 3, 4)).median() == pytest.approx(1, abs=0.25)
    assert 0.4 < float(random_loss(fresh[:6], fresh[6:])) < 2


def test_gradients_go_to_the_image_only_and_are_those_of_finite_differences(images: Tensor) -> None:
    """In float64, along a random direction; a step of 1e-9 crosses few kinks of the ReLUs."""
    loss = PerceptualLoss("random_vgg", seed=3).double()
    one, other = images[:1].double().requires_grad_(), images[1:2].double()

    def distance(image: Tensor) -> Tensor:  # without the cast to float32
        return (loss.extract(image)[0] - loss.extract(other)[0]).square().mean()

    distance(one).backward()
    assert one.grad is not None
    step = 1e-9 * torch.randn(one.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(6))
    with torch.no_grad():
        difference = (distance(one + step) - distance(one - step)) / 2
    assert float((one.grad * step).sum()) == pytest.approx(float(difference), rel=1e-3)
    assert all(parameter.grad is None and not parameter.requires_grad for parameter in loss.parameters())


def test_it_stays_in_float32_under_autocast(random_loss: PerceptualLoss, images: Tensor) -> None:
    expected = random_loss(images[:2], images[2:])
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(random_loss(images[:2], images[2:]), expected)


def test_vgg16_adds_both_of_its_layers(images: Tensor) -> None:
    loss = PerceptualLoss("random_vgg", "vgg16", seed=1)
    one, other = (loss.extract(image) for image in (images[:1], images[1:2]))
    assert [tuple(values.shape) for values in one] == [(1, 128, 16, 16), (1, 512, 4, 4)]
    expected = sum(float((x - y).square().mean()) for x, y in zip(one, other, strict=True))
    assert float(loss(images[:1], images[1:2])) == pytest.approx(expected, rel=1e-6)


def test_small_or_odd_images_and_unknown_names_are_refused(random_loss: PerceptualLoss, images: Tensor) -> None:
    with pytest.raises(InputError, match=r"^images: "):
        random_loss(images[..., :31], images[..., :31])
    with pytest.raises(InputError, match=r"^images: "):
        random_loss(images, images[:1])
    with pytest.raises(InputError, match=r"^perceptual: "):
        PerceptualLoss("alexnet")  # pyright: ignore[reportArgumentType]


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
    with pytest.raises(InputError, match=r"^weights of vgg16: "):
        LpipsDistance("vgg")
    with pytest.raises(InputError, match=r"^lpips: "):
        LpipsDistance("squeeze")


@pytest.mark.slow  # importing torchvision, which lpips does, takes 7 s
def test_it_is_the_published_formula_with_the_file_s_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Zhang et al. 2018, equation 1: squared differences of unit features, weighted per channel, averaged over space."""
    import lpips

    generator, state = torch.Generator().manual_seed(1), {}
    for name, (outputs, inputs, size) in LAYERS.items():
        weight = torch.randn(outputs, inputs, size, size, generator=generator)
        state[f"features.{name}.weight"] = weight * (2 / (inputs * size**2)) ** 0.5
        state[f"features.{name}.bias"] = torch.randn(outputs, generator=generator) / 10
    digest = hashlib.sha256(put_weights(tmp_path, monkeypatch, state, "alex", "alexnet-owt").read_bytes()).hexdigest()
    linear = torch.load(Path(lpips.__file__).parent / "weights/v0.1/alex.pth", map_location="cpu", weights_only=True)

    def features(image: torch.Tensor) -> list[torch.Tensor]:
        shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])
        values, found = ((2 * image - 1) - shift[:, None, None]) / scale[:, None, None], []
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


@pytest.mark.parametrize("damage", ["noise", "blur", "contrast"])
def test_worse_images_are_farther(random_loss: PerceptualLoss, images: Tensor, damage: str) -> None:
    noise = torch.randn(images.shape, generator=torch.Generator().manual_seed(2))
    worse = {
        "noise": [images + level * noise for level in (0, 0.01, 0.03, 0.1)],
        "blur": [images, *(avg_pool2d(images, n, 1, n // 2, count_include_pad=False) for n in (3, 5, 9))],
        "contrast": [images, *(0.5 + (images - 0.5) * share for share in (0.9, 0.7, 0.3))],
    }[damage]
    distances = [float(random_loss(image, images)) for image in worse]
    assert distances[0] == 0
    assert sorted(set(distances)) == distances
