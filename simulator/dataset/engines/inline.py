"""The engine ``inline``: tasks one after the other in this process; nothing protects it from one that hangs or dies."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from simulator.dataset.engines.stopping import stop_signals
from simulator.dataset.engines.tries import TRIES, GivenUpError, Outcome, is_tried_again, worded


def run_inline(
    function: Callable[[Any], Any],
    tasks: Iterable[Any],
    initializer: Callable[..., object] | None,
    initargs: tuple[Any, ...],
) -> Iterator[Outcome[Any, Any]]:
    """Yield the outcomes in the order of the tasks; see `simulator.dataset.engines.run`."""
    with stop_signals() as stop:
        if initializer is not None:
            try:
                initializer(*initargs)
            finally:
                stop.check()
        for task in tasks:
            attempts, error = 0, None
            while attempts == 0 or (is_tried_again(error) and attempts < TRIES):
                begin, value, error, text = time.perf_counter(), None, None, ""
                try:
                    value = function(task)
                except BaseException as caught:
                    if isinstance(caught, KeyboardInterrupt) and not stop.knows_ctrl_c:
                        raise
                    error, text = caught, traceback.format_exc()
                seconds = time.perf_counter() - begin
                attempts += 1
                stop.check()
            if error is not None and is_tried_again(error):
                error = GivenUpError(worded(error))
            assert isinstance(error, Exception | None)
            yield Outcome(task, value, error, text, attempts, seconds)
