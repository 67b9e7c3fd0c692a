"""``report`` as users meet it."""

import json
from pathlib import Path

from simulator.dataset import verify


def test_a_page_beside_the_data_set_or_elsewhere(flatlight, dataset: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "page.html"
    assert flatlight("report", dataset, "--output", elsewhere) == (0, f"look at {elsewhere}\n", "")
    assert not (dataset / "report.html").exists()
    code, out, _ = flatlight("report", dataset)
    assert (code, out) == (0, f"look at {dataset / 'report.html'}\n")
    assert (dataset / "report.html").read_bytes() == elsewhere.read_bytes()
    assert "report.html" in json.loads((dataset / "checksums.json").read_text())["files"]
    assert not [line for line in verify(dataset).problems if "report.html" in line]


def test_how_many_samples_are_shown(flatlight, dataset: Path, tmp_path: Path) -> None:
    assert flatlight("report", dataset, "--samples", 2, "--output", tmp_path / "few.html")[0] == 0
    assert (tmp_path / "few.html").read_text().count('class="card"') == 3  # train 2 of 3, validation at least 1


def test_mistakes(flatlight, one_error, dataset: Path, tmp_path: Path) -> None:
    one_error(flatlight("report", tmp_path / "no"), f"{tmp_path / 'no'}: ")
    one_error(flatlight("report", dataset, "--output", "page.pdf"), "--output: ")
    assert flatlight("report", dataset, "--samples", 0)[0] == 2
