"""The warping error along motion that is known exactly, and motion over slivers against a thing that moves as it is told."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from learning.evaluate.motion import SliverMotion, sliver_motion, warping_error
from simulator.dataset.reader import open_dataset
from simulator.dataset.sample import StoredSample


def shifted(frames: int, step: int) -> torch.Tensor:
    """Return a film whose content moves right by ``step`` columns per frame."""
    texture = torch.from_numpy(np.random.default_rng(0).random((3, 8, 40)))
    return torch.stack([texture[:, :, 20 - step * n : 36 - step * n] for n in range(frames)])


def motion_of(frames: int, step: float, height: int = 8, width: int = 16) -> SliverMotion:
    y, x = np.mgrid[:height, :width].astype(float)
    places = np.stack([x + step, y], axis=-1)
    seen = x + step <= width - 1
    return SliverMotion(*(np.stack([each] * (frames - 1)) for each in (places, seen)))


def test_a_film_that_follows_the_motion_has_no_error_and_a_still_one_has() -> None:
    film = shifted(4, 3)
    assert warping_error(film, motion_of(4, 3)) < 1e-12
    still = film[:1].expand(4, -1, -1, -1)
    expected = (still[1:, :, :, 3:] - still[:-1, :, :, :-3]).square().mean().sqrt()
    assert warping_error(still, motion_of(4, 3)) == pytest.approx(float(expected), rel=1e-12)


def test_between_pixels_it_is_interpolated_linearly() -> None:
    ramp = torch.arange(16.0).expand(3, 8, 16) / 100
    film = torch.stack([ramp, ramp - 0.025])  # moves right by 2.5 columns
    assert warping_error(film, motion_of(2, 2.5)) < 1e-7  # float32


def test_nothing_seen_is_no_number() -> None:
    motion = motion_of(3, 1)
    assert np.isnan(warping_error(shifted(3, 1), motion._replace(seen=np.zeros_like(motion.seen))))


def stored(motion: np.ndarray, valid: np.ndarray, seen: int, there: np.ndarray | None = None) -> StoredSample:
    """Return a sample whose frames have this motion ``(T, h, w, 3)``, which is valid there; None: something everywhere."""
    there = np.ones_like(valid) if there is None else there

    def frame(number: int) -> Any:
        extras = {"motion": motion[number], "motion_valid": valid[number]}
        return SimpleNamespace(extras=extras, valid=there[number])

    description = {"extras": {"motion": {}}, "metadata": {"frames_seen": seen}}
    return cast("StoredSample", SimpleNamespace(description=description, frames=len(motion), frame=frame))


@pytest.mark.parametrize("length", [2, 3])
def test_motion_is_that_of_the_slivers_middles(length: int) -> None:
    """Of a thing that grows faster: frame t moves by 2 t + 2 columns. A sliver shows the mean of its frames' places."""
    frames = 2 * length
    motion = np.zeros((frames, 8, 32, 3), np.float32)
    motion[..., 0] = 2 * np.arange(1, frames + 1)[:, None, None]
    motion[..., 1] = -0.1
    valid = np.ones((frames, 8, 32), bool)
    at = np.concatenate([[0], np.cumsum(motion[:-1, 0, 0, 0])])
    step = at[length:].mean() - at[:length].mean()
    found = sliver_motion(stored(motion, valid, frames), 2)
    assert found is not None
    x = np.arange(32.0)
    np.testing.assert_allclose(found.places[0, 7, :, 0], x + step)
    np.testing.assert_allclose(found.places[0, :, 0, 1], np.arange(8) - 0.1 * length, atol=1e-6)
    assert (found.seen[0, 7] == (x + step <= 31)).all()
    assert not found.seen[0, 0].any()


def test_what_is_hidden_on_the_way_is_not_seen() -> None:
    motion = np.zeros((6, 8, 32, 3), np.float32)
    motion[..., 0] = 2 * np.arange(1, 7)[:, None, None]
    valid = np.ones((6, 8, 32), bool)
    valid[2, 4, 10] = False
    found = sliver_motion(stored(motion, valid, 6), 3)
    assert found is not None
    assert not found.seen[0, 4, 5]  # half a step of 2 and one of 4 columns before the hidden point
    assert found.seen[0, 4, 6]


def test_where_nothing_is_nothing_moves() -> None:
    """A film that flickers there is told from a dark one; not where something comes or goes."""
    motion, there = np.zeros((4, 8, 8, 3), np.float32), np.zeros((4, 8, 8), bool)
    there[2, 2, 5] = True
    found = sliver_motion(stored(motion, there, 4, there), 2)
    assert found is not None
    assert (found.places[0] == np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1)).all()
    assert not found.seen[0, 2, 5]
    assert int(found.seen[0].sum()) == 63
    film = torch.zeros(2, 3, 8, 8)
    assert warping_error(film, found) == 0
    film[1] = 0.3
    assert warping_error(film, found) == pytest.approx(0.3, rel=1e-6)


def test_slivers_alone_and_samples_without_motion_say_nothing(clip_dataset: Path) -> None:
    motion, valid = np.zeros((3, 8, 8, 3), np.float32), np.ones((3, 8, 8), bool)
    assert sliver_motion(stored(motion, valid, 6), 3) is None
    assert sliver_motion(stored(motion, valid, 3), 2) is None
    assert sliver_motion(open_dataset(clip_dataset, "test").stored(0), 4) is None
