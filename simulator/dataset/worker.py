"""What runs inside a worker process of the local engine, and how such a process is launched.

A worker computes with one thread, ignores Ctrl-C (the parent decides), and ends itself when its parent is gone.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from simulator.errors import InputError

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMEXPR")
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in _LIBRARIES}
_LAUNCH = threading.Lock()
_failed_start: Failure | None = None  # of this worker; set before its first task


@dataclass(frozen=True)
class Failure:
    """An exception on its way to the parent, in a form that always survives the way.

    Attributes:
        summary: type and message.
        traceback: the worker's traceback as text.
        mistake: the exception itself when it is an ``InputError``.
        at_start: whether the initializer raised it.
    """

    summary: str
    traceback: str
    mistake: InputError | None
    at_start: bool


@dataclass(frozen=True)
class Reply:
    """What a worker sends back: a pickled value or a failure, and the seconds that the function took."""

    value: bytes
    failure: Failure | None
    seconds: float


def start_worker(initializer: Callable[..., object] | None, initargs: tuple[Any, ...]) -> None:
    """Prepare this worker; a failing initializer is reported with the first task, since a pool would retry for ever."""
    global _failed_start
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if initializer is None:
        return
    try:
        initializer(*initargs)
    except Exception as error:
        _failed_start = _failure(error, at_start=True)


def perform(payload: bytes) -> Reply:
    """Run one pickled (function, task) in this worker and catch what it raises.

    Both ways are pickled here and not by the pool, which dies of what cannot be pickled or unpickled.
    """
    if _failed_start is not None:
        return Reply(b"", _failed_start, 0.0)
    begin = time.perf_counter()
    try:
        function, task = pickle.loads(payload)
        value = function(task)
        seconds = time.perf_counter() - begin
        return Reply(pickle.dumps(value), None, seconds)
    except Exception as error:
        return Reply(b"", _failure(error, at_start=False), time.perf_counter() - begin)


def _failure(error: Exception, at_start: bool) -> Failure:
    mistake = None
    if isinstance(error, InputError):
        mistake = InputError(str(error))
        try:  # a user's subclass may not survive pickling
            copy = pickle.loads(pickle.dumps(error))
            mistake = copy if type(copy) is type(error) and str(copy) == str(error) else mistake
        except Exception:
            pass
    return Failure(f"{type(error).__name__}: {error}", traceback.format_exc(), mistake, at_start)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)  # a half-written sample stays under a temporary name


class _WorkerProcess(SpawnProcess):
    def start(self) -> None:
        with _worker_environment():
            super().start()


class WorkerContext(SpawnContext):
    """A spawn context whose processes compute with one thread, and which remembers them."""

    def __init__(self) -> None:
        super().__init__()
        self._launched: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]  # noqa: N802
        """Make a process, as the pool asks for it."""
        self._launched = [process for process in self._launched if process.pid is None or process.is_alive()]
        self._launched.append(_WorkerProcess(*args, **kwargs))
        return self._launched[-1]

    def terminate_all(self) -> None:
        """Ask all workers to end, all at once: the pool would wait up to seconds for each in turn."""
        for process in self._launched:
            if process.pid is not None:
                process.terminate()


@contextmanager
def _worker_environment() -> Iterator[None]:
    """Set for one launch what a child inherits: one thread per library (read when it loads), Ctrl-C blocked."""
    with _LAUNCH:
        before = {name: os.environ.get(name) for name in ONE_THREAD}
        os.environ.update(ONE_THREAD)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
