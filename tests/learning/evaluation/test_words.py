"""What stands beside the tables is what was done."""

from types import SimpleNamespace
from typing import Any, cast

from learning.evaluation.findings import Findings
from learning.evaluation.outcome import Outcome
from learning.evaluation.summary import summarise
from learning.evaluation.words import conditions, left_out

RANGE = (0.036, 0.2)


class _Test(SimpleNamespace):
    def __len__(self) -> int:
        return 3


def _conditions(psf: dict[str, Any], *methods: tuple[str, int, tuple[float, float]]) -> str:
    test = _Test(info=SimpleNamespace(config={"psf": psf}), split="test", fingerprint="f" * 64)
    config = SimpleNamespace(data=SimpleNamespace(stack="own"))
    about = [{"name": name, "planes": planes, "depth_range_m": limits} for name, planes, limits in methods]
    return conditions(cast("Findings", SimpleNamespace(test=test, config=config, stored_db=40.0, methods=about)))


def test_depths_of_the_scenes_are_counted_where_they_are_listed() -> None:
    assert "PSFs exact at 25 depths" in _conditions({"model": "exact", "depths": 25}, ("A", 8, RANGE))
    listed = {"model": "exact", "depths": None, "depths_cm": [4, 8, 16]}
    assert "PSFs exact at 3 depths" in _conditions(listed, ("A", 8, RANGE))


def test_planes_and_range_are_said_of_each_method_where_they_differ() -> None:
    alike = _conditions({}, ("A", 8, RANGE), ("B", 8, RANGE))
    assert alike.endswith("their own PSFs: 8 planes, depths from 3.6 to 20 cm.")
    differ = _conditions({}, ("A", 8, RANGE), ("B", 3, (0.01, 0.2)), ("C", 8, RANGE))
    assert differ.endswith("A, C: 8 planes, depths from 3.6 to 20 cm; B: 3 planes, depths from 1 to 20 cm.")


def test_scenes_without_a_score_are_counted() -> None:
    whole, lacking = summarise([[1.0, 2.0]]), summarise([[1.0, float("nan")]])
    outcomes = [
        Outcome(name, "learned", "own", None, {"psnr": whole, "lit_depth_rmse_cm": lacking}, None, (), scenes=2)
        for name in "AB"
    ]
    assert left_out(outcomes) == "- lit depth RMSE cm: 1 of 2 scenes have none and are left out (A, B)"
    assert not left_out([Outcome("A", "learned", "own", None, {"psnr": whole}, None, (), scenes=2)])
