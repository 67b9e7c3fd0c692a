"""The loop of fits: what it keeps, when it ends, and that an interrupted one goes on as if nothing had been."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.classical.fitting import FilmFitting, FilmNetwork, Fit, drawn_from
from learning.classical.neural_space_time import NeuralSpaceTime
from learning.layers.space_time import ClipProblem
from learning.method import torch_threads
from simulator.camera.shutter import DualRollingShutter
from simulator.errors import InputError


class Pixels(FilmNetwork):
    """A number for each pixel, its root mean square scaled by noise that is drawn anew each time, and a falling rate."""

    def __init__(self, problem: ClipProblem, unit: Tensor, generator: torch.Generator) -> None:
        super().__init__()
        with drawn_from(generator):
            self.values = nn.Parameter(torch.rand(problem.dark(1).shape))
        self.unit, self.generator = unit, generator

    def forward(self, share: float) -> Tensor:
        noise = torch.randn(self.values.shape, generator=self.generator).to(self.values)
        return self.unit * nn.functional.softplus(self.values + 0.1 * noise)

    def optimiser(self) -> torch.optim.Optimizer:
        return torch.optim.Adam([{"params": [self.values], "lr": 0.1}])

    def rate(self, share: float) -> float:
        return 1 - share


class PixelFitting(FilmFitting):
    def network(self, unit: Tensor, generator: torch.Generator) -> FilmNetwork:
        return Pixels(self.problem, unit, generator)


class Listed(FilmNetwork):
    """The true light times one more than what a list says, iteration after iteration; its only weight does nothing."""

    def __init__(self, light: Tensor, errors: list[float]) -> None:
        super().__init__()
        self.light, self.errors, self.nothing = light, errors, nn.Parameter(torch.zeros(()))

    def forward(self, share: float) -> Tensor:
        return self.light * (1 + self.errors[round(share * len(self.errors))]) + 0 * self.nothing

    def optimiser(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.parameters(), lr=1.0)


class ListedFitting(FilmFitting):
    light: Tensor
    errors: list[float]

    def network(self, unit: Tensor, generator: torch.Generator) -> FilmNetwork:
        return Listed(self.light, self.errors)


def light_of(problem: ClipProblem) -> Tensor:
    """Return light in which every number is another one."""
    return torch.from_numpy(np.random.default_rng(0).uniform(0.1, 0.9, problem.dark(1).shape)).to(problem.scale)


def measure(problem: ClipProblem, light: Tensor) -> Tensor:
    """Return the measurement ``(1, C, H, W)`` without noise."""
    return problem(light) / problem.scale + problem.offset


@pytest.fixture
def fitting(clip_capture: CaptureModel) -> PixelFitting:
    return PixelFitting(clip_capture, iterations=12, seed=5)


@pytest.fixture
def measurement(fitting: PixelFitting) -> Tensor:
    return measure(fitting.problem, light_of(fitting.problem))


class StoppedError(Exception):
    """Somebody pulls the plug."""


def stop_after(step: int) -> Any:
    def progress(done: int, total: int) -> None:
        if done == step:
            raise StoppedError

    return progress


def same(one: Fit, other: Fit) -> None:
    """See that two fits are the same bit for bit, but for their seconds."""
    assert torch.equal(one.film, other.film)
    assert (one.curve, one.residual, one.step) == (other.curve, other.residual, other.step)
    assert one.snapshots.keys() == other.snapshots.keys()
    for step, snapshot in one.snapshots.items():
        assert torch.equal(snapshot.film, other.snapshots[step].film)
        assert snapshot.residual == other.snapshots[step].residual


@pytest.mark.parametrize("stop", [6, 7])
def test_an_interrupted_fit_goes_on_bit_for_bit(
    fitting: PixelFitting, measurement: Tensor, tmp_path: Path, stop: int
) -> None:
    """Written after the sixth iteration: what was done since is done again, with the same noise and the same rates."""
    file, options = tmp_path / "state.pt", {"snapshots": (3, 12), "save_every": 6}
    with torch_threads(1):
        whole = fitting.fit(measurement, **options)
        with pytest.raises(StoppedError):
            fitting.fit(measurement, state=file, progress=stop_after(stop), **options)
        done: list[tuple[int, int]] = []
        rest = fitting.fit(measurement, state=file, progress=lambda *each: done.append(each), **options)
    same(whole, rest)
    assert done == [(step, 12) for step in range(7, 13)]
    # A finished one is only read.
    same(whole, fitting.fit(measurement, state=file, progress=stop_after(0), **options))


def test_snapshots_are_what_a_fit_would_have_returned(fitting: PixelFitting, measurement: Tensor) -> None:
    fit = fitting.fit(measurement, snapshots=(1, 8, 12, 99))
    assert list(fit.snapshots) == [1, 8, 12]
    assert torch.equal(fit.snapshots[12].film, fit.film)
    assert fit.snapshots[12].residual == fit.residual
    assert fit.snapshots[1].residual == fit.curve[0]
    assert 0 < fit.snapshots[1].seconds <= fit.snapshots[8].seconds <= fit.snapshots[12].seconds <= fit.seconds
    residual = fitting.problem(fitting.problem.light(fit.film[:, :, None])) - fitting.problem.target(measurement)
    assert float(residual.square().mean().sqrt()) == pytest.approx(fit.residual, rel=1e-4)  # of float32


def test_seconds_are_those_of_all_sessions(
    fitting: PixelFitting, measurement: Tensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that says one more each time it is asked: once before the first iteration, once after each."""
    asked = iter(range(100, 1000))
    monkeypatch.setattr("learning.classical.fitting.time.perf_counter", lambda: float(next(asked)))
    file = tmp_path / "state.pt"
    first = fitting.fit(measurement, seconds=4.0, state=file, snapshots=(3, 6))
    assert (first.step, first.seconds, first.snapshots[3].seconds) == (4, 4.0, 3.0)
    more = fitting.fit(measurement, seconds=7.0, state=file, snapshots=(3, 6))
    assert (more.step, more.seconds, more.snapshots[6].seconds) == (7, 7.0, 6.0)


