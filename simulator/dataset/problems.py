"""What a scene source cannot use: refused, or written down and gone on without."""

from __future__ import annotations

from collections.abc import Sequence

from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.io.store import Place
from simulator.text import counted

PROBLEMS = "source_problems.txt"
_SHOWN = 20


def shortened(lines: Sequence[str], indent: str = "  ") -> str:
    """Return lines as text, of many only the first, and how many more there are."""
    more = len(lines) - _SHOWN
    shown = [*lines[:_SHOWN], *([f"and {more} more"] if more > 0 else [])]
    return "\n".join(f"{indent}{line}" for line in shown)


def refuse_problems(problems: Sequence[str]) -> None:
    """Refuse a source that cannot use some of its files.

    Raises:
        InputError: naming them and why.
    """
    if problems:
        raise InputError(
            "scene",
            f"its source has {counted(len(problems), 'problem')}:\n{shortened(problems)}\nmend or remove what is named, or "
            "leave it out: flatlight generate --skip-bad",
        )


def list_problems(root: Place, problems: Sequence[str]) -> str:
    """Write down what a source cannot use and return it as lines to be read."""
    write_atomic(root / PROBLEMS, "".join(f"{line}\n" for line in problems).encode())
    count = counted(len(problems), "problem")
    return f"{count} of the source, gone on without ({PROBLEMS} lists all):\n{shortened(problems)}"
