"""What a report of recognition says of predictions made by hand: shares of the ceiling, tables, kinds of rows, reversal."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from learning.config import RecognitionConfig
from learning.evaluate.folder import claim_folder
from learning.recognition.report import CONFUSION, RESULTS, TABLE, Recognition, write_recognition
from learning.recognition.scores import Predictions


def named(
    name: str, right: int, *, slivers: int | None = 4, kind: str = "net", seeds: int = 1, noise_db: Any = None
) -> Predictions:
    """Return predictions to 20 captures of two classes, so many of which are right; of each further seed one more."""
    truth = np.arange(20) % 2
    guesses = np.stack([np.where(np.arange(20) < right + seed, truth, 1 - truth) for seed in range(seeds)])
    chances = 0.2 + 0.6 * np.stack([guesses == 0, guesses == 1], axis=-1)
    return Predictions(name, ("a", "b"), truth, chances, noise_db, slivers=slivers, kind=kind)


def written(
    folder: Path, predictions: list[Predictions], ceiling: str | None, backwards: Predictions | None = None
) -> tuple[Recognition, dict[str, Any], str]:
    rows = [{"name": name, "checkpoints": ["file"]} for name in dict.fromkeys(one.name for one in predictions)]
    plain = {"name": "trial", "output": "out", "data": {"test": "test"}, "classifiers": rows, "ceiling": ceiling}
    config = RecognitionConfig.model_validate(plain)
    found = Recognition(config, predictions, backwards, 40.0, "0" * 64, times=[], sheet=[], device="CPU")
    claim_folder(folder, "trial")
    report, *_ = write_recognition(folder, found)
    return found, json.loads((folder / RESULTS).read_bytes()), report.read_text(encoding="utf-8")


def test_shares_of_the_ceiling(tmp_path: Path) -> None:
    """As in the thesis, table 5.1: 29.69 of 39.13 are 76 %."""
    predictions = [named("net", 12, seeds=2), named("lens", 16, slivers=None), named("net", 8, seeds=2, noise_db=20.0)]
    found, results, report = written(tmp_path, predictions, "lens")
    assert [row[4] for row in found.rows()] == ["of the ceiling", "78 %", "100 %", "–", "–"]  # 12.5 of 16
    assert [one["of_ceiling"] for one in results["predictions"]] == pytest.approx([12.5 / 16, 1, 8.5 / 16])
    assert "| 78 % |" in report
    _, results, report = written(tmp_path, predictions[:1], None)
    assert results["predictions"][0]["of_ceiling"] is None
    assert "of the ceiling" not in report


def test_the_table_says_what_the_results_say(tmp_path: Path) -> None:
    _, results, _ = written(tmp_path, [named("net", 12, seeds=3), named("lens", 16)], "lens")
    rows = list(csv.DictReader((tmp_path / TABLE).open(encoding="utf-8")))
    for row, told in zip(rows, results["predictions"], strict=True):
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
    predictions = [
        named("net", 12),
        named("net, 2 slivers", 9, slivers=2),
        named("net, 8 slivers", 14, slivers=8),
        named("other, 1 sliver", 7, slivers=1, kind="other"),
    ]
    _, _, report = written(tmp_path, predictions, None)
    _, _, after = report.partition("## Slivers")
    lines = [line for line in after.partition("![")[0].splitlines() if line.startswith("| ")][2:]
    assert [line.split(" | ")[0] for line in lines] == ["| 2", "| 4", "| 8"]
    assert [line.split(" | ")[1].split()[0] for line in lines] == ["45.0", "60.0", "70.0"]


def test_what_becomes_of_reversed_clips(tmp_path: Path) -> None:
    """Of ten captures of a, six are classified correctly; backwards these become two b. Of b all are, and nine become a."""
    truth = np.repeat([0, 1], 10)
    forwards = np.where(np.arange(20) < 6, 0, 1)
    backwards = np.array([1, 1, 0, 0, 0, 0, *[1] * 4, *[0] * 9, 1])
    one, other = (
        Predictions("net", ("a", "b"), truth, np.eye(2)[guesses][None], test_fingerprint=name)
        for guesses, name in ((forwards, "f"), (backwards, "r"))
    )
    _, results, report = written(tmp_path, [one], None, other)
    told = results["backwards"]
    assert told["confusion_after_reversal"] == [[pytest.approx(2 / 3), pytest.approx(1 / 3)], [0.9, 0.1]]
    assert (told["test_fingerprint"], told["captures"]) == ("r", 20)
    _, _, after = report.partition("## Time-reversed clips")
    assert [line for line in after.splitlines() if line.startswith("| ")][2:4] == ["| a | 67 | 33 |", "| b | 90 | 10 |"]


def test_the_confusion_matrix_has_what_is_done_in_rows(tmp_path: Path) -> None:
    """All captures of a are taken for b: of the lower row nothing is missing, of the upper all is on the right."""
    truth = np.repeat([0, 1], 10)
    one = Predictions("net", ("a", "b"), truth, np.eye(2)[np.ones(20, int)][None])
    written(tmp_path, [one], None)
    with Image.open(tmp_path / CONFUSION) as image:
        pixels = np.asarray(image.convert("RGB"), float)
    blue = pixels[..., 2] - pixels[..., 0] > 60  # the darkest of "Blues"
    rows, columns = np.nonzero(blue)
    # One tall rectangle: both rows of the right column.
    assert np.ptp(rows) > 1.6 * np.ptp(columns)