def test_rates_follow_their_schedule(
    fitting: PixelFitting, measurement: Tensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    rates: list[float] = []
    step = torch.optim.Adam.step

    def recorded(self: torch.optim.Adam, *given: Any) -> Any:
        rates.append(self.param_groups[0]["lr"])
        return step(self, *given)

    monkeypatch.setattr(torch.optim.Adam, "step", recorded)
    fitting.fit(measurement)
    assert rates == pytest.approx([0.1 * (1 - step / 12) for step in range(12)])


def test_time_ends_a_fit_which_later_goes_on(fitting: PixelFitting, measurement: Tensor, tmp_path: Path) -> None:
    file = tmp_path / "state.pt"
    with torch_threads(1):
        short = fitting.fit(measurement, seconds=0.0, state=file)
        assert short.step == 1
        assert short.film.shape == (1, 4, 3, 16, 16)
        assert fitting.fit(measurement, seconds=short.seconds, state=file).step == 1  # those of all sessions count
        same(fitting.fit(measurement, state=file), fitting.fit(measurement))


def test_the_best_is_kept_by_the_mean_residual(clip_capture: CaptureModel) -> None:
    """One lucky iterate among bad ones is not taken for the best; one before a late failure is."""
    lucky = [0.5] * 10 + [0.0] + [0.9] * 5
    failing = [0.5, 0.4, 0.3, 0.2, 0.1, 0.9, 0.9, 0.9]
    for errors, best in ((lucky, 10), (failing, 4)):
        fitting = ListedFitting(clip_capture, iterations=len(errors), seed=0)
        fitting.light, fitting.errors = light_of(fitting.problem), errors
        fit = fitting.fit(measure(fitting.problem, fitting.light))
        wanted = fitting.problem.film(fitting.light * (1 + errors[best]))[:, :, 0]
        torch.testing.assert_close(fit.film, wanted)
        assert fit.residual == fit.curve[best]
    # The mean is of the latest fifty or so: what was bad long ago is forgotten.
    errors = [0.3] * 5 + [0.9] * 60 + [0.2] * 250
    fitting = ListedFitting(clip_capture, iterations=len(errors), seed=0)
    fitting.light, fitting.errors = light_of(fitting.problem), errors
    assert fitting.fit(measure(fitting.problem, fitting.light)).residual == pytest.approx(fitting.curve[-1], rel=1e-6)


def test_the_curve_is_the_residual(clip_capture: CaptureModel) -> None:
    fitting = ListedFitting(clip_capture, iterations=3, seed=0)
    fitting.light, fitting.errors = light_of(fitting.problem), [0.5, 0.25, 0.0]
    fitting(measure(fitting.problem, fitting.light))
    seen = float(fitting.problem(fitting.light).square().mean().sqrt())
    assert fitting.curve == pytest.approx([0.5 * seen, 0.25 * seen, 0.0], abs=1e-5 * seen)


def test_the_unit_is_the_even_light_that_explains_a_capture(clip_capture: CaptureModel) -> None:
    fitting = PixelFitting(clip_capture, iterations=1, seed=0)
    even = torch.tensor([0.2, 0.5, 0.05])[:, None, None] * torch.ones_like(fitting.problem.dark(1))
    unit = fitting._unit(fitting.problem(even))
    torch.testing.assert_close(unit, torch.tensor([0.2, 0.5, 0.05])[:, None, None])
    assert float(fitting._unit(-fitting.problem(even)).min()) > 0


def test_seeds_decide_and_torch_is_left_alone(clip_capture: CaptureModel, measurement: Tensor) -> None:
    before = torch.get_rng_state()
    films = [PixelFitting(clip_capture, iterations=2, seed=seed)(measurement) for seed in (0, 0, 1)]
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(films[0], films[1])
    assert not torch.allclose(films[0], films[2], rtol=1e-3)


def test_each_capture_is_a_fit_of_its_own_without_gradients_around(fitting: PixelFitting, measurement: Tensor) -> None:
    both = torch.cat([measurement, 0.5 * measurement])
    with torch.no_grad():
        films = fitting(both)
    assert films.shape == (2, 4, 3, 16, 16)
    assert not films.requires_grad
    torch.testing.assert_close(films[1], fitting.fit(both[1:]).film[0])


def test_other_states_are_refused(clip_capture: CaptureModel, measurement: Tensor, tmp_path: Path) -> None:
    file = tmp_path / "state.pt"
    PixelFitting(clip_capture, iterations=2, seed=0).fit(measurement, state=file)
    assert clip_capture.timing is not None
    later = replace(clip_capture.timing, shutter=DualRollingShutter(4e-3, 0.4e-3))
    for other, seen in (
        (PixelFitting(clip_capture, iterations=2, seed=1), measurement),
        (PixelFitting(clip_capture, iterations=3, seed=0), measurement),
        (PixelFitting(clip_capture, iterations=2, seed=0), measurement + 1e-3),
        (PixelFitting(replace(clip_capture, white=1.8), iterations=2, seed=0), measurement),
        (PixelFitting(replace(clip_capture, timing=later), iterations=2, seed=0), measurement),
    ):
        with pytest.raises(InputError, match=r"state\.pt: holds another fit"):
            other.fit(seen, state=file)
    for damaged in (file.read_bytes()[:200], b""):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=r"state\.pt: cannot be read"):
            PixelFitting(clip_capture, iterations=2, seed=0).fit(measurement, state=file)


