"""Every family: the same bytes for any order and number of threads, the same picture from both backends."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

FAMILIES = ("flying_things", "endoscopy", "high_speed", "activity")
Pictures = Mapping[str, NDArray[Any]]
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory, python: Callable) -> Callable[[str, int, str], Pictures]:
    folder = tmp_path_factory.mktemp("families")

    @functools.cache
    def run(variant: str, threads: int, order: str) -> Pictures:
        out = folder / f"{variant}_{threads}_{order}.npz"
        done = python(str(Path(__file__).with_name("families_worker.py")), variant, str(threads), order, str(out))
        assert done.returncode == 0, done.stderr
        with np.load(out, allow_pickle=False) as arrays:
            return dict(arrays)

    return run


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_rgb"])
def test_order_and_threads_do_not_change_a_byte(family: str, variant: str, rendered, request) -> None:
    if variant == "llvm_ad_rgb":
        request.getfixturevalue("needs_llvm")
    first, second = rendered(variant, 1, "forwards"), rendered(variant, 2, "backwards")
    for name in ("rgb", "depth", "valid", "id"):
        assert first[f"{family}.{name}"].tobytes() == second[f"{family}.{name}"].tobytes(), name


@pytest.mark.usefixtures("needs_llvm")
@pytest.mark.parametrize("family", FAMILIES)
def test_the_backends_agree(family: str, rendered) -> None:
    scalar, llvm = rendered("scalar_rgb", 1, "forwards"), rendered("llvm_ad_rgb", 1, "forwards")
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
