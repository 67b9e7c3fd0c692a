"""Tables say what the outcomes say."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from learning.evaluate import report
from learning.evaluate.outcome import Outcome, summarise
from learning.evaluate.report import (
    Findings,
    claim_folder,
    markdown_bins,
    markdown_further,
    markdown_table,
    terminal_table,
)
from learning.evaluate.scoring import Times
from simulator.errors import InputError

OF_NET = {"psnr": summarise([[20.0, 22.0], [23.0, 25.0]]), "depth_rmse_cm": summarise([[1.0, 3.0], [1.5, 3.5]])}
OF_CLS = {
    name: summarise([two]) for name, two in (("psnr", [15, 16]), ("flip", [0.25, 0.35]), ("linear_psnr", [12, 14]))
}
NET = Outcome("Net", "learned", "own", None, OF_NET, 2.4, (1.0, None))
CLS = Outcome("C|S", "classical", "own", None, OF_CLS, None, ())
CONSTANT = Outcome("constant", "naive", "own", None, {"depth_rmse_cm": summarise([[3.0, 5.0]])}, 4.0, (2.0, 3.0))
TIMES = {"Net": Times("Net", {"inversion": 0.01, "network": 0.02}, 0.03, 0.029)}
ROWS = [NET, CLS, CONSTANT]


def _rows(markdown: str) -> list[list[str]]:
    lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in markdown.splitlines()]
    assert len({len(line) for line in lines}) == 1
    return [[cell.strip() for cell in line] for line in lines]


def test_the_table_has_means_spreads_the_best_and_the_share_of_the_constant() -> None:
    head, _, *rows = _rows(markdown_table(ROWS, TIMES, 4.0))
    assert head == ["method", "PSNR dB ↑", "FLIP ↓", "depth RMSE cm ↓", "of constant", "s per scene ↓"]
    # Means 21 and 24 of the seeds, 21.5 and 23.5 of the scenes.
    assert rows[0] == ["Net", "**22.50 ± 1.41 (2.12)**", "–", "**2.25 ± 1.41 (0.35)**", "60 %", "0.03"]
    assert rows[1] == [r"C\|S", "15.50 ± 0.71", "**0.300 ± 0.071**", "–", "–", "–"]
    assert rows[2] == ["*constant*", "–", "–", "4.00 ± 1.41", "100 %", "–"]


def test_a_row_without_any_of_the_scores_is_left_to_the_other_table() -> None:
    other = Outcome("of disparity", "naive", "own", None, {"disparity_rmse": summarise([[0.2, 0.3]])}, None, ())
    for table in (markdown_table([*ROWS, other], {}, 4.0), terminal_table([*ROWS, other], {})):
        assert "constant" in table
        assert "of disparity" not in table
    assert "of disparity" in markdown_further([*ROWS, other])


def test_further_scores_stand_apart() -> None:
    head, _, *rows = _rows(markdown_further(ROWS))
    assert head == ["method", "linear PSNR dB ↑", "pooled depth RMSE cm ↓"]
    assert rows[0] == ["Net", "–", "2.40"]


def test_bins_and_times() -> None:
    assert _rows(markdown_bins(ROWS, (1.0, 2.5, 20.0)))[0] == ["depth RMSE cm", "1–2.5 cm", "2.5–20 cm"]
    assert _rows(markdown_bins(ROWS, (1.0, 2.5, 20.0)))[2:] == [["Net", "1.00", "–"], ["constant", "2.00", "3.00"]]
    slow = Times("slow", {"admm": 3.0}, 3.0, 3.0)
    assert _rows(report.markdown_times([TIMES["Net"], slow]))[2:] == [
        ["Net", "0.01", "0.02", "–", "0.03", "1"],
        ["slow", "–", "–", "3", "3", "100"],
    ]


def test_a_matrix_has_a_column_for_each_level() -> None:
    outcomes = [Outcome("Net", "learned", "own", level, NET.scores, None, ()) for level in (20.0, 50.0)]
    head, _, row = _rows(report.markdown_matrix(outcomes, "psnr", [20.0, 30.0, 50.0], "noise_db", " dB"))
    assert head == ["PSNR dB", "20 dB", "30 dB", "50 dB"]
    assert row == ["Net", "22.50 ± 1.41 (2.12)", "–", "22.50 ± 1.41 (2.12)"]


def test_the_csv_has_full_precision() -> None:
    rows = list(csv.DictReader(io.StringIO(report.csv_table(ROWS, TIMES))))
    assert [row["method"] for row in rows] == ["Net", "C|S", "constant"]
    assert float(rows[0]["psnr_over_scenes"]) == NET.scores["psnr"].over_scenes
    assert float(rows[0]["psnr_over_seeds"]) == NET.scores["psnr"].over_seeds
    assert rows[1]["psnr_over_seeds"] == rows[1]["depth_rmse_cm_mean"] == rows[1]["pooled_depth_rmse_cm"] == ""
    assert (rows[0]["seeds"], rows[1]["seeds"], rows[0]["seconds_per_scene"]) == ("2", "1", "0.03")


def test_the_terminal_gets_columns() -> None:
    lines = terminal_table(ROWS, TIMES).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert re.split(" {2,}", lines[1].strip()) == ["Net", "22.50 ± 1.41 (2.12)", "-", "2.25 ± 1.41 (0.35)", "0.03"]


RANGE = (0.036, 0.2)


class _Test(SimpleNamespace):
    def __len__(self) -> int:
        return 3


def _conditions(psf: dict[str, Any], *methods: tuple[str, int, tuple[float, float]]) -> str:
    test = _Test(info=SimpleNamespace(config={"psf": psf}), split="test", fingerprint="f" * 64)
    config = SimpleNamespace(data=SimpleNamespace(stack="own"))
    about = [{"name": name, "planes": planes, "depth_range_m": limits} for name, planes, limits in methods]
    return report.conditions(cast("Findings", SimpleNamespace(test=test, config=config, stored_db=40.0, methods=about)))


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
    for name in ("report.md", "noise.png", "times.png", "mine.png"):
        (tmp_path / name).write_text("old")
    report.remove_stale(tmp_path, ["report.md", "times.png"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.png", "report.md", "times.png"]
