"""Networks that are fitted to one capture and to nothing else: the loop that all of them share.

A network gives light x; Adam moves its weights until A x looks like the measurement y (`learning.layers.space_time`). Such a
fit takes minutes to hours, so it has a limit of time, films kept on the way, and a file from which it goes on.
"""

from __future__ import annotations

import io
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel, camera_identity
from learning.layers.space_time import ClipProblem
from simulator.errors import InputError
from simulator.io.files import sha256_bytes, storage_errors, write_atomic
from simulator.io.json import canonical_json

_MEMORY = 50  # iterations over which residuals are averaged to tell which iterate is best: input noise makes them jump
_SAVE_EVERY = 100
_FORMAT = "flatlight fit state 1"


class FilmNetwork(nn.Module, ABC):
    """What is fitted: weights that become light."""

    @abstractmethod
    def forward(self, share: float) -> Tensor:
        """Return light ``(N, K, 1, C, rows, columns)`` at the iteration that so large a share of all (0 to 1) precedes."""

    @abstractmethod
    def optimiser(self) -> torch.optim.Optimizer:
        """Return what moves the weights, with its first learning rates."""

    def rate(self, share: float) -> float:
        """Return the learning rates over the first ones."""
        del share
        return 1.0

    def penalty(self, light: Tensor) -> Tensor | float:
        """Return what is added to the mean squared misfit over the mean square of y."""
        del light
        return 0.0


class Snapshot(NamedTuple):
    """What a fit would have returned, had it ended there.

    Attributes:
        film: ``(1, N, C, h, w)`` radiance / white in the camera's channels.
        residual: root mean square of A x - y, where a pixel of white has the root of its PSF's energy; see `ClipProblem`.
        seconds: spent on the fit until then.
    """

    film: Tensor
    residual: float
    seconds: float


@dataclass
class Fit:
    """How far a fit is.

    Attributes:
        film: of the best iterate, like a `Snapshot`'s; empty before the first.
        residual: of the best iterate.
        step: iterations done.
        seconds: spent on them, all sessions together.
        curve: the residual of each iteration.
        snapshots: by the iteration after which they were taken.
        smoothed: mean residual of the last iterations; the best iterate is where it was least.
        least: its least value so far.
    """

    film: Tensor = field(default_factory=lambda: torch.empty(0))
    residual: float = math.inf
    step: int = 0
    seconds: float = 0.0
    curve: list[float] = field(default_factory=list)
    snapshots: dict[int, Snapshot] = field(default_factory=dict)
    smoothed: float = 0.0
    least: float = math.inf

    def improves(self, residual: float) -> bool:
        """Take the next iteration's residual; return whether its iterate is the best so far."""
        self.step += 1
        self.curve.append(residual)
        self.smoothed += (residual - self.smoothed) / min(self.step, _MEMORY)
        if self.smoothed > self.least:
            return False
        self.least, self.residual = self.smoothed, residual
        return True


