"""Tables say what the outcomes say."""

import csv
import io
import re

from learning.evaluation.outcome import Outcome
from learning.evaluation.report import (
    csv_table,
    markdown_bins,
    markdown_further,
    markdown_matrix,
    markdown_table,
    markdown_times,
    terminal_table,
)
from learning.evaluation.summary import summarise
from learning.evaluation.timing import Times

NET = Outcome(
    "Net",
    "learned",
    "own",
    None,
    {"psnr": summarise([[20.0, 22.0], [23.0, 25.0]]), "depth_rmse_cm": summarise([[1.0, 3.0], [1.5, 3.5]])},
    2.4,
    (1.0, None),
)
CLS = Outcome(
    "C|S",
    "classical",
    "own",
    None,
    {"psnr": summarise([[15.0, 16.0]]), "flip": summarise([[0.25, 0.35]]), "linear_psnr": summarise([[12.0, 14.0]])},
    None,
    (),
)
CONSTANT = Outcome("constant", "trivial", "own", None, {"depth_rmse_cm": summarise([[3.0, 5.0]])}, 4.0, (2.0, 3.0))
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
    other = Outcome("of disparity", "trivial", "own", None, {"disparity_rmse": summarise([[0.2, 0.3]])}, None, ())
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
    assert _rows(markdown_times([TIMES["Net"], slow]))[2:] == [
        ["Net", "0.01", "0.02", "–", "0.03", "1"],
        ["slow", "–", "–", "3", "3", "100"],
    ]


def test_a_matrix_has_a_column_for_each_level() -> None:
    outcomes = [Outcome("Net", "learned", "own", level, NET.scores, None, ()) for level in (20.0, 50.0)]
    assert _rows(markdown_matrix(outcomes, "psnr", [20.0, 30.0, 50.0], "noise_db", " dB")) == [
        ["PSNR dB", "20 dB", "30 dB", "50 dB"],
        ["---", "---:", "---:", "---:"],
        ["Net", "22.50 ± 1.41 (2.12)", "–", "22.50 ± 1.41 (2.12)"],
    ]


def test_the_csv_has_full_precision() -> None:
    rows = list(csv.DictReader(io.StringIO(csv_table(ROWS, TIMES))))
    assert [row["method"] for row in rows] == ["Net", "C|S", "constant"]
    assert float(rows[0]["psnr_over_scenes"]) == NET.scores["psnr"].over_scenes
    assert float(rows[0]["psnr_over_seeds"]) == NET.scores["psnr"].over_seeds
    assert rows[1]["psnr_over_seeds"] == rows[1]["depth_rmse_cm_mean"] == rows[1]["pooled_depth_rmse_cm"] == ""
    assert (rows[0]["seeds"], rows[1]["seeds"], rows[0]["seconds_per_scene"]) == ("2", "1", "0.03")


def test_the_terminal_gets_columns() -> None:
    lines = terminal_table(ROWS, TIMES).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert re.split(" {2,}", lines[1].strip()) == ["Net", "22.50 ± 1.41 (2.12)", "-", "2.25 ± 1.41 (0.35)", "0.03"]
