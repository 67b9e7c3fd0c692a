"""Progress on a terminal, in a log and as JSON."""

import json
import re
import warnings
from types import SimpleNamespace

import pytest

from simulator import console
from simulator.console import Bar, JsonLog
from simulator.dataset.forecast import Facts


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A clock that the test moves."""
    now = SimpleNamespace(s=1000.0)
    monkeypatch.setattr(console.time, "monotonic", lambda: now.s)
    return now


def test_plain_lines_with_rate_time_left_failures_and_room(clock, capsys) -> None:
    with Bar() as bar:
        for done in range(0, 101, 10):
            bar.watch(Facts(2, done * 1e6, 100e6))
            bar.update("samples", done, 100)
            clock.s += 5
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "samples: 0 of 100, 0 bytes of 100 MB, 2 failed"
    assert lines[1] == "samples: 30 of 100, 2/s, 35 s left, 30 MB of 100 MB, 2 failed"
    assert lines[-1] == "samples: 100 of 100, 2/s, 100 MB of 100 MB, 2 failed"
    assert len(lines) == 5  # one in more than ten seconds, and the end


def test_a_terminal_shows_the_same_in_one_line(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "160")
    with Bar() as bar:
        bar.update("samples", 0, 10)
        bar.watch(Facts(1, 5e6, 10e6))
        bar.update("samples", 5, 10)
        bar.say("a [line] above")
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)
    assert "5/10" in text
    assert "5 MB of 10 MB, 1 failed" in text
    assert "a [line] above" in text


def test_json_lines(clock, capsys) -> None:
    with JsonLog() as log:
        log.update("samples", 0, 10)
        log.watch(Facts(0, 1.0, 2.0))
        clock.s += 2
        log.update("samples", 4, 10)
        clock.s += 2
        log.update("samples", 10, 10)
        warnings.warn("dim light", stacklevel=1)
        log.tell("end", made=10)
    out, err = capsys.readouterr()
    assert err == ""
    events = [json.loads(line) for line in out.splitlines()]
    assert [event["event"] for event in events] == ["progress", "progress", "message", "end"]
    assert {key: events[1][key] for key in ("stage", "done", "total", "per_s", "left_s", "bytes_made", "failed")} == {
        "stage": "samples", "done": 10, "total": 10, "per_s": 2.5, "left_s": 0.0, "bytes_made": 1.0, "failed": 0
    }  # fmt: skip
    assert events[2]["text"] == "warning: dim light"
    assert events[3]["made"] == 10
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}\+00:00", events[0]["time"])
