"""Files that are drawn from a sealed data set, and the seal that takes them in."""

from pathlib import Path

import pytest

from simulator.dataset import checksums
from simulator.dataset.checksums import CHECKSUMS, REPORT, read_seal, write_beside
from simulator.dataset.manifest import ManifestWriter
from simulator.dataset.verification import verify
from simulator.errors import InputError
from simulator.io.files import sha256_file


def test_the_seal_takes_a_drawn_file_in_and_blesses_nothing_else(dataset: Path) -> None:
    before = read_seal(dataset)
    assert before is not None
    info = dataset / "dataset.json"
    info.write_text(info.read_text() + " ")
    write_beside(dataset, REPORT, b"a page")
    assert read_seal(dataset) == before | {REPORT: sha256_file(dataset / REPORT)}
    assert [line for line in verify(dataset).problems if "SHA-256 differs" in line and "dataset.json" in line]


def test_an_unsealed_data_set_stays_unsealed(dataset: Path) -> None:
    (dataset / CHECKSUMS).unlink()
    with ManifestWriter(dataset):  # a job that is running
        write_beside(dataset, REPORT, b"a page")
    assert (dataset / REPORT).read_bytes() == b"a page"
    assert not (dataset / CHECKSUMS).exists()


def test_a_seal_that_a_run_takes_off_while_it_is_read(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = checksums.read_text

    def late(path: Path, *arguments) -> str:
        path.unlink()
        return read(path, *arguments)

    monkeypatch.setattr(checksums, "read_text", late)
    assert read_seal(dataset) is None


def test_nothing_is_written_into_a_damaged_or_busy_data_set(dataset: Path) -> None:
    with ManifestWriter(dataset), pytest.raises(InputError, match="another process"):
        write_beside(dataset, REPORT, b"a page")
    (dataset / CHECKSUMS).write_text("{}")
    with pytest.raises(InputError, match=CHECKSUMS):
        write_beside(dataset, REPORT, b"a page")
    assert not (dataset / REPORT).exists()
