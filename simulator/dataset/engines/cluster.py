"""The engine ``ray``: tasks on the nodes of a Ray cluster, each in a worker process of `local`, so that it may die or hang.

Ray runs what it was given at least once, and again where a node dies. A task therefore leaves what it makes on the disk, and
only what the function returns comes back.
"""

from __future__ import annotations

import atexit
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for_objects
from typing import Any

from simulator.config.schema import RayConfig
from simulator.dataset.engines.local import ONE_THREAD, Worker
from simulator.dataset.engines.stopping import stop_signals
from simulator.dataset.engines.tries import Death, FailedStarts, Failure, Job, Outcome, Reply, Tries, check_start
from simulator.errors import InputError
from simulator.text import described

_RETRIES = 3  # by Ray, of a task whose node or Ray worker dies: no fault of the task
_TICK_S = 0.5
_COUNT_EVERY_S = 10.0  # nodes come and go
_OBJECT_STORE_BYTES = 128 << 20  # of a cluster of our own; what a task returns is small


class _StartDeath(Death):
    """A worker that ended before it took a task."""


class _Slot:
    """This Ray worker's own worker process, kept from task to task."""

    def __init__(self) -> None:
        self._worker: Worker | None = None
        self._start = b""
        atexit.register(self._end)  # at exit Python would wait for it

    def attempt(self, start: bytes, payload: bytes, timeout_s: float | None, max_tasks: int) -> Reply | Death | Failure:
        """Try a task once; a ``Failure`` is the initializer's."""
        if self._worker is None or self._start != start or self._worker.tasks >= max_tasks:
            self._end()
            self._start = start
            try:
                self._worker = Worker(start, timeout_s)
            except OSError as error:
                return _StartDeath(described(error), killed=False)
            news = self._news(self._worker)
            if isinstance(news, Death):
                return _StartDeath(news.cause, news.killed)
            if news.failure is not None:
                self._end()
                return news.failure
        self._worker.give(payload)
        return self._news(self._worker)

    def _news(self, worker: Worker) -> Reply | Death:
        while (news := worker.look()) is None:
            left = worker.due - time.monotonic()
            wait_for_objects([worker.pipe], None if math.isinf(left) else max(0.0, left))
        if isinstance(news, Death):
            self._worker = None
        return news

    def _end(self) -> None:
        if self._worker is not None:
            self._worker.end()
            self._worker = None


_slot: _Slot | None = None


def attempt(start: bytes, payload: bytes, timeout_s: float | None, max_tasks: int) -> Reply | Death | Failure:
    """Try a task once in this Ray worker's own process."""
    global _slot
    _slot = _slot or _Slot()
    return _slot.attempt(start, payload, timeout_s, max_tasks)


@contextmanager
def connected(workers: int | None, settings: RayConfig | None) -> Iterator[None]:
    """Connect to a cluster, or start one on this machine, for the time of the block; an earlier connection is kept.

    Raises:
        InputError: Ray is not installed, or there is no such cluster.
    """
    ray = _package()
    if ray.is_initialized():
        yield
        return
    address = (settings and settings.address) or os.environ.get("RAY_ADDRESS") or "local"
    environment = dict(ONE_THREAD)
    options: dict[str, Any] = {}
    if address == "local":  # of the same machine: what is importable here is importable there
        environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
        options = {"num_cpus": workers, "object_store_memory": _OBJECT_STORE_BYTES, "include_dashboard": False}
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray would report its use to its makers
    os.environ.setdefault("RAY_task_oom_retries", "0")  # by Ray for ever, while the tries of a task are ours to count
    main = threading.current_thread() is threading.main_thread()
    ours = signal.getsignal(signal.SIGTERM)
    try:
        ray.init(
            address=address,
            runtime_env={"env_vars": environment},
            log_to_driver=False,
            logging_level="ERROR",
            **options,
        )
    except Exception as error:
        raise InputError(
            "dataset.ray.address",
            f"no Ray cluster at {address!r} ({described(error)}); start one (`ray start --head`), or leave the address "
            "out for a cluster on this machine",
        ) from error
    finally:
        if main:
            signal.signal(signal.SIGTERM, ours)  # Ray puts its own in its place
    try:
        yield
    finally:
        ray.shutdown()


