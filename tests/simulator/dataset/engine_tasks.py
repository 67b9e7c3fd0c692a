"""Functions that the engine tests send to worker processes, which import this file by name."""

import os
import signal
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


def exit_hard(task: int) -> None:
    os._exit(7)


def fail(task: int) -> int:
    if task == 1:
        raise ZeroDivisionError("one over nothing")
    if task == 2:
        raise InputError("camera.exposure", "got -1")
    if task == 3:
        raise OneArgumentError("one argument")
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


def initializer_of_user_mistake() -> None:
    raise InputError("mask", "none such")


def initializer_that_breaks() -> None:
    raise KeyError("lost")


def initializer_that_dies() -> None:
    os._exit(3)
