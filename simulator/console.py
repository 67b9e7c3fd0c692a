"""What the terminal shows: progress, measured errors, the doctor's findings. Plain lines where it is no terminal."""

from __future__ import annotations

import json
import sys
import time
import warnings
from abc import ABC, abstractmethod
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Self

from simulator.text import duration, size

if TYPE_CHECKING:
    from simulator.dataset.forecast import Facts
    from simulator.doctor import Check
    from simulator.optics.stack import PsfStack

_PLAIN_EVERY_S = 10.0


class _Progress(ABC):
    """What bar and log share: warnings that the library raises become lines, rates are counted from a stage's beginning."""

    def __enter__(self) -> Self:
        self._began: dict[str, tuple[float, int]] = {}
        self._facts: Facts | None = None
        self._last = 0.0
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.showwarning = lambda message, *_, **__: self.say(f"warning: {message}")
        return self

    def __exit__(self, *_: object) -> None:
        self._warnings.__exit__(None, None, None)

    @abstractmethod
    def say(self, line: str) -> None:
        """Show a line."""

    def watch(self, facts: Facts) -> None:
        """Take what else is known of a job's samples, for the next ``update``."""
        self._facts = facts

    def _rate(self, stage: str, done: int) -> float:
        """Return how many are finished per second in a stage; 0 where it has only begun."""
        now = time.monotonic()
        began, first = self._began.setdefault(stage, (now, done))
        return (done - first) / (now - began) if now > began else 0.0

    def _due(self, done: int, total: int) -> bool:
        """Whether it is time for another line: every ten seconds, and at the end of a stage."""
        due = done == total or time.monotonic() - self._last > _PLAIN_EVERY_S
        if due:
            self._last = time.monotonic()
        return due


class Bar(_Progress):
    """A progress bar with rate and time left; in a pipe or log a plain line every ten seconds."""

    def __enter__(self) -> Self:
        from rich.console import Console

        super().__enter__()
        self._console = Console(stderr=True, highlight=False)
        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        if self._console.is_terminal:
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (
                TextColumn("{task.description:>16}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[facts]}"),
            )
            self._progress = Progress(*columns, console=self._console)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()
        super().__exit__()

    def update(self, stage: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` are finished in a stage; stages appear as they come."""
        rate = self._rate(stage, done)
        shown, facts = f"{rate:.2g}/s" if rate else "", self._facts_in_words()
        if self._progress is not None:
            if stage not in self._tasks:
                self._tasks[stage] = self._progress.add_task(stage, total=total, rate="", facts="")
            self._progress.update(self._tasks[stage], completed=done, total=total, rate=shown, facts=facts)
        elif self._due(done, total):
            left = f"{duration((total - done) / rate)} left" if rate and done < total else ""
            print(f"{stage}: {', '.join(filter(None, [f'{done} of {total}', shown, left, facts]))}", file=sys.stderr)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._progress is not None:
            # soft_wrap: the terminal wraps, and undoes it where one copies.
            self._console.print(line, markup=False, soft_wrap=True)
        else:
            print(line, file=sys.stderr, flush=True)

    def _facts_in_words(self) -> str:
        if self._facts is None:
            return ""
        made, expected = self._facts.bytes_made, self._facts.bytes_expected
        room = "" if made is None or expected is None else f"{size(made)} of {size(expected)}"
        return ", ".join(filter(None, [room, f"{self._facts.failed} failed" if self._facts.failed else ""]))


class JsonLog(_Progress):
    """The same as lines of JSON on stdout, for whatever watches jobs.

    ``event`` is progress or message, and at last end, error or stopped.
    """

    def update(self, stage: str, done: int, total: int) -> None:
        """Tell that ``done`` of ``total`` are finished in a stage."""
        rate = self._rate(stage, done)
        if self._due(done, total):
            left_s = round((total - done) / rate, 1) if rate else None
            facts = {} if self._facts is None else vars(self._facts)
            self.tell("progress", stage=stage, done=done, total=total, per_s=rate, left_s=left_s, **facts)

    def say(self, line: str) -> None:
        """Tell a line worth reading."""
        self.tell("message", text=line)

    def tell(self, event: str, **content: Any) -> None:
        """Write a line."""
        clock = datetime.now(UTC).isoformat(timespec="milliseconds")
        print(json.dumps({"time": clock, "event": event} | content, default=str), flush=True)


def describe_stack(stack: PsfStack, sensor_shape: tuple[int, int], scene_shape: tuple[int, int]) -> str:
    """Return what is worth knowing of a PSF stack, with its measured errors, one line each."""
    from simulator.optics.error_budget.budget import budget_lines
    from simulator.plots.psf_facts import psf_facts

    facts = psf_facts(stack, None, scene_shape, sensor_shape)
    width = max(len(what) for what, _ in facts)
    lines = [f"{what:>{width}}  {value}" for what, value in facts]
    budget = budget_lines(stack)
    return "\n".join([*lines, *([""] if budget else []), *budget])


def print_checks(checks: list[Check]) -> None:
    """Print the doctor's findings."""
    from rich.console import Console

    console = Console(highlight=False)
    marks = {"ok": "[green]ok[/]", "note": "[yellow]note[/]", "problem": "[red]problem[/]"}
    for check in checks:
        console.print(f"{marks[check.status]:>20} ", end="")
        console.print(f"{check.name}: {check.what}", markup=False)
        if check.advice:
            console.print(f"         {check.advice}", markup=False)
