"""The neural space-time model: its grids against interpolation by hand, and that it follows what moves."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.classical.neural_space_time import HashGrid, NeuralSpaceTime, SpaceTimeNetwork
from learning.method import torch_threads
from simulator.errors import InputError

SHAPES: list[tuple[list[float], list[float]]] = [([2, 3], [9, 7]), ([1, 1, 1], [4, 5, 6])]
ALL = torch.ones(8, dtype=torch.float64)
PRIMES = (1, 2654435761, 805459861)  # of Mueller et al.


def grid(base: list[float], finest: list[float], **options: int) -> HashGrid:
    """Return a grid in float64 with features that are all different."""
    made = HashGrid(base, finest, generator=torch.Generator().manual_seed(0), **options).double()
    made.table.data = torch.from_numpy(np.random.default_rng(0).normal(size=made.table.shape))
    return made


def places(axes: int) -> Tensor:
    return torch.from_numpy(np.random.default_rng(1).uniform(size=(40, axes)))


@pytest.mark.parametrize(("base", "finest"), SHAPES)
def test_cells_grow_geometrically(base: list[float], finest: list[float]) -> None:
    made = grid(base, finest)
    assert made.cells[0] == tuple(base)
    assert made.cells[-1] == tuple(finest)
    middle = [int(a * (b / a) ** (3 / 7)) for a, b in zip(base, finest, strict=True)]
    assert made.cells[3] == tuple(middle)


@pytest.mark.parametrize(("base", "finest"), SHAPES)
def test_what_is_linear_over_the_nodes_is_linear_between_them(base: list[float], finest: list[float]) -> None:
    """Nodes hold the values of a product of linear functions of each axis, as multilinear interpolation gives it anywhere."""
    made = grid(base, finest)
    slopes = np.random.default_rng(2).uniform(0.5, 2, (2, len(base)))

    def value(position: np.ndarray) -> np.ndarray:
        return np.stack([np.prod(1 + slope * position, axis=-1) for slope in slopes])

    nodes = [np.stack(np.meshgrid(*(np.linspace(0, 1, n + 1) for n in c), indexing="ij"), -1) for c in made.cells]
    made.table.data = torch.from_numpy(np.concatenate([value(each).reshape(2, -1) for each in nodes], axis=1))
    at = places(len(base))
    wanted = np.tile(value(at.numpy()).T, 8)
    np.testing.assert_allclose(made(at, ALL).detach().numpy(), wanted, rtol=1e-12)
    # Beyond the box it is as at its edge.
    beyond = at.clone()
    beyond[:, 0] = 1.7
    at[:, 0] = 1.0
    np.testing.assert_allclose(made(beyond, ALL).detach().numpy(), made(at, ALL).detach().numpy(), rtol=1e-12)


@pytest.mark.parametrize(("base", "finest"), SHAPES)
def test_shared_rows_are_those_of_equation_4(base: list[float], finest: list[float]) -> None:
    """Corner by corner in loops, for the finest level, which has more nodes than rows."""
    made = grid(base, finest, most=16)
    cells, table = made.cells[-1], made.table.detach().numpy()[:, -16:]
    assert np.prod(np.array(cells) + 1) > 16
    at = places(len(base))
    at[:3] = torch.tensor([[1.0], [1.4], [-0.3]])  # the last node; beyond both ends
    wanted = np.zeros((len(at), 2))
    for number, place in enumerate(at.clamp(0, 1).numpy()):
        scaled = place * cells
        low = np.minimum(np.floor(scaled), np.array(cells) - 1).astype(int)
        for corner in product((0, 1), repeat=len(cells)):
            node, part = low + corner, scaled - low
            row = int(np.bitwise_xor.reduce([int(n) * p for n, p in zip(node, PRIMES, strict=False)])) % 16
            weight = np.prod([p if upper else 1 - p for upper, p in zip(corner, part, strict=True)])
            wanted[number] += weight * table[:, row]
    np.testing.assert_allclose(made(at, ALL)[:, -2:].detach().numpy(), wanted, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("most", [16, 2**16])
@pytest.mark.parametrize(("base", "finest"), SHAPES)
def test_gradients_match_finite_differences(base: list[float], finest: list[float], most: int) -> None:
    made = grid(base, finest, most=most)
    at = places(len(base))[:3].requires_grad_()

    def features(position: Tensor, table: Tensor) -> Tensor:
        return torch.func.functional_call(made, {"table": table}, (position, torch.linspace(1, 0.3, 8).double()))

    assert torch.autograd.gradcheck(features, (at, made.table.detach().clone().requires_grad_()))


def test_the_window_weighs_the_levels() -> None:
    made, at = grid([2, 3], [9, 7]), places(2)
    window = torch.linspace(0, 1, 8, dtype=torch.float64)
    torch.testing.assert_close(made(at, window), made(at, ALL) * window.repeat_interleave(2), rtol=1e-12, atol=0)


@pytest.fixture
def camera(dotted_camera: Callable[..., CaptureModel]) -> Callable[..., CaptureModel]:
    """Make a camera of 16 x 16 pixels, by frames and channels."""
    return lambda frames=5, channels=1: dotted_camera((48, 44), (16, 16), 61, frames, dots=60, channels=channels)


def blob(capture: CaptureModel, speed: float) -> Tensor:
    """Return the film ``(1, N, 1, C, h, w)`` of a spot that crosses a dim scene at so many pixels per frame."""
    rows, columns = np.mgrid[:16, :16]
    frames = range(capture.frames)
    film = [0.02 + np.exp(-((rows - 8) ** 2 + (columns - 4 - speed * n) ** 2) / (2 * 1.5**2)) for n in frames]
    return torch.from_numpy(np.stack(film))[None, :, None, None].float().repeat(1, 1, 1, len(capture.offset), 1, 1)


FAST: dict[str, Any] = {"scene_rate": 1e-2, "motion_rate": 1e-3, "width": 32}


@pytest.mark.parametrize(
    ("iterations", "share"),  # 1.01 to 1.02 and 0.97 with three seeds
    [(250, 1.05), pytest.param(600, 1.0, marks=pytest.mark.slow)],
)
def test_follows_a_spot_that_moves(
    camera: Callable[..., CaptureModel], measured: Callable[..., Tensor], iterations: int, share: float
) -> None:
    """Within a fifth of a pixel, which is a tenth of a frame's step; and the misfit falls to the noise, then below it."""
    capture = camera()
    film = blob(capture, 2.0)
    method = NeuralSpaceTime(capture, iterations=iterations, **FAST)
    with torch_threads(1):
        fit = method.fit(measured(method.problem, method.problem.light(film), 0.03))
    found = fit.film[0, :, 0].numpy()
    noise = 0.03 * float(method.problem(method.problem.light(film)).max())
    assert fit.residual < share * noise < 0.3 * fit.curve[0]
    weights = np.maximum(found - 0.3 * found.max(axis=(1, 2), keepdims=True), 0)
    rows, columns = ((weights * at).sum(axis=(1, 2)) / weights.sum(axis=(1, 2)) for at in np.mgrid[:16, :16])
    np.testing.assert_allclose(columns, 4 + 2.0 * np.arange(5), atol=0.2)
    np.testing.assert_allclose(rows, 8, atol=0.2)
    assert found.min() >= 0
    assert float((fit.film - film[:, :, 0]).square().mean().sqrt()) < 0.04


