"""Locks against processes that take theirs with the system's own flock: alone, shared, waiting, and after a death."""

import errno
import fcntl
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from simulator.io import locks
from simulator.io.files import StorageError
from simulator.io.lines import open_locked
from simulator.io.locks import take_lock

HOLDER = """
import fcntl, sys
file = open(sys.argv[1], "ab")
fcntl.flock(file, int(sys.argv[2]))
print("held", flush=True)
sys.stdin.read()
"""
Held = Callable[[int], subprocess.Popen[str]]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "lock"


@pytest.fixture
def held(path: Path) -> Iterator[Held]:
    """Start a process that holds the lock of ``path`` until its input ends."""
    started: list[subprocess.Popen[str]] = []

    def hold(kind: int) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", HOLDER, str(path), str(kind)]
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout is not None
        assert process.stdout.readline() == "held\n"
        return process

    yield hold
    for process in started:
        with process:  # closes its pipes and waits for it
            process.kill()


def test_one_holds_it_alone(path: Path, held: Held) -> None:
    held(fcntl.LOCK_EX)
    with path.open("ab") as file:
        assert take_lock(file) is False
        assert take_lock(file.fileno(), shared=True) is False


def test_several_share_it(path: Path, held: Held) -> None:
    held(fcntl.LOCK_SH)
    with path.open("ab") as file, path.open("ab") as another:
        assert take_lock(file, shared=True) is True
        assert take_lock(another.fileno()) is False


def test_what_is_held_alone_can_be_shared_from_then_on(path: Path) -> None:
    with path.open("ab") as file, path.open("ab") as another:
        assert take_lock(file) is True
        assert take_lock(another, shared=True) is False
        assert take_lock(file, shared=True) is True
        assert take_lock(another, shared=True) is True


def test_a_folder_has_a_lock_and_closing_gives_it_back(tmp_path: Path) -> None:
    first, second = (os.open(tmp_path, os.O_RDONLY) for _ in range(2))
    assert take_lock(first) is True
    assert take_lock(second) is False
    os.close(first)
    assert take_lock(second) is True
    os.close(second)


def test_waits_until_it_is_given_back(path: Path, held: Held) -> None:
    holder = held(fcntl.LOCK_EX)
    taken: list[bool | None] = []
    with path.open("ab") as file:
        waiting = threading.Thread(target=lambda: taken.append(take_lock(file, wait=True)))
        waiting.start()
        waiting.join(0.2)
        assert taken == []
        assert holder.stdin is not None
        holder.stdin.close()
        waiting.join(30)
    assert taken == [True]


def test_a_killed_process_holds_nothing(path: Path, held: Held) -> None:
    holder = held(fcntl.LOCK_EX)
    with path.open("ab") as file:
        assert take_lock(file) is False
        holder.kill()
        holder.wait()
        assert take_lock(file) is True


@pytest.mark.parametrize("wait", [False, True])
def test_where_there_are_no_locks(path: Path, monkeypatch: pytest.MonkeyPatch, wait: bool) -> None:
    """On a file system that has none, and on a system without fcntl."""

    def answer(number: int) -> None:
        def refuse(*_: object) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(fcntl, "flock", refuse)

    with path.open("ab") as file:
        for number in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP):
            answer(number)
            assert take_lock(file, wait=wait) is None
        answer(errno.EIO)  # says nothing of locks
        with pytest.raises(OSError, match=os.strerror(errno.EIO)):
            take_lock(file, wait=wait)
        with pytest.raises(StorageError, match=os.strerror(errno.EIO)):
            open_locked(path, wait=wait)
        monkeypatch.setattr(locks, "fcntl", None)
        assert take_lock(file, wait=wait) is None
