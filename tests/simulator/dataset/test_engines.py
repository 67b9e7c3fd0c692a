"""Engines: every task gets exactly one outcome, whatever dies; nothing keeps running afterwards."""

import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from types import ModuleType

import pytest

from simulator.dataset.engines import (
    EngineError,
    GivenUpError,
    Outcome,
    WorkerError,
    _cgroup_quota,
    available_cpus,
    run,
)
from simulator.dataset.engines.tries import FailedStarts
from simulator.errors import InputError

HERE = Path(__file__).parent


@pytest.fixture
def tasks(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(HERE))  # workers inherit the path and so find the module by its name
    import engine_tasks  # type: ignore[import-not-found]

    yield engine_tasks
    sys.modules.pop("engine_tasks")


WORKERS = ["local", pytest.param("ray", marks=pytest.mark.slow)]
ALL = ["inline", *WORKERS]


@pytest.fixture
def engine(request: pytest.FixtureRequest, tasks: ModuleType) -> str:
    """The name of an engine; a Ray cluster for all tests is there when it is asked for."""
    if request.param == "ray":
        request.getfixturevalue("ray_cluster")
    return request.param


def by_task(outcomes: Iterator[Outcome]) -> dict:
    listed = list(outcomes)
    result = {outcome.task: outcome for outcome in listed}
    assert len(result) == len(listed), "a task was reported twice"
    return result


