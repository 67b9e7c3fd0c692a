"""The inversion at every depth against its equation, written independently, and against the simulator's forward model."""

from dataclasses import replace

import numpy as np
import pytest
import skimage.restoration
import torch

from learning.layers import inversion
from learning.layers.inversion import RegularisedInversion, WienerInversion
from learning.layers.noise import noise_level, noise_ratio
from simulator.arrays import next_fast_len
from simulator.camera.forward import ForwardModel
from simulator.errors import InputError

# Sensor, scene, PSF: even and odd, tall and wide, a PSF that is larger than the sensor, a sensor that holds all light.
SIZES = [
    ((24, 24), (8, 8), (9, 9)),
    ((21, 30), (9, 6), (14, 25)),
    ((20, 15), (20, 15), (31, 18)),
    ((48, 60), (16, 20), (15, 16)),
]


def randomised(layer: RegularisedInversion, seed: int = 1) -> RegularisedInversion:
    """Give the layer filters, lambdas and weights of noise that differ everywhere."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, values in layer.named_parameters():
            step = 0.3 if name == "filters" else 1.0
            values += step * torch.randn(values.shape, generator=generator, dtype=values.dtype)
    return layer


def equation_4_11(capture, layer, measurement, joint=False):
    """Invert in NumPy with full complex transforms, one plane and channel after the other; padding by its definition.

    Where lambda follows the noise, what this is, `learning.layers.noise` says; joint, |FH|^2 is the mean of all planes.
    """
    following = layer.log_noise_weight
    variance = noise_level(torch.from_numpy(measurement - capture.offset[:, None, None])).numpy() ** 2
    (H, W), (h, w) = capture.sensor_shape, capture.scene_shape
    values = np.asarray(capture.stack.values, np.float64)
    K, C, P, Q = values.shape
    L, M = (next_fast_len(max(n, f + p - 1)) for n, f, p in zip((H, W), capture.field_shape, (P, Q), strict=True))
    result = np.zeros((len(measurement), K, C, h, w))
    for b, k, c in np.ndindex(len(measurement), K, C):
        light = measurement[b, c].astype(np.float64) - capture.offset[c]
        padded = np.empty((L, M))
        for i, j in np.ndindex(L, M):
            value = 0.0
            for row, a in taper(i, H, L):
                value += sum(a * e * light[row, column] for column, e in taper(j, W, M))
            padded[i, j] = value
        psf, filt = np.zeros((K, L, M)), np.zeros((L, M))
        for i, j in np.ndindex(P, Q):
            psf[:, (i - P // 2) % L, (j - Q // 2) % M] += values[:, c, i, j]
        for i, j in np.ndindex(3, 3):
            filt[(i - 1) % L, (j - 1) % M] += layer.filters[k, i, j].item()
        transfer, penalty = np.fft.fft2(psf), np.abs(np.fft.fft2(filt)) ** 2
        power = np.mean(np.abs(transfer if joint else transfer[k : k + 1]) ** 2, axis=0)
        weight = np.exp(layer.log_lambda[k, c].item())
        if following is not None:
            weight += np.exp(following[k, c].item()) * variance[b] / np.mean(light**2)
        scene = np.fft.ifft2(
            np.fft.fft2(padded) * np.conj(transfer[k]) / (power + weight * np.mean(power) * penalty)
        ).real[(H - h) // 2 : (H + h) // 2, (W - w) // 2 : (W + w) // 2]
        result[b, k, c] = scene / (capture.gain * capture.white * capture.scene_irradiance)
    return result


def taper(index, sensor, length):
    """Return which samples of the sensor stand at an index of the period, and how strongly."""
    if index < sensor:
        return [(index, 1.0)]
    gap = length - sensor + 1
    weights = [(sensor - 1, (index - sensor + 1) / gap), (0, (length - index) / gap)]
    return [(sample, 0.5 + 0.5 * np.cos(2 * np.pi * step)) for sample, step in weights if step < 0.5]


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize(("sensor", "scene", "psf", "margin"), [*((*sizes, 0) for sizes in SIZES), (*SIZES[0], 6)])
@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("noise_weight", [None, 1.0])
def test_equals_equation_4_11_computed_directly(camera, sensor, scene, psf, margin, joint, noise_weight):
    """A field that goes on around the scene makes the period longer: its light must not come back into the scene."""
    capture = camera(sensor, scene, psf, depths_m=(0.02, 0.05), channels=("R", "G"))
    capture = replace(capture, irradiance=np.pad(capture.irradiance, margin, constant_values=0.7))
    layer = randomised(RegularisedInversion(capture, noise_weight=noise_weight, joint=joint))
    measurement = np.random.default_rng(2).random((2, 2, *sensor)) * [
        [[[1.0]]],
        [[[0.3]]],
    ]  # one is noisier than the other
    measurement[1] += 0.6
    with torch.no_grad():
        got = layer(torch.from_numpy(measurement)).numpy()
    wanted = equation_4_11(capture, layer, measurement, joint)
    # The least denominator is 1e-8 of the mean power, lambda |FP|^2 about 1e-2 of it: 1e-6 of the largest value.
    np.testing.assert_allclose(got, wanted, rtol=0, atol=2e-6 * np.abs(wanted).max())


def test_the_initial_lambda_is_the_sum_of_both_weights(camera):
    layer = RegularisedInversion(camera(*SIZES[0]), regularisation_lambda=0.25, noise_weight=3.0)
    ratio = torch.tensor([[0.0, 0.1, 0.2]])
    sums = 0.25 + 3.0 * ratio[0]
    following = torch.stack(list(layer.inverses(ratio)))[:, 0]
    for channel, total in enumerate(sums.tolist()):
        fixed = RegularisedInversion(camera(*SIZES[0]), regularisation_lambda=total)
        alike = torch.cat(list(fixed.inverses()))[:, channel]
        torch.testing.assert_close(following[:, channel], alike, rtol=1e-5, atol=0)


@pytest.mark.usefixtures("double")
def test_joint_planes_are_the_least_squares_of_the_stack(camera):
    """At every frequency argmin |Y - sum_k H_k V_k|^2 + K lambda mean|H|^2 |P|^2 sum_k |V_k|^2, times the K planes."""
    capture = camera(*SIZES[1], depths_m=(0.02, 0.03, 0.06), channels=("R", "G"))
    layer = RegularisedInversion(capture, regularisation_lambda=0.02, tikhonov=1.0, joint=True)
    alone = RegularisedInversion(capture, regularisation_lambda=1.0, tikhonov=1.0)
    kernels = np.asarray(capture.stack.values, np.float64)
    size = layer.rows.length, layer.columns.length
    padded = np.zeros((3, 2, *size))
    for i, j in np.ndindex(kernels.shape[-2:]):
        padded[:, :, i - kernels.shape[-2] // 2, j - kernels.shape[-1] // 2] = kernels[:, :, i, j]
    transfer = np.fft.fft2(padded)[:, :, : size[0] // 2 + 1]
    turns = [2 - 2 * np.cos(2 * np.pi * np.arange(length) / length) for length in size]
    response = 1 + turns[0][: size[0] // 2 + 1, None] + turns[1]  # of the Laplacian and 1 beside it
    with torch.no_grad():
        got = torch.cat(list(layer.inverses())).numpy()
        plane_wise = torch.cat(list(alone.inverses())).numpy()
    assert got.shape == transfer.shape
    assert not np.allclose(got, plane_wise)
    for c, y, x in [(0, 0, 0), (1, 0, 3), (0, 5, 0), (1, 7, 11), (0, size[0] // 2, size[1] - 1), (1, 2, size[1] // 2)]:
        ridge = np.sqrt(3 * 0.02 * np.mean(np.sum(kernels[:, c] ** 2, axis=(1, 2)))) * response[y, x]
        system = np.vstack([transfer[None, :, c, y, x], ridge * np.eye(3)])
        wanted = 3 * np.linalg.lstsq(system, np.array([1, 0, 0, 0]), rcond=None)[0]
        np.testing.assert_allclose(got[:, c, y, x], wanted, rtol=1e-5)  # the least denominator


@pytest.mark.usefixtures("double")
def test_planes_that_look_alike_share_what_one_would_get(camera):
    one = camera(*SIZES[0], depths_m=(0.05,))
    values = np.repeat(np.asarray(one.stack.values), 4, axis=0)
    four = one.with_stack(replace(one.stack, values=values, depths_m=np.array([0.02, 0.03, 0.05, 0.1])))
    measurement = torch.rand(2, 3, *SIZES[0][0])
    joint = RegularisedInversion(four, noise_weight=0.7, joint=True)(measurement)
    alone = RegularisedInversion(one, noise_weight=0.7)(measurement)
    torch.testing.assert_close(joint, alone.expand(-1, 4, -1, -1, -1), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("following", [None, 1.0])
@pytest.mark.parametrize("joint", [False, True])
def test_float32_is_as_exact_as_its_rounding(camera, double, following, joint):
    capture = camera(*SIZES[1])
    measurement = torch.rand(1, 3, *SIZES[1][0])
    kind = {"noise_weight": following, "joint": joint}
    wanted = randomised(RegularisedInversion(capture, **kind))(measurement).detach()
    torch.set_default_dtype(torch.float32)
    single = randomised(RegularisedInversion(capture, **kind).double()).float()
    got = single(measurement.float()).detach()
    assert got.dtype == torch.float32
    # 1e-7 of rounding, amplified by the inverse: at lambda 1e-2 at most tenfold per operation
    assert float((got - wanted).abs().max() / wanted.abs().max()) < 1e-5


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("at_once", [1, 2])  # as on a CPU, and as on a GPU
@pytest.mark.parametrize(
    "sizes", [((6, 5), (2, 3), (3, 4)), ((5, 6), (3, 2), (3, 4))]
)  # an even period of the rows, whose half has a last row of its own, and an odd one
def test_gradients_by_finite_differences(camera, sizes, at_once, monkeypatch):
    monkeypatch.setattr(inversion, "samples_at_once", lambda *_: at_once)
    capture = camera(*sizes, depths_m=(0.02, 0.05), channels=("R", "G"))
    for joint in (False, True):
        layer = randomised(RegularisedInversion(capture, noise_weight=1.0, joint=joint))
        assert layer.rows.length == sizes[0][0]
        light = layer.light(torch.rand(2, 2, *sizes[0]))
        ratio = noise_ratio(light)  # which has no gradient, but changes with the measurement

        def inverted(filters, log_lambda, log_noise_weight, light, layer=layer, ratio=ratio):
            given = {"filters": filters, "log_lambda": log_lambda, "log_noise_weight": log_noise_weight}
            return torch.func.functional_call(
                _Inverted(layer), {f"layer.{k}": v for k, v in given.items()}, (light, ratio)
            )

        given = (*(value for _, value in layer.named_parameters()), light.requires_grad_())
        assert torch.autograd.gradcheck(inverted, given, eps=1e-6, atol=1e-6, fast_mode=True)


class _Inverted(torch.nn.Module):
    """The inversion of light whose noise is known."""

    def __init__(self, layer):
        super().__init__()
        self.layer = layer

    def forward(self, light, ratio):
        return self.layer.volume(self.layer.spectrum(light), ratio)


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("joint", [False, True])
@pytest.mark.parametrize("sizes", SIZES)
def test_a_reprojection_is_the_forward_model(camera, sizes, joint):
    capture = camera(*sizes)
    volume = np.random.default_rng(3).random((2, 2, 3, *sizes[1]))
    got = RegularisedInversion(capture, [0, 2], joint=joint).reproject(torch.from_numpy(volume))
    whole = np.zeros((2, 3, 3, *sizes[1]))
    whole[:, [0, 2]] = volume * capture.irradiance * (capture.gain * capture.white)
    model = capture.forward_model(whole)
    for one, light in zip(got, whole, strict=True):
        np.testing.assert_allclose(one, model.forward(light[None]), rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("double")
@pytest.mark.parametrize("psf", [(19, 22), (12, 31)])
def test_points_come_out_at_their_pixels_and_planes(camera, psf):
    capture = camera((40, 47), (16, 15), psf, depths_m=(0.02, 0.03, 0.06), plain=True)
    capture = replace(capture, gain=3.0, offset=np.array([0.1, 0.2, 0.3]), white=0.25)
    layer = RegularisedInversion(capture, regularisation_lambda=1e-5)
    forward = ForwardModel(capture.stack, capture.sensor_shape, capture.scene_shape)
    for plane, row, column in [(0, 3, 11), (1, 15, 0), (2, 8, 7)]:
        volume = np.zeros((1, 3, 3, 16, 15))
        volume[0, plane, :, row, column] = 0.25
        stored = capture.offset[:, None, None] + capture.gain * forward.forward(volume)
        estimate = layer(torch.from_numpy(stored)[None])[0].detach().numpy()
        for channel in range(3):
            peak = np.unravel_index(np.argmax(estimate[:, channel]), (3, 16, 15))
            assert peak == (plane, row, column)
            # Of white; what the sensor cuts off is missing, what stays is sharp.
            assert estimate[plane, channel, row, column] == pytest.approx(1, abs=0.1)


@pytest.mark.usefixtures("double")
def test_a_scene_whose_light_all_arrives_is_recovered(camera):
    """The exact inverse of the simulator's own forward model, when nothing is regularised: radiance over white."""
    capture = camera((40, 44), (14, 18), (15, 13), depths_m=(0.05,))
    light = np.random.default_rng(0).random((3, 14, 18))
    exposure = ForwardModel(capture.stack, (40, 44), (14, 18)).forward((light * capture.irradiance)[None, None])
    stored = capture.offset[:, None, None] + capture.gain * exposure
    got = RegularisedInversion(capture, regularisation_lambda=1e-12)(torch.from_numpy(stored)[None])[0, 0]
    # the least denominator, 1e-8 against |FH|^2 that goes down to 6e-5 of its mean, where little of the scene is
    np.testing.assert_allclose(got.detach().numpy(), light / capture.white, atol=1e-5)


