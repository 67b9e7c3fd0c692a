"""The numbers in pictures' names: their order, and whether the count is complete."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts ``frame2`` before ``frame10``.

    Example:
        >>> sorted(["frame10.png", "frame2.png"], key=natural)
        ['frame2.png', 'frame10.png']
    """
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def counting_fault(names: Sequence[str]) -> str | None:
    """Say where the numbers of pictures leave their count, such as 3, 4, 7: between two of them is more time than elsewhere.

    Names count where one of their numbers differs and most of its steps are the same; times and other numbers do not.

    Args:
        names: of the pictures of one video, in order.

    Returns:
        What is wrong and what to do, or None.

    Example:
        >>> counting_fault(["a1.png", "a2.png", "a3.png", "a7.png"])
        'its pictures leave their count of 1 after a3.png (the next is a7.png): fetch what is missing, or split it there'
    """
    keys = [tuple(natural(name)) for name in names]
    if len(keys) < 3 or len({len(key) for key in keys}) > 1:
        return None
    differing = [place for place, parts in enumerate(zip(*keys, strict=True)) if len(set(parts)) > 1]
    if len(differing) != 1 or keys[0][differing[0]][0] < 0:
        return None
    numbers = [key[differing[0]][0] for key in keys]
    steps = [after - before for before, after in pairwise(numbers)]
    (usual, count), *_ = Counter(steps).most_common()
    if count == len(steps) or 2 * count <= len(steps):
        return None
    places = [index for index, step in enumerate(steps) if step != usual]
    more = f", and {len(places) - 1} times more" if len(places) > 1 else ""
    return (
        f"its pictures leave their count of {usual} after {names[places[0]]} (the next is {names[places[0] + 1]}{more}): "
        "fetch what is missing, or split it there"
    )
