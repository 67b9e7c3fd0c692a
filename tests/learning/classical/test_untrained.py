"""The untrained network: what its fits explain, what they follow from, and what they leave alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.classical.untrained import SkipNetwork, UntrainedNetwork
from learning.layers.space_time import ClipProblem
from learning.method import torch_threads
from simulator.errors import InputError

SMALL: dict[str, Any] = {"filters": 32, "learning_rate": 1e-2}
NOISE = 0.03  # over the greatest value


@pytest.fixture(scope="module")
def capture(clip_capture: CaptureModel) -> CaptureModel:
    """The tiny camera of clips with points that reach the whole sensor, and light from one pixel around the image."""
    values, rng = np.zeros((1, 3, 81, 81), np.float32), np.random.default_rng(5)
    values[:, :, rng.integers(0, 81, 90), rng.integers(0, 81, 90)] = 1
    capture = clip_capture.with_stack(replace(clip_capture.stack, values=values))
    return replace(capture, irradiance=np.pad(capture.irradiance, 1, mode="edge"))


@pytest.fixture(scope="module")
def film() -> Tensor:
    """Return ``(1, 4, 1, 3, 16, 16)``: a coloured square that moves two pixels per frame before a dim wall."""
    made = torch.full((1, 4, 1, 3, 16, 16), 0.1)
    for frame in range(4):
        made[0, frame, 0, :, 5:10, 2 * frame + 2 : 2 * frame + 7] = torch.tensor([0.9, 0.5, 0.7])[:, None, None]
    return made


@pytest.fixture
def given(capture: CaptureModel, film: Tensor, measured: Callable[..., Tensor]) -> Tensor:
    """Return the measurement ``(1, C, H, W)`` of the film."""
    problem = ClipProblem(capture)
    return measured(problem, problem.light(film), NOISE)


@pytest.mark.slow
def test_explains_a_capture_down_to_its_noise_and_finds_the_film(
    capture: CaptureModel, film: Tensor, given: Tensor
) -> None:
    method = UntrainedNetwork(capture, iterations=600, **SMALL)
    with torch_threads(1):
        fit = method.fit(given)
    problem = method.problem
    clean = problem(problem.light(film)) / problem.scale
    noise = float((NOISE * clean.max() * problem.scale).square().mean().sqrt())
    # Four seeds gave 0.90 to 0.95 of the noise, and 0.16 to 0.22 of the error; rounding leads elsewhere, as seeds do.
    assert fit.residual < noise < 0.5 * fit.curve[0]
    assert fit.film.shape == (1, 4, 3, 16, 16)
    assert float(fit.film.min()) >= 0
    wanted = film[:, :, 0]
    still = wanted.mean(dim=1, keepdim=True).expand_as(wanted)
    errors = [float((each - wanted).square().mean().sqrt()) for each in (fit.film, still)]
    assert errors[0] < 0.3 * errors[1]  # no picture that stands still is nearer


def test_an_interrupted_fit_goes_on_bit_for_bit(capture: CaptureModel, given: Tensor, tmp_path: Path) -> None:
    """With the network's own drawing of noise; torch's generator is left alone, and seeds decide."""
    method = UntrainedNetwork(capture, iterations=6, **SMALL)

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    before = torch.get_rng_state()
    with torch_threads(1):
        whole = method.fit(given)
        with pytest.raises(KeyboardInterrupt):
            method.fit(given, state=tmp_path / "state.pt", save_every=3, progress=stop)
        rest = method.fit(given, state=tmp_path / "state.pt")
        other = UntrainedNetwork(capture, iterations=6, seed=1, **SMALL).fit(given)
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(whole.film, rest.film)
    assert whole.curve == rest.curve
    assert not torch.allclose(other.film, whole.film, rtol=1e-3)


@pytest.mark.usefixtures("double")
def test_a_capture_twice_as_bright_is_a_film_twice_as_bright(capture: CaptureModel, given: Tensor) -> None:
    """Adam does not see the unit of the misfit; in float64, as it makes more of rounding from step to step."""
    method = UntrainedNetwork(capture, iterations=5, **SMALL)
    offset = method.problem.offset
    once, twice = (method.fit(offset + gain * (given - offset)).film for gain in (1.0, 2.0))
    torch.testing.assert_close(twice, 2 * once, rtol=1e-6, atol=0)


def test_noise_on_the_input_and_total_variation_have_their_effect(capture: CaptureModel, given: Tensor) -> None:
    settings: dict[str, Any] = {"iterations": 20, **SMALL}
    plain, flat = (UntrainedNetwork(capture, tv=tv, **settings).fit(given).film for tv in (0.0, 1.0))
    assert float(torch.diff(flat, dim=-1).abs().mean()) < 0.5 * float(torch.diff(plain, dim=-1).abs().mean())
    usual = UntrainedNetwork(capture, **settings).fit(given).film
    torch.testing.assert_close(usual, plain, rtol=1e-3, atol=1e-5)  # 1e-20 is too little to matter
    steady = UntrainedNetwork(capture, input_noise=0.0, **settings).fit(given).film
    assert not torch.allclose(steady, plain, rtol=1e-3)


def test_the_constants_are_those_of_the_notebook(capture: CaptureModel) -> None:
    """A fixed input from 0 to 0.1, noise of 0.05, Adam at 1e-3, total variation of 1e-20."""
    unit = torch.ones(3, 1, 1)
    network = UntrainedNetwork(capture, iterations=1, filters=8).network(unit, torch.Generator().manual_seed(0))
    given: list[Tensor] = []
    network.body.register_forward_pre_hook(lambda _, inputs: given.append(inputs[0]))  # pyright: ignore[reportAttributeAccessIssue]
    for _ in range(20):
        network(0.0)
    drawn = torch.stack(given).numpy()
    fixed = drawn.mean(axis=0)  # but for noise of 0.05 / sqrt(20)
    assert fixed.mean() == pytest.approx(0.05, abs=2e-3)
    assert np.sqrt(fixed.var() - 0.05**2 / 20) == pytest.approx(0.1 / np.sqrt(12), rel=0.05)
    assert drawn.std(axis=0, ddof=1).mean() == pytest.approx(0.05, rel=0.03)
    (group,) = network.optimiser().param_groups
    assert group["lr"] == 1e-3
    light = torch.rand(4, 1, 1, 3, 18, 18)
    squares = sum(float(np.square(np.diff(light.numpy().astype(np.float64), axis=axis)).sum()) for axis in (-2, -1))
    assert float(network.penalty(light)) == pytest.approx(1e-20 * squares, rel=1e-4)


def test_the_network_is_that_of_the_notebook() -> None:
    """The weights of each level, counted by hand, and any size of image."""
    network = SkipNetwork((10, 1, 3), filters=128, levels=5)
    norm = 2 * 128

    def conv(inputs: int, outputs: int, side: int) -> int:
        return inputs * outputs * side**2 + outputs

    for source, skips, down, up in zip((10, *[128] * 4), network.skips, network.down, network.up, strict=True):
        assert sum(each.numel() for each in skips.parameters()) == conv(source, 4, 1) + 2 * 4
        wanted = conv(source, 128, 3) + norm + conv(128, 128, 3) + norm
        assert sum(each.numel() for each in down.parameters()) == wanted
        wanted = 2 * 132 + conv(132, 128, 3) + norm + conv(128, 128, 1) + norm
        assert sum(each.numel() for each in up.parameters()) == wanted
    steps = [each for each in network.modules() if isinstance(each, torch.nn.Conv2d) and each.kernel_size == (3, 3)]
    assert {each.padding_mode for each in steps} == {"reflect"}
    assert [each[0][0].stride for each in network.down] == [(2, 2)] * 5
    assert [each[1][0].stride for each in network.down] == [(1, 1)] * 5
    slopes = {each.negative_slope for each in network.modules() if isinstance(each, torch.nn.LeakyReLU)}
    assert slopes == {0.2}
    assert network.inputs == 10
    assert network(torch.rand(1, 10, 72, 41)).shape == (1, 30, 72, 41)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"learning_rate": 0.0}, "^learning_rate: "),
        ({"input_noise": -0.1}, "^input_noise: "),
        ({"tv": float("nan")}, "^tv: "),
        ({"filters": 0}, "^filters: "),
        ({"levels": 0}, "^levels: "),
        ({"iterations": 0}, "^iterations: "),
    ],
)
def test_bad_settings_are_refused(capture: CaptureModel, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        UntrainedNetwork(capture, **{"iterations": 3} | settings)
