"""The classes of a data set: their names, their numbers, and what has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from learning.labels import class_names, class_numbers, labels
from simulator.dataset import open_dataset
from simulator.errors import InputError


def test_labels_are_the_samples(labelled_dataset: Path) -> None:
    dataset = open_dataset(labelled_dataset, "test")
    assert labels(dataset) == [dataset[at].label for at in range(len(dataset))]
    assert class_names(dataset) == ("leftwards", "rightwards")
    assert class_numbers(dataset, ("leftwards", "up", "rightwards")) == [2, 0] * 4
    assert class_numbers(dataset[3:5], ("leftwards", "rightwards")) == [0, 1]


def test_what_has_no_classes(labelled_dataset: Path, clip_dataset: Path) -> None:
    with pytest.raises(InputError, match="train/s00000000 and 7 more has no label"):
        class_names(open_dataset(clip_dataset))
    one = open_dataset(labelled_dataset)[:1]
    with pytest.raises(InputError, match="are 'rightwards'; recognition needs two classes"):
        class_names(one)
    with pytest.raises(InputError, match="samples of 'leftwards', expected what is learned: "):
        class_numbers(open_dataset(labelled_dataset), ("rightwards", "upwards"))
