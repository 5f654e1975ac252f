"""The engine `ray`: tasks are Ray tasks, on this machine or on all of its cluster."""

import os
import signal
import socket
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

from mjgranular._util.checks import require
from mjgranular._util.result_folder import mismatch, versions
from mjgranular._util.signals import kept_signals
from mjgranular.errors import InputError
from mjgranular.pool.workers import Answer, Function, WorkerLostError, Workers, run_task

# Chosen, not measured.
_CONNECT = 3.0  # [s] for the head's port to open
_STORE = 128 * 2**20  # bytes of the object store of a Ray that we start: shared data and rows
_AHEAD = 4  # tasks per core, so that no core waits for us


class RayPool:
    """Tasks on Ray.

    An existing session of this process is used and left open; else one lasts as long as the work.
    """

    def __init__(self, function: Function, shared: Any, workers: Workers) -> None:
        self._ray = require("ray", extra="ray", purpose="The engine ray")
        self._mine = not self._ray.is_initialized()
        if self._mine:
            _start(self._ray, workers)
        cores = max(1, int(self._ray.cluster_resources().get("CPU", 1)))
        # Ray queues tasks beyond its cores; we queue those beyond the requested count.
        count = workers.count or cores
        self.slots = count if count < cores else _AHEAD * cores
        self._work = self._ray.put((function, shared, versions()))
        # Ray repeats a task whose node is gone; what `tasks` repeats is for tasks that kill.
        self._run = self._ray.remote(num_cpus=1, max_retries=1)(_run)
        self._references: dict[Future, Any] = {}

    def submit(self, task: Any) -> Future:
        reference = self._run.remote(self._work, task)
        future = reference.future()
        self._references[future] = reference
        return future

    def result(self, future: Future) -> Answer:
        del self._references[future]
        errors = self._ray.exceptions
        try:
            done = future.result()
        except errors.RayTaskError as error:  # not from a task: those are caught
            last = str(error).strip().splitlines()[-1]
            raise InputError(f"a worker of Ray cannot begin: {last}") from None
        except errors.RayError as error:
            raise WorkerLostError(f"its worker is gone ({type(error).__name__})") from None
        if isinstance(done, str):
            raise InputError(done)
        return done

    def close(self) -> None:
        for reference in self._references.values():
            with suppress(Exception):  # the cluster is gone: nothing to end
                self._ray.cancel(reference, force=True)
        self._references.clear()
        if self._mine:
            self._ray.shutdown()


def _start(ray: Any, workers: Workers) -> None:
    """Start Ray on this machine, or connect to the cluster at the address."""
    if workers.address is None:
        options = {
            "num_cpus": workers.count or os.cpu_count(),
            "object_store_memory": _STORE,
            "include_dashboard": False,
            "address": "local",  # overrides RAY_ADDRESS
        }
    else:
        if workers.address != "auto":
            _check_port(workers.address)
        options = {"address": workers.address}
    try:
        # Ray replaces handlers of these signals, with which nothing of a run is lost.
        with kept_signals(signal.SIGINT, signal.SIGTERM):
            ray.init(**options, logging_level="ERROR", log_to_driver=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        where = f"the cluster at {workers.address}" if workers.address else "this machine"
        raise InputError(f"Ray cannot be used on {where}: {reason}") from None


def _run(work: tuple[Function, Any, dict[str, Any]], task: Any) -> Answer | str:
    """Run a task in a Ray worker; return why it cannot, if it has other versions."""
    function, shared, expected = work
    different = mismatch(expected, versions())
    if different is not None:
        return (
            f"the worker on {socket.gethostname()} has other versions, so its results could be "
            f"other ones: {different}; install the same on all nodes"
        )
    return run_task(function, shared, task)


def _check_port(address: str) -> None:
    """Check within seconds that something listens at HOST:PORT: Ray itself takes minutes."""
    host, colon, port = address.rpartition(":")
    if "://" in address or not (colon and host and port.isdigit() and int(port) < 65536):
        raise InputError(
            f"the address of a Ray cluster is HOST:PORT of its head, such as "
            f"10.0.0.1:6379, or auto, got {address!r}"
        )
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECT).close()
    except OSError as error:
        raise InputError(
            f"nothing answers at {address} ({error.strerror or error}): is the head of the "
            "cluster up (ray start --head), and its port open from here?"
        ) from None