@pytest.mark.parametrize("engine", ALL, indirect=True)
def test_every_task_once_and_errors_stay_with_their_task(engine: str, tasks: ModuleType) -> None:
    found = by_task(run(engine, tasks.fail, range(6), workers=2))
    values = {0: 0, 1: None, 2: None, 3: None, 4: None, 5: 5}
    assert {task: outcome.value for task, outcome in found.items()} == values
    assert "one over nothing" in str(found[1].error)
    assert isinstance(found[1].error, ZeroDivisionError if engine == "inline" else WorkerError)
    assert 'raise ZeroDivisionError("one over nothing")' in found[1].traceback  # the line of the worker's own code
    assert type(found[2].error) is InputError
    assert str(found[2].error) == "camera.exposure: got -1"
    assert isinstance(found[3].error, InputError)
    assert str(found[3].error) == "one argument"
    assert type(found[4].error).__name__ == ("SilentError" if engine == "inline" else "WorkerError")
    assert "raise SilentError" in found[4].traceback
    assert found[5].error is None
    assert found[5].traceback == ""
    assert {outcome.attempts for outcome in found.values()} == {1}


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_workers_start_once_with_one_thread_and_are_recycled(
    engine: str, tasks: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    outcomes = run(
        engine, tasks.started, range(12), workers=1, initializer=tasks.initialize, initargs=("yes",), max_tasks=4
    )
    found = by_task(outcomes)
    assert {outcome.value[0] for outcome in found.values()} == {"yes"}
    assert len({outcome.value[1] for outcome in found.values()}) == 3  # 12 tasks, 4 per worker
    assert os.getpid() not in {outcome.value[1] for outcome in found.values()}
    assert {outcome.value for outcome in run(engine, tasks.threads, range(2), workers=1)} == {"1,1,1"}
    assert os.environ["OMP_NUM_THREADS"] == "5"  # ours is as it was


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_killed_workers_cost_only_their_own_task_a_second_try(engine: str, tasks: ModuleType, tmp_path: Path) -> None:
    found = by_task(run(engine, tasks.die_once, [(number, str(tmp_path)) for number in range(12)], workers=2))
    assert {task[0]: outcome.value for task, outcome in found.items()} == {number: number for number in range(12)}
    assert {task[0]: outcome.attempts for task, outcome in found.items()} == {n: 1 + (n % 3 == 0) for n in range(12)}


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_a_task_that_always_kills_its_worker_is_given_up(engine: str, tasks: ModuleType) -> None:
    found = by_task(run(engine, tasks.die_always, range(8), workers=2))
    assert {task for task, outcome in found.items() if outcome.error is None} == set(range(8)) - {3}
    assert isinstance(found[3].error, GivenUpError)
    assert "SIGKILL" in str(found[3].error)
    assert "memory" in str(found[3].error)
    assert found[3].attempts == 3


LEAVES = ["sys.exit", "named", "KeyboardInterrupt", "GeneratorExit", "MemoryError"]
CRASHES = {"os._exit": "exit code", "abort": "SIGABRT", "segfault": "SIGSEGV"}
WAYS = [
    *(("inline", way) for way in LEAVES),  # nothing protects it from crashes
    *(("local", way) for way in (*LEAVES, *CRASHES)),
    *(pytest.param("ray", way, marks=pytest.mark.slow) for way in ("sys.exit", "os._exit")),  # in processes of `local`
]


@pytest.mark.parametrize(("engine", "way"), WAYS, indirect=["engine"])
def test_a_task_that_leaves_is_tried_three_times_and_the_others_are_done(
    engine: str, way: str, tasks: ModuleType
) -> None:
    found = by_task(run(engine, tasks.leave, [(number, way) for number in range(6)], workers=2))
    assert {task[0]: outcome.value for task, outcome in found.items()} == dict.fromkeys((1, 3, 5)) | {0: 0, 2: 2, 4: 4}
    assert {task[0]: outcome.attempts for task, outcome in found.items()} == {n: 1 + 2 * (n % 2) for n in range(6)}
    for number in (1, 3, 5):
        outcome = found[number, way]
        assert type(outcome.error) is GivenUpError
        assert {"sys.exit": "SystemExit", "named": "SystemExit"}.get(way, way) in f"{outcome.error} {CRASHES}"
        assert CRASHES.get(way, "") in str(outcome.error)
        assert ("in leave\n" in outcome.traceback) == (way not in CRASHES)
    if way == "os._exit":
        assert "exit code 0" in str(found[1, way].error)
        assert "exit code 1" in str(found[3, way].error)


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_workers_that_are_killed_whatever_they_do_end_the_run(engine: str, tasks: ModuleType) -> None:
    """As the system does when memory runs out; more of the same would not help."""
    with pytest.raises(InputError, match=r"^workers: .*memory"):
        list(run(engine, tasks.die_always, itertools.repeat(3), workers=2))


@pytest.mark.parametrize("engine", ALL, indirect=True)
def test_failing_initializers_end_the_run(engine: str, tasks: ModuleType) -> None:
    with pytest.raises(InputError, match=r"^mask: "):
        list(run(engine, tasks.square, range(9), workers=2, initializer=tasks.initializer_of_user_mistake))
    error, words = (KeyError, "lost") if engine == "inline" else (EngineError, r"(?s)KeyError: 'lost'.*that_breaks")
    with pytest.raises(error, match=words):
        list(run(engine, tasks.square, range(9), workers=2, initializer=tasks.initializer_that_breaks))


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_workers_that_die_while_starting_end_the_run(engine: str, tasks: ModuleType) -> None:
    with pytest.raises(InputError, match=r"^workers: .*exit code 3"):
        list(run(engine, tasks.square, range(9), workers=2, initializer=tasks.initializer_that_dies))


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_a_task_that_takes_too_long_is_stopped_three_times(engine: str, tasks: ModuleType) -> None:
    found = by_task(run(engine, tasks.sleep, [30.0, 0.0, 0.01, 0.02], workers=2, timeout_s=0.4))
    assert isinstance(found[30.0].error, GivenUpError)
    assert "not finished after 0.4 s" in str(found[30.0].error)
    assert {task: outcome.attempts for task, outcome in found.items()} == {30.0: 3, 0.0: 1, 0.01: 1, 0.02: 1}
    assert [found[task].error for task in (0.0, 0.01, 0.02)] == [None] * 3


def test_the_import_of_a_function_is_not_its_first_task_s_time(tasks: ModuleType) -> None:
    (outcome,) = run("local", tasks.SlowToImport(), [3], workers=1, timeout_s=0.5)
    assert (outcome.value, outcome.attempts) == (3, 1)


def test_an_initializer_that_hangs_ends_the_run(tasks: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulator.dataset.engines.local._START_S", 0.2)
    with pytest.raises(InputError, match=r"^workers: .*not finished after 0\.5 s"):
        list(run("local", tasks.square, [1], workers=1, initializer=time.sleep, initargs=(60,), timeout_s=0.5))


@pytest.mark.parametrize("engine", WORKERS, indirect=True)
def test_results_and_functions_that_cannot_travel(engine: str, tasks: ModuleType) -> None:
    found = by_task(run(engine, tasks.unpicklable, range(3), workers=1))
    assert "pickle" in str(found[1].error)
    assert (found[0].value, found[2].value) == (0, 2)
    generators = [(number for number in range(1)) for _ in range(2)]
    for outcome in run(engine, tasks.square, generators, workers=1):
        assert "cannot be sent to a worker process" in str(outcome.error)
    with pytest.raises(InputError, match=r"<lambda>.*: "):
        run(engine, lambda task: task, range(3))
    with pytest.raises(InputError, match=r"square.*: "):
        run(engine, tasks.square, range(3), initializer=tasks.initialize, initargs=(lambda: 0,))
    for name, workers, key in (("dask", 1, "engine"), (engine, 0, "workers")):
        with pytest.raises(InputError, match=f"^{key}: "):
            run(name, tasks.square, range(3), workers=workers)


def test_endless_tasks_are_taken_a_few_at_a_time_and_leaving_stops_the_workers(tasks: ModuleType) -> None:
    taken = itertools.count()
    with closing(run("local", tasks.started, (next(taken) for _ in itertools.count()), workers=2)) as outcomes:
        pids = {next(outcomes).value[1] for _ in range(10)}
    assert next(taken) <= 10 + 2 * 2
    assert not [pid for pid in pids if alive(pid)]


def test_available_cpus_and_quotas(tmp_path: Path) -> None:
    assert 1 <= available_cpus() <= len(os.sched_getaffinity(0))
    assert _cgroup_quota(tmp_path) is None
    (tmp_path / "cpu").mkdir()
    (tmp_path / "cpu/cpu.cfs_period_us").write_text("100000\n")
    (tmp_path / "cpu/cpu.cfs_quota_us").write_text("-1\n")
    assert _cgroup_quota(tmp_path) is None
    (tmp_path / "cpu/cpu.cfs_quota_us").write_text("250000\n")
    assert _cgroup_quota(tmp_path) == 2.5
    (tmp_path / "cpu.max").write_text("max 100000\n")
    assert _cgroup_quota(tmp_path) is None
    (tmp_path / "cpu.max").write_text("150000 100000\n")
    assert _cgroup_quota(tmp_path) == 1.5


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"


PARENT = """
import sys
sys.path.insert(0, sys.argv[1])
import engine_tasks
from simulator.dataset.engines import run
if __name__ == "__main__":
    try:
        for outcome in run(sys.argv[3], engine_tasks.sleep_and_blame, [(60.0, sys.argv[2])] * 4, workers=2):
            print(outcome)
    except KeyboardInterrupt:
        print("interrupted")
        sys.exit(130)
"""


SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129, signal.SIGKILL: -9}


@pytest.mark.usefixtures("ctrl_c")
@pytest.mark.parametrize(
    ("engine", "number", "status"),
    [
        *((engine, *each) for engine in ("inline", "local") for each in SIGNALS.items()),
        # Ctrl-C reaches Ray's own processes, too, and SIGTERM has a handler of Ray's; SIGKILL: see test_kills.
        *(pytest.param("ray", one, SIGNALS[one], marks=pytest.mark.slow) for one in (signal.SIGINT, signal.SIGTERM)),
    ],
)
def test_the_user_ends_a_run_and_no_worker_outlives_it(
    engine: str, number: signal.Signals, status: int, tmp_path: Path
) -> None:
    (tmp_path / "parent.py").write_text(PARENT)
    told = tmp_path / "told"
    told.mkdir()
    parent = subprocess.Popen(
        [sys.executable, str(tmp_path / "parent.py"), str(HERE), str(told), engine],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 60
        while len(list(told.iterdir())) < (1 if engine == "inline" else 2):
            assert time.monotonic() < deadline, "the workers did not start"
            time.sleep(0.05)
        pids = [int(path.name) for path in told.iterdir()]
        if number == signal.SIGINT:
            os.killpg(parent.pid, number)  # the terminal sends it to the whole group
        else:
            parent.send_signal(number)
        output, errors = parent.communicate(timeout=30)
    finally:
        parent.kill()
    assert parent.returncode == status
    assert "Traceback" not in errors
    if number == signal.SIGINT:
        assert output == "interrupted\n"
    deadline = time.monotonic() + 10
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < deadline, "workers are still running"
        time.sleep(0.05)


def test_one_broken_machine_of_many_does_not_end_the_run() -> None:
    failed = FailedStarts()
    for _ in range(3):
        failed.add("no such package")
    failed.refuse_hopeless(machines=2)
    with pytest.raises(InputError, match=r"^workers: .*no such package"):
        failed.refuse_hopeless()
    failed.clear()
    failed.refuse_hopeless()


NO_MEMORY = """
import sys
sys.path.insert(0, sys.argv[1])
import engine_tasks
from simulator.dataset.engines import run
from simulator.errors import InputError
if __name__ == "__main__":
    try:
        for outcome in run("ray", engine_tasks.sleep, [30.0, 31.0, 32.0, 33.0], workers=2):
            print(outcome.attempts, outcome.error)
    except InputError as error:
        print(error)
"""


@pytest.mark.slow
def test_where_ray_finds_no_memory_tasks_are_not_tried_for_ever(tmp_path: Path) -> None:
    """Ray itself would start them again without end; here its monitor takes any use of memory for too much."""
    (tmp_path / "parent.py").write_text(NO_MEMORY)
    monitor = {"RAY_memory_usage_threshold": "0.0001", "RAY_memory_monitor_refresh_ms": "200"}
    run_it = [sys.executable, str(tmp_path / "parent.py"), str(HERE)]
    done = subprocess.run(run_it, env=os.environ | monitor, capture_output=True, text=True, timeout=120, check=True)
    *tasks, end = (line for line in done.stdout.splitlines() if "memory" in line and "(raylet)" not in line)
    assert len(tasks) >= 3
    assert all(line.startswith("3 its node ran out of memory") for line in tasks)
    assert end.startswith("workers: they were killed over")
