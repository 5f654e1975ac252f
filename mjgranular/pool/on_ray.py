"""The engine `ray`: chunks are Ray tasks, on this machine or on all of its cluster."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from mjgranular._util.extras import require
from mjgranular.errors import GranularError, InputError
from mjgranular.pool.chunk import Function, run_chunk
from mjgranular.pool.versions import mismatch, versions
from mjgranular.pool.workers import Answer, Chunk, Done, Lost, Workers

# Chosen, not measured.
_CONNECT = 3.0  # [s] for the head's port to open
_ANSWER = 15.0  # [s] for the head's health check, by a process of Ray
_STORE = 128 * 2**20  # bytes of the object store of a Ray that we start: shared data and rows
_AHEAD = 2  # chunks per core, so that no core waits for us


class _Refused(NamedTuple):
    """A worker that cannot do the work, with the reason."""

    reason: str


def begin_ray(workers: Workers) -> tuple[Any, bool]:
    """Start a Ray session, or find the one that this process has.

    Args:
        workers: address; number of cores for a Ray on this machine.

    Returns:
        The module, and whether the session was started here, so that the caller must end it.

    Raises:
        MissingExtraError: Ray is not installed.
        InputError: no cluster answers at the address, or it is one of another version of Ray.
    """
    ray = require("ray", extra="ray", purpose="The engine ray")
    if ray.is_initialized():
        return ray, False
    common: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False}
    if workers.address is None:
        common |= {
            "num_cpus": workers.count or os.cpu_count(),
            "object_store_memory": _STORE,
            "include_dashboard": False,
            "address": "local",  # overrides RAY_ADDRESS
        }
    else:
        _check_answers(workers.address)
        common["address"] = workers.address
    try:
        with _signals_kept():
            ray.init(**common)
    except (ConnectionError, RuntimeError, ValueError) as error:
        said = " ".join(str(error).split())
        where = f"the cluster at {workers.address}" if workers.address else "this machine"
        raise InputError(f"Ray cannot be used on {where}: {said}") from None
    return ray, True


def cores_of(ray: Any) -> int:
    """Return the number of cores of all nodes of the session."""
    return max(1, int(ray.cluster_resources().get("CPU", 1)))


class RayPool:
    """Chunks as Ray tasks.

    An existing session of this process is used and left open; else one is started, and ended with
    the work.

    Args:
        function: function of the tasks; the workers import its module.
        shared: data for all of them, put into the object store once.
        workers: address and number of workers.

    Raises:
        MissingExtraError: Ray is not installed.
        InputError: no cluster answers at the address, or it is one of another version of Ray.
    """

    def __init__(self, function: Function, shared: Any, workers: Workers) -> None:
        self._ray, self._mine = begin_ray(workers)
        cores = cores_of(self._ray)
        self.count = min(workers.count or cores, cores)
        # Ray queues tasks beyond its cores; we queue those beyond the requested count.
        self.slots = self.count if self.count < cores else _AHEAD * cores
        self._work = self._ray.put((function, shared, versions()))
        # Retries of a chunk are not left to Ray: see `tasks`.
        self._run = self._ray.remote(num_cpus=1, max_retries=0)(_run)
        self._under_way: dict[Any, int] = {}

    def submit(self, key: int, chunk: Chunk) -> None:
        self._under_way[self._run.remote(self._work, chunk)] = key

    def wait(self) -> list[Done | Lost]:
        ready, _ = self._ray.wait(list(self._under_way), num_returns=1)
        return [self._result(ref, self._under_way.pop(ref)) for ref in ready]

    def _result(self, ref: Any, key: int) -> Done | Lost:
        errors = self._ray.exceptions
        try:
            found = self._ray.get(ref)
        except errors.RayTaskError as error:  # not from a task: those are caught
            raise InputError(_why(error)) from None
        except errors.RayError as error:
            told = " ".join(str(error).split()).partition(". ")[0]
            return Lost(key, f"its worker is gone ({type(error).__name__}: {told})")
        if isinstance(found, _Refused):
            raise InputError(found.reason)
        return Done(key, *found)

    def close(self) -> None:
        for ref in self._under_way:
            with suppress(Exception):  # the cluster is gone: nothing to end
                self._ray.cancel(ref, force=True)
        self._under_way.clear()
        if self._mine:
            self._ray.shutdown()


def _run(
    work: tuple[Function, Any, dict[str, Any]], chunk: Chunk
) -> tuple[list[Answer], float] | _Refused:
    """Process a chunk, in a Ray worker."""
    function, shared, expected = work
    different = mismatch(expected, versions())
    if different is not None:
        return _Refused(
            f"the worker on {socket.gethostname()} has other versions, so its results could be "
            f"other ones: {different}; install the same on all nodes"
        )
    return run_chunk(function, shared, chunk)


def _why(error: Any) -> str:
    """Return a sentence on why a worker could not begin."""
    cause = error.cause if isinstance(getattr(error, "cause", None), Exception) else error
    if isinstance(cause, GranularError):
        return str(cause)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    last = lines[-1] if lines else type(error).__name__
    if "ModuleNotFoundError" in str(error) or isinstance(cause, ImportError):
        return (
            f"a worker of Ray lacks a module that the tasks need, install it on all nodes: {last}"
        )
    return f"a worker of Ray cannot begin: {last}"


def _check_answers(address: str) -> None:
    """Check within seconds that a cluster answers at an address: Ray itself takes minutes.

    Raises:
        InputError: says what was tried.
    """
    asked = [sys.executable, "-m", "ray.scripts.scripts", "health-check"]
    if address != "auto":
        host, colon, port = address.rpartition(":")
        if "://" in address or not (colon and host and port.isdigit() and int(port) < 65536):
            raise InputError(
                f"the address of a Ray cluster is HOST:PORT of its head, such as 10.0.0.1:6379, or "
                f"auto, not {address!r}"
            )
        try:
            socket.create_connection((host, int(port)), timeout=_CONNECT).close()
        except OSError as error:
            raise InputError(
                f"nothing answers at {address} ({error.strerror or error}): is the head of the "
                "cluster up (ray start --head), and its port open from here?"
            ) from None
        asked += ["--address", address]
    try:
        done = subprocess.run(asked, capture_output=True, timeout=_ANSWER, check=False)
    except subprocess.TimeoutExpired:
        pass
    else:
        if done.returncode == 0:
            return
    where = "on this machine" if address == "auto" else f"at {address}"
    raise InputError(
        f"no Ray cluster answers {where} within {_ANSWER:g} s: ray start --head makes one, "
        "ray status says how it is"
    )


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Undo what Ray does to this process's signals, which end a run so that nothing is lost."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(number) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            if handler is not None:
                signal.signal(number, handler)
