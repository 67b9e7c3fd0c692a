"""Runs a function over many tasks: inline in this process, or local in worker processes, which may die or hang."""

from __future__ import annotations

import atexit
import math
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for_objects
from pathlib import Path
from typing import Any, Generic, TypeVar

from simulator.errors import InputError
from simulator.text import described

_LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMEXPR")
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in _LIBRARIES}
_LAUNCH = threading.Lock()
_SPAWN = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class Failure:
    """An exception on its way to the parent, in a form that always survives the way.

    Attributes:
        summary: type and message.
        traceback: the worker's traceback as text.
        mistake: the exception itself when it is an ``InputError``.
        leaves: whether the code tried to end its process, as ``sys.exit()`` does.
    """

    summary: str
    traceback: str
    mistake: InputError | None
    leaves: bool


@dataclass(frozen=True)
class Reply:
    """What a worker sends back: a pickled value or a failure, and the seconds that the function took."""

    value: bytes
    failure: Failure | None
    seconds: float


def work(pipe: Connection, start: bytes) -> None:
    """Be a worker: perform the initializer, then one task after the other, and reply to each; the parent ends it."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):  # the parent hangs up
        pipe.send(perform(start))
        while True:
            pipe.send(perform(pipe.recv_bytes()))


def perform(payload: bytes) -> Reply:
    """Call a pickled (function, arguments) and catch all that it raises: in a worker no Ctrl-C is the user's."""
    begin = time.perf_counter()
    try:
        function, arguments = pickle.loads(payload)
        value = function(*arguments)
        seconds = time.perf_counter() - begin
        return Reply(pickle.dumps(value), None, seconds)
    except BaseException as error:
        return Reply(b"", _failure(error), time.perf_counter() - begin)


def _failure(error: BaseException) -> Failure:
    mistake = None
    if isinstance(error, InputError):
        mistake = InputError(error.path, error.reason)
        try:  # a user's subclass may not survive pickling
            copy = pickle.loads(pickle.dumps(error))
            mistake = copy if type(copy) is type(error) and str(copy) == str(error) else mistake
        except Exception:
            pass
    return Failure(described(error), traceback.format_exc(), mistake, _leaves(error))


def _leaves(error: BaseException | None) -> bool:
    """Whether code tried to end its process (``sys.exit()``, KeyboardInterrupt), also where that became an ``InputError``."""
    cause = None if error is None else error.__cause__
    return not isinstance(error, Exception | None) or not isinstance(cause, Exception | None)


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


Task = TypeVar("Task")
Result = TypeVar("Result")

ENGINES = ("inline", "local")
_TRIES = 3  # of a task that ends its worker, tries to, or does not finish in time
_IN_A_ROW = 3  # workers that die while they start, or tasks whose workers are killed: the next will not do better
_TICK_S = 0.5
_START_S = 600.0  # for the initializer, or a task's time where that is longer
_GRACE_S = 1.0  # from the end of a worker's pipe to its own


@dataclass(frozen=True)
class Outcome(Generic[Task, Result]):
    """How one task went.

    Attributes:
        task: the task as given.
        value: what the function returned; None when ``error`` is set.
        error: None, or an ``InputError`` (as raised), ``WorkerError`` (anything else) or, inline, what was raised.
        traceback: the traceback of the error as text; empty without one.
        attempts: how often it was tried.
        seconds: wall time inside the function, of the last attempt.
    """

    task: Task
    value: Result | None
    error: Exception | None = None
    traceback: str = ""
    attempts: int = 1
    seconds: float = 0.0


class WorkerError(RuntimeError):
    """A task failed by something that is not the user's mistake."""


class GivenUpError(WorkerError):
    """A task ended its worker, tried to, or did not finish in time, whenever it was tried."""


class EngineError(RuntimeError):
    """The initializer failed by something that is not the user's mistake; no task can be done."""


@dataclass
class _Job:
    task: Any
    attempts: int = 0


