"""What the samples of a data set show, by name and by number: the classes that recognition tells apart."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from learning.provenance import playback
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset, spread_positions
from simulator.errors import InputError
from simulator.text import show

_WHICH = "check which classes the scenes have (scene.actions, scene.classes)"


def labels(dataset: Dataset) -> list[str]:
    """Return the label of each sample of a split.

    Raises:
        InputError: a sample without one.
    """
    entries = load_manifest(dataset.root).entries
    found = [entries[dataset.split, name].label for name in dataset.ids]
    without = [name for name, label in zip(dataset.ids, found, strict=True) if label is None]
    if without:
        which = f" and {len(without) - 1} more have" if without[1:] else " has"
        reason = f"{dataset.split}/{without[0]}{which} no label, without which there is nothing to recognise"
        raise InputError(dataset.root, f"{reason}; take scenes with classes, such as the family activity")
    return [label for label in found if label is not None]


def class_names(dataset: Dataset) -> tuple[str, ...]:
    """Return the classes of a split, sorted.

    Raises:
        InputError: a sample without a label, or only one class.
    """
    classes = tuple(sorted(set(labels(dataset))))
    if len(classes) < 2:
        got = (
            f"all {len(dataset)} samples of split {dataset.split!r} are {show(classes[0])}" if classes else "no sample"
        )
        raise InputError(dataset.root, f"got {got}; recognition needs two classes at least; {_WHICH}")
    return classes


def class_numbers(dataset: Dataset, classes: Sequence[str]) -> list[int]:
    """Return the number of each sample's class among those that a network tells apart.

    Raises:
        InputError: a sample without a label, or one of another class.
    """
    number = {name: place for place, name in enumerate(classes)}
    found = labels(dataset)
    unknown = sorted(set(found) - set(number))
    if unknown:
        got = f"split {dataset.split!r} has samples of {', '.join(map(show, unknown[:3]))}{' ...' * (len(unknown) > 3)}"
        cure = f"train with them, or leave them out; {_WHICH}"
        raise InputError(dataset.root, f"{got}, expected the network's classes: {', '.join(classes)}; {cure}")
    return [number[label] for label in found]


def check_forwards(dataset: Dataset) -> None:
    """Refuse clips that do not run forwards: their labels still describe the action as it was filmed."""
    if (runs := playback(dataset)) == "forwards":
        return
    got = "its clips run backwards" if runs == "backwards" else "its clips stand still"
    cure = "take the samples that they were made from"
    cure += "; an evaluation compares both (data.backwards)" if runs == "backwards" else ""
    raise InputError(dataset.root, f"{got}, so their labels no longer describe what they show; {cure}")


def spread_over_classes(numbers: Sequence[int], count: int) -> list[int]:
    """Return the positions of so many samples, all of them at most, by their class numbers: of as many classes as can be."""
    of_class: dict[int, list[int]] = {}
    for place, number in enumerate(numbers):
        of_class.setdefault(number, []).append(place)
    turns = list(itertools.zip_longest(*(of_class[number] for number in sorted(of_class))))
    if turns and count < len(of_class):
        return [turns[0][at] for at in spread_positions(len(of_class), count)]
    return [place for turn in turns for place in turn if place is not None][:count]


def spoken(name: str) -> str:
    """Return the name of a class as a reader wants it."""
    return name.replace("_", " ")
