"""Runs a function over many tasks: inline in this process, or local in worker processes that may die."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait as wait_for_objects
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any, Generic, TypeVar

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
        mistake = InputError(error.path, error.reason)
        try:  # a user's subclass may not survive pickling
            copy = pickle.loads(pickle.dumps(error))
            mistake = copy if type(copy) is type(error) and str(copy) == str(error) else mistake
        except Exception:
            pass
    return Failure(f"{type(error).__name__}: {error}", traceback.format_exc(), mistake, at_start)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for_objects([parent.sentinel])
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


Task = TypeVar("Task")
Result = TypeVar("Result")

ENGINES = ("inline", "local")
_RETRIES = 2  # a task whose worker died is tried three times in all
_BREAKDOWNS = 3  # pools in a row that broke down without finishing one task
_TICK_S = 0.5


@dataclass(frozen=True)
class Outcome(Generic[Task, Result]):
    """How one task went.

    Attributes:
        task: the task as given.
        value: what the function returned; None when ``error`` is set.
        error: None, or an ``InputError`` (as raised), ``WorkerError`` (anything else) or, inline, what was raised.
        traceback: the traceback of the error as text; empty without one.
        attempts: 1, or more when workers died on it.
        seconds: wall time inside the function.
    """

    task: Task
    value: Result | None
    error: Exception | None = None
    traceback: str = ""
    attempts: int = 1
    seconds: float = 0.0


class WorkerError(RuntimeError):
    """A task failed in a worker by something that is not the user's mistake, or its worker died."""


