"""Keeps the chatter of C++ libraries off the user's terminal.

OpenEXR prints to the process's file descriptor 2 and through Python's ``print`` when it meets a damaged file; the
errors that we raise say the same in words.
"""

from __future__ import annotations

import io
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

_LOCK = threading.RLock()  # two threads that swap descriptors at once would leave the wrong one in place


@contextmanager
def quiet() -> Iterator[None]:
    """Silence file descriptor 2 and ``print`` for the block.

    Descriptors belong to the whole process: what *another* thread writes to stderr (or prints) during the block, some
    milliseconds around one decode, is lost too. Blocks of several threads wait for each other.
    """
    with _LOCK:
        try:
            kept = os.dup(2)
        except OSError:  # a daemon without stderr has nothing to silence
            with redirect_stdout(io.StringIO()):
                yield
            return
        try:
            if sys.stderr is not None:
                sys.stderr.flush()
            sink = os.open(os.devnull, os.O_WRONLY)
            os.dup2(sink, 2)
            os.close(sink)
            with redirect_stdout(io.StringIO()):
                yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
