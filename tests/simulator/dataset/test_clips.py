"""Splits of a finite source: no video in two of them, no clip moved by a larger count, no clip left out."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simulator.dataset.clips import ClipOrder, clip_order
from simulator.errors import InputError

SPLITS = ("train", "validation", "test")
GROUPS = st.lists(st.integers(1, 4), min_size=1, max_size=9).map(
    lambda sizes: [7 * video + 3 for video, size in enumerate(sizes) for _ in range(size)]
)
COUNTS = st.fixed_dictionaries(dict.fromkeys(SPLITS, st.integers(0, 12)))


def places(order: ClipOrder, counts: dict[str, int]) -> dict[str, list[int]]:
    return {split: [order.place(split, index) for index in range(count)] for split, count in counts.items()}


@given(GROUPS, COUNTS)
@example([0, 1, 2, 3, 4], {"train": 1, "validation": 0, "test": 3})
def test_counts_are_accepted_exactly_where_no_two_splits_share_a_video(groups: list[int], counts: dict) -> None:
    order = ClipOrder(groups)
    videos = {split: {groups[place] for place in taken} for split, taken in places(order, counts).items()}
    shared = sum(map(len, videos.values())) > len(set().union(*videos.values()))
    repeated = sum(count > 0 for count in counts.values()) > 1 and max(counts.values()) > len(groups)
    if shared or repeated:
        assert f"but of {len(set(groups))} videos ({len(groups)} clips) " in str(order.shortage(counts))
    else:
        assert order.shortage(counts) is None


@given(GROUPS, st.sampled_from(SPLITS), st.integers(0, 40))
def test_one_split_alone_shows_every_clip_before_it_shows_one_again(groups: list[int], split: str, more: int) -> None:
    order = ClipOrder(groups)
    assert order.shortage({split: len(groups) + more}) is None
    walk = places(order, {split: 2 * len(groups)})[split]
    assert sorted(walk[: len(groups)]) == list(range(len(groups)))
    assert walk[len(groups) :] == walk[: len(groups)]
    runs = [groups[place] for place in walk[: len(groups)]]
    assert sum(one != other for one, other in pairwise(runs)) == len(set(groups)) - 1  # none is cut


@given(st.integers(1, 30), st.integers(0, 30), st.integers(0, 30))
def test_clips_without_videos_lie_where_they_always_did(clips: int, validation: int, test: int) -> None:
    """Data sets that exist: training from the front, 1st, 3rd, ... from the back validation, 2nd, 4th, ... test."""
    order = ClipOrder(clips)
    assert [order.place("train", i) for i in range(clips)] == list(range(clips))
    assert [order.place("pilot", i) for i in range(16)] == [i % clips for i in range(16)]
    backwards = range(clips - 1, -1, -1)
    assert places(order, {"validation": validation})["validation"][: -(-clips // 2)] == [*backwards[::2]][:validation]
    assert places(order, {"test": test})["test"][: clips // 2] == [*backwards[1::2]][:test]


def test_all_clips_of_a_video_come_before_the_next_one() -> None:
    order = ClipOrder([0, 0, 1, 2, 2, 2, 5, 5])
    counts = {"train": 2, "validation": 2, "test": 3}
    assert order.shortage(counts) is None
    assert places(order, counts) == {"train": [0, 1], "validation": [6, 7], "test": [3, 4, 5]}
    assert places(order, {"validation": 4})["validation"] == [6, 7, 2, 3]


def test_what_is_missing_is_said() -> None:
    message = str(ClipOrder([0, 0, 1, 1, 2, 2]).shortage({"train": 3, "validation": 2, "test": 1}))
    assert "but of 3 videos (6 clips) train" in message
    assert "train takes 2 for 3 samples, validation takes 1 for 2 samples, test takes 1 for 1 samples" in message
    assert message.endswith("ask for fewer samples, take more clips of each video, bring more videos")
    message = str(ClipOrder(3).shortage({"train": 2, "test": 1}))
    assert message.startswith("no two splits may share a source video, but of 3 clips train takes ")
    assert message.endswith("ask for fewer samples, bring more clips")


class Source:
    inputs: tuple[Path, ...] = ()

    def __init__(self, length: int, groups: object = None, splits: object = None) -> None:
        self.length, self.splits = length, splits
        if groups is not None:
            self.groups = groups

    def __len__(self) -> int:
        return self.length


def test_splits_that_a_source_keeps_apart_stay_apart() -> None:
    order = clip_order(Source(9, splits={"train": range(4), "validation": [6, 4, 5], "test": []}))  # type: ignore[arg-type]
    assert order is not None
    assert places(order, {"train": 5, "pilot": 2, "validation": 3}) == {
        "train": [0, 1, 2, 3, 0],
        "pilot": [0, 1],
        "validation": [6, 4, 5],
    }
    assert places(order, {"test": 2})["test"] == [7, 5]  # has none of its own: from all, where any source's test lies
    assert order.shortage({"train": 4, "validation": 3, "test": 1}) is None
    message = str(order.shortage({"train": 4, "validation": 3, "test": 2}))
    assert "(train and validation as the source keeps them apart, any other split from all of it)" in message


@pytest.mark.parametrize("own", [[-1], [2, 3]])
def test_splits_of_clips_that_are_not_there(own: list[int]) -> None:
    with pytest.raises(InputError, match=r"^scene: "):
        clip_order(Source(3, splits={"train": own}))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("length", "groups"),
    [
        *((0, None), (0, []), (3, [0, 1]), (3, [0, 2, 1]), (3, [0.0, 1.0, 2.0]), (2, [[0], [1]])),
        (5, np.array([5, 5, 3, 3, 7], np.uint16)),  # differences of unsigned numbers never fall
    ],
)
def test_sources_that_contradict_themselves(length: int, groups: object) -> None:
    with pytest.raises(InputError, match=r"^scene: "):
        clip_order(Source(length, groups))  # type: ignore[arg-type]


def test_sources_may_give_their_videos_as_an_array() -> None:
    order = clip_order(Source(4, np.array([0, 0, 3, 3], np.uint8)))  # type: ignore[arg-type]
    assert order is not None
    assert (order.clips, order.videos, order.place("validation", 0)) == (4, 2, 2)
    assert clip_order(object()) is None  # type: ignore[arg-type]
