"""Neural space-time model: one still scene and a motion that carries it through the frames, both small networks.

Cao et al., Neural Space-Time Model for Dynamic Multi-Shot Imaging, Nature Methods 21 (2024): frame n at a place p is
scene(p + motion(p, t_n)). What shone once is seen again wherever motion takes it, so each frame learns from the rows that saw
any other; but what appears, is covered or changes its brightness has no place in the model. Networks of coordinates with the
hash grids of Mueller et al., Instant Neural Graphics Primitives, ACM Trans. Graph. 41 (2022), sections 3 and 4. Numbers are
those of the authors' code (`diffcam_tennis` in rmcao/nstm: this kind of camera, 270 x 320 pixels), sizes taken per pixel,
with three exceptions: the learning rates; the motion's finest grid has a cell for each frame, theirs 12 for some 280 moments;
and light is a softplus, theirs an ELU with a small penalty on what is below zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.classical.fitting import FilmFitting, FilmNetwork, drawn_from
from simulator.errors import InputError

_LEVELS, _FEATURES = 8, 2
_SCENE_BASE, _MOTION_BASE = 4, 1  # cells of the coarsest grids
_MOTION_WIDTH = 32
_MOMENTS: dict[str, Any] = {"betas": (0.9, 0.99), "eps": 1e-15}  # of Adam
_DECAY = 0.1  # of learning rates, over the whole fit
_PRIMES = (1, 2654435761, 805459861)  # Mueller et al., equation 4


class NeuralSpaceTime(FilmFitting):
    """Films by a scene and its motion; see `FilmFitting` for what a fit gives besides."""

    def __init__(
        self,
        capture: CaptureModel,
        *,
        iterations: int,
        seed: int = 0,
        scene_rate: float = 1e-2,
        motion_rate: float = 1e-3,
        scene_cells: float = 0.6,
        motion_cells: float = 0.1,
        motion_cells_over_time: float = 1.0,
        coarse: float = 0.8,
        width: int = 128,
    ) -> None:
        """Prepare the fit.

        Args:
            capture: the camera.
            iterations: of each capture; each sees the whole of it. The authors' code takes 20 of some 280 moments per
                iteration, and about 56 000 iterations.
            seed: of the weights.
            scene_rate: first learning rate of the scene; it falls to a tenth, exponentially. The authors' 1e-3 suits their
                many more iterations; the default is what validation clips liked.
            motion_rate: of the motion; the authors' is 1e-5.
            scene_cells: of the scene's finest grid per pixel, along rows and columns.
            motion_cells: of the motion's finest grid.
            motion_cells_over_time: of the motion's finest grid per frame.
            coarse: share of the iterations after which the finest level of both grids counts in full: coarse to fine, as in
                Park et al., Nerfies, ICCV 2021, equation 8.
            width: of the scene's two hidden layers.

        Raises:
            InputError: numbers that are not positive.
        """
        numbers = {"scene_rate": scene_rate, "motion_rate": motion_rate, "scene_cells": scene_cells}
        numbers |= {"motion_cells": motion_cells, "motion_cells_over_time": motion_cells_over_time, "coarse": coarse}
        super().__init__(capture, iterations=iterations, seed=seed, width=width, **numbers)
        for name, value in (*numbers.items(), ("width", width)):
            if not (math.isfinite(value) and value > 0):
                raise InputError(name, f"got {value!r}, expected a positive number")

    def network(self, unit: Tensor, generator: torch.Generator) -> FilmNetwork:
        """Return scene and motion as they begin: evenly bright, at rest; see `FilmFitting.network`."""
        return SpaceTimeNetwork(self.problem.shape, unit, generator, self.told)


class SpaceTimeNetwork(FilmNetwork):
    """The light of a scene that moves."""

    unit: Tensor
    places: Tensor
    moments: Tensor

    def __init__(self, shape: tuple[int, ...], unit: Tensor, generator: torch.Generator, told: dict[str, Any]) -> None:
        """Draw the weights; the settings are those of `NeuralSpaceTime`."""
        super().__init__()
        frames, planes, channels, rows, columns = shape
        self._shape, self._told = shape, told
        finest = [max(told["scene_cells"] * side, _SCENE_BASE) for side in (rows, columns)]
        self.scene_grid = HashGrid([_SCENE_BASE] * 2, finest, generator=generator)
        cells = [told["motion_cells"] * rows, told["motion_cells"] * columns, told["motion_cells_over_time"] * frames]
        self.motion_grid = HashGrid(
            [_MOTION_BASE] * 3, [max(each, _MOTION_BASE) for each in cells], generator=generator
        )
        with drawn_from(generator):
            self.scene = _perceptron(told["width"], planes * channels, nn.GELU(approximate="tanh"))
            self.motion = _perceptron(_MOTION_WIDTH, 2, nn.ELU())
        times, *places = ((torch.arange(size) + 0.5) / size for size in (frames, rows, columns))
        moments = torch.stack(torch.meshgrid(times, *places, indexing="ij"), dim=-1).flatten(0, 2).roll(-1, dims=-1)
        for name, values in (("unit", unit / math.log(2)), ("moments", moments)):
            self.register_buffer(name, values, persistent=False)

    def forward(self, share: float) -> Tensor:
        """Return light ``(N, K, 1, C, rows, columns)``."""
        frames, planes, channels, rows, columns = self._shape
        seen = self.moments[:, :2] + self.displacement(share)
        found = self.scene(self.scene_grid(seen, self._window(share)))
        found = found.reshape(frames, rows, columns, planes, channels)
        return nnf.softplus(found).permute(0, 3, 4, 1, 2)[:, :, None] * self.unit

    def displacement(self, share: float = 1.0) -> Tensor:
        """Return where each pixel of each frame looks in the scene, from its own place: ``(N rows columns, 2)``.

        Rows and columns in units of the field's; beyond it, the scene goes on as it is at the edge.
        """
        return self.motion(self.motion_grid(self.moments, self._window(share)))

    def _window(self, share: float) -> Tensor:
        level = torch.arange(_LEVELS, device=self.moments.device, dtype=self.moments.dtype)
        return (1 - torch.cos(math.pi * (share / self._told["coarse"] * _LEVELS - level).clamp(0, 1))) / 2

    def optimiser(self) -> torch.optim.Optimizer:
        """Return Adam with a rate for the scene and one for the motion."""
        groups = [
            {"params": [*self.scene_grid.parameters(), *self.scene.parameters()], "lr": self._told["scene_rate"]},
            {"params": [*self.motion_grid.parameters(), *self.motion.parameters()], "lr": self._told["motion_rate"]},
        ]
        return torch.optim.Adam(groups, **_MOMENTS)

    def rate(self, share: float) -> float:
        """Return the learning rates over the first ones."""
        return _DECAY**share


class HashGrid(nn.Module):
    """Features of places by linear interpolation between the nodes of grids from coarse to fine.

    A grid with more nodes than its table has rows shares rows among them (equation 4): what collides is left to the network
    behind. Grids of small scenes fit, and have a row for each node.
    """

    def __init__(
        self, base: Sequence[float], finest: Sequence[float], *, generator: torch.Generator, most: int = 2**16
    ) -> None:
        """Draw the features, evenly from -1e-4 to 1e-4.

        Args:
            base: cells of the coarsest grid along each of two or three axes.
            finest: of the finest one; in between, geometrically (equations 2 and 3).
            generator: on the CPU.
            most: rows of a table.
        """
        super().__init__()
        self.cells: list[tuple[int, ...]] = []
        self._rows: list[int] = []
        for level in range(_LEVELS):
            share = level / (_LEVELS - 1)
            own = (int(one * (other / one) ** share + 1e-9) for one, other in zip(base, finest, strict=True))
            self.cells.append(tuple(max(each, 1) for each in own))
            self._rows.append(min(math.prod(each + 1 for each in self.cells[-1]), most))
        drawn = torch.rand(_FEATURES, sum(self._rows), generator=generator)
        self.table = nn.Parameter(1e-4 * (2 * drawn - 1))

    def forward(self, places: Tensor, window: Tensor) -> Tensor:
        """Return features ``(P, levels features)`` of places ``(P, D)``; the window weighs the levels.

        Each axis goes from 0 to 1, and on beyond as it is there.
        """
        tables = self.table.split(self._rows, dim=1)
        levels = zip(self.cells, tables, window, strict=True)
        return torch.cat([strength * _interpolated(table, cells, places) for cells, table, strength in levels]).mT


def _interpolated(table: Tensor, cells: tuple[int, ...], places: Tensor) -> Tensor:
    """Return features ``(F, P)`` of one level's table ``(F, rows)``."""
    nodes = [many + 1 for many in cells]
    if math.prod(nodes) > table.shape[1]:
        return _hashed(table, cells, places)
    grid = (2 * places - 1).flip(-1).reshape(1, *(1,) * (len(cells) - 1), *places.shape)
    image = table.unflatten(1, nodes)[None]
    return nnf.grid_sample(image, grid, padding_mode="border", align_corners=True)[0].flatten(1)