def test_selected_planes_and_single_ones(camera):
    capture = camera(*SIZES[0])
    measurement = torch.rand(2, 3, *SIZES[0][0])
    whole = RegularisedInversion(capture)(measurement)
    torch.testing.assert_close(RegularisedInversion(capture, [2, 0])(measurement), whole[:, [2, 0]])
    flat = camera(*SIZES[0], depths_m=(float("inf"),), channels=("Y",))
    assert RegularisedInversion(flat)(measurement[:, :1]).shape == (2, 1, 1, 8, 8)


@pytest.mark.parametrize("kind", [RegularisedInversion, WienerInversion])
def test_memory_format_and_precision_follow_the_module(camera, kind):
    layer, measurement = kind(camera(*SIZES[0])), torch.rand(2, 3, *SIZES[0][0])
    plain = layer(measurement).detach()
    other = layer.to(memory_format=torch.channels_last)(measurement.to(memory_format=torch.channels_last)).detach()
    double = layer.to(torch.float64)(measurement.double()).detach()
    assert double.dtype == torch.float64
    for each in (other, double):
        assert float((each - plain).abs().max() / plain.abs().max()) < 1e-5  # rounding of float32


@pytest.mark.parametrize("kind", [RegularisedInversion, WienerInversion])
def test_float32_under_autocast(camera, kind):
    layer, measurement = kind(camera(*SIZES[0])), torch.rand(1, 3, *SIZES[0][0])
    plain = layer(measurement)
    with torch.autocast("cpu", torch.bfloat16):
        mixed = layer(measurement)
        rounded = layer(measurement.bfloat16())
    assert mixed.dtype == rounded.dtype == torch.float32
    assert torch.equal(mixed, plain)