class EngineError(RuntimeError):
    """No worker can be started; no task can be done."""


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

    Only ``2 x workers`` tasks are taken from ``tasks`` ahead of their outcomes. Leaving the loop, Ctrl-C and SIGTERM
    stop the workers; wrap the call in ``contextlib.closing`` to have that happen at once on an exception of your own.

    Args:
        engine: ``inline`` or ``local``.
        function: called with one task; for ``local`` importable by name, as its results and tasks must be picklable.
        tasks: any iterable, also an endless one.
        workers: processes of ``local``; ``auto`` takes every CPU this process may use.
        initializer: called once per worker (or here) before its first task.
        initargs: its arguments.
        timeout_s: ``local`` only: seconds after which a task is stopped and reported as failed.
        max_tasks: ``local`` only: a worker is replaced after so many tasks, since renderers leak.

    Raises:
        InputError: unknown engine, senseless number of workers, or the initializer's own ``InputError``.
        EngineError: the initializer failed otherwise, or workers die before they finish any task.
    """
    if engine not in ENGINES:
        raise InputError("engine", f"expected one of {', '.join(ENGINES)}, got {engine!r}")
    if workers != "auto" and (not isinstance(workers, int) or isinstance(workers, bool) or workers < 1):
        raise InputError("workers", f"expected 'auto' or a whole number of at least 1, got {workers!r}")
    if engine == "inline":
        return _run_inline(function, tasks, initializer, initargs)
    try:
        pickle.dumps(function)
    except Exception as error:
        raise InputError(repr(function), f"cannot be sent to workers: must be importable by name ({error})") from error
    count = available_cpus() if isinstance(workers, str) else workers
    return _Local(function, tasks, count, initializer, initargs, timeout_s, max_tasks).outcomes()


def _run_inline(
    function: Callable[[Any], Any], tasks: Iterable[Any], initializer: Callable[..., object] | None, initargs: tuple
) -> Iterator[Outcome[Any, Any]]:
    with _sigterm_unwinds():
        if initializer is not None:
            initializer(*initargs)
        for task in tasks:
            begin = time.perf_counter()
            try:
                outcome = Outcome(task, function(task), seconds=time.perf_counter() - begin)
            except Exception as error:
                seconds = time.perf_counter() - begin
                outcome = Outcome(task, None, error, traceback.format_exc(), seconds=seconds)
            yield outcome


class _Local:
    """A pebble pool that is rebuilt when it breaks down as a whole (it does when a worker dies between two tasks)."""

    def __init__(
        self,
        function: Callable[[Any], Any],
        tasks: Iterable[Any],
        workers: int,
        initializer: Callable[..., object] | None,
        initargs: tuple[Any, ...],
        timeout_s: float | None,
        max_tasks: int,
    ) -> None:
        self._function, self._source, self._workers = function, iter(tasks), workers
        self._initializer, self._initargs = initializer, initargs
        self._timeout_s, self._max_tasks = timeout_s, max_tasks
        self._again: deque[_Job] = deque()
        self._running: dict[Future[Reply], _Job] = {}
        self._breakdowns = 0

    def outcomes(self) -> Iterator[Outcome[Any, Any]]:
        with _sigterm_unwinds():
            more = True
            while more:
                with self._pool() as pool:
                    more = yield from self._use(pool)

    @contextmanager
    def _pool(self) -> Iterator[Any]:
        from pebble import ProcessPool

        context: Any = WorkerContext()  # pebble's own protocol does not match the standard library's types
        pool = ProcessPool(
            max_workers=self._workers,
            max_tasks=self._max_tasks,
            initializer=start_worker,
            initargs=(self._initializer, self._initargs),
            context=context,
        )
        try:
            yield pool
        finally:
            pool.stop()
            context.terminate_all()
            pool.join()

    def _use(self, pool: Any) -> Iterator[Outcome[Any, Any]]:
        """Work with one pool; returns whether it broke down and another is needed."""
        while self._submit(pool):
            if not self._running:
                return False
            done, _ = wait(self._running, timeout=_TICK_S, return_when=FIRST_COMPLETED)
            for future in done:
                outcome = self._finish(future)
                if outcome is not None:
                    self._breakdowns = 0
                    yield outcome
        self._again.extend(self._running.values())
        self._running.clear()
        self._breakdowns += 1
        if self._breakdowns >= _BREAKDOWNS:
            msg = (
                f"worker processes died {_BREAKDOWNS} times before they finished any task. Run once with engine inline "
                "to see the reason; a script that starts workers needs `if __name__ == '__main__':` around its calls"
            )
            raise EngineError(msg)
        return True

    def _submit(self, pool: Any) -> bool:
        """Keep the pool fed; returns False when it is broken."""
        while len(self._running) < 2 * self._workers:
            job = self._again.popleft() if self._again else next((_Job(task) for task in self._source), None)
            if job is None:
                break
            try:
                payload = pickle.dumps((self._function, job.task))
            except Exception as error:
                failed: Future[Reply] = Future()
                failed.set_exception(error)
                self._running[failed] = job
                continue
            try:
                self._running[pool.schedule(perform, args=(payload,), timeout=self._timeout_s)] = job
            except RuntimeError:
                self._again.append(job)
                return False
        return pool.active if self._running else True

    def _finish(self, future: Future[Reply]) -> Outcome[Any, Any] | None:
        """Turn a future into an outcome, or None when the task is to be tried again."""
        from concurrent.futures.process import BrokenProcessPool

        from pebble import ProcessExpired

        job = self._running.pop(future)
        try:
            reply = future.result()
        except BrokenProcessPool:
            self._again.append(job)  # nobody knows whose fault it was
            return None
        except ProcessExpired as error:
            job.attempts += 1
            if job.attempts <= _RETRIES:
                self._again.append(job)
                return None
            reason = f"its worker process died {job.attempts} times, at last {_cause_of_death(error.exitcode)}"
            return Outcome(job.task, None, WorkerError(reason), attempts=job.attempts)
        except TimeoutError:
            reason = f"not finished after {self._timeout_s} s, so it was stopped"
            return Outcome(job.task, None, WorkerError(reason), attempts=job.attempts + 1)
        except Exception as error:
            reason = f"the task cannot be sent to a worker process: {error}"
            return Outcome(job.task, None, WorkerError(reason), attempts=job.attempts + 1)
        if reply.failure is None:
            return Outcome(job.task, pickle.loads(reply.value), attempts=job.attempts + 1, seconds=reply.seconds)
        error = _error_of(reply.failure)
        return Outcome(job.task, None, error, reply.failure.traceback, job.attempts + 1, reply.seconds)


def _error_of(failure: Failure) -> Exception:
    if failure.at_start:
        if failure.mistake is not None:
            raise failure.mistake
        msg = f"worker processes cannot start: {failure.summary}\n{failure.traceback}"
        raise EngineError(msg)
    return failure.mistake or WorkerError(failure.summary)


def _cause_of_death(code: int) -> str:
    if code >= 0:
        return f"with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    hint = " (usually the system ran out of memory: use fewer workers)" if name == "SIGKILL" else ""
    return f"by {name}{hint}"


@contextmanager
def _sigterm_unwinds() -> Iterator[None]:
    """Let SIGTERM leave through ``finally`` blocks like Ctrl-C does, unless the program handles it already."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return

    def stop(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
