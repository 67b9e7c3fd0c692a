"""A camera as physics of deepinv: the same light, adjoint, norm 1, the sensor's noise; by dense matrices and deepinv."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import torch

from simulator.camera.forward import ForwardModel
from simulator.camera.noise import GaussianNoise, PhysicalNoise
from simulator.camera.sensor import Sensor
from simulator.camera.shutter import RollingShutter
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

deepinv = pytest.importorskip("deepinv")
from learning.deepinv_physics import LenslessPhysics, as_physics  # noqa: E402  (needs deepinv)

CASES = [(1, None), (3, None), (1, 4), (2, 4)]


def _model(planes: int, frames: int | None, channels: int = 3) -> tuple[ForwardModel, Any]:
    """Return a camera of an asymmetric PSF on a sensor that is not square, and the edges of its frames."""
    rng = np.random.default_rng(planes)
    values = rng.random((planes, channels, 5, 7)).astype(np.float32)
    stack = PsfStack(values, np.linspace(0.1, 0.2, planes), 1e-5, ("R", "G", "B")[:channels], "f")
    shutter = None if frames is None else RollingShutter(exposure_s=0.02, line_time_s=0.001)
    edges = None if frames is None else np.linspace(0, 0.03, frames + 1)
    return ForwardModel(stack, (10, 12), (6, 8), shutter), edges


def _sensor(**changes: Any) -> Sensor:
    numbers: dict[str, Any] = {"name": "s", "pixel_pitch_m": 1e-6, "physical_shape": (40, 48), "binning": 4}
    numbers |= {"shape": (10, 12), "full_well_e": 1000.0, "read_noise_e": 6.0, "row_noise_e": 0.0, "prnu": 0.0}
    numbers |= {"dark_current_e_per_s": 500.0, "black_level_dn": 64.0, "bit_depth": 12, "full_scale": 100.0}
    return Sensor(**(numbers | {"noise": PhysicalNoise()} | changes))


def _volume(x: torch.Tensor, physics: LenslessPhysics, planes: int, frames: int | None) -> np.ndarray:
    """Return the volume ``(T, K, C, h, w)`` of one image, by the order that the class describes."""
    parts = x[0].numpy()
    parts = parts[:, None] if frames is None else parts
    parts = parts[:, :, None] if planes == 1 else parts
    return np.ascontiguousarray(np.moveaxis(parts, 0, 2))


@pytest.mark.parametrize(("planes", "frames"), CASES)
def test_it_is_the_forward_model_scaled_to_norm_one(planes: int, frames: int | None) -> None:
    model, edges = _model(planes, frames)
    physics = as_physics(model, edges)
    x = torch.from_numpy(np.random.default_rng(1).random((1, *physics.image_shape), np.float32))
    expected = model.forward(_volume(x, physics, planes, frames), edges)
    # float32 convolutions: rounding of 1e-6 of the largest value
    np.testing.assert_allclose(physics.A(x)[0].numpy() * physics.norm, expected, atol=3e-6 * expected.max())
    count = x.numel()
    columns = physics.A(torch.eye(count).reshape(count, *physics.image_shape)).reshape(count, -1)
    # The power iteration ends at a relative change of 1e-7 per step.
    assert float(torch.linalg.matrix_norm(columns.double(), 2)) == pytest.approx(1, abs=1e-4)
    batch = torch.randn((2, *physics.image_shape))
    assert abs(float(physics.adjointness_test(batch))) < 1e-4  # of sums of some hundred float32 products, each about 1
    # deepinv's own power iteration from a random image comes near from below.
    start = torch.rand((1, *physics.image_shape))
    assert float(physics.compute_sqnorm(start, max_iter=300, tol=1e-7, verbose=False)) == pytest.approx(1, abs=1e-3)


def test_it_has_gradients() -> None:
    """The gradient of half the squared misfit is A^T (A x - y)."""
    physics = as_physics(_model(2, 4)[0], _model(2, 4)[1])
    x = torch.rand((2, *physics.image_shape), requires_grad=True)
    y = torch.rand((2, 3, 10, 12))
    (0.5 * (physics.A(x) - y).square().sum()).backward()
    assert x.grad is not None
    torch.testing.assert_close(x.grad, physics.A_adjoint(physics.A(x.detach()) - y), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_sensors_noise_has_the_sensors_statistics(channels: int) -> None:
    """Means and variances of many draws of both, per channel, at three brightnesses; bins hold other numbers of pixels."""
    model, sensor = _model(1, None, channels)[0], _sensor()
    physics = as_physics(model, sensor=sensor)
    draws, rng = 300, np.random.default_rng(0)
    for share in (0.02, 0.2, 0.7):
        light = np.full((channels, *sensor.shape), share * sensor.full_scale, np.float32)
        ours = torch.from_numpy(np.stack([sensor.expose(light, rng) for _ in range(draws)]).astype(np.float32))
        torch.manual_seed(0)
        theirs = physics.noise_model(torch.from_numpy(light / np.float32(physics.norm)).expand(draws, -1, -1, -1))
        ours = physics.from_digital(ours)
        dims = (0, 2, 3)  # 36 000 numbers each: means right to 0.5 % of the deviation, variances to 0.75 %
        deviation = ours.std(dim=dims)
        assert ((ours.mean(dim=dims) - theirs.mean(dim=dims)).abs() < 0.04 * deviation).all()
        torch.testing.assert_close(theirs.var(dim=dims), ours.var(dim=dims), rtol=0.05, atol=0)


def test_gaussian_noise_is_a_share_of_full_scale() -> None:
    model, sensor = _model(1, None)[0], _sensor(noise=GaussianNoise(psnr_db=40, peak="full_scale"))
    physics = as_physics(model, sensor=sensor)
    clean = torch.zeros((1, 3, 10, 12)).expand(300, -1, -1, -1)
    assert float((physics.noise_model(clean) * physics.unit).std()) == pytest.approx(0.01, rel=0.01)  # 108 000 draws


def test_what_deepinv_cannot_express_is_refused() -> None:
    model = _model(1, None)[0]
    with pytest.raises(InputError, match=r"^psnr_db: "):
        as_physics(model, sensor=_sensor(noise=GaussianNoise(psnr_db=40)))
    with pytest.raises(InputError, match=r"^readout: "):
        as_physics(model, sensor=_sensor(readout="bayer"))
    with pytest.raises(InputError, match=r"^noise_model: "):
        as_physics(model, sensor=_sensor(), noise_model=deepinv.physics.GaussianNoise(0.1))
    with pytest.raises(InputError, match=r"^x: "):
        as_physics(model).A(torch.zeros((1, 3, 8, 6)))


def test_without_deepinv_it_says_what_to_install() -> None:
    code = """if True:
        import sys
        sys.modules["deepinv"] = None
        import learning
        from simulator.errors import InputError
        try:
            import learning.deepinv_physics
        except InputError as error:
            print(error)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.startswith("deepinv: ")
