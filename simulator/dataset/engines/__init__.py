"""Runs a function over many tasks: in this process, in worker processes that may die or hang, or on a Ray cluster."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simulator.dataset.engines.inline import run_inline
from simulator.dataset.engines.local import Pool
from simulator.dataset.engines.tries import (
    EngineError,
    GivenUpError,
    Outcome,
    Result,
    Task,
    Tries,
    WorkerError,
    start_payload,
)
from simulator.errors import InputError
from simulator.text import described

if TYPE_CHECKING:
    from simulator.config.schema import RayConfig

__all__ = ["ENGINES", "EngineError", "GivenUpError", "Outcome", "WorkerError", "available_cpus", "ready", "run"]

ENGINES = ("inline", "local", "ray")


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
    ray: RayConfig | None = None,
) -> Iterator[Outcome[Task, Result]]:
    """Apply ``function`` to every task and yield the outcomes, in any order.

    Tasks are taken from ``tasks`` when a worker is free for them. One that ends its worker in any way, tries to
    (``sys.exit()``, KeyboardInterrupt), does not finish in time or runs out of memory is tried three times. Leaving the loop,
    Ctrl-C, SIGTERM and SIGHUP stop the workers; wrap the call in ``contextlib.closing`` to have that happen at once on an
    exception of your own.

    Args:
        engine: ``inline``, ``local`` or ``ray``; nothing protects ``inline`` from a task that hangs or ends the process
            outright.
        function: called with one task; for workers importable by name, as its results and tasks must be picklable.
        tasks: any iterable, also an endless one.
        workers: processes; ``auto`` takes every CPU this process may use, with ``ray`` every CPU of the cluster.
        initializer: called once per worker (or here) before its first task.
        initargs: its arguments.
        timeout_s: seconds after which a task's worker is stopped; not for ``inline``.
        max_tasks: a worker is replaced after so many tasks, since renderers leak; not for ``inline``.
        ray: for ``ray`` which cluster, and what a task needs of a node.

    Raises:
        InputError: unknown engine, senseless number of workers, what cannot be sent to workers, the initializer's own
            ``InputError``, workers that die while they start or, for lack of memory, with every task, or no such cluster.
        EngineError: the initializer failed otherwise.
    """
    if engine not in ENGINES:
        raise InputError("engine", f"expected one of {', '.join(ENGINES)}, got {engine!r}")
    if workers != "auto" and (not isinstance(workers, int) or isinstance(workers, bool) or workers < 1):
        raise InputError("workers", f"expected 'auto' or a whole number of at least 1, got {workers!r}")
    if engine == "inline":
        return run_inline(function, tasks, initializer, initargs)
    try:
        pickle.dumps(function)
        start = start_payload(function, initializer, initargs)
    except Exception as error:
        raise InputError(
            repr(function), f"cannot be sent to workers: must be importable by name ({described(error)})"
        ) from error
    tries, chosen = Tries(function, tasks), workers if isinstance(workers, int) else None
    if engine == "ray":
        from simulator.dataset.engines.cluster import Cluster

        return Cluster(tries, chosen, start, timeout_s, max_tasks, ray).outcomes()
    return Pool(tries, chosen or available_cpus(), start, timeout_s, max_tasks).outcomes()


@contextmanager
def ready(engine: str, workers: int | str, ray: RayConfig | None) -> Iterator[None]:
    """Keep the cluster of engine ``ray`` connected over several runs, which would each start one; errors as `run`."""
    with ExitStack() as stack:
        if engine == "ray":
            from simulator.dataset.engines.cluster import connected

            stack.enter_context(connected(workers if isinstance(workers, int) else None, ray))
        yield


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
