"""The classes of a data set: their names, their numbers, and what has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from learning.labels import class_names, class_numbers, labels, spread_over_classes
from simulator.dataset import open_dataset
from simulator.errors import InputError


def test_labels_are_the_samples(labelled_dataset: Path) -> None:
    dataset = open_dataset(labelled_dataset, "test")
    assert labels(dataset) == [dataset[at].label for at in range(len(dataset))]
    assert class_names(dataset) == ("leftwards", "rightwards")
    assert class_numbers(dataset, ("leftwards", "up", "rightwards")) == [2, 0] * 4
    assert class_numbers(dataset[3:5], ("leftwards", "rightwards")) == [0, 1]


def test_what_has_no_classes(labelled_dataset: Path, clip_dataset: Path) -> None:
    with pytest.raises(InputError, match="train/s00000000 and 7 more"):
        class_names(open_dataset(clip_dataset))
    one = open_dataset(labelled_dataset)[:1]
    with pytest.raises(InputError, match="are 'rightwards'; recognition needs two classes"):
        class_names(one)
    with pytest.raises(InputError, match="samples of 'leftwards', expected the network's classes: rightwards, upwards"):
        class_numbers(open_dataset(labelled_dataset), ("rightwards", "upwards"))


def test_what_is_shown_is_of_different_classes() -> None:
    """Of classes that take turns, where positions evenly apart may be of one of them, and of rare ones."""
    for numbers in ([place % 10 for place in range(400)], [0] * 97 + list(range(1, 10))):
        for count in (4, 6, 10):
            found = spread_over_classes(numbers, count)
            assert len({numbers[at] for at in found}) == len(found) == count
    assert spread_over_classes([1, 0, 1], 5) == [1, 0, 2]
    assert spread_over_classes([1, 1, 0, 0, 0], 3) == [2, 0, 3]
    assert not spread_over_classes([], 3)