def test_strength_means_the_same_for_every_scale_of_the_psf(camera):
    capture = camera(*SIZES[0])
    brighter = replace(capture, stack=replace(capture.stack, values=np.asarray(capture.stack.values) * 1e-12))
    brighter = replace(brighter, gain=capture.gain * 1e12)
    measurement = torch.rand(1, 3, *SIZES[0][0])
    once, again = (RegularisedInversion(model)(measurement).detach() for model in (capture, brighter))
    assert float((once - again).abs().max() / once.abs().max()) < 1e-5  # rounding of float32


def test_a_filter_without_any_response_divides_by_something(camera):
    capture = camera(*SIZES[3])
    layer = RegularisedInversion(capture)
    with torch.no_grad():
        layer.filters.zero_()
    layer(torch.rand(1, 3, *SIZES[3][0])).sum().backward()
    assert layer.filters.grad is not None
    assert bool(torch.isfinite(layer.filters.grad).all())


@pytest.mark.parametrize("kind", [RegularisedInversion, WienerInversion])
def test_refuses_an_image_that_sends_no_light_from_everywhere(camera, kind):
    """A stop that hides a corner of it; what it hides of the field around the image does not matter."""
    capture = camera(*SIZES[0])
    irradiance = np.pad(capture.irradiance, 2)
    kind(replace(capture, irradiance=irradiance))
    irradiance[2, 2] = 0
    with pytest.raises(InputError, match=r"^irradiance: "):
        kind(replace(capture, irradiance=irradiance))


@pytest.mark.parametrize("shape", [(1, 3, 24, 25), (1, 2, 24, 24), (3, 24, 24), (1, 2, 3, 24, 24)])
def test_refuses_measurements_of_another_camera(camera, shape):
    with pytest.raises(InputError, match=r"^measurement: "):
        RegularisedInversion(camera(*SIZES[0]))(torch.rand(shape))
    with pytest.raises(InputError, match=r"^measurement: "):
        WienerInversion(camera(*SIZES[0]))(torch.rand(2, 4, 3, 24, 26))


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_refuses_what_is_not_positive(camera, value):
    pairs = [(RegularisedInversion, name) for name in ("regularisation_lambda", "noise_weight")]
    for kind, name in (*pairs, (WienerInversion, "noise_to_signal")):
        with pytest.raises(InputError, match=rf"^{name}: "):
            kind(camera(*SIZES[0]), **{name: value})
    if value:
        with pytest.raises(InputError, match=r"^tikhonov: "):
            RegularisedInversion(camera(*SIZES[0]), tikhonov=value)
    with pytest.raises(InputError, match=r"^plane: "):
        WienerInversion(camera(*SIZES[0]), plane=3)


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
def test_gradients_of_wiener_by_finite_differences(camera):
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