def _package() -> Any:
    try:
        import ray
    except ImportError as error:
        raise InputError(
            "dataset.engine", f"ray is not installed ({error}); pip install 'flatlight[cluster]', or engine: local"
        ) from error
    return ray


class Cluster:
    """A run on a Ray cluster: the tasks that are under way there."""

    def __init__(
        self,
        tries: Tries,
        workers: int | None,
        start: bytes,
        timeout_s: float | None,
        max_tasks: int,
        settings: RayConfig | None,
    ) -> None:
        """Prepare a run on at most ``workers`` CPUs of the cluster, None for all of them; errors as `connected`."""
        self._ray = _package()
        self._tries, self._workers, self._settings = tries, workers, settings or RayConfig()
        self._start, self._timeout_s, self._max_tasks = start, timeout_s, max_tasks
        self._under_way: dict[Future[Any], tuple[Job, Any]] = {}  # each with its reference, by which Ray knows it
        self._failed_starts = FailedStarts()
        self._limit, self._counted = 0, -math.inf

    def outcomes(self) -> Iterator[Outcome]:
        """Yield the outcomes as they come; see `simulator.dataset.engines.run`."""
        ray, tries = self._ray, self._tries
        with stop_signals(), connected(self._workers, self._settings):
            options: dict[str, Any] = {"num_cpus": 1, "max_retries": _RETRIES, "resources": self._settings.resources}
            if self._settings.memory_gb is not None:
                options["memory"] = round(self._settings.memory_gb * 1e9)
            remote = ray.remote(**options)(attempt)
            start = ray.put(self._start)
            try:
                while True:
                    while len(self._under_way) < self._most() and len(tries.done) < self._limit and tries.waiting():
                        if (taken := tries.next()) is not None:
                            job, payload = taken
                            reference = remote.remote(start, payload, self._timeout_s, self._max_tasks)
                            self._under_way[reference.future()] = job, reference
                    if tries.done:
                        yield tries.done.popleft()
                        self._listen(0.0)
                        continue
                    tries.refuse_hopeless()
                    self._failed_starts.refuse_hopeless(sum(bool(node["Alive"]) for node in ray.nodes()))
                    if not self._under_way:
                        return
                    self._listen(_TICK_S)
            finally:
                for _, reference in self._under_way.values():
                    ray.cancel(reference, force=True)

    def _most(self) -> int:
        """Return how many tasks may be under way: one more for each CPU than it can do, so that none waits for the next."""
        if time.monotonic() - self._counted > _COUNT_EVERY_S:
            cpus = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
            self._limit = 2 * cpus if self._workers is None else min(self._workers, 2 * cpus)
            self._counted = time.monotonic()
        return self._limit

    def _listen(self, timeout_s: float) -> None:
        """Wait for news of tasks, at most ``timeout_s``, and act on it."""
        # Not ray.wait(), in which a signal that raises SystemExit ends the process at once.
        for future in wait(self._under_way, timeout_s, return_when=FIRST_COMPLETED).done:
            job, _ = self._under_way.pop(future)
            try:
                news = future.result()
            except self._ray.exceptions.RayTaskError as error:  # of a node that lacks what workers need, such as us
                news = _StartDeath(f"a node cannot make samples: {described(error.cause or error)}", killed=False)
            except self._ray.exceptions.OutOfMemoryError:
                cure = "give dataset.ray.memory_gb, so that fewer samples at a time are made on a node"
                self._tries.lose(job, Death(f"its node ran out of memory, and Ray ended it: {cure}", killed=True))
                continue
            except self._ray.exceptions.RayError as error:
                self._tries.lose(job, Death(f"its Ray worker ended: {described(error).splitlines()[0]}", killed=False))
                continue
            if isinstance(news, _StartDeath):
                self._tries.put_back(job)
                self._failed_starts.add(news.cause)
            elif isinstance(news, Failure):
                check_start(news)
            elif isinstance(news, Death):
                self._tries.lose(job, news)
            else:
                self._failed_starts.clear()
                self._tries.finish(job, news)