def available_cpus() -> int:
    """Return how many CPUs this process may use: its affinity, and its container's quota where there is one."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota = _cgroup_quota(Path("/sys/fs/cgroup"))
    return max(1, count if quota is None else min(count, int(quota)))


def _cgroup_quota(folder: Path) -> float | None:
    try:
        if (folder / "cpu.max").exists():
            used, period = (folder / "cpu.max").read_text().split()
        else:
            used = (folder / "cpu/cpu.cfs_quota_us").read_text().strip()
            period = (folder / "cpu/cpu.cfs_period_us").read_text()
        return None if used in ("max", "-1") else float(used) / float(period)
    except (OSError, ValueError, ZeroDivisionError):
        return None


def run(
    engine: str,
    function: Callable[[Task], Result],
    tasks: Iterable[Task],
    *,
    workers: int | str = "auto",
    initializer: Callable[..., object] | None = None,
    initargs: tuple[Any, ...] = (),
    timeout_s: float | None = None,
    max_tasks: int = 300,
) -> Iterator[Outcome[Task, Result]]:
    """Apply ``function`` to every task and yield the outcomes, in any order.

    Tasks are taken from ``tasks`` when a worker is free for them. One that ends its worker in any way, tries to
    (``sys.exit()``, KeyboardInterrupt) or does not finish in time is tried three times. Leaving the loop, Ctrl-C, SIGTERM
    and SIGHUP stop the workers; wrap the call in ``contextlib.closing`` to have that happen at once on an exception of your
    own.

    Args:
        engine: ``inline`` or ``local``; nothing protects ``inline`` from a task that hangs or ends the process outright.
        function: called with one task; for ``local`` importable by name, as its results and tasks must be picklable.
        tasks: any iterable, also an endless one.
        workers: processes of ``local``; ``auto`` takes every CPU this process may use.
        initializer: called once per worker (or here) before its first task.
        initargs: its arguments.
        timeout_s: ``local`` only: seconds after which a task's worker is stopped.
        max_tasks: ``local`` only: a worker is replaced after so many tasks, since renderers leak.

    Raises:
        InputError: unknown engine, senseless number of workers, what cannot be sent to workers, the initializer's own
            ``InputError``, or workers that die while they start or, for lack of memory, with every task.
        EngineError: the initializer failed otherwise.
    """
    if engine not in ENGINES:
        raise InputError("engine", f"expected one of {', '.join(ENGINES)}, got {engine!r}")
    if workers != "auto" and (not isinstance(workers, int) or isinstance(workers, bool) or workers < 1):
        raise InputError("workers", f"expected 'auto' or a whole number of at least 1, got {workers!r}")
    if engine == "inline":
        return _run_inline(function, tasks, initializer, initargs)
    try:
        pickle.dumps(function)
        start = pickle.dumps((initializer or _no_preparation, initargs))
    except Exception as error:
        raise InputError(
            repr(function), f"cannot be sent to workers: must be importable by name ({described(error)})"
        ) from error
    count = available_cpus() if isinstance(workers, str) else workers
    return _Pool(function, tasks, count, start, timeout_s, max_tasks).outcomes()


def _no_preparation() -> None:
    """Stand for an initializer."""


def _run_inline(
    function: Callable[[Any], Any], tasks: Iterable[Any], initializer: Callable[..., object] | None, initargs: tuple
) -> Iterator[Outcome[Any, Any]]:
    with _stop_signals() as stop:
        if initializer is not None:
            try:
                initializer(*initargs)
            finally:
                stop.check()
        for task in tasks:
            attempts, error = 0, None
            while attempts == 0 or (_leaves(error) and attempts < _TRIES):
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
            if not isinstance(error, Exception | None):
                error = GivenUpError(described(error))
            yield Outcome(task, value, error, text, attempts, seconds)


class _Worker:
    """A process with a pipe of its own, which does one task at a time: its death is that task's alone."""

    def __init__(self, start: bytes, timeout_s: float | None) -> None:
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
        self.ready = False  # whether its initializer is done
        self.job: _Job | None = None
        self.tasks = 0
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        self.allowed_s = max(self._timeout_s, _START_S)
        self.due = time.monotonic() + self.allowed_s

    def give(self, job: _Job, payload: bytes) -> None:
        self.job, self.tasks, self.allowed_s = job, self.tasks + 1, self._timeout_s
        self.due = time.monotonic() + self.allowed_s
        with suppress(OSError):  # a dead one is found when its reply is asked for
            self.pipe.send_bytes(payload)

    def reply(self) -> Reply | None:
        """Return its reply, or None while there is none.

        Raises:
            EOFError: the process has ended.
        """
        alive = self._process.is_alive()  # asked first: the last thing it did may have been to reply
        try:
            if self.pipe.poll():
                return self.pipe.recv()
        except OSError:
            alive = False
        if not alive:
            raise EOFError
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


