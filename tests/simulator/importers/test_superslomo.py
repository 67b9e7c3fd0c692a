"""Super SloMo with random weights against its published layers, written a second time: the real weights are not at hand."""

import datetime
import pickle
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.ndimage
import torch
from numpy.typing import NDArray
from safetensors.torch import save_file
from torch import nn

from simulator.colour import linear_to_srgb
from simulator.errors import InputError
from simulator.importers.superslomo import SuperSloMo
from simulator.io.files import sha256_file

MEAN = np.array([0.429, 0.431, 0.397])


class Pair(nn.Module):
    """Two convolutions, each followed by the leaky rectifier; their names are those of the public weights."""

    def __init__(self, first: tuple[int, int], second: tuple[int, int], size: int = 3) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(*first, size, padding="same")
        self.conv2 = nn.Conv2d(*second, size, padding="same")


class Published(nn.Module):
    """Figure 4 of the paper as a module, so that torch itself checks names and shapes when weights are loaded."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(channels_in, 32, 7, padding="same")
        self.conv2 = nn.Conv2d(32, 32, 7, padding="same")
        self.down1 = Pair((32, 64), (64, 64), 5)
        self.down2 = Pair((64, 128), (128, 128))
        self.down3 = Pair((128, 256), (256, 256))
        self.down4 = Pair((256, 512), (512, 512))
        self.down5 = Pair((512, 512), (512, 512))
        self.up1 = Pair((512, 512), (1024, 512))
        self.up2 = Pair((512, 256), (512, 256))
        self.up3 = Pair((256, 128), (256, 128))
        self.up4 = Pair((128, 64), (128, 64))
        self.up5 = Pair((64, 32), (64, 32))
        self.conv3 = nn.Conv2d(32, channels_out, 3, padding="same")

    def forward(self, x: Any) -> Any:
        leaky, half = nn.LeakyReLU(0.1), nn.AvgPool2d(2)
        double = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=True)
        levels = [leaky(self.conv2(leaky(self.conv1(x))))]
        for down in (self.down1, self.down2, self.down3, self.down4, self.down5):
            levels.append(leaky(down.conv2(leaky(down.conv1(half(levels[-1]))))))
        x = levels.pop()
        for up in (self.up1, self.up2, self.up3, self.up4, self.up5):
            x = leaky(up.conv2(torch.cat([leaky(up.conv1(double(x))), levels.pop()], dim=1)))
        return leaky(self.conv3(x))


def numbers(network: nn.Module, *planes: NDArray) -> NDArray:
    """Run a network on arrays (H, W, channels)."""
    stacked = torch.tensor(np.concatenate(planes, -1).transpose(2, 0, 1)[None], dtype=torch.float32)
    with torch.no_grad():
        return network(stacked)[0].permute(1, 2, 0).numpy().astype(np.float64)


def warped(picture: NDArray, flow: NDArray) -> NDArray:
    """SciPy's bilinear look-up at (x + flow) (W - 1) / W, zero outside; the map of the public code's training."""
    height, width = picture.shape[:2]
    rows, columns = np.indices((height, width))
    y = (rows + flow[..., 1]) * (height - 1) / height
    x = (columns + flow[..., 0]) * (width - 1) / width
    ringed = np.pad(picture, ((1, 1), (1, 1), (0, 0)))  # the zeros outside begin a pixel after the last
    channels = [
        scipy.ndimage.map_coordinates(ringed[..., c], [y + 1, x + 1], order=1, mode="constant") for c in range(3)
    ]
    return np.stack(channels, -1)


@pytest.fixture(scope="module")
def networks() -> tuple[Published, Published]:
    torch.manual_seed(5)
    flow, interpolation = Published(6, 4), Published(20, 5)
    for network in (flow, interpolation):
        for parameter in network.parameters():
            if parameter.ndim == 4:  # a spread by which the signal neither dies out nor explodes over 23 layers
                nn.init.kaiming_normal_(parameter, 0.1, nonlinearity="leaky_relu")
    with torch.no_grad():
        for network in (flow, interpolation):
            network.conv3.weight *= 20  # flows of some pixels
    return flow, interpolation


@pytest.fixture(scope="module")
def content(networks: tuple[Published, Published]) -> dict[str, Any]:
    """All that the public file holds, the date and the losses of its training too."""
    return {
        "Detail": "End to end Super SloMo.",
        "epoch": 199,
        "timestamp": datetime.datetime(2018, 12, 1, 12, 30),
        "trainBatchSz": 6,
        "learningRate": 1e-6,
        "loss": [[3.0, 2.5]],
        "valLoss": [[3.0]],
        "valPSNR": [[28.0]],
        "state_dictFC": networks[0].state_dict(),
        "state_dictAT": networks[1].state_dict(),
    }


@pytest.fixture(scope="module")
def checkpoint(content: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("weights") / "SuperSloMo.ckpt"
    torch.save(content, path, _use_new_zipfile_serialization=False)  # of the age of the public file: torch 0.4
    yield path
    path.unlink()  # 158 MB


@pytest.fixture(scope="module")
def interpolator(checkpoint: Path) -> SuperSloMo:
    return SuperSloMo.from_checkpoint(checkpoint)


@pytest.fixture(scope="module")
def frames() -> NDArray[np.float32]:
    """Two smooth frames whose sides are no multiples of 32."""
    noise = np.random.default_rng(2).random((2, 37, 50, 3))
    smooth = scipy.ndimage.gaussian_filter(noise, (0, 2, 2, 0))
    return ((smooth - smooth.min()) / np.ptp(smooth)).astype(np.float32)


@pytest.mark.slow
def test_frames_are_those_of_the_formulas(
    interpolator: SuperSloMo, checkpoint: Path, networks: tuple[Published, Published], frames: NDArray[np.float32]
) -> None:
    found = interpolator.interpolate(frames, 3)
    assert found.shape == (4, 37, 50, 3)
    assert np.array_equal(found[::3], frames)
    assert interpolator.inputs == (checkpoint,)
    written = {"name": "superslomo", "checkpoint": "SuperSloMo.ckpt", "sha256": sha256_file(checkpoint)}
    assert written.items() <= interpolator.record().items()

    first, second = (
        np.pad(linear_to_srgb(frame).astype(np.float64), ((0, 27), (0, 14), (0, 0)), mode="edge") - MEAN
        for frame in frames
    )
    flows = numbers(networks[0], first, second)
    forth, back = flows[..., :2], flows[..., 2:]
    assert 0.3 < np.abs(flows).mean() < 30  # else nothing would be tested
    for index in (1, 2):
        t = index / 3
        to_first = -(1 - t) * t * forth + t**2 * back  # equation 4
        to_second = (1 - t) ** 2 * forth - t * (1 - t) * back
        known = first, second, forth, back, to_second, to_first, warped(second, to_second), warped(first, to_first)
        refined = numbers(networks[1], *known)
        visible = 1 / (1 + np.exp(-refined[..., 4:]))
        from_first = visible * warped(first, to_first + refined[..., :2])
        from_second = (1 - visible) * warped(second, to_second + refined[..., 2:4])
        blended = (1 - t) * from_first + t * from_second  # equation 5
        encoded = blended / ((1 - t) * visible + t * (1 - visible)) + MEAN
        # float32 places of some 60 pixels, told apart to 4e-6, times steps of up to 0.3 per pixel, through two networks.
        np.testing.assert_allclose(linear_to_srgb(found[index]), encoded[:37, :50].clip(0), atol=1e-4)


def test_bytes_do_not_depend_on_threads_which_stay(interpolator: SuperSloMo, frames: NDArray[np.float32]) -> None:
    before, results = torch.get_num_threads(), set()
    try:
        for threads in (1, 4):
            torch.set_num_threads(threads)
            results.add(pickle.loads(pickle.dumps(interpolator)).interpolate(frames, 2).tobytes())
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert len(results) == 1


@pytest.mark.slow  # writes and reads 158 MB
def test_safetensors_give_the_same(
    interpolator: SuperSloMo, content: dict[str, Any], frames: NDArray[np.float32], tmp_path: Path
) -> None:
    flat = {f"{key}.{name}": content[key][name] for key in ("state_dictFC", "state_dictAT") for name in content[key]}
    path = tmp_path / "weights.safetensors"
    save_file(flat, path)
    from_safetensors = SuperSloMo.from_checkpoint(path).interpolate(frames, 2)
    path.unlink()
    assert np.array_equal(from_safetensors, interpolator.interpolate(frames, 2))


class Evil:
    """Touches a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return Path.touch, (self.path,)