class FilmFitting(nn.Module, ABC):
    """Films from captures, one at a time, each by a network of its own that begins anew.

    Attributes:
        told: the settings.
        states: folder of the states from which `forward` goes on, a file for each capture; None keeps none.
        seconds: after which `forward` ends a fit; see `fit`.
        progress: called by `forward` with iterations done and in all.
        curve: the residual of each iteration of the last capture; see `Snapshot`.
        state: file of the last capture's state.
    """

    def __init__(self, capture: CaptureModel, *, iterations: int, seed: int, **settings: Any) -> None:
        """Prepare the problem.

        Args:
            capture: the camera.
            iterations: of each capture; schedules run over as many.
            seed: of the first weights and of all that is drawn on the way; 0 is a seed.
            settings: all others that decide the film.

        Raises:
            InputError: no iteration, a seed below 0 or beyond 64 bits, or the camera of stills.
        """
        super().__init__()
        if iterations < 1:
            raise InputError("iterations", f"got {iterations}, expected at least 1")
        if not 0 <= seed < 2**63:
            raise InputError("seed", f"got {seed}, expected a whole number from 0 to 2^63 - 1")
        self.problem = ClipProblem(capture)
        self.iterations, self.seed = iterations, seed
        self.told: dict[str, Any] = {"iterations": iterations, "seed": seed, **settings}
        self.states: Path | None = None
        self.seconds = math.inf
        self.progress: Callable[[int, int], None] | None = None
        self.curve: list[float] = []
        self.state: Path | None = None
        self._camera = camera_identity(capture)

    @abstractmethod
    def network(self, unit: Tensor, generator: torch.Generator) -> FilmNetwork:
        """Return the network as a fit begins with it.

        Args:
            unit: the light of a clip without structure that explains the measurement best, ``(C, 1, 1)``.
            generator: on the CPU, of all that is drawn, now and later: what follows from a seed is alike on every device.
        """

    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, N, C, h, w)`` radiance / white in the camera's channels, of measurements ``(B, C, H, W)``."""
        how: dict[str, Any] = {"seconds": self.seconds, "progress": self.progress, "save_every": _SAVE_EVERY}
        films = []
        for each in measurement.split(1):
            self.state = self._state(each)
            films.append(self.fit(each, state=self.state, **how).film)
        return torch.cat(films)

    def fit(
        self,
        measurement: Tensor,
        *,
        seconds: float = math.inf,
        snapshots: Sequence[int] = (),
        state: Path | None = None,
        save_every: int = 500,
        progress: Callable[[int, int], None] | None = None,
    ) -> Fit:
        """Fit a network to one measurement ``(1, C, H, W)``, DN / 2^bits.

        Args:
            measurement: of this camera.
            seconds: after which no further iteration begins; of all sessions together. One is done in any case.
            snapshots: iterations after which the film is kept.
            state: file from which an interrupted fit goes on, and to which it is written; None keeps none. Its folder must
                exist. On a CPU with as many threads the result is the same bit for bit as that of a fit never interrupted.
            save_every: iterations after which the state is written; it is written at the end, too.
            progress: called after each iteration with how many are done and how many there are.

        Returns:
            The film of the best iterate: that with the least mean residual over the latest iterations.

        Raises:
            InputError: several measurements, one of another camera or with values that are not finite, settings with
                which the misfit does not stay finite, a state that is damaged or of another fit, or ``save_every`` below 1.
            StorageError: the state cannot be written.
        """
        if len(measurement) != 1:
            raise InputError("measurement", f"got {len(measurement)}, expected one: each is a fit of its own")
        if save_every < 1:
            raise InputError("save_every", f"got {save_every}, expected at least 1")
        problem, target = self.problem, self.problem.target(measurement)
        if not target.isfinite().all():
            raise InputError("measurement", "got values that are not finite, expected numbers: restore it from a copy")
        generator = torch.Generator().manual_seed(self.seed)
        with torch.no_grad():
            network = self.network(self._unit(target), generator).to(target)
        optimiser = network.optimiser()
        first = [group["lr"] for group in optimiser.param_groups]
        fit = Fit()
        identity = self._identity(measurement)
        if state is not None and state.exists():
            fit = _load(state, identity, network, optimiser, generator, target)
        # Adam's epsilon is a size of gradients: without a unit of its own, the misfit would count more in a bright capture.
        power = float(target.square().mean()) or 1.0
        before = time.perf_counter() - fit.seconds
        while fit.step < self.iterations and (fit.step == 0 or fit.seconds < seconds):
            share = fit.step / self.iterations
            for group, rate in zip(optimiser.param_groups, first, strict=True):
                group["lr"] = rate * network.rate(share)
            with torch.enable_grad():
                light = network(share)
                misfit = (problem(light) - target).square().mean()
                loss = misfit / power + network.penalty(light)
            if not math.isfinite(float(loss.detach())):  # torch's way back through grids would crash
                told = {name: f"{value:g}" for name, value in self.told.items() if isinstance(value, float)}
                cure = "expected lower rates, and all else nearer to the defaults"
                reason = f"the misfit is not finite after {fit.step} iterations; {cure}"
                raise InputError(", ".join(told), f"got {', '.join(told.values())}: {reason}")
            residual = math.sqrt(float(misfit.detach()))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            if fit.improves(residual):
                fit.film = problem.film(light.detach())[:, :, 0]
            fit.seconds = time.perf_counter() - before
            if fit.step in snapshots:
                fit.snapshots[fit.step] = Snapshot(fit.film, fit.residual, fit.seconds)
            if state is not None and fit.step % save_every == 0:
                _save(state, identity, network, optimiser, generator, fit)
            if progress is not None:
                progress(fit.step, self.iterations)
        if state is not None:
            _save(state, identity, network, optimiser, generator, fit)
        self.curve = fit.curve
        return fit

    def _identity(self, measurement: Tensor) -> dict[str, Any]:
        values = measurement.detach().cpu().contiguous().numpy()
        return {"told": self.told, "camera": self._camera, "measurement": sha256_bytes(values.tobytes())}

    def _state(self, measurement: Tensor) -> Path | None:
        if self.states is None:
            return None
        with storage_errors(self.states):
            self.states.mkdir(parents=True, exist_ok=True)
        name = sha256_bytes(canonical_json([type(self).__name__, self._identity(measurement)]))
        return self.states / f"{name[:32]}.pt"

    def _unit(self, target: Tensor) -> Tensor:
        """Return the light that is the same everywhere and always and explains the measurement best, ``(C, 1, 1)``."""
        seen = self.problem(torch.ones_like(self.problem.dark(1)))
        unit = (seen * target).sum(dim=(0, 2, 3)) / seen.square().sum(dim=(0, 2, 3))
        return unit.clamp_min(1e-6)[:, None, None]  # positive, even of a capture without light


