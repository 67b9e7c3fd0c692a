"""Functions that the engine tests send to worker processes, which import this file by name."""

import os
import signal
import sys
import time
from pathlib import Path

from simulator.errors import InputError

STATE = {"started": "no"}


class OneArgumentError(InputError):
    """An error of a user that cannot be unpickled."""

    def __init__(self, text: str) -> None:
        super().__init__("", text)


def initialize(word: str) -> None:
    STATE["started"] = word


def started(task: int) -> tuple[str, int]:
    return STATE["started"], os.getpid()


def square(task: int) -> int:
    return task * task


def threads(task: int) -> str:
    return ",".join(os.environ[f"{name}_NUM_THREADS"] for name in ("OMP", "OPENBLAS", "MKL"))


def die_once(task: tuple[int, str]) -> int:
    """Be killed in the middle of the task the first time it is tried."""
    number, folder = task
    marker = Path(folder) / f"tried-{number}"
    if number % 3 == 0 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.01)
    return number


def die_always(task: int) -> int:
    if task == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def leave(task: tuple[int, str]) -> int:
    """End the process, or try to, in the way that is named, unless the number is even."""
    number, way = task
    if number % 2:
        if way == "sys.exit":
            sys.exit(number // 2)  # 0 and 1
        if way == "named":
            try:
                sys.exit()
            except SystemExit as error:
                raise InputError("scene", "SystemExit") from error
        if way == "os._exit":
            os._exit(number // 2)
        if way == "MemoryError":
            raise MemoryError
        if way == "abort":
            os.abort()
        if way == "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        raise KeyboardInterrupt if way == "KeyboardInterrupt" else GeneratorExit
    return number


class SilentError(Exception):
    """An error whose message fails."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


def fail(task: int) -> int:
    if task == 1:
        raise ZeroDivisionError("one over nothing")
    if task == 2:
        raise InputError("camera.exposure", "got -1")
    if task == 3:
        raise OneArgumentError("one argument")
    if task == 4:
        raise SilentError
    return task


def unpicklable(task: int) -> object:
    return (lambda: task) if task == 1 else task


def sleep(task: float) -> float:
    time.sleep(task)
    return task


def sleep_and_tell(task: tuple[float, str]) -> None:
    seconds, folder = task
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(seconds)


def sleep_and_blame(task: tuple[float, str]) -> None:
    """The same, by somebody who takes whatever ends it for a fault of the user's code."""
    try:
        sleep_and_tell(task)
    except BaseException as error:
        raise InputError("scene", "ended") from error


def initializer_of_user_mistake() -> None:
    raise InputError("mask", "none such")


def initializer_that_breaks() -> None:
    raise KeyError("lost")


def initializer_that_dies() -> None:
    os._exit(3)


class SlowToImport:
    """A stand-in for a function of a module whose import takes a second."""

    def __call__(self, task: int) -> int:
        return task

    def __reduce__(self) -> tuple:
        return slow_import, ()


def slow_import() -> SlowToImport:
    if "slow" not in STATE:
        time.sleep(1)
        STATE["slow"] = "imported"
    return SlowToImport()
