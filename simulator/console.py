"""What the terminal shows: progress, measured errors, the doctor's findings. Plain lines where it is no terminal."""

from __future__ import annotations

import sys
import time
import warnings
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from simulator.doctor import Check
    from simulator.optics.stack import PsfStack

_PLAIN_EVERY_S = 10.0


class Bar:
    """A progress bar with rate and time left; in a pipe or log a plain line every ten seconds.

    Warnings that the library raises meanwhile are shown as lines above it.
    """

    def __enter__(self) -> Self:
        from rich.console import Console

        self._console = Console(stderr=True, highlight=False)
        self._progress: Any = None
        self._tasks: dict[str, Any] = {}
        self._began: dict[str, tuple[float, int]] = {}
        self._last_line = 0.0
        self._warnings = warnings.catch_warnings()
        self._warnings.__enter__()
        warnings.showwarning = lambda message, *_, **__: self.say(f"warning: {message}")
        if self._console.is_terminal:
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (
                TextColumn("{task.description:>16}"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(),
            )
            self._progress = Progress(*columns, console=self._console)
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._progress is not None:
            self._progress.stop()
        self._warnings.__exit__(None, None, None)

    def update(self, stage: str, done: int, total: int) -> None:
        """Show that ``done`` of ``total`` are finished in a stage; stages appear as they come."""
        now = time.monotonic()
        began, first = self._began.setdefault(stage, (now, done))
        rate = (done - first) / (now - began) if now > began else 0.0
        shown = f"{rate:.2g}/s" if rate else ""
        if self._progress is not None:
            if stage not in self._tasks:
                self._tasks[stage] = self._progress.add_task(stage, total=total, rate="")
            self._progress.update(self._tasks[stage], completed=done, total=total, rate=shown)
        elif done == total or now - self._last_line > _PLAIN_EVERY_S:
            self._last_line = now
            left = f", {(total - done) / rate:.0f} s left" if rate and done < total else ""
            print(f"{stage}: {done} of {total}{', ' + shown if shown else ''}{left}", file=sys.stderr, flush=True)

    def say(self, line: str) -> None:
        """Print a line above the bar."""
        if self._progress is not None:
            self._console.print(line, markup=False)
        else:
            print(line, file=sys.stderr, flush=True)


def describe_stack(stack: PsfStack, sensor_shape: tuple[int, int], scene_shape: tuple[int, int]) -> str:
    """Return what is worth knowing of a PSF stack, with its measured errors, one line each."""
    from simulator.optics.error_budget.budget import budget_lines, read_budget
    from simulator.plots.psf_facts import psf_facts

    facts = psf_facts(stack, None, scene_shape, sensor_shape)
    width = max(len(what) for what, _ in facts)
    lines = [f"{what:>{width}}  {value}" for what, value in facts]
    budget = budget_lines(read_budget(stack))
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
