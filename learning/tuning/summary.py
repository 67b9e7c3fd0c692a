"""What a tuning found, in words: a line when a level is done, a table at the end; beside the constant guess, always."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_HEADINGS = ("method", "noise dB", "PSNR dB", "depth RMSE cm", "score", "parameters")
_WORDS = 5  # from this column on, texts begin at the left


def in_words(result: Mapping[str, Any], constant: Mapping[str, Any]) -> str:
    """Return a line about the result of a method at a level.

    Args:
        result: as in the book.
        constant: ``psnr_db`` and ``depth_rmse_cm`` of guessing the mean colour and the mean depth.
    """
    line = (
        f"{result['method']} at {result['noise_db']:g} dB: PSNR {_number(result['psnr_db'])} dB (constant guess "
        f"{_number(constant['psnr_db'])}), depth RMSE {_number(result['depth_rmse_cm'])} cm "
        f"({_number(constant['depth_rmse_cm'])}), score {result['score']:.4g} with {_parameters(result)}"
    )
    return "; ".join([line, *_remarks(result)])


def table(content: Mapping[str, Any]) -> str:
    """Return all results of a book and the constant guess, one line each."""
    constant = content["about"]["constant_guess"]
    rows: list[tuple[str, ...]] = [_HEADINGS]
    for result in content["results"]:
        words = "; ".join([_parameters(result), *_remarks(result)])
        numbers = (_number(result["psnr_db"]), _number(result["depth_rmse_cm"]), f"{result['score']:.4g}")
        rows.append((result["method"], f"{result['noise_db']:g}", *numbers, words))
    rows.append(("constant guess", "", _number(constant["psnr_db"]), _number(constant["depth_rmse_cm"]), "", ""))
    widths = [max(len(row[at]) for row in rows) for at in range(_WORDS)]
    return "\n".join(
        "  ".join(
            [row[0].ljust(widths[0]), *(row[at].rjust(widths[at]) for at in range(1, _WORDS)), *row[_WORDS:]]
        ).rstrip()
        for row in rows
    )


def _parameters(result: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{key} {value}" if isinstance(value, str) else f"{key} {value:g}"
        for key, value in result["parameters"].items()
    )


def _remarks(result: Mapping[str, Any]) -> list[str]:
    remarks = []
    if worse := result["no_better_than_constant"]:
        remarks.append(f"{' and '.join(worse)} no better than a constant guess")
    if result["at_limit"]:
        remarks.append(f"at its limit: {', '.join(result['at_limit'])}")
    if not result["converged"]:
        remarks.append(f"still changing after {result['rounds']} rounds")
    return remarks


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
