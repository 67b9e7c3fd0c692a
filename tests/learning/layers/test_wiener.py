"""The trainable inversion: scikit-image's Wiener filter at first, and a filter of its own afterwards."""

from dataclasses import replace

import numpy as np
import pytest
import skimage.restoration
import torch

from learning.layers.wiener import WienerInversion
from simulator.errors import InputError


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(("shape", "psf"), [((32, 40), (9, 13)), ((30, 27), (14, 8))])
def test_starts_as_the_wiener_filter_of_scikit_image(camera, shape, psf):
    """On a sensor that needs no padding, which both then take for one period."""
    scene = tuple(n - p + 1 - (n - (n - p + 1)) % 2 for n, p in zip(shape, psf, strict=True))
    capture = camera(shape, scene, psf)
    layer = WienerInversion(capture, plane=1, noise_to_signal=0.03)
    assert (layer.rows.length, layer.columns.length) == shape
    measurement = np.random.default_rng(0).random((3, *shape))
    got = layer(torch.from_numpy(measurement)[None])[0].detach().numpy()
    for channel in range(3):
        kernel = np.asarray(capture.stack.values)[1, channel]
        wanted = skimage.restoration.wiener(
            measurement[channel] - capture.offset[channel],
            kernel,
            0.03 * np.sum(kernel**2),
            np.ones((1, 1)),  # an impulse regularises all frequencies alike
            clip=False,
        )[layer.rows.scene, layer.columns.scene]
        wanted /= capture.gain * capture.white * capture.irradiance.astype(np.float64)
        np.testing.assert_allclose(got[channel], wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())  # rounding


@pytest.mark.usefixtures("double")
def test_gradients_by_finite_differences(camera):
    capture = camera((6, 5), (2, 3), (3, 4), depths_m=(0.05,), channels=("R", "G"))
    layer, measurement = WienerInversion(capture), torch.rand(1, 2, 6, 5, requires_grad=True)

    def inverted(weight, measurement):
        return torch.func.functional_call(layer, {"weight": weight}, (measurement,))

    # A spectrum of real images: its imaginary part at 0 has no effect, so both gradients are 0 there.
    assert torch.autograd.gradcheck(inverted, (layer.weight, measurement), eps=1e-6, atol=1e-6, fast_mode=True)


def test_frames_are_inverted_one_by_one(camera):
    capture = camera((24, 24), (8, 8), (9, 9))
    layer, frames = WienerInversion(capture), torch.rand(2, 4, 3, 24, 24)
    together = layer(frames)
    assert together.shape == (2, 4, 3, 8, 8)
    for b, n in np.ndindex(2, 4):
        torch.testing.assert_close(together[b, n], layer(frames[b, n][None])[0])


def test_one_learning_rate_serves_every_scale(camera):
    """Adam's first step changes every number by the rate: here by the same share of W, for PSFs 1e6 times brighter."""
    capture = camera((24, 24), (8, 8), (9, 9))
    bright = replace(capture, stack=replace(capture.stack, values=np.asarray(capture.stack.values) * 1e6))
    bright = replace(bright, gain=capture.gain / 1e6)
    measurement, results = torch.rand(1, 3, 24, 24), []
    for model in (capture, bright):
        layer = WienerInversion(model)
        assert 2 * float(layer.weight.detach().square().mean()) == pytest.approx(1, abs=1e-4)
        optimiser = torch.optim.Adam(layer.parameters(), 1e-2, eps=1e-30)  # some imaginary parts have no gradient
        (layer(measurement) - 1).square().mean().backward()
        optimiser.step()
        results.append(layer(measurement).detach())
    assert float((results[0] - results[1]).abs().max() / results[0].abs().max()) < 1e-3


def test_learns_to_invert_better(camera):
    capture = camera((24, 24), (8, 8), (9, 9), plain=True)
    torch.manual_seed(0)
    scenes = torch.rand(16, 3, 8, 8)
    kernel = torch.from_numpy(np.asarray(capture.stack.values)[0]).float().flip(-2, -1)[:, None]
    measurements = torch.nn.functional.conv2d(scenes, kernel, padding=12, groups=3)[..., :24, :24]
    measurements += 0.05 * torch.randn_like(measurements)
    layer = WienerInversion(capture, noise_to_signal=1.0)
    optimiser = torch.optim.Adam(layer.parameters(), 1e-2)
    losses = []
    for _ in range(40):
        loss = (layer(measurements) - scenes).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.5 * losses[0]


def test_memory_format_changes_nothing(camera):
    layer, frames = WienerInversion(camera((24, 24), (8, 8), (9, 9))), torch.rand(2, 4, 3, 24, 24)
    plain = layer(frames).detach()
    assert torch.equal(layer.to(memory_format=torch.channels_last)(frames).detach(), plain)


def test_float32_under_autocast(camera):
    layer, measurement = WienerInversion(camera((24, 24), (8, 8), (9, 9))), torch.rand(1, 3, 24, 24)
    plain = layer(measurement)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(layer(measurement), plain)


@pytest.mark.parametrize(
    ("arguments", "message"), [({"plane": 3}, "plane: got 3"), ({"noise_to_signal": 0.0}, "noise_to_signal")]
)
def test_refuses(camera, arguments, message):
    with pytest.raises(InputError, match=message):
        WienerInversion(camera((24, 24), (8, 8), (9, 9)), **arguments)


def test_refuses_measurements_of_another_camera(camera):
    with pytest.raises(InputError, match="measurement: got shape"):
        WienerInversion(camera((24, 24), (8, 8), (9, 9)))(torch.rand(2, 4, 3, 24, 26))
