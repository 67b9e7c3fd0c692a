"""What becomes of tasks: their outcomes, the tries that each is given, and the way of an exception between processes."""

from __future__ import annotations

import pickle
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

from simulator.errors import InputError
from simulator.text import described

Task = TypeVar("Task")
Result = TypeVar("Result")

TRIES = 3
"""Of a task that ends its process, tries to, does not finish in time or runs out of memory."""
IN_A_ROW = 3
"""Workers that die while they start, or tasks whose workers are killed: the next will not do better."""


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

    @property
    def reason(self) -> str:
        """Why it failed, and how often it was tried; empty where it did not."""
        tried = f" (tried {self.attempts} times)" if self.attempts > 1 else ""
        return "" if self.error is None else worded(self.error) + tried


class WorkerError(RuntimeError):
    """A task failed by something that is not the user's mistake."""


class GivenUpError(WorkerError):
    """A task ended its worker, tried to, did not finish in time or ran out of memory, whenever it was tried."""


class EngineError(RuntimeError):
    """The initializer failed by something that is not the user's mistake; no task can be done."""


def worded(error: BaseException) -> str:
    """Return what an error says that is meant to be read as it is; type and message of any other."""
    return str(error) if isinstance(error, InputError | WorkerError) else described(error)


@dataclass(frozen=True)
class Failure:
    """An exception on its way to the parent, in a form that always survives the way.

    Attributes:
        summary: what it says; see `worded`.
        traceback: the worker's traceback as text.
        mistake: the exception itself when it is an ``InputError``.
        again: whether the task is to be tried again; see `is_tried_again`.
    """

    summary: str
    traceback: str
    mistake: InputError | None
    again: bool


@dataclass(frozen=True)
class Reply:
    """What a worker sends back: a pickled value or a failure, and the seconds that the function took."""

    value: bytes
    failure: Failure | None
    seconds: float


@dataclass(frozen=True)
class Death:
    """What is known of a worker that ended in the middle of a task: how, and whether by SIGKILL."""

    cause: str
    killed: bool


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
    return Failure(worded(error), traceback.format_exc(), mistake, is_tried_again(error))


def is_tried_again(error: BaseException | None) -> bool:
    """Whether a task that raised this may do better: it tried to end its process (``sys.exit()``), or memory ran out.

    Also where that became an ``InputError``.
    """
    return any(
        isinstance(raised, MemoryError) or not isinstance(raised, Exception | None)
        for raised in (error, error and error.__cause__)
    )


def start_payload(
    function: Callable[..., object], initializer: Callable[..., object] | None, initargs: tuple[Any, ...]
) -> bytes:
    """Return for ``perform`` what prepares a worker; without an initializer the import of the function."""
    return pickle.dumps((_imported, (function,)) if initializer is None else (initializer, initargs))


def _imported(function: Callable[..., object]) -> None:
    """Do nothing: to get here the module was imported, which must not count as the first task's time."""


def check_start(failure: Failure | None) -> None:
    """Raise what an initializer raised.

    Raises:
        InputError: as it was raised.
        EngineError: anything else.
    """
    if failure is None:
        return
    if failure.mistake is not None:
        raise failure.mistake
    msg = f"worker processes cannot start: {failure.summary}\n{failure.traceback}"
    raise EngineError(msg)


class FailedStarts:
    """Workers that died before they took a task, counted until one does."""

    def __init__(self) -> None:
        self._causes: list[str] = []

    def clear(self) -> None:
        """Forget them: a worker has started."""
        self._causes.clear()

    def add(self, cause: str) -> None:
        """Count another one."""
        self._causes.append(cause)

    def refuse_hopeless(self, machines: int = 1) -> None:
        """Refuse to go on where the next will not do better on any of so many machines; after the outcomes are taken.

        Raises:
            InputError: with the last cause.
        """
        if len(self._causes) >= IN_A_ROW * machines:
            raise InputError(
                "workers",
                f"{len(self._causes)} in a row died while they started: {self._causes[-1]}; run once with engine "
                "inline to see why, and put a script that starts workers under `if __name__ == '__main__':`",
            )


@dataclass
class Job:
    """A task and how often it was tried."""

    task: Any
    attempts: int = 0


class Tries:
    """The tasks of a run that are still to be tried, and the outcomes that wait to be taken.

    Attributes:
        done: outcomes.
    """

    def __init__(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> None:
        self._function, self._source = function, iter(tasks)
        self._waiting: deque[Job] = deque()
        self.done: deque[Outcome[Any, Any]] = deque()
        self._killed = 0  # tasks in a row

    def waiting(self) -> bool:
        """Whether a task waits to be tried; another is taken from the source where none does."""
        if not self._waiting:
            self._waiting.extend(Job(task) for task in islice(self._source, 1))
        return bool(self._waiting)

    def next(self) -> tuple[Job, bytes] | None:
        """Return the next waiting task with its payload; None where it cannot be sent, which is its outcome."""
        job = self._waiting.popleft()
        try:
            return job, pickle.dumps((self._function, (job.task,)))
        except Exception as error:
            reason = f"the task cannot be sent to a worker process: {described(error)}"
            self.done.append(Outcome(job.task, None, WorkerError(reason)))
            return None

    def finish(self, job: Job, reply: Reply) -> None:
        """Take a worker's reply to a task."""
        self._killed = 0
        failure = reply.failure
        if failure is None:
            self.done.append(Outcome(job.task, pickle.loads(reply.value), None, "", job.attempts + 1, reply.seconds))
        elif failure.again:
            self._try_again(job, failure.summary, failure, reply.seconds)
        else:
            error = failure.mistake or WorkerError(failure.summary)
            self.done.append(Outcome(job.task, None, error, failure.traceback, job.attempts + 1, reply.seconds))

    def lose(self, job: Job, death: Death) -> None:
        """Take the news that a task's worker ended.

        Raises:
            InputError: workers are killed whatever they do.
        """
        self._killed += self._try_again(job, death.cause) and death.killed

    def put_back(self, job: Job) -> None:
        """Let a task wait again that no worker took."""
        self._waiting.appendleft(job)

    def refuse_hopeless(self) -> None:
        """Refuse to go on where workers are killed whatever they do; to be called once the outcomes are taken.

        Raises:
            InputError: for lack of memory, most likely.
        """
        if self._killed >= IN_A_ROW:
            raise InputError(
                "workers",
                f"they were killed over {self._killed} tasks in a row, each tried {TRIES} times, most likely because "
                "memory ran out; use fewer workers or smaller scenes",
            )

    def _try_again(self, job: Job, reason: str, failure: Failure | None = None, seconds: float = 0.0) -> bool:
        """Put a task back, or give it up after the last attempt; returns whether it was given up."""
        job.attempts += 1
        if job.attempts < TRIES:
            self._waiting.append(job)
            return False
        text = "" if failure is None else failure.traceback
        self.done.append(Outcome(job.task, None, GivenUpError(reason), text, job.attempts, seconds))
        return True
