"""How the user ends a run: Ctrl-C, SIGTERM and SIGHUP leave through ``finally`` blocks, and differ from a task's own."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass
class Stop:
    """What Ctrl-C or a signal raised, to tell it from the same raised by a task.

    Attributes:
        raised: the exception; None as long as nobody asked for an end.
        knows_ctrl_c: whether every Ctrl-C would be seen here; if not, any KeyboardInterrupt may be one.
    """

    raised: BaseException | None = None
    knows_ctrl_c: bool = True

    def check(self) -> None:
        """Raise what was asked for, whatever has become of it on its way."""
        if self.raised is not None:
            raise self.raised from None


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Let SIGTERM and SIGHUP leave through ``finally`` blocks as Ctrl-C does, unless the program handles them already."""
    stop = Stop()

    def leave(number: int, _: object) -> None:
        stop.raised = KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)
        raise stop.raised

    main = threading.current_thread() is threading.main_thread()  # Python lets no other thread listen
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    if hasattr(signal, "SIGHUP"):
        usual[signal.SIGHUP] = signal.SIG_DFL
    ours = [number for number, handler in usual.items() if main and signal.getsignal(number) is handler]
    stop.knows_ctrl_c = not main or signal.SIGINT in ours or signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    for number in ours:
        signal.signal(number, leave)
    try:
        yield stop
    finally:
        for number in ours:
            signal.signal(number, usual[number])
