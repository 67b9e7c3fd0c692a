"""Times: by turns, the first one not counted, medians by stage."""

import time
from collections.abc import Callable

import pytest
import torch

from learning.evaluation.timing import device_in_words, take_times
from learning.method import Clock


class Sleeper:
    """A method that takes known seconds, and says when it was called, on which scene."""

    def __init__(self, name: str, seconds: Callable[[int], float], log: list[tuple[str, float]]) -> None:
        self.name, self.capture, self._seconds, self._log, self._turn = name, None, seconds, log, 0

    def reconstruct(self, measurement: torch.Tensor, clock: Clock | None = None) -> None:
        assert clock is not None
        assert measurement.shape == (1, 1, 2, 2)
        self._log.append((self.name, measurement[0, 0, 0, 0].item()))
        for share, stage in ((1, "inversion"), (2, "network")):
            with clock.stage(stage):
                time.sleep(share * self._seconds(self._turn))
        self._turn += 1


def test_the_median_by_stage_of_turns_after_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    log: list[tuple[str, float]] = []
    done: list[tuple[int, int]] = []
    fast = Sleeper("fast", lambda turn: [100.0, 1.0, 9.0, 2.0][turn], log)
    slow = Sleeper("slow", lambda turn: 10.0, log)
    scenes = torch.arange(2.0)[:, None, None, None].expand(2, 1, 2, 2)
    times = take_times([fast, slow], scenes, 3, lambda *counts: done.append(counts))  # pyright: ignore[reportArgumentType]
    assert log == [
        ("fast", 0),
        ("slow", 0),
        ("fast", 1),
        ("slow", 1),
        ("fast", 0),
        ("slow", 0),
        ("fast", 1),
        ("slow", 1),
    ]
    assert times[0].stages == {"inversion": 2.0, "network": 4.0}
    assert (times[0].total, times[0].fastest) == (6.0, 3.0)
    assert times[1].total == pytest.approx(30.0)
    assert done == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_the_device_names_its_threads() -> None:
    assert f"{torch.get_num_threads()} of " in device_in_words(torch.device("cpu"))