class _Pool:
    """Workers, the tasks that they have and those to come."""

    def __init__(
        self,
        function: Callable[[Any], Any],
        tasks: Iterable[Any],
        count: int,
        start: bytes,
        timeout_s: float | None,
        max_tasks: int,
    ) -> None:
        self._function, self._source, self._count, self._start = function, iter(tasks), count, start
        self._timeout_s, self._max_tasks = timeout_s, max_tasks
        self._waiting: deque[_Job] = deque()
        self._workers: list[_Worker] = []
        self._done: deque[Outcome[Any, Any]] = deque()
        self._killed = 0  # tasks in a row
        self._failed_starts: list[str] = []  # in a row, by their cause

    def outcomes(self) -> Iterator[Outcome[Any, Any]]:
        atexit.register(self._end)  # at exit Python would wait for the processes of a loop that was never left
        with _stop_signals():
            try:
                while True:
                    left = self._hand_out()
                    if self._done:
                        yield self._done.popleft()
                        self._listen(0.0)
                        continue
                    self._refuse_hopeless()
                    if not left:
                        return
                    self._listen(_TICK_S)
            finally:
                self._end()
                atexit.unregister(self._end)

    def _end(self) -> None:
        while self._workers:
            self._workers.pop().end()

    def _hand_out(self) -> bool:
        """Give every free worker a task and start missing ones; returns whether any task is left.

        Where outcomes wait to be taken, no more tasks are begun.
        """
        while len(self._done) < self._count and (self._waiting or self._take()):
            worker = next((worker for worker in self._workers if worker.ready and worker.job is None), None)
            if worker is None:
                break
            job = self._waiting.popleft()
            try:
                worker.give(job, pickle.dumps((self._function, (job.task,))))
            except Exception as error:
                reason = f"the task cannot be sent to a worker process: {described(error)}"
                self._done.append(Outcome(job.task, None, WorkerError(reason)))
        try:
            while self._waiting and len(self._workers) < self._count:
                self._workers.append(_Worker(self._start, self._timeout_s))
        except OSError as error:
            self._failed_starts.append(described(error))
        return bool(self._waiting) or any(worker.job is not None for worker in self._workers)

    def _take(self) -> bool:
        self._waiting.extend(_Job(task) for task in islice(self._source, 1))
        return bool(self._waiting)

    def _listen(self, timeout_s: float) -> None:
        """Wait for replies, deaths and ends of time, for so long at most, and act on them."""
        due = min((worker.due for worker in self._workers), default=math.inf) - time.monotonic()
        wait_for_objects([worker.pipe for worker in self._workers], max(0.0, min(timeout_s, due)))
        for worker in list(self._workers):
            try:
                reply = worker.reply()
            except EOFError:
                code = worker.end(_GRACE_S)
                self._lose(worker, f"the worker process ended {_cause_of_death(code)}", killed=code == -signal.SIGKILL)
                continue
            if reply is not None and not worker.ready:
                _check_start(reply.failure)
                worker.ready, worker.due = True, math.inf
                self._failed_starts.clear()
            elif reply is not None:
                self._finish(worker, reply)
            elif time.monotonic() > worker.due:
                worker.end()
                self._lose(worker, f"not finished after {worker.allowed_s:g} s, so it was stopped")

    def _lose(self, worker: _Worker, cause: str, killed: bool = False) -> None:
        self._workers.remove(worker)
        if not worker.ready:
            self._failed_starts.append(cause)
        elif worker.job is not None:
            self._killed += self._try_again(worker.job, cause) and killed

    def _finish(self, worker: _Worker, reply: Reply) -> None:
        job, worker.job, worker.due = worker.job, None, math.inf
        assert job is not None
        self._killed = 0
        if worker.tasks >= self._max_tasks:
            self._workers.remove(worker)
            worker.end()
        failure = reply.failure
        if failure is None:
            self._done.append(Outcome(job.task, pickle.loads(reply.value), None, "", job.attempts + 1, reply.seconds))
        elif failure.leaves:
            self._try_again(job, failure.summary, failure, reply.seconds)
        else:
            error = failure.mistake or WorkerError(failure.summary)
            self._done.append(Outcome(job.task, None, error, failure.traceback, job.attempts + 1, reply.seconds))

    def _try_again(self, job: _Job, reason: str, failure: Failure | None = None, seconds: float = 0.0) -> bool:
        """Put a task back, or give it up after the last attempt; returns whether it was given up."""
        job.attempts += 1
        if job.attempts < _TRIES:
            self._waiting.append(job)
            return False
        error = failure.mistake if failure is not None and failure.mistake is not None else GivenUpError(reason)
        text = "" if failure is None else failure.traceback
        self._done.append(Outcome(job.task, None, error, text, job.attempts, seconds))
        return True

    def _refuse_hopeless(self) -> None:
        if self._killed >= _IN_A_ROW:
            raise InputError(
                "workers",
                f"they were killed over {self._killed} tasks in a row, each tried {_TRIES} times, most likely because "
                "memory ran out; use fewer workers or smaller scenes",
            )
        if len(self._failed_starts) >= _IN_A_ROW:
            raise InputError(
                "workers",
                f"{len(self._failed_starts)} in a row came to no task: {self._failed_starts[-1]}; run once with engine "
                "inline to see why, and put a script that starts workers under `if __name__ == '__main__':`",
            )


def _check_start(failure: Failure | None) -> None:
    if failure is None:
        return
    if failure.mistake is not None:
        raise failure.mistake
    msg = f"worker processes cannot start: {failure.summary}\n{failure.traceback}"
    raise EngineError(msg)


def _cause_of_death(code: int) -> str:
    if code >= 0:
        return f"with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    hint = ", most likely because memory ran out: use fewer workers or smaller scenes" if name == "SIGKILL" else ""
    return f"by {name}{hint}"


@dataclass
class _Stop:
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
def _stop_signals() -> Iterator[_Stop]:
    """Let SIGTERM and SIGHUP leave through ``finally`` blocks as Ctrl-C does, unless the program handles them already."""
    stop = _Stop()

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
