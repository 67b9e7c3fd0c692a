"""Every family: a clip's contract, the same bytes for any order and number of threads, one image from both backends."""

from __future__ import annotations

import importlib
import json
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from scenes.layout import place_balls, place_balls_beside
from simulator.render import Renderer
from simulator.types import SceneSource, View

FAMILIES = ("flying_things", "endoscopy", "high_speed", "activity")
WORKER = "simulator/render/worker.py"
# What a family takes, which of its clips is looked at, and what that clip says of itself.
CLIPS: dict[str, tuple[dict[str, Any], int, dict[str, Any]]] = {
    "flying_things": ({"objects": 10, "samples_per_pixel": 4}, 3, {"objects": 10}),
    "endoscopy": ({"frames": 3, "frames_per_second": 25.0}, 1, {"organ": "small_intestine"}),
    "high_speed": ({"frames": 3, "frames_per_second": 3000.0}, 5, {"event": "collision", "background": "black"}),
    "activity": ({"frames": 3, "frames_per_second": 6.0}, 7, {}),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_a_clip_keeps_the_contract(family: str) -> None:
    """From the index and the generator alone, in any process, within the depth range, well exposed, told in JSON."""
    keywords, index, facts = CLIPS[family]
    near_m, far_m = (0.005, 0.1) if family == "endoscopy" else (0.036, 0.2)
    view = View((24, 24), 102.4e-6, 1.9e-3, near_m, far_m)
    make = getattr(importlib.import_module(f"scenes.{family}"), family)
    source = make(view, renderer=Renderer("scalar_rgb"), **{"samples_per_pixel": 1} | keywords)
    assert isinstance(source, SceneSource)
    assert tuple(source.inputs) == ()
    packed = pickle.dumps(source)
    assert len(packed) < 2000
    clip, again = (one.clip(index, np.random.default_rng(5)) for one in (source, pickle.loads(packed)))
    assert clip.rgb.tobytes() == again.rgb.tobytes()
    assert clip.depth_m.tobytes() == again.depth_m.tobytes()
    assert not np.array_equal(clip.rgb, source.clip(index, np.random.default_rng(6)).rgb)
    frames, rate = keywords.get("frames", 1), keywords.get("frames_per_second", 1.0)
    assert clip.rgb.shape == (frames, 24, 24, 3)
    np.testing.assert_allclose(clip.frame_edges_s, np.arange(frames + 1) / rate, rtol=1e-12)
    assert near_m <= clip.depth_m[clip.valid].min() <= clip.depth_m[clip.valid].max() <= far_m
    assert 0.05 < clip.rgb[clip.valid].mean() < 0.9
    told = json.loads(json.dumps(clip.source))
    assert told.items() >= ({"family": family, "index": index, "variant": "scalar_rgb"} | facts).items()
    label = {"flying_things": None, "activity": "pouring"}.get(family, next(iter(facts.values()), None))
    assert clip.label == label


@pytest.mark.parametrize("family", FAMILIES)
def test_scenes_fill_a_margin_to_62_degrees_and_show_the_same_in_the_image(family: str) -> None:
    keywords, index, _ = CLIPS[family]
    near_m, far_m = (0.005, 0.1) if family == "endoscopy" else (0.036, 0.2)
    if family == "high_speed":
        keywords = keywords | {"background": "room"}
    view = View((24, 24), 102.4e-6, 1.9e-3, near_m, far_m)
    make = getattr(importlib.import_module(f"scenes.{family}"), family)
    clip, alone = (
        make(each, renderer=Renderer("scalar_rgb"), **keywords | {"samples_per_pixel": 4}).clip(
            index, np.random.default_rng(5)
        )
        for each in (replace(view, margin=(24, 24)), view)
    )
    # Things beside the image may reach into it; a wider floor rounds otherwise.
    same = np.isclose(clip.depth_m, alone.depth_m, rtol=1e-5)
    assert same.mean() > 0.9
    around = clip.surroundings
    assert around is not None
    assert around.rgb.shape == (len(clip.rgb), 18, 18, 3)
    lit = around.rgb.max(axis=-1) > 0.01 * clip.rgb.mean()
    assert lit.mean() > 0.97
    assert 0.2 < around.rgb.mean() / clip.rgb.mean() < 5


@pytest.mark.parametrize("margin", [1, 3, 4, 8, 100])
def test_things_beside_the_image_have_their_middles_there(margin: int) -> None:
    view = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2, (margin, margin))
    for seed in range(5):
        rng = np.random.default_rng(seed)
        for ball in place_balls_beside(view, 30, place_balls(view, 30, rng), rng):
            across = np.abs(ball.centre_m[:2]) / ball.centre_m[2]
            assert max(across) > view.tan_half_width
            assert max(across) < view.field.tan_half_width


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_order_and_threads_do_not_change_a_byte(family: str, variant: str, rendered, request) -> None:
    if variant == "llvm_ad_rgb":
        request.getfixturevalue("needs_llvm")
    first, second = (rendered(WORKER, "families", variant, *how) for how in (("1", "forwards"), ("2", "backwards")))
    for name in ("rgb", "depth", "valid", "id"):
        assert first[f"{family}.{name}"].tobytes() == second[f"{family}.{name}"].tobytes(), name


@pytest.mark.slow
@pytest.mark.usefixtures("needs_llvm")
@pytest.mark.parametrize("family", FAMILIES)
def test_the_backends_agree(family: str, rendered) -> None:
    scalar, llvm = (rendered(WORKER, "families", variant, "1", "forwards") for variant in ("scalar_rgb", "llvm_ad_rgb"))
    different = scalar[f"{family}.id"] != llvm[f"{family}.id"]
    # Two tracers may disagree where a ray meets an edge: one pixel in 200 of these coarse pictures.
    assert different.mean() <= 0.005
    # A ray within float32's rounding of an edge between two triangles may take either, one in 200 again.
    near = np.isclose(scalar[f"{family}.depth"], llvm[f"{family}.depth"], rtol=1e-4)
    assert np.mean(near) >= 0.995
    assert _mean_score(scalar[f"{family}.noisy"], llvm[f"{family}.noisy"]) < 4


def _mean_score(first: NDArray[Any], second: NDArray[Any]) -> float:
    """How many standard deviations the largest of the pictures' block means lie apart, after Sidak's correction.

    Blocks of 6 x 6 pixels: with 4 paths a single pixel's light is far from normal (lamps are found or not).
    """
    means = [_blocks(images.astype(np.float64)) for images in (first, second)]
    runs = len(first)
    scatter = np.sqrt(sum(values.var(axis=0, ddof=1) for values in means) / runs)
    score = (means[0].mean(axis=0) - means[1].mean(axis=0)) / np.maximum(scatter, 1e-9)
    lit = np.maximum(means[0].mean(axis=0), means[1].mean(axis=0)) > 0
    # Two-sided p of the largest of many, as the normal deviation that has the same p.
    p = 2 * stats.t.sf(np.abs(score[lit]).max(), 2 * (runs - 1))
    return float(stats.norm.isf(max(1 - (1 - p) ** lit.sum(), 1e-300) / 2))


def _blocks(images: NDArray[np.float64]) -> NDArray[np.float64]:
    runs, rows, columns, channels = images.shape
    return images.reshape(runs, rows // 6, 6, columns // 6, 6, channels).mean(axis=(2, 4))
