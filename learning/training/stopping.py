"""Ends of a training before its time: a person's Ctrl-C, a cluster's SIGTERM, numbers that are none."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType

from simulator.errors import InputError


class DivergedError(InputError):
    """The loss or its gradient is no number any more; the weights before that step are kept."""


class Stop:
    """Whether somebody asked the training to stop."""

    def __init__(self) -> None:
        self.wanted = False


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turn the first Ctrl-C or SIGTERM into a wish that the loop sees after its step; the second acts at once."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():  # Python lets no other thread listen
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def ask(number: int, _: FrameType | None) -> None:
        stop.wanted = True
        signal.signal(number, signal.default_int_handler)

    for number in before:
        signal.signal(number, ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ignore_interrupts(_: int) -> None:
    """Let a worker of the loader live on after Ctrl-C, which the terminal sends to it too, until the loop has finished."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def unwrapped() -> Iterator[None]:
    """Give the message of bad input in a worker of the loader without the traceback that torch wraps it in."""
    try:
        yield
    except InputError as error:
        _, found, message = str(error).rpartition("Error: ")
        if not (found and str(error).startswith("Caught ")):
            raise
        raise InputError(message.strip()) from error


def diverged(
    step: int, terms: Mapping[str, float], gradient_norm: float, ids: Sequence[str], kept: str
) -> DivergedError:
    """Return the error of a step whose loss or gradient is not finite.

    Args:
        step: number of the step, which was not taken.
        terms: of the loss.
        gradient_norm: length of the gradient.
        ids: of the samples in the batch.
        kept: what can be gone on from.
    """
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in {**terms, "gradient": gradient_norm}.items())
    msg = (
        f"step {step}: the loss or its gradient is not finite ({numbers}) for samples {', '.join(ids)}; the step was not "
        f"taken, {kept}. A smaller optimiser.learning_rate or an optimiser.gradient_clip may help, in another output folder "
        "(start: goes on from a checkpoint); look at these samples first"
    )
    return DivergedError(msg)


def diverged_in_validation(step: int, metrics: Mapping[str, float], kept: str) -> DivergedError:
    """Return the error of a validation whose numbers are none.

    Args:
        step: after which it was made.
        metrics: of the validation.
        kept: what can be gone on from.
    """
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
    cure = "Try precision: float32, or a smaller optimiser.learning_rate, in another output folder"
    msg = f"validation after step {step} is not finite ({numbers}); {kept}. {cure}"
    return DivergedError(msg)
