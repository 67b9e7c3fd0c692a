"""Which samples a training step sees: decided by the seed and the step's number alone, so that training can resume."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import Sampler

from simulator.errors import InputError


class Draw(NamedTuple):
    """A sample and the noise it is seen with.

    Attributes:
        position: of the sample in its split.
        number: of the drawing: another number is another noise.
    """

    position: int
    number: int


class Batches(Sampler[list[Draw]]):
    """Endless batches; give it to a ``DataLoader`` as ``batch_sampler``.

    An epoch is a permutation of all samples, and epochs follow each other without a gap: a batch may hold the end of one and
    the beginning of the next. The epoch's number is the number of the draw. Batch ``n`` depends on ``seed`` and ``n`` alone,
    so a loader that starts at ``first = n`` goes on where another stopped.
    """

    def __init__(self, length: int, batch: int, *, seed: int, first: int = 0, rank: int = 0, ranks: int = 1) -> None:
        """Set the order.

        Args:
            length: how many samples there are.
            batch: samples in a batch of all ranks together.
            seed: of the order.
            first: number of the first batch.
            rank: which part of each batch to give, 0 to ``ranks - 1``.
            ranks: how many processes share a batch; they must divide it.

        Raises:
            InputError: numbers that make no sense.
        """
        if length < 1 or batch < 1 or first < 0 or seed < 0:
            msg = f"got length {length}, batch {batch}, first {first}, seed {seed}; expected at least 1, 1, 0 and 0"
            raise InputError(msg)
        if not 0 <= rank < ranks or batch % ranks:
            msg = f"batch: got {batch} for rank {rank} of {ranks} processes; they must divide it: choose a multiple"
            raise InputError(msg)
        self._length, self._batch, self._seed, self._first = length, batch, seed, first
        part = batch // ranks
        self._part = slice(rank * part, (rank + 1) * part)
        self._order: tuple[int, NDArray[np.intp]] | None = None

    def __iter__(self) -> Iterator[list[Draw]]:
        """Yield the batches from ``first`` on, without end."""
        number = self._first
        while True:
            yield self.batch(number)
            number += 1

    def batch(self, number: int) -> list[Draw]:
        """Return this rank's part of a batch."""
        places = range(number * self._batch, (number + 1) * self._batch)[self._part]
        return [self._draw(*divmod(place, self._length)) for place in places]

    def _draw(self, epoch: int, place: int) -> Draw:
        if self._order is None or self._order[0] != epoch:
            rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(epoch,)))
            self._order = epoch, rng.permutation(self._length)
        return Draw(int(self._order[1][place]), epoch)
