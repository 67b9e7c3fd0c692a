"""What a release says of itself is one and the same wherever it stands."""

import tomllib
from pathlib import Path

import yaml

import simulator

TOP = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_one_version() -> None:
    newest = next(line for line in (TOP / "CHANGELOG.md").read_text(encoding="utf-8").splitlines() if line[:3] == "## ")
    citation = yaml.safe_load((TOP / "CITATION.cff").read_text(encoding="utf-8"))
    assert {PROJECT["version"], simulator.__version__, citation["version"], newest.split()[1]} == {PROJECT["version"]}


def test_the_citation_has_what_its_schema_requires() -> None:
    """Citation File Format 1.2.0: required keys, and the types of those that are used."""
    citation = yaml.safe_load((TOP / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] in ("software", "dataset")
    assert all(
        {"name"} == author.keys() or {"family-names", "given-names"} <= author.keys() for author in citation["authors"]
    )
    assert citation["license"] == PROJECT["license"]
    assert len(set(citation["keywords"])) == len(citation["keywords"]) > 0
    texts = ("message", "title", "abstract", "version")
    assert all(isinstance(citation[name], str) and citation[name].strip() for name in texts)
