"""Scenes changed and re-simulated: against explicit indices, stored measurements, the forward model of changed volumes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from learning.camera import CaptureModel, capture_model
from learning.simulate import Augmentation, SceneCamera
from simulator.camera.planes import split_planes
from simulator.camera.surroundings import whole_frames
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.types import Clip, Surroundings

NONE = Augmentation(flip=False, reverse=False, colour=0, exposure=0)


@pytest.fixture(params=["tiny", "wide"])
def dataset(request: pytest.FixtureRequest) -> Dataset:
    """One whose light is all from the image, one with light from beside it."""
    return open_dataset(request.getfixturevalue(f"{request.param}_dataset"), "train")


@pytest.fixture
def clip() -> Clip:
    """Two frames of 4 x 6 pixels amid surroundings of 6 x 5 coarse ones, all of them different."""
    rng = np.random.default_rng(0)
    around = Surroundings(rng.random((1, 6, 5, 3), np.float32), 1 + rng.random((1, 6, 5), np.float32), 2)
    light, depth_m, valid = (
        rng.random((2, 4, 6, 3), np.float32),
        1 + rng.random((2, 4, 6), np.float32),
        rng.random((2, 4, 6)),
    )
    extras = {"normal": rng.random((2, 4, 6, 3), np.float32)}
    edges_s = np.array([0.0, 0.1, 0.3])
    return Clip(light, depth_m, valid < 0.5, edges_s, "run", extras=extras, surroundings=around)


def mirrored(values: NDArray, rows: bool, columns: bool) -> NDArray:
    """Return ``(T, h, w, ...)`` with rows, columns or both in the other order, pixel by pixel."""
    result = np.empty_like(values)
    height, width = values.shape[1:3]
    for i in range(height):
        for j in range(width):
            result[:, i, j] = values[:, height - 1 - i if rows else i, width - 1 - j if columns else j]
    return result


def test_scenes_are_mirrored_and_recoloured(clip: Clip) -> None:
    """What the image, its depth and validity undergo, what is beside it undergoes, too; colours are light's alone."""
    counts = dict.fromkeys([(False, False), (False, True), (True, False), (True, True)], 0)
    gains = []
    for seed in range(400):
        changed = Augmentation(reverse=False, colour=0.3, exposure=1.5).apply(clip, np.random.default_rng(seed))
        (turns,) = (turns for turns in counts if np.array_equal(changed.depth_m, mirrored(clip.depth_m, *turns)))
        counts[turns] += 1
        gain = (changed.rgb / mirrored(clip.rgb, *turns))[0, 0, 0]
        gains.append(gain)
        around, given = changed.surroundings, clip.surroundings
        assert around is not None
        assert given is not None
        np.testing.assert_allclose(changed.rgb, mirrored(clip.rgb, *turns) * gain, rtol=1e-6)
        np.testing.assert_allclose(around.rgb, mirrored(given.rgb, *turns) * gain, rtol=1e-6)
        np.testing.assert_array_equal(around.depth_m, mirrored(given.depth_m, *turns), strict=True)
        np.testing.assert_array_equal(changed.valid, mirrored(clip.valid, *turns), strict=True)
        assert around.coarseness == 2
        assert changed.rgb.dtype == around.rgb.dtype == np.float32
        assert (changed.label, changed.extras) == ("run", {})  # normals and motion do not mirror like depth
        assert changed.frame_edges_s is clip.frame_edges_s
    # Binomial, a quarter of 400: 100 +- 9; the logarithms have 0.3 each and together 2^x, x uniform to 1.5.
    assert all(abs(count - 100) < 40 for count in counts.values())
    logs = np.log(gains)
    for one, other in pairwise(logs.T):
        assert stats.kstest((one - other) / (0.3 * np.sqrt(2)), "norm").pvalue > 1e-3
    spread = np.std(logs.mean(axis=1))
    assert spread == pytest.approx(np.sqrt(0.3**2 / 3 + (np.log(2) * 1.5) ** 2 / 3), rel=0.1)


def test_time_runs_backwards_in_half_of_the_clips_and_stills_draw_nothing_for_it(clip: Clip) -> None:
    """Surroundings of one frame stay; of several they run with the image. Each frame keeps the times of its place."""
    many = replace(clip, surroundings=Surroundings(*(np.repeat(part, 2, 0) for part in _of(clip)), 2))
    assert many.surroundings is not None
    many.surroundings.rgb[1] *= 2
    backwards = 0
    for seed in range(200):
        changed = Augmentation(flip=False, colour=0, exposure=0).apply(many, np.random.default_rng(seed))
        turned = np.array_equal(changed.rgb, clip.rgb[::-1])
        assert turned or np.array_equal(changed.rgb, clip.rgb)
        way = slice(None, None, -1 if turned else 1)
        for found, given in ((changed.depth_m, clip.depth_m), (changed.valid, clip.valid)):
            assert np.array_equal(found, given[way])
        assert changed.surroundings is not None
        assert np.array_equal(changed.surroundings.rgb, many.surroundings.rgb[way])
        assert changed.frame_edges_s is many.frame_edges_s
        backwards += turned
    assert abs(backwards - 100) < 29  # four deviations of a binomial
    first = {"rgb": clip.rgb[:1], "depth_m": clip.depth_m[:1], "valid": clip.valid[:1], "extras": {}}
    still = replace(clip, frame_edges_s=clip.frame_edges_s[:2], **first)
    one, other = (Augmentation(reverse=each).apply(still, np.random.default_rng(1)) for each in (False, True))
    assert np.array_equal(one.rgb, other.rgb)


