"""What lists say of a plugin is what its code says: names, types, ranges, defaults, meanings."""

from pathlib import Path

import pytest
from rich.console import Console

from simulator.plugin_listing import parameter_lines, plugin_lines, plugin_table
from simulator.plugins import available, resolve
from simulator.text import documented

DESIGN = '''
"""A design of the tests (Nobody, J. Test. 1, 1, 2001).

More words that no list needs.
"""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field


def shape(
    *,
    width_mm: Annotated[float, Field(gt=0, le=20)] = 3.0,
    angle_degrees: Annotated[float, Field(ge=-5, lt=5)] = 1e-3,
    rank: int,
    file: Path | None = None,
    depth_cm: Annotated[float, Field(ge=0.5)] | None = None,
    kind: Literal["round", "square"] = "round",
    open: bool = True,
    size_mm: tuple[Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]] = (1.0, 2.5),
    kinds: Annotated[list[Literal["round", "square"]], Field(min_length=1)] | None = None,
    files: Path | list[Path] = Path("a"),
    rows: list[list[int]] = [],
    offsets: tuple[float, ...] = (),
    named: tuple[str, int] = ("a", 1),
):
    """Return nothing.

    Args:
        width_mm: side of the [square]
            mask.
        rank: of the array.
        kind: ``round`` or not.

    Raises:
        InputError: never.
    """
'''


@pytest.fixture
def plugin(tmp_path: Path):
    (tmp_path / "design.py").write_text(DESIGN)
    return resolve("mask", "./design.py:shape", tmp_path)


def test_parameters_have_type_range_default_and_meaning(plugin) -> None:
    lines = [(line.name, line.default, line.expected, line.meaning) for line in parameter_lines(plugin)]
    assert lines == [
        ("width_mm", "3", "number over 0 to 20", "side of the [square] mask"),
        ("angle_degrees", "0.001", "number from -5 to under 5", ""),
        ("rank", "required", "whole number", "of the array"),
        ("file", "null", "path", ""),
        ("depth_cm", "null", "number from 0.5", ""),
        ("kind", "round", "round | square", "round or not"),
        ("open", "true", "true or false", ""),
        ("size_mm", "[1, 2.5]", "2 numbers over 0", ""),
        ("kinds", "null", "list of round | square", ""),
        ("files", "a", "path or list of paths", ""),
        ("rows", "[]", "list of lists of whole numbers", ""),
        ("offsets", "[]", "list of numbers", ""),
        ("named", "[a, 1]", "list of text, whole number", ""),
    ]


def test_plain_lines_and_the_table_of_a_terminal_say_what_it_is(plugin) -> None:
    lines = plugin_lines("camera.mask.design", [plugin]).splitlines()
    assert lines[:3] == [
        "camera.mask.design:",
        "  ./design.py:shape: A design of the tests (Nobody, J. Test. 1, 1, 2001).",
        "      width_mm: 3           number over 0 to 20; side of the [square] mask",
    ]
    assert lines[3] == "      angle_degrees: 0.001  number from -5 to under 5"
    console = Console(width=100)
    with console.capture() as shown:
        console.print(plugin_table(plugin))
    # Brackets are words here, not markup.
    for word in (
        lines[1].partition(": ")[2],
        "side of the [square] mask",
        "over 0 to 20",
        "required",
        "round | square",
    ):
        assert word in " ".join(shown.get().split())


def test_every_parameter_of_every_shipped_design_has_a_meaning() -> None:
    for docstring in ("", "Do it.", "Do it.\n\nReturns:\n    args: none."):
        assert documented(docstring, "Args") == {}
    for name in available("mask"):
        for line in parameter_lines(resolve("mask", name)):
            assert line.meaning, f"{name}: {line.name}"


def test_a_section_with_a_type_says_its_types() -> None:
    """Names of our own classes would tell users nothing."""
    (depth,) = [line for line in parameter_lines(resolve("source", "rgb_depth")) if line.name == "depth"]
    assert depth.expected == "{type: metric, ...} or {type: disparity, ...} or {type: linear | inverse, ...}"
