"""The engine ``local``: worker processes on this machine, each with a pipe of its own, which may die or hang."""

from __future__ import annotations

import atexit
import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_objects

from simulator.dataset.engines.stopping import stop_signals
from simulator.dataset.engines.tries import Death, FailedStarts, Job, Outcome, Reply, Tries, check_start, perform
from simulator.text import described

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMEXPR")
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in _LIBRARIES}
_LAUNCH = threading.Lock()
_SPAWN = multiprocessing.get_context("spawn")
_TICK_S = 0.5
_START_S = 600.0  # for the initializer, or a task's time where that is longer
_GRACE_S = 1.0  # from the end of a worker's pipe to its own


def work(pipe: Connection, start: bytes) -> None:
    """Be a worker: perform the initializer, then one task after the other, and reply to each; the parent ends it."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):  # the parent hangs up
        pipe.send(perform(start))
        while True:
            pipe.send(perform(pipe.recv_bytes()))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_objects([parent.sentinel])
        os._exit(1)  # a half-written sample stays under a temporary name


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


class Worker:
    """A process that does one task at a time: its death is that task's alone.

    Attributes:
        ready: whether its initializer is done.
        tasks: how many it was given.
    """

    def __init__(self, start: bytes, timeout_s: float | None) -> None:
        """Start the process; it performs ``start`` and then takes tasks of so many seconds each."""
        self.pipe, theirs = _SPAWN.Pipe()
        self._process = _SPAWN.Process(target=work, args=(theirs, start))
        try:
            with _worker_environment():
                self._process.start()
        except BaseException:  # such as a Ctrl-C that came meanwhile
            if self._process.pid is not None:
                self._process.kill()
            raise
        finally:
            theirs.close()
        self.ready = False
        self.tasks = 0
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        self._allowed_s = max(self._timeout_s, _START_S)
        self.due = time.monotonic() + self._allowed_s

    def give(self, payload: bytes) -> None:
        """Send a task."""
        self.tasks, self._allowed_s = self.tasks + 1, self._timeout_s
        self.due = time.monotonic() + self._allowed_s
        with suppress(OSError):  # a dead one is found when its reply is asked for
            self.pipe.send_bytes(payload)

    def look(self) -> Reply | Death | None:
        """Return its reply, how it ended, or None while there is neither; after its time it is ended."""
        alive = self._process.is_alive()  # asked first: the last thing it did may have been to reply
        try:
            if self.pipe.poll():
                reply = self.pipe.recv()
                self.due = math.inf
                return reply
        except (EOFError, OSError):
            alive = False
        if not alive:
            code = self.end(_GRACE_S)
            return Death(f"the worker process ended {_cause_of_death(code)}", killed=code == -signal.SIGKILL)
        if time.monotonic() > self.due:
            self.end()
            return Death(f"not finished after {self._allowed_s:g} s, so it was stopped", killed=False)
        return None

    def end(self, grace_s: float = 0.0) -> int:
        """Make sure that the process has ended and return its exit code; nothing is lost that is not on the disk."""
        self._process.join(grace_s)
        self._process.kill()
        self._process.join()
        self.pipe.close()
        code = self._process.exitcode
        assert code is not None
        return code


class Pool:
    """Workers, and which task each of them has."""

    def __init__(self, tries: Tries, count: int, start: bytes, timeout_s: float | None, max_tasks: int) -> None:
        self._tries, self._count, self._start = tries, count, start
        self._timeout_s, self._max_tasks = timeout_s, max_tasks
        self._workers: dict[Worker, Job | None] = {}
        self._failed_starts = FailedStarts()

    def outcomes(self) -> Iterator[Outcome]:
        """Yield the outcomes as they come; see `simulator.dataset.engines.run`."""
        atexit.register(self._end)  # at exit Python would wait for the processes of a loop that was never left
        with stop_signals():
            try:
                while True:
                    left = self._hand_out()
                    if self._tries.done:
                        yield self._tries.done.popleft()
                        self._listen(0.0)
                        continue
                    self._tries.refuse_hopeless()
                    self._failed_starts.refuse_hopeless()
                    if not left:
                        return
                    self._listen(_TICK_S)
            finally:
                self._end()
                atexit.unregister(self._end)

    def _end(self) -> None:
        while self._workers:
            self._workers.popitem()[0].end()

    def _hand_out(self) -> bool:
        """Give every free worker a task and start missing ones; returns whether any task is left.

        Where outcomes wait to be taken, no more tasks are begun.
        """
        while len(self._tries.done) < self._count and self._tries.waiting():
            free = (worker for worker, job in self._workers.items() if worker.ready and job is None)
            worker = next(free, None)
            if worker is None:
                break
            if (taken := self._tries.next()) is not None:
                self._workers[worker], payload = taken
                worker.give(payload)
        waiting = len(self._tries.done) < self._count and self._tries.waiting()
        try:
            while waiting and len(self._workers) < self._count:
                self._workers[Worker(self._start, self._timeout_s)] = None
        except OSError as error:
            self._failed_starts.add(described(error))
        return waiting or any(job is not None for job in self._workers.values())

    def _listen(self, timeout_s: float) -> None:
        """Wait for replies, deaths and ends of time, at most ``timeout_s``, and act on them."""
        due = min((worker.due for worker in self._workers), default=math.inf) - time.monotonic()
        wait_for_objects([worker.pipe for worker in self._workers], max(0.0, min(timeout_s, due)))
        for worker, job in list(self._workers.items()):
            news = worker.look()
            if isinstance(news, Death):
                del self._workers[worker]
                if not worker.ready:
                    self._failed_starts.add(news.cause)
                elif job is not None:
                    self._tries.lose(job, news)
            elif news is not None and not worker.ready:
                check_start(news.failure)
                worker.ready = True
                self._failed_starts.clear()
            elif news is not None:
                assert job is not None
                self._workers[worker] = None
                if worker.tasks >= self._max_tasks:
                    del self._workers[worker]
                    worker.end()
                self._tries.finish(job, news)


def _cause_of_death(code: int) -> str:
    if code >= 0:
        return f"with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    hint = ", most likely because memory ran out: use fewer workers or smaller scenes" if name == "SIGKILL" else ""
    return f"by {name}{hint}"