def test_a_share_of_the_clips_stands_still_at_any_of_its_frames(clip: Clip) -> None:
    """All else is drawn as without: what did not stop is the same clip."""
    many = replace(clip, surroundings=Surroundings(*(np.repeat(part, 2, 0) for part in _of(clip)), 2))
    assert many.surroundings is not None
    many.surroundings.rgb[1] *= 2
    still, first = 0, 0
    for seed in range(200):
        moving, changed = (
            Augmentation(flip=False, still=share).apply(many, np.random.default_rng(seed)) for share in (0, 0.3)
        )
        if np.array_equal(moving.rgb, changed.rgb):
            continue
        still += 1
        (at,) = (n for n in range(2) if np.array_equal(changed.rgb[0], moving.rgb[n]))
        first += at == 0
        for name in ("rgb", "depth_m", "valid"):
            found, given = getattr(changed, name), getattr(moving, name)
            assert all(np.array_equal(frame, given[at]) for frame in found)
        assert changed.surroundings is not None
        assert moving.surroundings is not None
        assert np.array_equal(changed.surroundings.rgb, moving.surroundings.rgb[[at]])
        assert changed.frame_edges_s is clip.frame_edges_s
    assert abs(still - 60) < 26  # four deviations of a binomial
    assert 12 < first < still - 12


def _of(clip: Clip) -> tuple[NDArray, NDArray]:
    assert clip.surroundings is not None
    return clip.surroundings.rgb, clip.surroundings.depth_m


def test_each_change_can_be_left_out(clip: Clip) -> None:
    same = NONE.apply(clip, np.random.default_rng(0))
    assert np.array_equal(same.rgb, clip.rgb)
    assert np.array_equal(same.depth_m, clip.depth_m)
    stops = []
    for seed in range(200):
        brighter = Augmentation(flip=False, reverse=False, colour=0, exposure=0.7).apply(
            clip, np.random.default_rng(seed)
        )
        ratio = brighter.rgb / clip.rgb
        assert np.ptp(ratio) < 1e-5
        stops.append(np.log2(ratio.mean()))
    assert stats.kstest(stops, "uniform", args=(-0.7, 1.4)).pvalue > 1e-3


def test_an_unchanged_scene_is_measured_as_it_was(dataset: Dataset) -> None:
    camera = SceneCamera(dataset)
    for position in range(4):
        sample = dataset[position]
        seen = camera.sensor.noiseless(camera.exposure(NONE.apply(sample.clip(), np.random.default_rng(0))))
        # On one machine to the last bit; float32 on another.
        np.testing.assert_allclose(seen, sample.noiseless, rtol=0, atol=1e-6 * sample.noiseless.max())


def volume_of(clip: Clip, capture: CaptureModel) -> NDArray[np.float32]:
    """Return irradiance M L_k of the whole field, ``(1, K, C, rows, columns)``."""
    ((rgb, depth_m),) = whole_frames(clip, capture.field_shape)
    colours = np.einsum("ca,hwa->chw", capture.scene_to_camera, rgb).astype(np.float32)
    return split_planes(colours * capture.irradiance, depth_m, capture.stack.depths_m)[None]


def test_a_mirrored_scene_is_seen_through_psfs_that_stay(dataset: Dataset) -> None:
    """What is measured is the forward model's of the mirrored volume, with light in other colours; not a mirrored image."""
    camera, capture = SceneCamera(dataset), capture_model(dataset)
    model = capture.forward_model()
    sample = dataset[2]
    clip = sample.clip()
    plain = volume_of(clip, capture)
    colours, kinds = capture.scene_to_camera, set()
    for seed in range(20):
        changed = Augmentation(colour=0.4).apply(clip, np.random.default_rng(seed))
        ((rows, columns),) = (
            turns for turns in np.ndindex(2, 2) if np.array_equal(changed.depth_m, mirrored(clip.depth_m, *turns))
        )
        kinds.add((rows, columns))
        gains = (changed.rgb.sum(axis=(0, 1, 2)) / clip.rgb.sum(axis=(0, 1, 2))).astype(float)
        recoloured = np.einsum("ce,tkehw->tkchw", colours @ np.diag(gains) @ np.linalg.inv(colours), plain)
        volume = recoloured[..., :: -1 if rows else 1, :: -1 if columns else 1].astype(np.float32)
        wanted = capture.offset[:, None, None] + capture.gain * model.forward(volume)
        seen = camera.sensor.noiseless(camera.exposure(changed))
        np.testing.assert_allclose(seen, wanted, rtol=0, atol=3e-6 * wanted.max())
        if rows or columns:
            mirror = sample.noiseless[:, :: -1 if rows else 1, :: -1 if columns else 1]
            scaled = mirror * (seen.sum() / mirror.sum())
            assert np.abs(scaled - wanted).max() > 0.05 * wanted.max()
    assert len(kinds) == 4


def test_surroundings_count_where_there_are_some_and_must_be_there(wide_dataset: Path) -> None:
    dataset = open_dataset(wide_dataset, "train")
    camera, clip = SceneCamera(dataset), dataset[0].clip()
    around = clip.surroundings
    assert around is not None
    dark = replace(clip, surroundings=replace(around, rgb=np.zeros_like(around.rgb)))
    assert camera.exposure(dark).sum() < 0.8 * camera.exposure(clip).sum()
    with pytest.raises(InputError, match=r"^data\.augment: "):
        camera.exposure(replace(clip, surroundings=None))
    with pytest.raises(InputError, match=r"^network\.measnet: "):
        camera.global_measurements(replace(clip, surroundings=None), 1)