@contextmanager
def drawn_from(generator: torch.Generator) -> Iterator[None]:
    """Let what torch draws on the CPU without being told a generator, such as first weights, come from this one.

    Torch's own generator stays where it is.
    """
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.set_state(generator.get_state())
        yield
        generator.set_state(torch.default_generator.get_state())


def _save(
    path: Path,
    identity: Mapping[str, Any],
    network: FilmNetwork,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    fit: Fit,
) -> None:
    """Write all that a fit needs to go on: one file, replaced as a whole."""
    plain = vars(fit) | {"snapshots": {step: tuple(each) for step, each in fit.snapshots.items()}}
    content = {
        "format": _FORMAT,
        "identity": dict(identity),
        "network": network.state_dict(),
        "optimiser": optimiser.state_dict(),
        "generator": generator.get_state(),
        "fit": plain,
    }
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_atomic(path, buffer.getvalue())


def _load(
    path: Path,
    identity: Mapping[str, Any],
    network: FilmNetwork,
    optimiser: torch.optim.Optimizer,
    generator: torch.Generator,
    like: Tensor,
) -> Fit:
    """Read the state into what was built anew; nothing in the file is run."""
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        if content["format"] != _FORMAT:
            raise InputError(path, f"got {content['format']!r}, expected {_FORMAT!r} of this version of Flatlight")
        if content["identity"] != identity:
            other = ", ".join(key for key, value in identity.items() if content["identity"].get(key) != value)
            raise InputError(path, f"holds another fit ({other} differs); choose another file, or delete it")
        network.load_state_dict(content["network"])
        optimiser.load_state_dict(content["optimiser"])
        generator.set_state(content["generator"])
        fit = Fit(**content["fit"])
        fit.film = fit.film.to(like)
        fit.snapshots = {step: Snapshot(each[0].to(like), *each[1:]) for step, each in fit.snapshots.items()}
    except InputError:
        raise
    except Exception as error:  # torch raises what it likes for a damaged file
        text = ": ".join([type(error).__name__, *str(error)[:200].splitlines()[:1]])
        raise InputError(path, f"cannot be read ({text}); restore it, or delete it to begin again") from error
    return fit