def _hashed(table: Tensor, cells: tuple[int, ...], places: Tensor) -> Tensor:
    """Return the same where nodes share rows."""
    row = torch.zeros((len(places), 1), dtype=torch.long, device=places.device)
    weight = torch.ones_like(places[:, :1])
    for axis, many in enumerate(cells):
        place = places[:, axis : axis + 1].clamp(0, 1) * many
        low = place.detach().floor().clamp_max(many - 1)
        upper = place - low
        node = torch.cat([low, low + 1], dim=1).long() * _PRIMES[axis]
        row = (row[:, :, None] ^ node[:, None]).flatten(1)
        weight = (weight[:, :, None] * torch.cat([1 - upper, upper], dim=1)[:, None]).flatten(1)
    chosen = table.index_select(1, (row % table.shape[1]).flatten()).unflatten(1, row.shape)
    return (chosen * weight).sum(dim=-1)


def _perceptron(width: int, outputs: int, activation: nn.Module) -> nn.Sequential:
    """Return two hidden layers on a grid's features, with weights by Xavier's rule (Glorot and Bengio 2010), biases 0."""
    linear = [nn.Linear(*sizes) for sizes in pairwise((_LEVELS * _FEATURES, width, width, outputs))]
    for layer in linear:
        nn.init.xavier_uniform_(layer.weight)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(linear[0], activation, linear[1], activation, linear[2])