def test_checkpoints_that_are_none_are_refused_by_name(content: dict[str, Any], tmp_path: Path) -> None:
    def refusal(found: Any, name: str = "bad.ckpt") -> str:
        path = tmp_path / name
        if isinstance(found, bytes):
            path.write_bytes(found)
        else:
            torch.save(found, path)
        with pytest.raises(InputError, match=r"^superslomo_checkpoint: ") as caught:
            SuperSloMo.from_checkpoint(path)
        assert str(path) in str(caught.value)
        assert "weights_only" not in str(caught.value)  # torch's advice to let the file run its code
        return str(caught.value)

    for found, name in ((b"not a checkpoint", "bad.ckpt"), (b"nor this", "bad.safetensors")):
        refusal(found, name)
    assert "state_dictFC and state_dictAT" in refusal({"state_dict": {"a": torch.ones(1)}})
    flow = {name: torch.zeros(1).expand(tensor.shape) for name, tensor in content["state_dictFC"].items()}
    for change, words in [
        ({"conv1.weight": torch.zeros(1, 1, 1, 1)}, "conv1.weight is torch.float32 (1, 1, 1, 1)"),
        ({"up3.conv2.bias": None}, "up3.conv2.bias is nothing"),
        ({"extra": torch.ones(1)}, "also holds extra"),
        ({"conv2.bias": torch.full((32,), torch.nan)}, "conv2.bias holds NaN"),
    ]:
        assert words in refusal({"state_dictFC": flow | change})
    refusal({"state_dictFC": Evil(tmp_path / "touched")})
    assert not (tmp_path / "touched").exists()
