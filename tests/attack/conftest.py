"""Shared by the attacks: child processes that may crash, and the modules of `scripts/attacks`."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).resolve().parent
for folder in (HERE, HERE.parents[1] / "scripts"):
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))

import strangers  # noqa: E402

# What is run after a script of a test, which defines `run(*case)`: one case after the other.
_LOOP = """
import json, sys
for case in json.loads(sys.argv[1]):
    print(json.dumps({"case": case}), flush=True)
    print(json.dumps({"result": run(*case)}), flush=True)
"""


@pytest.fixture
def survive(tmp_path: Path) -> Callable[[str, Sequence[Any]], list[Any]]:
    """Run cases one after the other in a child process; return what each has returned.

    The process must come to its end: if it does not, the test reports the case it was at.
    """

    def survive(script: str, cases: Sequence[Any]) -> list[Any]:
        done = subprocess.run(
            [sys.executable, "-X", "faulthandler", "-c", script + _LOOP, json.dumps(list(cases))],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=1800,
        )
        rows = [json.loads(line) for line in done.stdout.splitlines()]
        at = rows[-1].get("case") if rows else None
        assert done.returncode == 0, f"ended with {done.returncode} at {at}\n{done.stderr[-3000:]}"
        return [row["result"] for row in rows if "result" in row]

    return survive


class Child:
    """A process that calls functions; when it dies the call raises, and the next begins another."""

    def __init__(self, folder: Path, guard: Callable[[], object]) -> None:
        self._folder, self._guard = folder, guard
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, strangers.begin, (self._folder,))
        self._pool.submit(self._guard).result()

    def __call__(self, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return self._pool.submit(function, *arguments).result()
        except BrokenProcessPool:
            self._start()
            raise

    def close(self) -> None:
        self._pool.shutdown()


@pytest.fixture(scope="module")
def child_with(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Child]]:
    """Start children that are prepared by a function of a module on the path."""
    children: list[Child] = []

    def start(guard: Callable[[], object]) -> Child:
        children.append(Child(tmp_path_factory.mktemp("child"), guard))
        return children[-1]

    yield start
    for child in children:
        child.close()