@pytest.mark.parametrize(
    "given", [torch.zeros(2, 3, 48, 48), torch.full((1, 3, 48, 48), math.nan), torch.zeros(1, 3, 4, 4)]
)
def test_what_cannot_be_fitted_is_refused(fitting: PixelFitting, given: Tensor) -> None:
    with pytest.raises(InputError, match=r"^measurement: "):
        fitting.fit(given)


def test_a_rate_that_leads_to_infinity_is_named(clip_capture: CaptureModel, measurement: Tensor) -> None:
    with pytest.raises(InputError, match=r"^scene_rate, motion_rate, .*: got 1e\+30, 0\.001, .* after \d+ iterations"):
        NeuralSpaceTime(clip_capture, iterations=20, width=8, scene_rate=1e30).fit(measurement)


def test_counts_below_one_are_refused(clip_capture: CaptureModel, measurement: Tensor) -> None:
    with pytest.raises(InputError, match=r"^iterations: "):
        PixelFitting(clip_capture, iterations=0, seed=0)
    for seed in (-1, 2**63):
        with pytest.raises(InputError, match=r"^seed: "):
            PixelFitting(clip_capture, iterations=1, seed=seed)
    with pytest.raises(InputError, match=r"^save_every: "):
        PixelFitting(clip_capture, iterations=2, seed=0).fit(measurement, save_every=0)
