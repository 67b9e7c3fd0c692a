"""What a report of recognition says of answers made by hand: shares of the ceiling, the table, which rows are of one kind."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from learning.config import RecognitionConfig
from learning.evaluate.folder import claim_folder
from learning.recognition.report import RESULTS, TABLE, Recognition, write_recognition
from learning.recognition.scores import Answers


def named(
    name: str, right: int, *, slivers: int | None = 4, kind: str = "net", seeds: int = 1, noise_db: Any = None
) -> Answers:
    """Return answers to 20 captures of two classes, so many of which are right; of each further seed one more."""
    truth = np.arange(20) % 2
    guesses = np.stack([np.where(np.arange(20) < right + seed, truth, 1 - truth) for seed in range(seeds)])
    chances = 0.2 + 0.6 * np.stack([guesses == 0, guesses == 1], axis=-1)
    return Answers(name, ("a", "b"), truth, chances, noise_db, slivers=slivers, kind=kind)


def written(folder: Path, answers: list[Answers], ceiling: str | None) -> tuple[Recognition, dict[str, Any], str]:
    rows = [{"name": name, "checkpoints": ["file"]} for name in dict.fromkeys(one.name for one in answers)]
    plain = {"name": "trial", "output": "out", "data": {"test": "test"}, "classifiers": rows, "ceiling": ceiling}
    found = Recognition(RecognitionConfig.model_validate(plain), answers, None, 40.0, "0" * 64, {}, [], "CPU")
    claim_folder(folder, "trial")
    report, *_ = write_recognition(folder, found)
    return found, json.loads((folder / RESULTS).read_bytes()), report.read_text(encoding="utf-8")


def test_shares_of_the_ceiling(tmp_path: Path) -> None:
    """As in the thesis, table 5.1: 29.69 of 39.13 are 76 %."""
    answers = [named("net", 12, seeds=2), named("lens", 16, slivers=None), named("net", 8, seeds=2, noise_db=20.0)]
    found, results, report = written(tmp_path, answers, "lens")
    assert [row[4] for row in found.rows()] == ["of the ceiling", "78%", "100%", "–", "–"]  # 12.5 of 16
    assert [one["of_ceiling"] for one in results["answers"]] == pytest.approx([12.5 / 16, 1, 8.5 / 16])
    assert "| 78% |" in report
    _, results, report = written(tmp_path, answers[:1], None)
    assert results["answers"][0]["of_ceiling"] is None
    assert "of the ceiling" not in report


def test_the_table_says_what_the_results_say(tmp_path: Path) -> None:
    _, results, _ = written(tmp_path, [named("net", 12, seeds=3), named("lens", 16)], "lens")
    rows = list(csv.DictReader((tmp_path / TABLE).open(encoding="utf-8")))
    for row, told in zip(rows, results["answers"], strict=True):
        for top in (1, 2, 5):
            numbers = told[f"top_{top}"]
            low, high = numbers["interval"]
            assert low <= numbers["mean"] <= high
            expected = {"": numbers["mean"], "_low": low, "_high": high}
            expected["_half_interval_over_seeds"] = numbers["half_interval_over_seeds"]
            for name, value in expected.items():
                assert row[f"top_{top}{name}"] == ("" if value is None else str(value)), name
        for name in ("of_ceiling", "calibration_error", "log_loss"):
            assert float(row[name]) == told[name]
        assert [row["classifier"], row["slivers"], row["seeds"]] == [told["name"], "4", str(told["seeds"])]
    assert float(rows[0]["top_1_half_interval_over_seeds"]) == pytest.approx(4.3027 * 0.05 / np.sqrt(3), rel=1e-4)


def test_only_rows_of_one_kind_are_compared_by_slivers(tmp_path: Path) -> None:
    answers = [
        named("net", 12),
        named("net, 2 slivers", 9, slivers=2),
        named("net, 8 slivers", 14, slivers=8),
        named("other, 1 sliver", 7, slivers=1, kind="other"),
    ]
    _, _, report = written(tmp_path, answers, None)
    _, _, after = report.partition("## Slivers")
    lines = [line for line in after.partition("![")[0].splitlines() if line.startswith("| ")][2:]
    assert [line.split(" | ")[0] for line in lines] == ["| 2", "| 4", "| 8"]
    assert [line.split(" | ")[1].split()[0] for line in lines] == ["45.0", "60.0", "70.0"]