def test_begins_evenly_bright_and_at_rest_and_grows_finer(camera: Callable[..., CaptureModel]) -> None:
    capture = camera(channels=2)
    method = NeuralSpaceTime(capture, iterations=4, coarse=0.5, **FAST)
    unit = torch.tensor([0.3, 0.6])[:, None, None]
    network = method.network(unit, torch.Generator().manual_seed(0))
    assert isinstance(network, SpaceTimeNetwork)
    light = network(0.0)
    assert light.shape == (5, 1, 1, 2, 18, 18)
    torch.testing.assert_close(light, unit.expand_as(light))
    assert float(network.displacement().detach().abs().max()) < 1e-3
    assert network._window(0.0).tolist() == [0.0] * 8
    torch.testing.assert_close(network._window(0.25), torch.tensor([1.0] * 4 + [0.0] * 4))
    torch.testing.assert_close(network._window(0.5), torch.ones(8))
    assert network._window(0.5 * 2.5 / 8)[2].item() == pytest.approx(0.5)
    for one in (network.scene_grid, network.motion_grid):
        one.table.data = torch.from_numpy(np.random.default_rng(5).normal(size=one.table.shape)).float()
    moves = [float(network.displacement(share).detach().abs().max()) for share in (0.0, 0.25, 0.5)]
    assert moves[0] == 0 < moves[1] != moves[2]
    torch.testing.assert_close(network(0.0), light)
    assert [network.rate(share) for share in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 0.1**0.5, 0.1])


def test_an_interrupted_fit_goes_on_bit_for_bit(
    camera: Callable[..., CaptureModel], measured: Callable[..., Tensor], tmp_path: Path
) -> None:
    capture = camera(3)
    method = NeuralSpaceTime(capture, iterations=6, **FAST)
    given = measured(method.problem, method.problem.light(blob(capture, 2.0)))

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    before = torch.get_rng_state()
    with torch_threads(1):
        whole = method.fit(given)
        with pytest.raises(KeyboardInterrupt):
            method.fit(given, state=tmp_path / "state.pt", save_every=3, progress=stop)
        rest = method.fit(given, state=tmp_path / "state.pt")
    assert torch.equal(whole.film, rest.film)
    assert whole.curve == rest.curve
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(method(given), whole.film)
    other = NeuralSpaceTime(capture, iterations=6, seed=1, **FAST).fit(given)
    assert not torch.equal(other.film, whole.film)


@pytest.mark.parametrize(
    "name", ["scene_rate", "motion_rate", "scene_cells", "motion_cells", "motion_cells_over_time", "coarse", "width"]
)
@pytest.mark.parametrize("value", [0, float("nan")])
def test_bad_settings_are_refused(camera: Callable[..., CaptureModel], name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"^{name}: "):
        NeuralSpaceTime(camera(), iterations=3, **{name: value})
