"""Words about the tables, and the folder that they are written to."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from learning.evaluate import report
from learning.evaluate.folder import claim_folder, remove_stale
from learning.evaluate.outcome import Outcome, summarise
from learning.evaluate.report import Findings
from simulator.errors import InputError

RANGE = (0.036, 0.2)


class _Test(SimpleNamespace):
    def __len__(self) -> int:
        return 3


def _conditions(psf: dict[str, Any], *methods: tuple[str, int, tuple[float, float]], timing: Any = None) -> str:
    test = _Test(info=SimpleNamespace(config={"psf": psf}), split="test", fingerprint="f" * 64)
    config = SimpleNamespace(data=SimpleNamespace(stack="own"))
    about = [{"name": name, "planes": planes, "depth_range_m": limits} for name, planes, limits in methods]
    parts = {"test": test, "config": config, "stored_db": 40.0, "methods": about}
    return report.conditions(cast("Findings", SimpleNamespace(**parts, camera=SimpleNamespace(timing=timing))))


def test_depths_of_the_scenes_are_counted_where_they_are_listed() -> None:
    assert "PSFs exact at 25 depths" in _conditions({"model": "exact", "depths": 25}, ("A", 8, RANGE))
    listed = {"model": "exact", "depths": None, "depths_cm": [4, 8, 16]}
    assert "PSFs exact at 3 depths" in _conditions(listed, ("A", 8, RANGE))


def test_slivers_and_the_one_plane_are_said_of_clips() -> None:
    timing = SimpleNamespace(frames=10, frame_edges_s=[0.0, 0.02])
    told = _conditions({"model": "exact", "depths": 5}, ("A", 1, (0.3, 0.3)), timing=timing)
    assert "PSFs exact at 5 depths, 10 slivers of a capture of 20 ms" in told
    assert told.endswith("their own PSFs: one plane at 30 cm.")


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
    assert report.left_out(outcomes) == "- lit depth RMSE cm: 1 of 2 scenes have none and are left out (A, B)"
    assert not report.left_out([Outcome("A", "learned", "own", None, {"psnr": whole}, None, (), scenes=2)])


@pytest.mark.parametrize("content", ["dataset.json", "training.json", "report.md", "notes.txt"])
def test_a_folder_of_something_else_is_refused_and_left_alone(tmp_path: Path, content: str) -> None:
    (tmp_path / content).write_text("mine")
    with pytest.raises(InputError, match=r"^output: "):
        claim_folder(tmp_path, "trial")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {content: "mine"}


def test_a_folder_is_gone_on_with_under_its_own_name_only(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    claim_folder(folder, "trial")
    (folder / "notes.txt").write_text("mine")
    claim_folder(folder, "trial")
    with pytest.raises(InputError, match=r"^output: "):
        claim_folder(folder, "other")
    (folder / "evaluation.json").write_text("{}")
    with pytest.raises(InputError, match=r"evaluation\.json: "):
        claim_folder(folder, "trial")
    with pytest.raises(InputError, match=r"notes\.txt is a file"):
        claim_folder(folder / "notes.txt", "trial")


def test_what_was_not_written_this_time_goes_and_foreign_files_stay(tmp_path: Path) -> None:
    names = (
        "report.md",
        "noise.png",
        "times.png",
        "mine.png",
        "a/noise.png",
        "a/mine.png",
        "b/noise.png",
        "c/noise.png",
    )
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("old")

    def left(*written: str, **recorded: Any) -> set[str]:
        (tmp_path / "evaluation.json").write_text(json.dumps({"name": "trial", **recorded}))
        remove_stale(tmp_path, written, report._OWN)
        assert json.loads((tmp_path / "evaluation.json").read_text()) == {"name": "trial", "files": sorted(written)}
        return {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")} - {"evaluation.json"}

    kept = set(names) - {"noise.png"}
    assert left("report.md", "times.png") == kept  # of an earlier version, without a record
    others = ["../up/noise.png", "/noise.png", "a/b/noise.png", "mine.png", "c/./noise.png"]
    assert left("report.md", files=["a/noise.png", "b/noise.png", "times.png", *others]) == kept - {
        "times.png",
        "a/noise.png",
        "b/noise.png",
    }
    assert not (tmp_path / "b").exists()
