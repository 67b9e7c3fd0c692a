"""Other systems: the command says where it runs, and reading a data set needs nothing that only Unix has."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

# Other packages come first: they know their system by sys.platform, which still is what it is.
WITHOUT_UNIX = """
import os, signal, sys
import numpy, pydantic, shutil, subprocess, typer
import multiprocessing.connection
for name in ("fcntl", "grp", "posix", "pty", "pwd", "resource", "termios"):
    sys.modules[name] = None
for name in ("O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "fork", "getuid", "pread", "sched_getaffinity", "sysconf"):
    delattr(os, name)
for name in ("SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "SIGUSR1", "pthread_sigmask"):
    delattr(signal, name)
"""


def test_on_windows_the_command_is_one_line(flatlight, monkeypatch: pytest.MonkeyPatch) -> None:
    import simulator.cli  # noqa: F401 - before: typer would look for what only Windows has

    monkeypatch.setattr(sys, "platform", "win32")
    code, out, err = flatlight("--help")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "WSL 2" in err


def test_the_command_is_imported_without_unix(python: Callable) -> None:
    done = python("-c", f"{WITHOUT_UNIX}\nimport simulator.cli, learning.commands")
    assert done.returncode == 0, done.stderr


def test_a_data_set_is_read_and_verified_without_unix(python: Callable, trial) -> None:
    root: Path = trial.generate(dataset={"validation": 0, "test": 0, "train": 1})
    code = """
from simulator.dataset import open_dataset, verify
assert verify(sys.argv[1]).ok
print(open_dataset(sys.argv[1], "train")[0].measurement.shape)
"""
    done = python("-c", WITHOUT_UNIX + code, str(root))
    assert (done.returncode, done.stdout) == (0, "(3, 48, 60)\n"), done.stderr
