"""Tables say what the outcomes say."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace

from learning.evaluate import tables
from learning.evaluate.outcome import Outcome, summarise
from learning.evaluate.paired import Difference
from learning.evaluate.scoring import Times
from learning.evaluate.tables import markdown_bins, markdown_further, markdown_table, terminal_table

OF_NET = {"psnr": summarise([[20.0, 22.0], [23.0, 25.0]]), "depth_rmse_cm": summarise([[1.0, 3.0], [1.5, 3.5]])}
OF_CLS = {
    name: summarise([two]) for name, two in (("psnr", [15, 16]), ("flip", [0.25, 0.35]), ("linear_psnr", [12, 14]))
}
SEEDS = tuple(
    Outcome(
        "Net", "learned", "own", None, {"psnr": summarise([psnr]), "depth_rmse_cm": summarise([cm])}, 2.2, (), seed=n
    )
    for n, psnr, cm in ((1, [20.0, 22.0], [1.0, 3.0]), (2, [23.0, 25.0], [1.5, 3.5]))
)
NET = Outcome("Net", "learned", "own", None, OF_NET, 2.4, (1.0, None), singly=SEEDS)
CLS = Outcome("C|S", "classical", "own", None, OF_CLS, None, ())
CONSTANT = Outcome("constant", "naive", "own", None, {"depth_rmse_cm": summarise([[3.0, 5.0]])}, 4.0, (2.0, 3.0))
TIMES = {"Net": Times("Net", {"inversion": 0.01, "network": 0.02}, 0.03, 0.029)}
ROWS = [NET, CLS, CONSTANT]


def _rows(markdown: str) -> list[list[str]]:
    lines = [re.split(r"(?<!\\)\|", line)[1:-1] for line in markdown.splitlines()]
    assert len({len(line) for line in lines}) == 1
    return [[cell.strip() for cell in line] for line in lines]


def test_the_table_has_means_spreads_the_best_and_the_share_of_the_constant() -> None:
    head, _, *rows = _rows(markdown_table(ROWS, TIMES))
    assert head == ["method", "PSNR dB ↑", "FLIP ↓", "depth RMSE cm ↓", "of constant", "s per scene ↓"]
    # Means 21 and 24 of the seeds, 21.5 and 23.5 of the scenes.
    assert rows[0] == ["Net", "**22.50 ± 1.41 (2.12)**", "–", "**2.25 ± 1.41 (0.35)**", "60 %", "0.03"]
    # The second seed is better than the mean of both, but no method.
    assert rows[1] == ["↳ seed 1", "21.00 ± 1.41", "–", "2.00 ± 1.41", "55 %", "–"]
    assert rows[2] == ["↳ seed 2", "24.00 ± 1.41", "–", "2.50 ± 1.41", "55 %", "–"]
    assert rows[3] == [r"C\|S", "15.50 ± 0.71", "**0.300 ± 0.071**", "–", "–", "–"]
    assert rows[4] == ["*constant*", "–", "–", "4.00 ± 1.41", "100 %", "–"]


def test_a_row_without_any_of_the_scores_is_left_to_the_other_table() -> None:
    other = Outcome("of disparity", "naive", "own", None, {"disparity_rmse": summarise([[0.2, 0.3]])}, None, ())
    for table in (markdown_table([*ROWS, other], {}), terminal_table([*ROWS, other], {})):
        assert "constant" in table
        assert "of disparity" not in table
    assert "of disparity" in markdown_further([*ROWS, other])


def test_further_scores_stand_apart() -> None:
    head, _, *rows = _rows(markdown_further(ROWS))
    assert head == ["method", "linear PSNR dB ↑", "pooled depth RMSE cm ↓"]
    assert rows[0] == ["Net", "–", "2.40"]
    assert rows[1] == ["↳ seed 1", "–", "2.20"]


def test_bins_and_times() -> None:
    assert _rows(markdown_bins(ROWS, (1.0, 2.5, 20.0)))[0] == ["depth RMSE cm", "1–2.5 cm", "2.5–20 cm"]
    assert _rows(markdown_bins(ROWS, (1.0, 2.5, 20.0)))[2:] == [["Net", "1.00", "–"], ["constant", "2.00", "3.00"]]
    slow = Times("slow", {"admm": 3.0}, 3.0, 3.0)
    assert _rows(tables.markdown_times([TIMES["Net"], slow]))[2:] == [
        ["Net", "0.01", "0.02", "–", "0.03", "1"],
        ["slow", "–", "–", "3", "3", "100"],
    ]


def _at(level: float, psnr: float, tuned_db: float | None = None) -> Outcome:
    scores = {"psnr": summarise([[psnr, psnr + 2]]), "depth_rmse_cm": summarise([[2.0, 2.0]])}
    return Outcome("CLS", "classical", "own", level, scores, 2.0, (), tuned_db=tuned_db)


def test_a_matrix_has_a_column_for_each_level_and_a_row_for_each_seed() -> None:
    black, mean = (
        Outcome(name, "naive", "own", None, {"psnr": summarise([[psnr, psnr]])}, None, ())
        for name, psnr in (("black", 5.0), ("mean image", 13.0))
    )
    columns = {
        "20 dB": [_at(20, 10, 20), CONSTANT, black, mean],
        "30 dB": [NET, _at(30, 15, 20), CONSTANT, black, mean],
    }
    head, _, *rows = _rows(tables.markdown_matrix("psnr", columns))
    assert head == ["PSNR dB ↑", "20 dB", "30 dB"]
    assert rows == [
        ["CLS", "11.00 ± 1.41", "16.00 ± 1.41 †"],  # parameters of 20 dB at 30
        ["*mean image*", "**13.00 ± 0.00**", "13.00 ± 0.00"],
        ["Net", "–", "**22.50 ± 1.41 (2.12)**"],
        ["↳ seed 1", "–", "21.00 ± 1.41"],
        ["↳ seed 2", "–", "24.00 ± 1.41"],
    ]
    # An oracle is shown, but is no rival.
    oracle = replace(mean, method="oracle", kind="oracle", scores={"psnr": summarise([[40.0, 40.0]])})
    assert _rows(tables.markdown_matrix("psnr", {"20 dB": [black, oracle]}))[2:] == [
        ["*oracle*", "40.00 ± 0.00"],
        ["*black*", "**5.00 ± 0.00**"],
    ]
    # Of clips in which nothing moves, none has a PSNR of moving pixels.
    still = {"moving": [_at(20, 10, 20)], "still": [replace(_at(20, 10, 20), scores={})]}
    assert _rows(tables.markdown_matrix("psnr", still))[2:] == [["CLS", "**11.00 ± 1.41**", "–"]]
    depths = {row[0]: row[2] for row in _rows(tables.markdown_matrix("depth_rmse_cm", columns))[2:]}
    assert depths["Net"] == "2.25 ± 1.41 (0.35) · 60 %"
    assert depths["↳ seed 2"] == "2.50 ± 1.41 · 55 %"
    assert depths["CLS"] == "**2.00 ± 0.00** · 50 % †"
    assert depths["*constant*"] == "4.00 ± 1.41 · 100 %"


def test_the_best_constant_has_one_row_whatever_its_depth_is() -> None:
    named = {
        title: [replace(CONSTANT, method=f"constant depth ({title} cm)"), _at(20, 10)] for title in ("4.00", "6.00")
    }
    rows = [row[0] for row in _rows(tables.markdown_matrix("depth_rmse_cm", named))[2:]]
    assert rows == ["CLS", "*constant depth*"]


DIFFERENCES = {
    "20 dB": [
        Difference("Net", "CLS", 20.0, "psnr", 1.234, (0.9, 1.6), 9),
        Difference("Net", "CLS", 20.0, "depth_rmse_cm", 0.2, (0.1, 0.3), 9),
        Difference("Net, seed 1", "CLS", 20.0, "psnr", -0.5, (-1.0, 0.1), 9),
    ],
    "30 dB": [Difference("Net", "CLS", 30.0, "psnr", 2.0, None, 1)],
}


def test_differences_have_intervals_and_verdicts() -> None:
    head, _, *rows = _rows(tables.markdown_differences("psnr", DIFFERENCES))
    assert head == ["PSNR dB ↑", "20 dB", "30 dB"]
    assert rows == [
        ["Net − CLS", "+1.23 [+0.90, +1.60] ▲", "+2.00 ○"],
        ["Net, seed 1 − CLS", "-0.50 [-1.00, +0.10] ○", "–"],
    ]
    assert _rows(tables.markdown_differences("depth_rmse_cm", DIFFERENCES))[2] == [
        "Net − CLS",
        "+0.20 [+0.10, +0.30] ▼",
        "–",
    ]
    head, _, *rows = _rows(tables.markdown_verdicts(DIFFERENCES))
    assert head == ["PSNR, depth RMSE", "20 dB", "30 dB"]
    assert rows == [["Net − CLS", "▲▼", "○"], ["Net, seed 1 − CLS", "○", "–"]]
    lines = [re.split(" {2,}", line) for line in tables.terminal_verdicts(DIFFERENCES).splitlines()]
    assert lines[1:] == [["Net - CLS", "+-", "."], ["Net, seed 1 - CLS", ".", "-"]]


def test_the_csv_of_differences_has_full_precision() -> None:
    rows = list(
        csv.DictReader(io.StringIO(tables.csv_differences({"a": DIFFERENCES["20 dB"], "b": DIFFERENCES["30 dB"]})))
    )
    assert rows[0] == dict(
        zip(rows[0], ["a", "Net", "CLS", "20.0", "psnr", "9", "1.234", "0.9", "1.6", "reference"], strict=True)
    )
    assert [row["set"] for row in rows] == ["a", "a", "a", "b"]
    assert [row["favours"] for row in rows] == ["reference", "other", "", ""]
    assert rows[3]["low"] == rows[3]["high"] == ""


def test_the_csv_has_full_precision() -> None:
    rows = list(csv.DictReader(io.StringIO(tables.csv_table({"a": (ROWS, TIMES)}))))
    assert [row["method"] for row in rows] == ["Net", "Net", "Net", "C|S", "constant"]
    assert [row["seed"] for row in rows] == ["", "1", "2", "", ""]
    assert float(rows[0]["psnr_over_scenes"]) == NET.scores["psnr"].over_scenes
    assert float(rows[0]["psnr_over_seeds"]) == NET.scores["psnr"].over_seeds
    assert rows[3]["psnr_over_seeds"] == rows[3]["depth_rmse_cm_mean"] == rows[3]["pooled_depth_rmse_cm"] == ""
    assert (rows[0]["seeds"], rows[1]["seeds"], rows[0]["seconds_per_scene"]) == ("2", "1", "0.03")


def test_the_terminal_gets_columns() -> None:
    lines = terminal_table(ROWS, TIMES).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert re.split(" {2,}", lines[1].strip()) == ["Net", "22.50 ± 1.41 (2.12)", "-", "2.25 ± 1.41 (0.35)", "0.03"]
    assert re.split(" {2,}", lines[2].strip()) == ["seed 1", "21.00 ± 1.41", "-", "2.00 ± 1.41", "-"]
