"""The order of samples: every epoch whole, every batch known by its number, ranks sharing it."""

from __future__ import annotations

from itertools import islice

import pytest

from learning.batches import Batches, Draw
from simulator.errors import InputError


@pytest.mark.parametrize(("length", "batch"), [(32, 8), (10, 4), (7, 3), (3, 8), (1, 2)])
def test_an_epoch_leaves_no_sample_out(length: int, batch: int) -> None:
    stream = [draw for draws in islice(Batches(length, batch, seed=5), 4 * length) for draw in draws]
    epochs = [stream[start : start + length] for start in range(0, len(stream), length)]
    for number, epoch in enumerate(epochs):
        if len(epoch) == length:  # batches may end within an epoch
            assert sorted(epoch) == [Draw(position, number) for position in range(length)]
    orders = {tuple(draw.position for draw in epoch) for epoch in epochs}
    assert length < 10 or len(orders) == len(epochs)  # a permutation that repeats would be no accident


def test_a_batch_follows_from_seed_and_number() -> None:
    batches = list(islice(Batches(10, 4, seed=5), 30))
    assert all(len(batch) == 4 for batch in batches)
    assert list(islice(Batches(10, 4, seed=5, first=13), 17)) == batches[13:]
    assert list(islice(Batches(10, 4, seed=6), 30)) != batches
    once = Batches(10, 4, seed=5)
    assert next(iter(once)) == next(iter(once)) == once.batch(0) == batches[0]
    assert once.batch(20) == batches[20]
    assert once.batch(2) == batches[2]  # ends one epoch and begins the next


@pytest.mark.parametrize("ranks", [1, 2, 3, 6])
def test_ranks_share_each_batch(ranks: int) -> None:
    whole = list(islice(Batches(10, 6, seed=5, first=2), 8))
    parts = [list(islice(Batches(10, 6, seed=5, first=2, rank=rank, ranks=ranks), 8)) for rank in range(ranks)]
    for number, batch in enumerate(whole):
        assert [draw for part in parts for draw in part[number]] == batch
        assert {len(part[number]) for part in parts} == {6 // ranks}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"length": 0}, "got length 0"),
        ({"batch": 0}, "batch 0"),
        ({"first": -1}, "first -1"),
        ({"seed": -1}, "seed -1"),
        ({"ranks": 3}, "got 4 for rank 0 of 3 processes; they must divide it"),
        ({"rank": 2, "ranks": 2}, "rank 2 of 2"),
        ({"rank": -1}, "rank -1 of 1"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(changes: dict[str, int], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Batches(**{"length": 10, "batch": 4, "seed": 0} | changes)
